"""The falling body: its laws, and the program as a user runs it."""

from __future__ import annotations

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

import spring_mass
from bodies import Body
from ebb.domains import TetMesh, TriMesh

QUIET = Console(quiet=True)
G = spring_mass.GRAVITY


def make_ball(drop: float = 0.2, resolution: int = 3) -> Body:
    body = Body("ball", TetMesh.ball(resolution, 0.5))
    spring_mass.prepare(body, drop)
    return body


def momentum(mesh: TetMesh) -> np.ndarray:
    mass = mesh.vertices.mass.to_numpy().astype(float)
    return mass @ mesh.vertices.qd.to_numpy().astype(float)


def test_mass_and_stiffness_are_spread():
    body = make_ball()
    mass = body.solid.vertices.mass.to_numpy()
    assert mass.sum() == pytest.approx(spring_mass.DENSITY * body.solid.tetrahedra.volume.to_numpy().sum(), rel=1e-5)
    edges = body.solid.edges
    stiffness = dict(
        zip(zip(edges.tail.to_numpy(), edges.head.to_numpy(), strict=True), edges.stiffness.to_numpy(), strict=True)
    )
    assert min(stiffness.values()) > 0
    assert all(stiffness[b, a] == pytest.approx(k) for (a, b), k in stiffness.items())


def test_a_body_falls_freely_until_it_lands():
    body = make_ball(drop=1.0)
    vertices, start = body.solid.vertices, body.solid.vertices.q.to_numpy()
    dt, steps = 1e-4, 400
    for _ in range(steps):
        spring_mass.step(body.solid, dt)
    time = dt * steps
    fallen = start - vertices.q.to_numpy()
    assert fallen[:, 2] == pytest.approx(G * time * (time + dt) / 2, rel=1e-3)
    assert fallen[:, :2] == pytest.approx(0, abs=1e-6)
    assert vertices.qd.to_numpy()[:, 2] == pytest.approx(-G * time, rel=1e-3)


def test_internal_forces_keep_momentum_and_angular_momentum():
    body = make_ball()
    vertices = body.solid.vertices
    rng = np.random.default_rng(0)
    vertices.q.load(vertices.q.to_numpy() + 0.03 * rng.normal(size=(vertices.size, 3)))
    vertices.qd.load(rng.normal(size=(vertices.size, 3)))
    spring_mass.compute_internal_forces(vertices)
    spring_mass.keep_volume(body.solid.tetrahedra)
    force, place = vertices.force.to_numpy().astype(float), vertices.q.to_numpy().astype(float)
    scale = np.abs(force).sum()
    assert scale > 1
    assert force.sum(axis=0) == pytest.approx([0, 0, 0], abs=1e-5 * scale)
    assert np.cross(place, force).sum(axis=0) == pytest.approx([0, 0, 0], abs=1e-5 * scale)


def test_forces_are_the_slope_of_the_energy(monkeypatch):
    monkeypatch.setattr(spring_mass, "DAMPING", 0.0)
    body = make_ball(resolution=2)
    vertices = body.solid.vertices
    rng = np.random.default_rng(1)
    start = vertices.q.to_numpy() + 0.02 * rng.normal(size=(vertices.size, 3))
    direction = rng.normal(size=(vertices.size, 3))

    def elastic_at(t):
        vertices.q.load(start + t * direction)
        return spring_mass.measure(body.solid).elastic

    slope = (elastic_at(1e-3) - elastic_at(-1e-3)) / 2e-3
    vertices.q.load(start)
    spring_mass.compute_internal_forces(vertices)
    spring_mass.keep_volume(body.solid.tetrahedra)
    assert -(vertices.force.to_numpy() * direction).sum() == pytest.approx(slope, rel=2e-3)


def test_it_falls_is_squashed_bounces_and_loses_energy():
    body = make_ball(drop=0.3)
    dt = spring_mass.stable_step(body.solid)
    totals, heights, lows = [], [], []
    for number in range(round(0.9 / dt)):
        spring_mass.step(body.solid, dt)
        if number % 25 == 0:
            totals.append(spring_mass.measure(body.solid).total)
            place = body.solid.vertices.q.to_numpy()
            heights.append(np.ptp(place[:, 2]))
            lows.append(place[:, 2].min())
    totals, heights, lows = np.array(totals), np.array(heights), np.array(lows)
    assert lows.min() >= 0
    landed = int(np.argmax(lows == 0))
    assert lows[landed:].max() > 0.03, "it bounces"
    assert heights.min() < 0.92 * heights[0], "it is squashed"
    assert totals[-1] < 0.9 * totals[0]
    assert np.diff(totals).max() < 0.01 * totals[0], "nothing feeds it"


def test_it_comes_to_rest(monkeypatch):
    monkeypatch.setattr(spring_mass, "DAMPING", 8e-3)
    body = make_ball(drop=0.02, resolution=2)
    dt = spring_mass.stable_step(body.solid)
    for _ in range(round(2.0 / dt)):
        spring_mass.step(body.solid, dt)
    energy = spring_mass.measure(body.solid)
    assert energy.kinetic < 5e-3 * energy.total
    assert energy.height > 0.9 * spring_mass.measure(make_ball(0.0, 2).solid).height


def test_the_stable_step_is_stable_and_not_timid():
    body = make_ball(drop=10.0)
    dt = spring_mass.stable_step(body.solid)
    vertices = body.solid.vertices
    vertices.qd.load(0.1 * np.random.default_rng(3).normal(size=(vertices.size, 3)))
    before = spring_mass.measure(body.solid)
    for _ in range(300):
        spring_mass.step(body.solid, dt)
    assert spring_mass.measure(body.solid).total < 1.001 * before.total
    vertices.q.load(vertices.pos.to_numpy() + np.array([0, 0, 10]))
    vertices.qd.load(0.01 * np.random.default_rng(3).normal(size=(vertices.size, 3)))
    for _ in range(300):
        spring_mass.step(body.solid, 8 * dt)
    assert not spring_mass.measure(body.solid).total < 10 * before.total


def test_the_skin_follows():
    skin = TriMesh.icosphere(3, 0.5)
    body = Body("ball", TetMesh.from_surface(skin, resolution=8), skin)
    spring_mass.prepare(body, 0.25)
    points, triangles = spring_mass.surface(body)
    assert triangles.shape == (1280, 3)
    # The solid is dropped by its lowest point, which is a corner of the lattice.
    shift = points - skin.vertices.pos.to_numpy()
    assert shift == pytest.approx(np.broadcast_to(shift[0], shift.shape), abs=1e-5)
    body.solid.vertices.q.load(body.solid.vertices.pos.to_numpy() @ np.diag([1, 2, 3]).astype(np.float32))
    assert spring_mass.surface(body)[0] == pytest.approx(skin.vertices.pos.to_numpy() * [1, 2, 3], abs=1e-5)


def test_moments_are_the_turning_points():
    heights = [5, 4, 2, 1, 2, 3, 2, 1.5, 2, 2.1, 2]
    moments = [np.array([[0, 0, float(h)]]) for h in heights]
    assert [m[0, 2] for m in spring_mass.choose_moments(moments)] == [5, 1, 3, 1.5, 2]


@pytest.fixture(scope="module")
def command():
    import typer

    app = typer.Typer()
    app.command()(spring_mass.main)
    return lambda *words: CliRunner().invoke(app, list(words))


def test_the_program_runs_and_saves(command, tmp_path):
    pytest.importorskip("meshio")
    for name in ("ball.vtu", "ball.veg"):
        path = tmp_path / name
        result = command(
            "--steps", "12", "--resolution", "6", "--backend", "cpu", "--threads", "1", "--save", str(path)
        )
        assert result.exit_code == 0, result.output
        assert "160 tetrahedra, 12 steps" in result.output and "kinetic" in result.output
        assert TetMesh.load(path).tetrahedra.size == 160


def test_the_program_takes_files(command, tmp_path):
    TetMesh.box(2, 1, 1, size=(20, 10, 10)).save(tmp_path / "bar.veg")
    TriMesh.torus(3, 1, 16, 8).save(tmp_path / "ring.off")
    for name, text in (("bar.veg", "bar: 12 tetrahedra"), ("ring.off", "ring: ")):
        result = command("--mesh", str(tmp_path / name), "--steps", "2", "--resolution", "6")
        assert result.exit_code == 0 and text in result.output


def test_the_program_says_what_is_wrong(command, tmp_path):
    result = command("--mesh", str(tmp_path / "none.veg"))
    assert result.exit_code == 1 and "E701" in result.output + str(result.exception)
    TriMesh.grid(2, 2).save(tmp_path / "open.off")
    result = command("--mesh", str(tmp_path / "open.off"))
    assert result.exit_code == 1 and "not closed" in result.output + str(result.exception)
    result = command("--steps", "200", "--dt", "0.5", "--resolution", "6")
    assert result.exit_code == 2 and "grows without bound" in result.output


def test_without_pymeshfix_a_ball_falls(command, monkeypatch):
    import bodies

    monkeypatch.setattr(bodies, "what_bunny_lacks", lambda: "pymeshfix")
    result = command("--mesh", "bunny", "--steps", "2", "--resolution", "6")
    assert result.exit_code == 0
    assert "a ball falls instead" in result.output and "ball: 160 tetrahedra" in result.output
