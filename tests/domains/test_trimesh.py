"""Surfaces: what the generators make, and that the relations hang together."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import TriMesh

# name: (mesh, Euler characteristic, boundary edges)
SHAPES = {
    "icosahedron": (lambda: TriMesh.icosphere(0), 2, 0),
    "icosphere": (lambda: TriMesh.icosphere(2, radius=3.0), 2, 0),
    "torus": (lambda: TriMesh.torus(1.0, 0.3, 12, 7), 0, 0),
    "grid": (lambda: TriMesh.grid(4, 3), 1, 14),
    "box": (lambda: TriMesh.box(2, 3, 4), 2, 0),
}


@pytest.fixture(params=SHAPES)
def shape(request):
    make, euler, boundary = SHAPES[request.param]
    return make(), euler, boundary


def arrays(mesh):
    return mesh.vertices.pos.to_numpy().astype(np.float64), mesh.triangles.v.to_numpy()


def enclosed_volume(points, triangles):
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij", np.cross(a, b), c) / 6


def test_euler_characteristic_and_boundary(shape):
    mesh, euler, boundary = shape
    assert mesh.vertices.size - mesh.edges.size // 2 + mesh.triangles.size == euler
    assert mesh.edges.size - 3 * mesh.triangles.size == boundary  # a boundary edge has a triangle in one direction


def test_edges_are_both_ways_once_and_sorted(shape):
    mesh, _, _ = shape
    tail, head = mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy()
    pairs = list(zip(tail.tolist(), head.tolist(), strict=True))
    assert pairs == sorted(set(pairs))
    assert set(pairs) == {(b, a) for a, b in pairs}
    assert (tail != head).all()


@pytest.mark.parametrize("name", ["e01", "e10", "e12", "e21", "e20", "e02"])
def test_edge_fields_join_the_corners(shape, name):
    mesh, _, _ = shape
    edge = getattr(mesh.triangles, name).to_numpy()
    corners = mesh.triangles.v.to_numpy()
    assert (mesh.edges.tail.to_numpy()[edge] == corners[:, int(name[1])]).all()
    assert (mesh.edges.head.to_numpy()[edge] == corners[:, int(name[2])]).all()


def test_members_in_kernels(shape):
    mesh, _, _ = shape
    vertices = mesh.vertices
    for name in ("degree", "neighbor_sum", "triangle_count", "corner_sum"):
        vertices.new_field(name, ebb.int64, init=0)

    @ebb.kernel
    def count(v: vertices):
        for e in v.edges:
            v.degree += 1
            assert e.tail == v
        for n in v.neighbors:
            v.neighbor_sum += ebb.id(n)
        for t in v.triangles:
            v.triangle_count += 1
            v.corner_sum += ebb.id(t)
            assert t.v[0] == v or t.v[1] == v or t.v[2] == v

    count(vertices)
    tail, head = mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy()
    corners, n = mesh.triangles.v.to_numpy(), vertices.size
    rows = np.repeat(np.arange(len(corners)), 3)
    assert np.array_equal(vertices.degree.to_numpy(), np.bincount(tail, minlength=n))
    assert np.array_equal(vertices.neighbor_sum.to_numpy(), np.bincount(tail, head, n))
    assert np.array_equal(vertices.triangle_count.to_numpy(), np.bincount(corners.ravel(), minlength=n))
    assert np.array_equal(vertices.corner_sum.to_numpy(), np.bincount(corners.ravel(), rows, n))


def test_normals_point_outwards():
    points, triangles = arrays(TriMesh.icosphere(3))
    assert enclosed_volume(points, triangles) == pytest.approx(4 / 3 * np.pi, rel=0.02)
    assert np.linalg.norm(points, axis=1) == pytest.approx(1, abs=1e-6)
    assert enclosed_volume(*arrays(TriMesh.box(2, 2, 2, size=(1, 2, 3)))) == pytest.approx(6)
    assert enclosed_volume(*arrays(TriMesh.torus(2, 0.5, 60, 40))) == pytest.approx(2 * np.pi**2 * 2 * 0.25, rel=0.02)


def test_grid_faces_up_and_has_its_area():
    points, triangles = arrays(TriMesh.grid(3, 5, size=(2.0, 3.0)))
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a) / 2
    assert (normals[:, 2] > 0).all()
    assert normals.sum(axis=0) == pytest.approx([0, 0, 6])


def test_empty_and_points_without_triangles():
    empty = TriMesh.from_arrays(np.empty((0, 3)), np.empty((0, 3), dtype=int))
    assert (empty.vertices.size, empty.edges.size, empty.triangles.size) == (0, 0, 0)
    loose = TriMesh.from_arrays(np.zeros((4, 3)), [])
    assert (loose.vertices.size, loose.edges.size) == (4, 0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: TriMesh.icosphere(-1),
        lambda: TriMesh.icosphere(1.5),
        lambda: TriMesh.torus(1, 0.2, 2, 5),
        lambda: TriMesh.grid(0, 1),
        lambda: TriMesh.box(1, True, 1),
    ],
)
def test_generators_refuse_impossible_counts(make):
    with pytest.raises(ValueError, match="should be an integer >= "):
        make()
