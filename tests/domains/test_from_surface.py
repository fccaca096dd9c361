"""Closed surfaces filled with tetrahedra, and points embedded in them."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import TetMesh, TriMesh
from ebb.domains.lattice import inside


def surface_arrays(mesh):
    return mesh.vertices.pos.to_numpy().astype(np.float64), mesh.triangles.v.to_numpy().astype(np.int64)


def test_a_cube_that_fits_the_lattice_is_filled_exactly():
    # Its faces, edges and corners lie on the lines along which the inside is found.
    for cubes in (1, 2, 4, 5, 8):
        mesh = TetMesh.from_surface(TriMesh.box(4, 4, 4), resolution=cubes)
        assert mesh.tetrahedra.size == 6 * cubes**3
        assert mesh.tetrahedra.volume.to_numpy().sum() == pytest.approx(1)


def test_a_ball_is_covered_with_little_more():
    sphere = TriMesh.icosphere(4)
    mesh = TetMesh.from_surface(sphere, resolution=24)
    centres = mesh.vertices.pos.to_numpy()[mesh.tetrahedra.v.to_numpy()].mean(axis=1)
    assert np.linalg.norm(centres, axis=1).max() < 1 + 2 * 3**0.5 / 24
    assert 4.19 < mesh.tetrahedra.volume.to_numpy().sum() < 4.19 * 1.25
    _, weights = mesh.embed(sphere.vertices.pos.to_numpy() * 0.999)
    assert (weights.min(axis=1) < -1e-6).mean() < 0.02


def test_inside_agrees_with_the_formula_of_a_torus():
    points, triangles = surface_arrays(TriMesh.torus(1.0, 0.4, 160, 90))
    samples = tuple(np.linspace(-1.6, 1.6, n) for n in (41, 37, 33))
    x, y, z = np.meshgrid(*samples, indexing="ij")
    distance = np.hypot(np.hypot(x, y) - 1.0, z)
    found = inside(points, triangles, samples)
    sure = np.abs(distance - 0.4) > 0.002
    assert np.array_equal(found[sure], (distance < 0.4)[sure])


def test_overlapping_parts_and_cavities_count_by_winding():
    points, triangles = surface_arrays(TriMesh.icosphere(3))
    shifted = np.concatenate([points, points + np.array([0.5, 0, 0])])
    both = np.concatenate([triangles, triangles + len(points)])
    hollow = np.concatenate([points, 0.5 * points])
    with_cavity = np.concatenate([triangles, triangles[:, ::-1] + len(points)])
    samples = (np.array([-0.9, 0.05, 0.25, 0.7, 1.4]), np.array([0.013]), np.array([0.017]))
    assert inside(shifted, both, samples).ravel().tolist() == [True] * 5
    assert inside(hollow, with_cavity, samples).ravel().tolist() == [True, False, False, True, False]


def test_arrays_stand_for_a_surface():
    points, triangles = surface_arrays(TriMesh.icosphere(1))
    assert TetMesh.from_surface(points, triangles, resolution=np.int16(5)).tetrahedra.size > 0


@pytest.mark.parametrize("resolution", [0, -3, 2.5, 3.0, True, np.True_, "8", float("nan")])
def test_resolution_is_a_positive_integer(resolution):
    with pytest.raises(ValueError, match="resolution"):
        TetMesh.from_surface(TriMesh.icosphere(0), resolution=resolution)


def test_an_open_surface_is_refused():
    with pytest.raises(ebb.MeshFormatError, match="not closed") as caught:
        TetMesh.from_surface(TriMesh.grid(2, 2), resolution=4)
    assert caught.value.codes == ("E711",)


SOLIDS = {
    "ball": lambda: TetMesh.ball(3),
    "box": lambda: TetMesh.box(3, 2, 2),
    "torus": lambda: TetMesh.from_surface(TriMesh.torus(1.0, 0.4, 30, 20), resolution=10),
}


@pytest.fixture(params=SOLIDS)
def solid(request):
    return SOLIDS[request.param]()


def test_embedding_gives_the_points_back(solid):
    rng = np.random.default_rng(2)
    corners, cells = solid.vertices.pos.to_numpy().astype(float), solid.tetrahedra.v.to_numpy()
    low, high = corners.min(axis=0), corners.max(axis=0)
    points = rng.uniform(low - 0.3, high + 0.3, size=(3000, 3))  # some of them outside
    rows, weights = solid.embed(points)
    assert weights.sum(axis=1) == pytest.approx(1)
    assert np.einsum("ni,nij->nj", weights, corners[cells[rows]]) == pytest.approx(points, abs=1e-5)


def test_points_inside_get_weights_that_are_not_negative(solid):
    rng = np.random.default_rng(4)
    corners, cells = solid.vertices.pos.to_numpy().astype(float), solid.tetrahedra.v.to_numpy()
    chosen = rng.integers(len(cells), size=2000)
    points = np.einsum("ni,nij->nj", rng.dirichlet(np.ones(4), 2000), corners[cells[chosen]])
    rows, weights = solid.embed(points)
    assert weights.min() > -1e-5
    assert (rows == chosen).mean() > 0.95


def test_points_outside_get_a_tetrahedron_nearby():
    solid = TetMesh.ball(4)
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rows, _ = solid.embed(1.2 * directions)
    centres = solid.vertices.pos.to_numpy()[solid.tetrahedra.v.to_numpy()[rows]].mean(axis=1)
    assert np.linalg.norm(centres - directions, axis=1).max() < 0.5


def test_points_far_away_get_a_tetrahedron_on_their_side():
    rows, _ = TetMesh.box(40, 1, 1, (40, 1, 1)).embed([[-1e30, 0.5, 0.5], [1e30, 0.5, 0.5]])
    near, far = rows // 6
    assert near < 5 and far > 35


def test_no_points_and_bad_points():
    solid = TetMesh.box(1, 1, 1)
    rows, weights = solid.embed(np.empty((0, 3)))
    assert rows.shape == (0,) and weights.shape == (0, 4)
    with pytest.raises(ebb.MeshFormatError, match="not finite"):
        solid.embed([[0.0, float("nan"), 0.0]])
    with pytest.raises(ebb.MeshFormatError, match="shape"):
        solid.embed([[0.0, 0.0]])
    with pytest.raises(ebb.MeshFormatError, match="empty"):
        TetMesh.from_arrays([], []).embed([[0.0, 0.0, 0.0]])
