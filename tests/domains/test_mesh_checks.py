"""Arrays that make no mesh are refused, and the message names the row."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import TetMesh, TriMesh

SQUARE = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
CORNER = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
NAN = float("nan")

# name: (points, triangles, code, text)
TRIANGLES = {
    "points in the plane": ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "E712", "positions should be numbers"),
    "points are words": ([["a", "b", "c"]], [[0, 0, 0]], "E712", "positions should be numbers"),
    "ragged points": ([[0, 0, 0], [1]], [[0, 1, 2]], "E712", "positions should be an array"),
    "ragged corners": (SQUARE, [[0, 1, 2], [1]], "E712", "triangles should be an array"),
    "complex points": (np.ones((3, 3), dtype=complex), [[0, 1, 2]], "E712", "complex128"),
    "quadrangles": (SQUARE, [[0, 1, 3, 2]], "E712", r"\(1, 4\)"),
    "corners are floats": (SQUARE, [[0.0, 1.0, 2.0]], "E712", "float64"),
    "one triangle flat": (SQUARE, [0, 1, 2], "E712", r"shape \(3,\)"),
    "index too large": (SQUARE, [[0, 1, 2], [1, 3, 4]], "E705", "triangle 1 has the corner 4"),
    "index negative": (SQUARE, [[0, 1, -1]], "E705", "corner -1"),
    "no points": ([], [[0, 1, 2]], "E705", "there are no points"),
    "NaN": ([[0, 0, 0], [1, NAN, 0], [0, 1, 0]], [[0, 1, 2]], "E706", "point 1"),
    "infinite, unused": ([*SQUARE, [float("inf"), 0, 0]], [[0, 1, 2]], "E706", "point 4"),
    "beyond float32": ([*SQUARE, [0, -1e39, 0]], [[0, 1, 2]], "E706", "point 4 .* too large for float32"),
    "corner twice": (SQUARE, [[0, 1, 2], [1, 3, 3]], "E707", "triangle 1 .* names one point twice"),
    "in a line": ([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]], "E707", "no area"),
    "three at an edge": (CORNER, [[0, 1, 2], [1, 0, 3], [0, 1, 4]], "E709", r"one of 3 at the edge of the points"),
    "turned over": (SQUARE, [[0, 1, 2], [1, 2, 3]], "E710", "triangle 1 and triangle 0"),
    "twice": (SQUARE, [[0, 1, 2], [0, 1, 2]], "E710", "triangle 1 and triangle 0"),
}
TETRAHEDRA = {
    "triangles": (CORNER, [[0, 1, 2]], "E712", r"\(n, 4\)"),
    "index too large": (CORNER, [[0, 1, 2, 5]], "E705", "corner 5"),
    "NaN": ([*CORNER[:3], [0, 0, NAN]], [[0, 1, 2, 3]], "E706", "point 3"),
    "flat": (SQUARE, [[0, 1, 2, 3]], "E707", "no volume"),
    "corner twice": (CORNER, [[0, 1, 2, 2]], "E707", "names one point twice"),
    "inverted": (CORNER, [[0, 1, 2, 3], [0, 2, 1, 4]], "E708", "tetrahedron 1 .* is inverted"),
    "three at a face": (
        [*CORNER, [2, 2, 3]],
        [[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]],
        "E709",
        "one of 3 at the face",
    ),
}


@pytest.mark.parametrize("name", TRIANGLES)
def test_triangles(name):
    points, cells, code, text = TRIANGLES[name]
    with pytest.raises(ebb.MeshFormatError, match=text) as caught:
        TriMesh.from_arrays(points, cells)
    assert caught.value.codes == (code,)


@pytest.mark.parametrize("name", TETRAHEDRA)
def test_tetrahedra(name):
    points, cells, code, text = TETRAHEDRA[name]
    with pytest.raises(ebb.MeshFormatError, match=text) as caught:
        TetMesh.from_arrays(points, cells)
    assert caught.value.codes == (code,)


def test_what_is_no_manifold_can_be_taken_as_it_is():
    points, cells, _, _ = TRIANGLES["three at an edge"]
    mesh = TriMesh.from_arrays(points, cells, manifold=False)
    assert (mesh.triangles.size, mesh.edges.size) == (3, 14)
    with pytest.raises(ebb.MeshFormatError, match="no area"):
        TriMesh.from_arrays(points, [[0, 1, 1]], manifold=False)


def test_scale_does_not_decide_what_is_flat():
    for scale in (1e-12, 1e12):
        assert TetMesh.from_arrays(np.multiply(CORNER, scale), [[0, 1, 2, 3]]).tetrahedra.size == 1
        assert TriMesh.from_arrays(np.multiply(CORNER, scale), [[0, 1, 2]]).triangles.size == 1


@pytest.mark.parametrize("dtype", [np.int8, np.uint16, np.int32, np.uint64])
def test_corners_may_be_integers_of_any_size(dtype):
    assert TriMesh.from_arrays(np.array(SQUARE, np.float32), np.array([[0, 1, 2]], dtype)).edges.size == 6
