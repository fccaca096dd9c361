"""A fine surface coupled to a coarse solid."""

from __future__ import annotations

import numpy as np
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

import ebb
import rendermesh
from ebb.domains import TetMesh, TriMesh


@pytest.fixture
def pair():
    skin = TriMesh.torus(1.0, 0.4, 40, 24)
    solid = TetMesh.from_surface(skin, resolution=8)
    rendermesh.couple(skin, solid)
    return skin, solid


def test_untwisted_the_skin_stays(pair):
    skin, solid = pair
    rendermesh.deform(skin, solid, 0.0)
    assert rendermesh.distance(skin) < 1e-5


def test_linear_maps_are_followed_exactly(pair):
    skin, solid = pair
    matrix, shift = np.array([[1, 0.5, 0], [0, 2, 0.25], [-1, 0, 1]]), np.array([3, -1, 2])
    solid.vertices.q.load(solid.vertices.pos.to_numpy() @ matrix.T + shift)
    rendermesh.follow(skin.vertices)
    expected = skin.vertices.pos.to_numpy() @ matrix.T + shift
    assert skin.vertices.q.to_numpy() == pytest.approx(expected, abs=1e-4)


def test_a_twist_keeps_heights_and_distances_from_the_axis(pair):
    skin, solid = pair
    rendermesh.deform(skin, solid, 0.25)
    place, q = solid.vertices.pos.to_numpy(), solid.vertices.q.to_numpy()
    assert q[:, 2] == pytest.approx(place[:, 2])
    assert np.hypot(q[:, 0], q[:, 1]) == pytest.approx(np.hypot(place[:, 0], place[:, 1]), abs=1e-5)
    assert 0.1 < rendermesh.distance(skin) < 2


def test_the_skin_nears_the_exact_twist_as_the_solid_gets_finer():
    errors = []
    for resolution in (6, 12, 24):
        skin = TriMesh.icosphere(3)
        solid = TetMesh.from_surface(skin, resolution=resolution)
        rendermesh.couple(skin, solid)
        rendermesh.deform(skin, solid, 0.25)
        x, y, z = skin.vertices.pos.to_numpy().T
        c, s = np.cos(0.5 * np.pi * z), np.sin(0.5 * np.pi * z)
        exact = np.stack([c * x - s * y, s * x + c * y, z], axis=1)
        errors.append(np.abs(skin.vertices.q.to_numpy() - exact).max())
    assert errors[1] < 0.4 * errors[0] and errors[2] < 0.4 * errors[1]  # it is of second order


def test_normals_are_unit_and_point_outwards(pair):
    skin, solid = pair
    rendermesh.deform(skin, solid, 0.0)
    p, normal = skin.vertices.pos.to_numpy(), skin.vertices.normal.to_numpy()
    ring = p * [1, 1, 0] / np.hypot(p[:, 0], p[:, 1])[:, None]
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1, abs=1e-5)
    assert np.einsum("ij,ij->i", normal, (p - ring) / 0.4).min() > 0.98


@pytest.mark.parametrize("suffix", ["off", "ply", "vtu"])
def test_the_program(tmp_path, suffix):
    if suffix != "off":
        pytest.importorskip("meshio")
    app = typer.Typer()
    app.command()(rendermesh.main)
    TriMesh.icosphere(2).save(tmp_path / "sphere.off")
    words = ["--mesh", str(tmp_path / "sphere.off"), "--resolution", "5", "--save", str(tmp_path / f"out.{suffix}")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "162 points of the skin" in result.output
    assert TriMesh.load(tmp_path / f"out.{suffix}").triangles.size == 320


def test_the_torus_stands_upright():
    points = rendermesh.load_skin("torus", Console(quiet=True)).vertices.pos.to_numpy()
    assert np.ptp(points, axis=0) == pytest.approx([1, 0.296, 1], abs=0.01)
    assert points[:, 2].min() == pytest.approx(0, abs=1e-6)


def soft_pair():
    skin = TriMesh.icosphere(2)
    solid = TetMesh.from_surface(skin, resolution=4, self_edges=True, precision=ebb.float64)
    body = rendermesh.soft_body(solid)
    rendermesh.tie(skin, solid)
    return skin, body


def test_the_skin_of_a_soft_body_follows_linear_maps_exactly():
    skin, body = soft_pair()
    matrix, shift = np.array([[1, 0.5, 0], [0, 2, 0.25], [-1, 0, 1]]), np.array([3, -1, 2])
    rest = body.mesh.vertices.pos.to_numpy()
    body.mesh.vertices.q.load(rest @ matrix.T + shift - rest)
    rendermesh.follow_body(skin.vertices)
    expected = skin.vertices.pos.to_numpy() @ matrix.T + shift
    assert skin.vertices.q.to_numpy() == pytest.approx(expected, abs=1e-4)


def test_a_soft_body_sways_and_its_foot_stays():
    skin, body = soft_pair()
    assert list(rendermesh.sway(skin, body, 6, 0.01)) == list(range(1, 7))
    moved = skin.vertices.q.to_numpy() - skin.vertices.pos.to_numpy()
    height = skin.vertices.pos.to_numpy()[:, 2]
    assert moved[height > 0.8, 0].min() > 0.002  # to where it is pulled
    assert np.abs(moved[height < -0.99]).max() < 0.1 * np.abs(moved).max()


def test_the_program_of_a_soft_body(tmp_path):
    app = typer.Typer()
    app.command()(rendermesh.main)
    TriMesh.icosphere(2).save(tmp_path / "sphere.off")
    TetMesh.ball(2, 1.2).save(tmp_path / "ball.veg")
    words = ["--mesh", str(tmp_path / "sphere.off"), "--solid", str(tmp_path / "ball.veg"), "--motion", "sway"]
    result = CliRunner().invoke(app, [*words, "--steps", "3", "--save", str(tmp_path / "out.off")])
    assert result.exit_code == 0, result.output
    assert "162 points of the skin in 160 tetrahedra" in result.output
    assert TriMesh.load(tmp_path / "out.off").triangles.size == 320
    ball = TetMesh.ball(2, 1.2)
    cells = ball.tetrahedra.v.to_numpy()
    cells[3] = cells[3, [0, 1, 3, 2]]
    np.savez(tmp_path / "ball.npz", V=ball.vertices.pos.to_numpy(), T=cells)
    other = ["--mesh", words[1], "--solid", str(tmp_path / "ball.npz")]
    result = CliRunner().invoke(app, other)
    assert "tetrahedron 3 " in str(result.exception) and "--fix-orientation turns" in str(result.exception)
    result = CliRunner().invoke(app, [*other, "--fix-orientation"])
    assert result.exit_code == 0 and "1 of the 160 tetrahedra were inverted" in result.output
    result = CliRunner().invoke(app, ["--mesh", words[1], "--fix-orientation"])
    assert result.exit_code == 2 and "there is no --solid" in result.output
