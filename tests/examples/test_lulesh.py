"""The blast of LULESH: published results, the analytic shock, two meshes, regions, threads, failures and bad input."""

from __future__ import annotations

import ctypes
import itertools
import os
from collections import Counter

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import ebb
import lulesh
import lulesh_regions
import pictures
from backends import require
from lulesh_model import Model

MESHES = ("unstructured", "grid")
ZONE_FIELDS = ("e", "p", "q", "vol", "sound_speed")

# Iterations and the final energy of the zone at the origin, by size: LLNL-TR-490254 and the reference (30 and 45).
PUBLISHED = {5: (72, 7.853665e03), 10: (231, 2.720531e04), 30: (932, 2.025075e05), 45: (1477, 4.234875e05)}


def state(blast):
    """The fields of zones and nodes in the order of rows, one row of numbers each."""
    zones, nodes = blast.zones, blast.nodes
    found = {name: zones.fields[name].to_numpy().ravel() for name in ZONE_FIELDS}
    found["x"] = lulesh.moment(blast).x.ravel()
    found["vel"] = nodes.vel.to_numpy().ravel()
    return found | {"time": np.array(blast.time), "dt": np.array(blast.dt)}


def after(cycles, size, **options):
    blast = lulesh.Sedov(size, **options)
    blast.run(cycles)
    return blast


def check_published(size, **options):
    blast = after(10**6, size, **options)
    iterations, energy = PUBLISHED[size]
    assert blast.cycle == iterations
    assert f"{blast.origin_energy():.6e}" == f"{energy:.6e}"
    assert blast.time == pytest.approx(lulesh.STOP_TIME, rel=1e-14)
    largest, _, relative = blast.symmetry()
    assert largest < 1e-7 and relative < 1e-9


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("size", [5, 10])
def test_published_results(size, mesh):
    check_published(size, regions=11, mesh=mesh)


@pytest.mark.slow
@pytest.mark.parametrize(("size", "regions"), [(30, 11), (30, 1), (45, 1)])
def test_published_results_of_full_runs(size, regions):
    check_published(size, regions=regions)


def test_the_shock_is_where_sedov_has_it():
    # In a gas with gamma = 5/3 the shock of the energy E is at (E t^2 / (0.4936 rho))^(1/5) (Sedov 1959), here at 1.0,
    # and the gas behind it is at most four times as dense as that before it; the scheme smears it over some zones.
    blast = after(10**6, 12)
    moment = lulesh.moment(blast)
    centre = sum(moment.x[i : 12 + i, j : 12 + j, k : 12 + k] for i, j, k in np.ndindex(2, 2, 2)) / 8
    radius = np.linalg.norm(centre, axis=-1)
    total = 8 * (blast.zones.initial_volume.to_numpy().flat[0]) * lulesh.ORIGIN_ENERGY * 12**3
    front = (total * blast.time**2 / (0.4936 * lulesh.DENSITY)) ** 0.2
    assert front == pytest.approx(1.0, abs=0.01)
    assert radius.flat[moment.density.argmax()] == pytest.approx(front, abs=0.06)
    assert moment.density.max() == pytest.approx(4, abs=0.6)
    assert moment.density[radius > front + 0.06].mean() == pytest.approx(lulesh.DENSITY, abs=0.02)
    assert moment.density[radius < 0.55].max() < 0.25


@pytest.mark.parametrize("mesh", MESHES)
def test_whole_fields_are_those_of_a_plain_program(tmp_path, mesh):
    size, cycles = 5, 60
    model, blast = Model(size), after(cycles, size, regions=4, mesh=mesh)
    model.run(cycles)
    path = tmp_path / "state.npz"
    lulesh.dump(path, blast)
    saved = np.load(path)
    expected = {name: getattr(model, name) for name in ("time", "dt", "e", "p", "q", "v", "ss")}
    for axis, name in enumerate("xyz"):
        expected |= {name: model.x[:, axis], f"{name}d": model.xd[:, axis]}
    for name, values in expected.items():
        np.testing.assert_allclose(saved[name], values, rtol=1e-10, atol=1e-12 * np.abs(values).max(), err_msg=name)


def test_meshes_and_regions_change_nothing():
    expected = state(after(40, 6))
    for options in ({"mesh": "grid"}, {"regions": 11}, {"regions": 5, "balance": 3, "cost": 4, "mesh": "grid"}):
        for name, values in state(after(40, 6, **options)).items():
            scale = np.abs(expected[name]).max()
            np.testing.assert_allclose(values, expected[name], rtol=1e-9, atol=1e-11 * scale, err_msg=name)


@pytest.mark.parametrize("mesh", MESHES)
def test_threads_change_no_bit(mesh):
    found = []
    for threads in (1, 2):
        with ebb.backend("cpu", threads=threads):
            found.append(state(after(12, 20, regions=3, mesh=mesh)))
    for name, values in found[0].items():
        assert np.array_equal(values, found[1][name]), name


def test_axes_are_alike():
    blast = after(60, 7)
    energy = blast.zones.e.to_numpy().reshape(7, 7, 7)
    for order in itertools.permutations(range(3)):
        np.testing.assert_allclose(energy.transpose(order), energy, rtol=1e-10, atol=1e-8)
    largest, total, relative = blast.symmetry()
    assert largest <= total < 1e-6 and relative < 1e-10
    blast.zones.e.load(np.arange(343.0).reshape(blast.zones.shape))
    plane = np.arange(49.0).reshape(7, 7)
    assert blast.symmetry()[0] == np.abs(plane - plane.T).max()


def test_runs_go_on_where_they_stopped():
    whole, parts = after(30, 5), lulesh.Sedov(5)
    for cycles in (1, 4, 25):
        parts.run(cycles)
    assert parts.cycle == 30
    for name, values in state(whole).items():
        assert np.array_equal(values, state(parts)[name]), name
    whole.run(10**6)
    whole.run(10**6)
    assert whole.cycle == 72


# ---- Regions ----


def test_numbers_are_those_of_the_c_library():
    try:
        library = ctypes.CDLL("libc.so.6")
    except OSError:
        pytest.skip("no GNU C library here")
    library.srand(0)
    expected = [library.rand() for _ in range(2000)]
    assert list(itertools.islice(lulesh_regions.random_numbers(), 2000)) == expected


def test_regions_have_all_zones():
    region_of = lulesh_regions.draw_regions(20**3, 11, 1)
    sizes = np.bincount(region_of, minlength=11)
    assert sizes.sum() == 20**3 and (sizes > 0).all()
    assert not lulesh_regions.draw_regions(100, 1, 1).any()
    late = np.bincount(lulesh_regions.draw_regions(20**3, 4, 3), minlength=4)
    assert late[3] > late[0]
    assert Counter(lulesh_regions.evaluations(region, 11, 1) for region in range(11)) == {1: 5, 2: 5, 20: 1}


# ---- What goes wrong ----


@pytest.mark.parametrize("backend", ["cpu", "reference", "opencl"])
@pytest.mark.parametrize(
    ("field", "value", "text"),
    [("vel", 1e9, "the zone has no volume left"), ("q", 1e13, "the artificial viscosity is above its limit")],
)
def test_domain_aborts(backend, field, value, text):
    require(backend)
    with ebb.backend(backend):
        blast = after(3, 3)
        if field == "vel":
            velocity = blast.nodes.vel.to_numpy().reshape(4, 4, 4, 3)
            velocity[2, 2, 2] = value
            blast.nodes.vel.load(velocity.reshape((*blast.nodes.shape, 3)))
        else:
            viscosity = blast.zones.q.to_numpy().ravel()
            viscosity[5] = value
            blast.zones.q.load(viscosity.reshape(blast.zones.shape))
        with pytest.raises(lulesh.DomainError, match=rf"cycle [45](.|\n)*{text}") as caught:
            blast.run(5)
        assert "row" in str(caught.value)
        if field == "q":
            assert "5" in str(caught.value).split("row", 1)[1][:20]


@pytest.mark.parametrize("backend", ["cpu", "opencl"])
@pytest.mark.parametrize("mesh", MESHES)
def test_after_an_abort_all_is_as_after_the_last_whole_cycle(backend, mesh, monkeypatch):
    require(backend)
    with ebb.backend(backend):
        plain, largest = lulesh.Sedov(4, mesh=mesh), []
        for _ in range(30):
            plain.run(1)
            largest.append(float(plain.zones.q.to_numpy().max()))
        last = int(np.argmax(largest)) + 1  # the viscosity is looked at in the cycle after this one
        assert last > 9
        monkeypatch.setattr(lulesh, "LARGEST_VISCOSITY", largest[last - 1] * (1 - 1e-9))
        blast = after(9, 4, mesh=mesh)
        with pytest.raises(lulesh.DomainError, match=rf"cycle {last + 1}: "):  # nothing is kept, or made again
            blast.run(40)
        blast = after(9, 4, mesh=mesh)
        blast.keep_whole()
        with pytest.raises(lulesh.DomainError, match=rf"cycle {last + 1}: (.|\n)*artificial viscosity"):
            blast.run(40)
        assert blast.cycle == last
        expected, found = state(after(last, 4, mesh=mesh)), state(blast)
        for name, values in expected.items():
            np.testing.assert_allclose(found[name], values, rtol=1e-9, atol=1e-12, err_msg=name)
        # A zone is turned inside out, which is found after the nodes have moved.
        velocity = blast.nodes.vel.to_numpy()
        velocity.reshape(5, 5, 5, 3)[2, 2, 2] = 1e9
        blast.nodes.vel.load(velocity)
        before = state(blast)
        with pytest.raises(lulesh.DomainError, match=rf"cycle {last + 1}: "):
            blast.run(5)
        assert blast.cycle == last and not blast.nodes.force.to_numpy().any()
        for name, values in state(blast).items():
            assert (values == before[name]).all(), name


def invoke(*words):
    app = typer.Typer()
    app.command()(lulesh.main)
    return CliRunner().invoke(app, [str(word) for word in words])


def said(result):
    return " ".join(result.output.replace("│", " ").split())


def test_bad_input_is_refused_before_the_run(tmp_path):
    for words, text in {
        ("--size", 0): "'--size'",
        ("--regions", 0): "'--regions'",
        ("--iterations", 0): "'--iterations'",
        ("--cost", -1): "'--cost'",
        ("--size", 2, "--regions", 9): "--regions 9 is more than the 8 zones of --size 2",
        ("--regions", 4, "--balance", 40): "--balance 40 leaves next to nothing to smaller regions",
        ("--regions", 2, "--balance", 20): "--balance 20 leaves next to nothing to smaller regions",
        ("--mesh", "hexagonal"): "--mesh is one of unstructured, grid, not hexagonal",
        ("--save", tmp_path): "cannot be written",
    }.items():
        result = invoke(*words)
        assert result.exit_code == 2, result.output
        assert text in said(result), result.output
        assert "Run completed" not in result.output
    result = invoke("--size", 3, "--backend", "abacus")
    assert result.exit_code == 1


def test_more_threads_than_cores_are_a_warning():
    result = invoke("--size", 3, "--iterations", 2, "--threads", (os.cpu_count() or 1) + 1)
    assert result.exit_code == 0 and "will be slow" in said(result)
    ebb.set_backend("cpu")


def test_the_summary_and_the_dump(tmp_path, monkeypatch):
    path = tmp_path / "new" / "state.npz"
    result = invoke("--size", 5, "--regions", 3, "--dump", path)
    assert result.exit_code == 0, result.output
    for text in ("Iteration count = 72", "Final Origin Energy = 7.853665e+03", "MaxAbsDiff", "TotalAbsDiff",
                 "MaxRelDiff", "Elapsed time", "Grind time", "FOM"):  # fmt: skip
        assert text in said(result), result.output
    saved = np.load(path)
    assert float(saved["time"]) == pytest.approx(0.01)
    assert {name: saved[name].shape for name in ("e", "p", "q", "v", "ss")} == dict.fromkeys(
        ("e", "p", "q", "v", "ss"), (125,)
    )
    nodes = {name: saved[name].reshape(6, 6, 6) for name in ("x", "y", "z", "xd", "yd", "zd")}
    # The first axis of the reference goes fastest: in its arrays [k, j, i] is the node i along x.
    assert (np.diff(nodes["x"], axis=2) > 0).all() and (np.diff(nodes["z"], axis=0) > 0).all()
    assert not nodes["x"][:, :, 0].any() and not nodes["y"][:, 0].any() and not nodes["z"][0].any()
    assert not nodes["xd"][:, :, 0].any()
    drawn = []
    monkeypatch.setattr(pictures, "save_strip", lambda path, shapes, **options: drawn.append((path, shapes)))
    result = invoke("--size", 5, "--iterations", 9, "--quiet", "--mesh", "grid", "--save", tmp_path / "blast")
    assert result.exit_code == 0 and not result.output.strip(), result.output
    assert (tmp_path / "blast.vtk").stat().st_size > 0
    [(picture, shapes)] = drawn
    assert picture == tmp_path / "blast.png"
    assert all(len(shape.points) == len(shape.colors) == 4 * 6 * 25 for shape in shapes)
