"""The fluid among frequencies: diffusion, projection, symmetry, memory, and a version of the step in NumPy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.fft
import typer
from typer.testing import CliRunner

import ebb
import fluids_fft
from backends import BACKENDS, lacking, require
from ebb.runtime.device import current_device
from fluids_fft import FORCE, RADIUS, VISCOSITY, Fluid, drag, stroke

EXAMPLES = Path(fluids_fft.__file__).parent


@pytest.fixture(params=BACKENDS)
def backend(request):
    if lacking(request.param):
        pytest.skip(lacking(request.param))
    with ebb.backend(request.param):
        yield request.param


def set_velocity(fluid, u, v):
    fluid.grid.cells.u.load(np.broadcast_to(u, (fluid.n, fluid.n)).astype(np.float32))
    fluid.grid.cells.v.load(np.broadcast_to(v, (fluid.n, fluid.n)).astype(np.float32))


def spectrum(fluid, name):
    return fluids_fft.complex_numbers(fluid.frequencies.fields[name].view()).copy()


def waves(n):
    """The wave numbers of a transform of n x n reals, with those of the highest wave positive, as the sample has it."""
    i, j = np.arange(n)[:, None], np.arange(n // 2 + 1)[None, :]
    return np.where(2 * i <= n, i, i - n), j


def random_flow(fluid, seed=0, size=0.1):
    noise = np.random.default_rng(seed)
    set_velocity(fluid, *(size * noise.standard_normal((2, fluid.n, fluid.n))))


# ---- An independent version of the step, in float64 ----


class Sample:
    """What the CUDA sample does, in NumPy."""

    def __init__(self, n, positions, dt=0.09, viscosity=0.0025):
        self.n, self.dt, self.viscosity = n, dt, viscosity
        self.w = np.zeros((n, n, 2))
        self.p = positions.astype(np.float64)

    def push(self, place, change):
        at = [int(x * self.n) for x in place]
        for x in range(-4, 5):
            for y in range(-4, 5):
                self.w[(at[0] + x) % self.n, (at[1] + y) % self.n] += np.array(change) / (1 + x**4 + y**4)

    def step(self):
        n, index = self.n, np.stack(np.meshgrid(*[np.arange(self.n)] * 2, indexing="ij"), axis=-1)
        before = index - self.dt * n * self.w
        low = np.floor(before).astype(int)
        share = before - low
        carried = np.zeros_like(self.w)
        for corner in np.ndindex(2, 2):
            weight = np.prod(np.where(corner, share, 1 - share), axis=-1)
            near = (low + corner) % n
            carried += weight[..., None] * self.w[near[..., 0], near[..., 1]]
        kx, ky = waves(n)
        square = kx * kx + ky * ky
        u, v = (scipy.fft.rfft2(carried[..., c]) / (1 + self.viscosity * self.dt * square) for c in (0, 1))
        along = (kx * u + ky * v) / np.maximum(square, 1)
        back = [scipy.fft.irfft2(x, (n, n)) for x in (u - kx * along, v - ky * along)]
        self.w = np.stack(back, axis=-1)
        cell = np.floor(self.p * n).astype(int) % n
        self.p = (self.p + self.dt * self.w[cell[:, 0], cell[:, 1]]) % 1


@pytest.mark.parametrize("n", [16, 21])
def test_a_step_is_that_of_the_sample(backend, n):
    fluid = Fluid(n)
    sample = Sample(n, fluid.particles.pos.to_numpy())
    for number in range(3):
        place, way = stroke(20 * number)
        change = [FORCE * n * 0.09 * along for along in way]
        fluid.push(place, change)
        sample.push(place, change)
        fluid.step()
        sample.step()
        np.testing.assert_allclose(fluid.velocity(), sample.w, atol=2e-5 * np.abs(sample.w).max())
    moved = np.abs(fluid.particles.pos.to_numpy() - sample.p)
    assert np.minimum(moved, 1 - moved).max() < 1e-5
    assert np.abs(sample.w).max() > 0.01


def test_positions_stay_in_the_square(backend):
    fluid = Fluid(8)
    set_velocity(fluid, 3.7, -5.3)
    for _ in range(4):
        fluid.step()
    positions = fluid.particles.pos.to_numpy()
    assert (positions >= 0).all() and (positions <= 1).all()


# ---- Diffusion and projection ----


@pytest.mark.parametrize("k", [1, 3, 7])
def test_a_wave_decays_by_the_factor_of_its_frequency(backend, k):
    fluid = Fluid(16, viscosity=0.1)
    y = (np.arange(16) + 0.5) / 16
    for turned in (False, True):
        wave = np.sin(2 * np.pi * k * y)  # across the direction of the flow, so that it carries nothing on
        set_velocity(fluid, *((0, wave[:, None]) if turned else (wave, 0)))
        fluid.step()
        fluid.step()
        expected = wave / (1 + 0.1 * 0.09 * k * k) ** 2
        found = fluid.velocity()[..., int(turned)]
        np.testing.assert_allclose(
            found, np.broadcast_to(expected[:, None] if turned else expected, (16, 16)), atol=1e-6
        )
        np.testing.assert_allclose(fluid.velocity()[..., int(not turned)], 0, atol=1e-6)


@pytest.mark.parametrize("n", [15, 16])
def test_no_divergence_is_left(backend, n):
    fluid = Fluid(n)
    random_flow(fluid)
    fluid.advect()
    for name in ("u", "v"):
        fluid.transforms.forward(fluid.grid.cells.fields[f"carried_{name}"], fluid.frequencies.fields[name])
    kx, ky = waves(n)
    before = kx * spectrum(fluid, "u") + ky * spectrum(fluid, "v")
    fluid.diffuse_and_project()
    after = kx * spectrum(fluid, "u") + ky * spectrum(fluid, "v")
    assert np.abs(after).max() < 1e-6 * np.abs(before).max()


def test_the_mean_velocity_is_kept(backend):
    fluid = Fluid(16)
    random_flow(fluid)
    fluid.advect()
    mean = [fluid.grid.cells.fields[f"carried_{name}"].to_numpy().mean(dtype=float) for name in ("u", "v")]
    fluid.solve()
    np.testing.assert_allclose(fluid.velocity().mean(axis=(0, 1), dtype=float), mean, atol=1e-8)


def test_what_has_no_divergence_is_only_diffused(backend):
    fluid = Fluid(16, viscosity=0.0)
    x, y = np.meshgrid((np.arange(16) + 0.5) / 16, (np.arange(16) + 0.5) / 16, indexing="ij")
    u, v = np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y), -np.cos(2 * np.pi * x) * np.sin(2 * np.pi * y)
    fluid.grid.cells.carried_u.load(u.astype(np.float32))
    fluid.grid.cells.carried_v.load(v.astype(np.float32))
    fluid.solve()
    np.testing.assert_allclose(fluid.velocity(), np.stack([u, v], axis=-1), atol=1e-6)


# ---- Symmetry ----


def test_a_symmetric_force_makes_a_symmetric_flow(backend):
    # With an odd number of cells no wave is its own opposite, and the grid has a cell in its middle.
    n = 17
    middle = (0.5, 0.5)
    fluid = Fluid(n)
    fluid.push(middle, (0.6, 0.0))
    for _ in range(3):
        fluid.step()
    u, v = np.moveaxis(fluid.velocity(), -1, 0)
    size = np.abs(u).max()
    np.testing.assert_allclose(u, u[:, ::-1], atol=1e-5 * size)
    np.testing.assert_allclose(v, -v[:, ::-1], atol=1e-5 * size)
    turned = Fluid(n)
    turned.push(middle, (0.0, 0.6))
    for _ in range(3):
        turned.step()
    np.testing.assert_allclose(turned.velocity()[..., 1], u.T, atol=1e-5 * size)
    np.testing.assert_allclose(turned.velocity()[..., 0], v.T, atol=1e-5 * size)


def test_the_brush_reaches_over_the_edge(backend):
    fluid = Fluid(20)
    fluid.push((0.01, 0.99), (2.0, -1.0))
    u, v = np.moveaxis(fluid.velocity(), -1, 0)
    assert (u[0, 19], v[0, 19]) == (2.0, -1.0)
    assert (u[19, 0], v[1, 18]) == pytest.approx((2 / 3, -1 / 3))
    assert np.count_nonzero(u) == (2 * RADIUS + 1) ** 2
    assert u.sum() == pytest.approx(-2 * v.sum())


# ---- Memory ----


def test_transforms_read_and_write_the_memory_of_fields(monkeypatch):
    fluid = Fluid(24, threads=2)
    cells, frequencies = fluid.grid.cells, fluid.frequencies
    random_flow(fluid)
    fluid.step()
    own = {(each.address, each.buffer.nbytes) for each in (*cells.fields.values(), *frequencies.fields.values())}
    touched = []

    def watched(function):
        def call(values, *arguments, out=None, **named):
            found = (
                function(values, *arguments, **named) if out is None else function(values, *arguments, out=out, **named)
            )
            touched.extend((values, found))
            return found

        return call

    for module, name in ((np.fft, "rfft"), (np.fft, "irfft")):
        monkeypatch.setattr(module, name, watched(getattr(module, name)))
    fluid.transforms._columns = tuple(map(watched, fluid.transforms._columns))
    fluid.step()
    assert len(touched) == 2 * 4 * (2 + 1)  # rows in two shares, columns, for four transforms
    for array in touched:
        at = fluids_fft.address(array)
        assert any(start <= at and at + array.nbytes <= start + nbytes for start, nbytes in own)
    assert fluid.transforms.copies == 0 and fluid.transforms.package == "SciPy"


def test_without_scipy_columns_are_transformed_in_place_too(monkeypatch):
    expected = Fluid(12)
    monkeypatch.setitem(sys.modules, "scipy.fft", None)
    monkeypatch.delattr(scipy, "fft")
    fluid = Fluid(12)
    assert fluid.transforms.package == "NumPy"
    for each in (expected, fluid):
        random_flow(each)
        each.step()
    np.testing.assert_allclose(fluid.velocity(), expected.velocity(), atol=1e-6)
    assert fluid.transforms.copies == 0


MEASURED = """
import resource, sys
import ebb, fluids_fft
def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()
small = fluids_fft.Fluid(16)
fluids_fft.drag(small, 0, fluids_fft.FORCE)
small.step()
own, before, n = ebb.memory().host_bytes, resident(), 1536
fluid = fluids_fft.Fluid(n)
for number in range(2):
    fluids_fft.drag(fluid, number, fluids_fft.FORCE)
    fluid.step()
print((ebb.memory().host_bytes - own) / n**2, (resident() - before) / n**2)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it reads /proc")
def test_a_cell_takes_little_memory(tmp_path):
    command, variables = [sys.executable, "-c", MEASURED], os.environ | {"EBB_CACHE_DIR": str(tmp_path)}
    for _ in range(2):  # the first compiles, which takes memory, but not for cells
        done = subprocess.run(command, cwd=EXAMPLES, env=variables, capture_output=True, text=True, check=True)
    fields, process = map(float, done.stdout.split())
    assert fields < 33  # 16 for the velocity now and carried on, 8 for its transform, 8 for a particle
    assert process < 56


# ---- On a device ----


@pytest.fixture
def device():
    pytest.importorskip("reikna")
    require("opencl")
    with ebb.backend("opencl"):
        yield


@pytest.mark.parametrize("n", [9, 16])
def test_a_device_transforms_as_the_host_does(device, n):
    expected, fluid = Fluid(n), Fluid(n, transforms=fluids_fft.DeviceTransforms())
    for each in (expected, fluid):
        random_flow(each)
        for _ in range(2):
            each.step()
    np.testing.assert_allclose(fluid.velocity(), expected.velocity(), atol=1e-6)
    np.testing.assert_allclose(fluid.particles.pos.to_numpy(), expected.particles.pos.to_numpy(), atol=1e-6)


def test_a_device_transforms_in_the_memory_of_kernels(device, monkeypatch):
    fluid = Fluid(16, transforms=fluids_fft.DeviceTransforms())
    random_flow(fluid)
    fluid.step()
    own = current_device()
    moved, upload, download = [], own.upload, own.download
    monkeypatch.setattr(own, "upload", lambda target, source: (moved.append(source), upload(target, source)))
    monkeypatch.setattr(own, "download", lambda source, target: (moved.append(target), download(source, target)))
    fluid.step()
    least = min(16 * 16 * 4, 16 * 9 * 8)
    assert all(array.nbytes < least for array in moved)  # but whether a check has failed
    fields = [*fluid.grid.cells.fields.values(), *fluid.frequencies.fields.values()]
    handles = {field.path: field.buffer.on(own).buffer.int_ptr for field in fields}
    assert fluid.transforms.memory == handles and len(handles) == 6


def test_the_program_says_where_it_transforms(monkeypatch):
    require("opencl")
    words = ("--grid", "8", "--steps", "2", "--backend", "opencl")
    monkeypatch.setattr(fluids_fft, "transforms_on", lambda backend: None)
    assert "moved to and from the device" in run_program(*words).output
    pytest.importorskip("reikna")
    monkeypatch.undo()
    assert "by reikna on the device" in run_program(*words).output


# ---- Backends and the program ----


def test_any_number_of_threads_gives_the_same_bits():
    found = []
    for threads in (1, 2, 5):
        with ebb.backend("cpu", threads=threads):
            fluid = Fluid(96)
            for number in range(3):
                drag(fluid, 40 * number, FORCE)
                fluid.step()
            found.append((fluid.velocity().tobytes(), fluid.particles.pos.to_numpy().tobytes()))
    assert found[0] == found[1] == found[2]


def run_program(*words):
    app = typer.Typer()
    app.command()(fluids_fft.main)
    return CliRunner().invoke(app, list(words))


def test_the_program(tmp_path):
    dump, picture = tmp_path / "out" / "fluid.npz", tmp_path / "out" / "fluid.png"
    words = ("--grid", "24", "--steps", "12", "--threads", "2", "--dump", str(dump), "--save", str(picture))
    result = run_program(*words, "--dump-at", "1,12")
    assert result.exit_code == 0, result.output
    assert "576 cells and as many particles" in result.output and ", 0 copies:" in result.output
    assert picture.read_bytes()[:4] == b"\x89PNG"
    arrays = np.load(dump)
    assert arrays["steps"].tolist() == [1, 12] and arrays["viscosity"] == VISCOSITY
    sample = Sample(24, Fluid(24).particles.pos.to_numpy())
    for number in range(12):
        place, way = stroke(number)
        sample.push(place, [FORCE * 24 * 0.09 * along for along in way])
        sample.step()
        if number in (0, 11):
            np.testing.assert_allclose(arrays[f"velocity_{number + 1}"], sample.w, atol=1e-4 * np.abs(sample.w).max())
            assert arrays[f"particles_{number + 1}"].shape == (576, 2)


def test_wrong_words_are_refused_before_anything_runs():
    for wrong in (
        ("--dump-at", "1,x"),
        ("--dump-at", "0"),
        ("--dump-at", "7"),
        ("--backend", "abacus"),
        ("--grid", "1"),
    ):
        result = run_program("--grid", "8", "--steps", "6", *wrong)
        assert result.exit_code != 0 and not isinstance(result.exception, ValueError), wrong


def test_a_run_that_fails_saves_what_it_had(tmp_path):
    dump = tmp_path / "fluid.npz"
    result = run_program("--grid", "8", "--steps", "40", "--force", "1e36", "--dump", str(dump))
    assert result.exit_code == 1 and "not a number" in str(result.exception)
    assert np.load(dump)["steps"].size == 1
