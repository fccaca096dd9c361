"""Stable Fluids: divergence, decay, symmetry, conservation, and the program."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import ebb
import stable_fluids
from ebb.domains import Grid2D, Grid3D
from multigrid import METHODS
from stable_fluids import SCENES, Fluid, Physics, error_of_vortices, make_grid, taylor_green


def make(shape, periodic=True, extent=None, precision=ebb.float64, **physics):
    physics.setdefault("tolerance", 1e-10)
    extent = tuple(n / shape[0] for n in shape) if extent is None else extent
    grid = (Grid2D if len(shape) == 2 else Grid3D)(shape, extent=extent, periodic=periodic, precision=precision)
    return Fluid(grid, Physics(**physics))


def shake(fluid, seed=0):
    """Velocities and dye by chance."""
    rng, cells = np.random.default_rng(seed), fluid.grid.cells
    cells.vel.load(rng.standard_normal((*cells.shape, cells.ndim)))
    cells.dye.load(rng.random((*cells.shape, 3)))


def divergence(fluid):
    """Of the flow through the faces of each cell."""
    total = np.zeros(fluid.grid.shape)
    for axis, faces in enumerate(fluid.grid.faces):
        flow = faces.flow.to_numpy()
        if fluid.grid.periodic[axis]:
            total += np.roll(flow, -1, axis) - flow
        else:
            total += np.diff(flow, axis=axis)
            assert not np.take(flow, [0, -1], axis).any(), "nothing flows through a wall"
    return total / fluid.grid.spacing[0]


@pytest.mark.parametrize(
    ("shape", "periodic", "method"),
    [
        *(((12, 10), False, method) for method in METHODS),
        ((16, 24), True, "multigrid"),
        ((7, 9), (False, True), "multigrid"),
        ((8, 8, 12), True, "multigrid"),
        ((6, 8, 4), (True, False, False), "multigrid"),
    ],
    ids=str,
)
def test_the_projection_takes_the_divergence_out(shape, periodic, method):
    fluid = make(shape, periodic, method=method, tolerance=1e-9)
    shake(fluid)
    solved = fluid.project()
    largest = np.abs(fluid.grid.cells.divergence.to_numpy()).max()
    assert solved.converged and largest > 1
    assert np.abs(divergence(fluid)).max() <= 2e-9 * largest


def central_divergence(fluid):
    velocity, h = fluid.grid.cells.vel.to_numpy(), fluid.grid.spacing[0]
    return sum(np.roll(velocity[..., axis], -1, axis) - np.roll(velocity[..., axis], 1, axis) for axis in range(2)) / (
        2 * h
    )


def test_what_is_left_at_the_cells_falls_with_the_square_of_their_side():
    left = []
    for n in (16, 32, 64):
        fluid = make((n, n))
        fluid.grid.cells.vel.load(
            lambda i, j, n=n: (np.sin(2 * np.pi * (i + 0.5) / n), np.exp(np.sin(2 * np.pi * (i + j + 1) / n)))
        )
        fluid.project()
        left.append(np.abs(central_divergence(fluid)).max())
    order = np.log2(np.divide(left[:-1], left[1:]))
    assert order[-1] == pytest.approx(2, abs=0.15) and order[0] > 1.7


def decay_error(n, ndim, viscosity, advection):
    """The error of the vortices of Taylor and Green after half a second, by steps of a cell."""
    fluid = make((n, n, 4)[:ndim], viscosity=viscosity, advection=advection, tolerance=1e-6)
    fluid.grid.cells.vel.load(taylor_green(stable_fluids.centers(fluid.grid)))
    for _ in range(n // 2):
        fluid.step(1 / n)
    assert fluid.time == pytest.approx(0.5)
    return error_of_vortices(fluid)


@pytest.mark.parametrize(("advection", "viscosity"), [("linear", 0.0), ("linear", 0.01), ("maccormack", 0.01)])
def test_vortices_decay_as_in_the_closed_form(advection, viscosity):
    # Splitting a step into advection and projection is of order 1 in time, whatever the interpolation.
    errors = np.array([decay_error(n, 2, viscosity, advection) for n in (16, 32, 64)])
    order = np.log2(errors[:-1] / errors[1:])
    assert order[-1] == pytest.approx(1, abs=0.15) and order[0] > 0.75
    assert errors[-1] < (0.11 if advection == "linear" else 0.07)


def test_diffusion_alone_is_of_order_two_in_space():
    errors = []
    for n in (8, 16, 32):
        fluid = make((n, n), viscosity=0.05, advection="linear")
        (solver,) = (solver for field, _, solver in fluid._diffusers if field == "vel")
        fluid.grid.cells.vel.load(taylor_green(stable_fluids.centers(fluid.grid)))
        steps = n * n // 8
        for _ in range(steps):
            solver.shift.value = steps / 0.05 / 0.5
            fluid._weigh(fluid.grid.cells, "vel_before", "vel", steps / 0.05 / 0.5)
            solver.solve(1e-11)
        fluid.time = 0.5
        errors.append(error_of_vortices(fluid))
    order = np.log2(np.divide(errors[:-1], errors[1:]))
    assert order[-1] == pytest.approx(2, abs=0.15) and order[0] > 1.7


def test_a_flat_flow_in_space_is_that_of_the_plane():
    assert decay_error(16, 3, 0.0, "linear") == pytest.approx(decay_error(16, 2, 0.0, "linear"), rel=1e-4)


@pytest.mark.parametrize(
    ("shape", "periodic", "advection"),
    [((16, 12), False, "maccormack"), ((8, 6, 8), (True, False, False), "linear")],
    ids=str,
)
def test_what_is_symmetric_stays_so(shape, periodic, advection):
    fluid = make(shape, periodic, buoyancy=2.0, viscosity=1e-3, advection=advection, tolerance=1e-12)
    rng, mirror = np.random.default_rng(3), np.array([-1, *[1] * (len(shape) - 1)])
    source, start = rng.random((*shape, 3)), 0.1 * rng.standard_normal((*shape, len(shape)))
    fluid.grid.cells.source.load(source + source[::-1])
    fluid.grid.cells.vel.load(start + mirror * start[::-1])
    for _ in range(6):
        fluid.step(0.05)
    velocity, dye = fluid.grid.cells.vel.to_numpy(), fluid.grid.cells.dye.to_numpy()
    assert np.abs(velocity).max() > 0.05
    np.testing.assert_allclose(dye, dye[::-1], atol=1e-8)
    np.testing.assert_allclose(velocity[::-1] * mirror, velocity, atol=1e-8)


@pytest.mark.parametrize(("advection", "off"), [("linear", 1e-13), ("maccormack", 0.01)])
def test_a_uniform_flow_keeps_the_dye_without_being_told(advection, off):
    fluid = make((12, 10), advection=advection)
    shake(fluid)
    fluid.grid.cells.vel.load([0.31, -0.17])
    for _ in range(5):
        fluid.step(0.1)
        assert fluid.drift < off


@pytest.mark.parametrize(
    ("shape", "periodic", "advection"),
    [((16, 16), True, "linear"), ((12, 16), False, "maccormack"), ((8, 6, 8), True, "linear")],
    ids=str,
)
def test_the_dye_is_kept(shape, periodic, advection):
    fluid = make(shape, periodic, advection=advection, diffusion=1e-3)
    shake(fluid)
    before = fluid.grid.cells.dye.to_numpy().sum(axis=tuple(range(len(shape))))
    for _ in range(5):
        fluid.step(0.05)
        assert fluid.drift < 0.1
    dye = fluid.grid.cells.dye.to_numpy()
    assert (dye >= 0).all()
    np.testing.assert_allclose(dye.sum(axis=tuple(range(len(shape)))), before, rtol=1e-12)


@pytest.mark.parametrize("shape", [(8, 4), (4, 8, 4)])
def test_a_chessboard_carried_by_half_a_cell_becomes_exactly_its_mean(shape):
    fluid = make(shape, extent=tuple(map(float, shape)), advection="linear")
    board = np.indices(shape).sum(axis=0) % 2
    fluid.grid.cells.dye.load(np.stack([board, 1 - board, 3.0 * board], axis=-1))
    fluid.grid.cells.vel.load([1.0, -1.0, 1.0][: len(shape)])
    fluid.step(0.5)
    assert (fluid.grid.cells.dye.to_numpy() == [0.5, 0.5, 1.5]).all()
    assert (fluid.grid.cells.vel.to_numpy() == [1.0, -1.0, 1.0][: len(shape)]).all()


@pytest.mark.parametrize("shape", [(8, 4), (4, 8, 4)])
def test_a_velocity_that_alternates_becomes_exactly_its_mean(shape):
    fluid = make(shape, advection="linear")
    board = np.indices(shape).sum(axis=0) % 2
    fluid.grid.cells.vel.load(np.stack([board, *[2.0 * board] * (len(shape) - 1)], axis=-1))
    fluid.project()
    assert (fluid.grid.cells.vel.to_numpy() == [0.5, *[1.0] * (len(shape) - 1)]).all()


def test_without_viscosity_fluid_slides_along_walls():
    fluid = make((16, 16), (True, False), advection="linear")
    fluid.grid.cells.vel.load([1.0, 0.0])
    for _ in range(5):
        fluid.step(0.05)
    np.testing.assert_allclose(fluid.grid.cells.vel.to_numpy()[..., 0], 1, atol=1e-12)


def test_a_viscous_fluid_sticks_to_the_walls_of_a_channel():
    """The profile of Poiseuille."""
    fluid = make((8, 32), (True, False), extent=(0.25, 1.0), viscosity=1.0, advection="linear")
    cells = fluid.grid.cells

    @ebb.kernel
    def push(c):
        c.vel += [0.05 * 8.0, 0.0]

    for _ in range(40):
        push(cells)
        fluid.step(0.05)
    y = (np.arange(32) + 0.5) / 32
    profile = cells.vel.to_numpy()[3, :, 0]
    assert profile == pytest.approx(4 * y * (1 - y), abs=2e-3)


@pytest.mark.parametrize(
    ("scene", "ndim"),
    [*((scene, 2) for scene in SCENES), *(pytest.param(scene, 3, marks=pytest.mark.slow) for scene in SCENES)],
)
def test_scenes(scene, ndim):
    chosen = SCENES[scene]
    fluid = Fluid(
        make_grid(chosen, 8, ndim, chosen.periodic, ebb.float64), Physics(chosen.viscosity, buoyancy=chosen.buoyancy)
    )
    chosen.fill(fluid.grid)
    for _ in range(3):
        assert fluid.step(chosen.dt).residuals[-1] < 1e-2
    energy, fastest = fluid.measure()
    assert 0 < energy < 1 and 0 < fastest < 2
    assert fluid.grid.cells.dye.to_numpy().sum() > 0


def invoke(*words):
    app = typer.Typer()
    app.command()(stable_fluids.main)
    return CliRunner().invoke(app, ["--grid", "16", "--steps", "8", "--threads", "2", *map(str, words)])


def test_the_program(tmp_path):
    picture, film, folder = tmp_path / "out" / "smoke.png", tmp_path / "films" / "smoke.gif", tmp_path / "frames"
    result = invoke("--save", picture, "--animate", film, "--frames", folder, "--every", 2, "--height", 48)
    assert result.exit_code == 0, result.output
    assert "smoke in <Grid2D: 16 x 24 cells" in result.output and "ms for each of the others" in result.output
    assert struct.unpack(">II", picture.read_bytes()[16:24]) == (4 * 480 + 3 * 10, 720)
    assert sorted(path.name for path in folder.iterdir()) == [f"frame-000{n}.png" for n in range(1, 5)]
    image = pytest.importorskip("PIL.Image").open(film)
    assert image.n_frames == 4 and image.size == (32, 48)


@pytest.mark.slow
def test_the_program_in_space(tmp_path):
    picture = tmp_path / "smoke.png"
    options = ("--steps", 2, "--advection", "linear", "--solver", "jacobi", "--box", "periodic")
    result = invoke("--dimensions", 3, "--grid", 8, *options, "--save", picture)
    assert result.exit_code == 0, result.output
    assert "8 x 8 x 16 cells" in result.output and "periodic in" in result.output


def test_other_options(tmp_path):
    result = invoke(
        "--scene", "vortices", "--advection", "linear", "--viscosity", "0.01", "--animate", tmp_path / "a.webp"
    )
    assert result.exit_code == 0, result.output
    assert "off the closed form by" in result.output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--scene", "river"), "--scene: is one of"),
        (("--solver", "abacus"), "--solver: is one of"),
        (("--advection", "cubic"), "--advection: is one of"),
        (("--box", "round"), "--box: is one of"),
        (("--backend", "abacus"), "E601"),
    ],
)
def test_wrong_options_end_the_program_before_it_runs(words, said):
    result = invoke(*words)
    assert result.exit_code != 0
    assert said in f"{result.output}{result.exception}" and "Traceback" not in result.output


def test_an_interrupt_leaves_what_there_is(tmp_path, monkeypatch):
    step = Fluid.step

    def step_or_stop(self, dt):
        if self.time > 0.09:
            raise KeyboardInterrupt
        return step(self, dt)

    monkeypatch.setattr(Fluid, "step", step_or_stop)
    result = invoke("--save", tmp_path / "a.png", "--frames", tmp_path / "frames", "--every", 1)
    assert result.exit_code == 0 and "interrupted after" in result.output
    assert (tmp_path / "a.png").exists() and len(list((tmp_path / "frames").iterdir())) == 5


def test_a_fluid_that_bursts_ends_the_program(tmp_path):
    result = invoke("--dt", "1e20", "--steps", "20", "--save", tmp_path / "a.png")
    assert result.exit_code == 1 and ("no number any more" in f"{result.exception}" or "E401" in f"{result.exception}")
