"""Particles in flows: the order of the integrator, streamlines, walls, and the mass that cells are given."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import ebb
import grid_particles
from backends import BACKENDS, lacking
from grid_particles import FLOWS, Flow, Tracers


@pytest.fixture(params=BACKENDS)
def backend(request):
    """The name of the backend that the program runs on."""
    if lacking(request.param):
        pytest.skip(lacking(request.param))
    with ebb.backend(request.param):
        yield request.param


@ebb.func
def turning(at, t):
    # Linear in space, so that interpolation adds no error, and its speed changes with time.
    return [-(at.y - 0.5) * (1 + t), (at.x - 0.5) * (1 + t)]


@ebb.func
def shearing(at, t):
    return [0.5 * at.y - 0.25 * at.z + 0.1, 0.2 * at.x - 0.3, 0.1 * at.x + 0.4 * at.y - 0.2]


TURNING = Flow(turning, (1, 1), (1.0, 1.0), periodic=False, steady=False, dt=0.1)
SHEARING = Flow(shearing, (1, 1, 1), (1.0, 1.0, 1.0), periodic=False, steady=True, dt=0.1)


def error_of_turning(order, steps):
    """How far from its place a particle is after a second; the angle is then t + t*t/2."""
    start = np.array([[0.75, 0.5], [0.3, 0.4], [0.5, 0.62]])
    tracers = Tracers(TURNING, 4, start, order, ebb.float64)
    for _ in range(steps):
        tracers.step(1 / steps)
    x, y = (start - 0.5).T
    expected = 0.5 + np.stack([x * np.cos(1.5) - y * np.sin(1.5), x * np.sin(1.5) + y * np.cos(1.5)], axis=1)
    return np.abs(tracers.particles.pos.to_numpy() - expected).max()


@pytest.mark.parametrize("order", [2, 4])
def test_the_order_of_the_integrator(order):
    errors = np.array([error_of_turning(order, steps) for steps in (8, 16, 32)])
    measured = np.log2(errors[:-1] / errors[1:])
    assert measured == pytest.approx(order, abs=0.25)


def test_interpolation_is_exact_for_linear_velocities(backend):
    start = np.random.default_rng(0).random((50, 3)) * 0.9 + 0.05
    tracers = Tracers(SHEARING, 4, start, 2, ebb.float64)
    matrix = np.array([[0, 0.5, -0.25], [0.2, 0, 0], [0.1, 0.4, 0]])
    shift = np.array([0.1, -0.3, -0.2])
    tracers.step(0.01)
    half = start + 0.005 * (start @ matrix.T + shift)
    np.testing.assert_allclose(tracers.particles.pos.to_numpy(), start + 0.01 * (half @ matrix.T + shift), atol=1e-14)


def stream_function(points):
    x, y = 2 * np.pi * points.T
    return np.sin(x) * np.sin(y)


def drift_from_streamlines(cells, order, dt):
    start = np.random.default_rng(1).random((200, 2))
    tracers = Tracers(FLOWS["cells"], cells, start, order, ebb.float64)
    for _ in range(round(1 / dt)):
        tracers.step(dt)
    return np.abs(stream_function(tracers.particles.pos.to_numpy()) - stream_function(start)).max()


def test_particles_stay_on_streamlines():
    # Of a fine step only the error of the interpolation is left, which falls at least with the square of the cells.
    coarse, fine = (drift_from_streamlines(cells, 4, 0.01) for cells in (16, 64))
    assert fine < 1e-4 and np.log2(coarse / fine) / 2 > 1.9
    # On a fine grid the error of the midpoint rule is larger than that, and falls with a power of the step.
    assert drift_from_streamlines(64, 2, 0.1) > 10 * drift_from_streamlines(64, 2, 0.02)


def test_positions_wrap_in_periodic_domains(backend):
    tracers = Tracers(FLOWS["abc"], 4, np.random.default_rng(2).random((40, 3)) * 2 * np.pi, 2)
    for _ in range(8):
        tracers.step(0.5)
    points = tracers.particles.pos.to_numpy()
    assert (points >= 0).all() and (points <= np.float32(2 * np.pi)).all()
    tracers.particles.new_field("moved", ebb.bool_)
    grid = tracers.grid

    @ebb.kernel
    def check(p):
        p.moved = p.dual_cell != grid.dual_locate(p.pos)

    check(tracers.particles)
    assert not tracers.particles.moved.to_numpy().any()


def test_particles_stay_in_a_closed_box(backend):
    tracers = Tracers(FLOWS["gyre"], 4, 40, 2)
    for _ in range(10):
        tracers.step(1.0)
    points = tracers.particles.pos.to_numpy()
    assert (points >= 0).all() and (points <= (2, 1)).all()
    assert tracers.time == pytest.approx(10)


def test_velocities_are_those_of_the_time(backend):
    tracers = Tracers(FLOWS["gyre"], 6, np.array([[0.5, 0.25]]), 4)
    start = tracers.grid.cells.vel.to_numpy()
    for _ in range(20):  # a period, in which the border swings to and fro
        tracers.step(0.5)
    np.testing.assert_allclose(tracers.grid.cells.vel.to_numpy(), start, atol=1e-6)


@pytest.mark.parametrize("flow", FLOWS)
def test_the_mass_is_kept(backend, flow):
    tracers = Tracers(FLOWS[flow], 5, 150, 2)
    for _ in range(2):
        tracers.step(FLOWS[flow].dt)
        tracers.deposit()
        points, cells = tracers.particles.pos.to_numpy(), tracers.grid.cells
        count, mass = cells.count.to_numpy(), cells.mass.to_numpy()
        box = [(0, length) for length in FLOWS[flow].extent]
        assert count.sum() == 150
        if flow == "gyre":
            np.testing.assert_array_equal(count, np.histogramdd(points, count.shape, box)[0])
        assert mass.sum(dtype=np.float64) == pytest.approx(150, rel=1e-6)
        assert (mass >= 0).all()


@pytest.mark.parametrize("flow", FLOWS)
def test_every_backend_moves_particles_alike(flow):
    found = {}
    for name in BACKENDS:
        if lacking(name):
            continue
        with ebb.backend(name):
            tracers = Tracers(FLOWS[flow], 5, 30, 4)
            for _ in range(3):
                tracers.step(FLOWS[flow].dt)
            found[name] = tracers.particles.pos.to_numpy()
    for points in found.values():
        np.testing.assert_allclose(points, found["cpu"], atol=2e-6)


def test_the_program(tmp_path):
    app = typer.Typer()
    app.command()(grid_particles.main)
    words = ["--particles", "2000", "--grid", "8", "--steps", "12", "--threads", "2"]
    picture = tmp_path / "out" / "gyre.png"
    result = CliRunner().invoke(app, [*words, "--sort", "5", "--save", str(picture)])
    assert result.exit_code == 0, result.output
    assert "2000 particles on <Grid2D: 16 x 8 cells" in result.output
    assert "ns a particle a step" in result.output and "counted in cells: 2000 particles" in result.output
    width, height = struct.unpack(">II", picture.read_bytes()[16:24])
    assert (width, height) == (4 * 840 + 3 * 12, 420)
    result = CliRunner().invoke(app, [*words, "--flow", "abc", "--steps", "1", "--order", "4"])
    assert result.exit_code == 0, result.output
    for wrong in (["--flow", "river"], ["--order", "3"], ["--backend", "abacus"]):
        assert CliRunner().invoke(app, [*words, *wrong]).exit_code == 1
