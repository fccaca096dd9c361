"""Diffusion on surfaces: the maximum principle, the heat that is kept, and a closed form."""

from __future__ import annotations

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import heat
from ebb.domains import TriMesh


def run(mesh, start, steps, diffusivity=1.0, factor=1.0):
    heat.prepare(mesh, start)
    dt = factor * heat.stable_step(mesh, diffusivity)
    changes = [heat.step(mesh, dt, diffusivity) for _ in range(steps)]
    return dt, changes


def test_areas_and_weights():
    mesh = TriMesh.grid(4, 3, size=(4.0, 3.0))
    heat.prepare(mesh, np.zeros(mesh.vertices.size))
    assert mesh.vertices.area.to_numpy().sum() == pytest.approx(12)
    # In squares cut in two, a side inside has the weight cot 45 degrees of two triangles, halved; a diagonal has none.
    tail, head = mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy()
    place = mesh.vertices.pos.to_numpy()
    length = np.linalg.norm(place[tail] - place[head], axis=1)
    weight = mesh.edges.weight.to_numpy()
    assert weight[length > 1.1] == pytest.approx(0, abs=1e-6)
    assert set(weight[length < 1.1].round(5)) == {0.5, 1.0}


@pytest.mark.parametrize(
    "make",
    [lambda: TriMesh.torus(1, 0.4, 20, 12), lambda: TriMesh.icosphere(2), lambda: TriMesh.grid(9, 7, (1.0, 3.0))],
    ids=["torus", "sphere", "sheet of obtuse angles"],
)
def test_maximum_principle_and_kept_heat(make):
    mesh = make()
    start = np.random.default_rng(0).random(mesh.vertices.size)
    heat.prepare(mesh, start)
    dt = heat.stable_step(mesh, 1.0)
    low, high, total = heat.totals(mesh)
    assert (low, high) == (start.min(), start.max())
    for _ in range(100):
        heat.step(mesh, dt, 1.0)
        now = heat.totals(mesh)
        assert low <= now[0] <= now[1] <= high
        assert now[2] == pytest.approx(total, rel=1e-12)
        low, high = now[:2]
    assert high - low < 0.5 * np.ptp(start)


def test_a_uniform_temperature_stays():
    mesh = TriMesh.icosphere(2)
    _, changes = run(mesh, np.full(mesh.vertices.size, 3.5), 5)
    assert max(changes) < 1e-14
    assert mesh.vertices.T.to_numpy() == pytest.approx(3.5)


def test_a_longer_step_is_unstable():
    mesh = TriMesh.icosphere(2)
    _, changes = run(mesh, np.random.default_rng(0).random(mesh.vertices.size), 300, factor=2.5)
    assert changes[-1] > 1e3


def test_spherical_harmonics_decay_as_they_should():
    # On the unit sphere z is an eigenfunction of the Laplacian with the eigenvalue -2.
    mesh = TriMesh.icosphere(4)
    z = mesh.vertices.pos.to_numpy()[:, 2].astype(float)
    dt, changes = run(mesh, z, 400)
    expected = np.exp(-2 * dt * 400)
    assert mesh.vertices.T.to_numpy() == pytest.approx(expected * z, abs=0.01)
    assert changes[0] == pytest.approx(2 * dt, rel=0.03)


def test_change_is_the_largest_of_the_step():
    mesh = TriMesh.torus(1, 0.4, 10, 8)
    start = np.random.default_rng(2).random(mesh.vertices.size)
    _, changes = run(mesh, start, 1)
    assert changes[0] == np.abs(mesh.vertices.T.to_numpy() - start).max()


def test_the_program(tmp_path):
    pytest.importorskip("meshio")
    app = typer.Typer()
    app.command()(heat.main)
    TriMesh.icosphere(3).save(tmp_path / "sphere.off")
    words = ["--mesh", str(tmp_path / "sphere.off"), "--steps", "30", "--save", str(tmp_path / "out.vtu")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "1280 triangles, at most 30 steps" in result.output
    assert TriMesh.load(tmp_path / "out.vtu").triangles.size == 1280
    result = CliRunner().invoke(app, ["--mesh", str(tmp_path / "sphere.off"), "--tolerance", "1.0"])
    assert "nothing changes by more than 1" in result.output
    result = CliRunner().invoke(app, ["--mesh", str(tmp_path / "none.off")])
    assert result.exit_code == 1
