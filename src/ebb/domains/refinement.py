"""Tetrahedra split in eight."""

from __future__ import annotations

import numpy as np

from ebb.domains.io.data import Floats, Integers, MeshData, Region
from ebb.domains.topology import undirected_edges
from ebb.records import replace

# The corners of a tetrahedron are numbered from 0 to 3, the middles of its edges 01, 02, 03, 12, 13, 23 from 4 to 9.
# Each child has the orientation of its parent.
_CORNERS = np.array([(0, 4, 5, 6), (4, 1, 7, 8), (5, 7, 2, 9), (6, 8, 9, 3)])
"""The four children at the corners, half as large as their parent and alike in shape."""

_DIAGONALS = np.array([(4, 9), (5, 8), (6, 7)])
"""What is left is an octahedron, with the middles of opposite edges opposite each other."""

_AROUND = np.array(
    [
        [(4, 9, 5, 6), (4, 9, 6, 8), (4, 9, 8, 7), (4, 9, 7, 5)],
        [(5, 8, 6, 4), (5, 8, 9, 6), (5, 8, 7, 9), (5, 8, 4, 7)],
        [(6, 7, 4, 5), (6, 7, 5, 9), (6, 7, 9, 8), (6, 7, 8, 4)],
    ]
)
"""For each diagonal, the four children around it."""

_CURVE_BITS = 10
"""How often the bounding box is halved along each axis to order points: 1024 cubes along its longest side."""

_PART = 1 << 16
"""How many tetrahedra are split at a time, so that little memory is taken besides the result."""


def refine_tetrahedra(mesh: MeshData) -> MeshData:
    """Each tetrahedron in eight: four at its corners, and four around the shortest diagonal of the octahedron between.

    This is Bey's red refinement ("Tetrahedral grid refinement", Computing 55, 1995), with the diagonal by length. The
    points stay and keep their numbers; after them come the middles of the edges, of which those that lie close together
    mostly have close numbers. The children of the tetrahedron i are those from 8 i to 8 i + 7.
    """
    edges = undirected_edges(mesh.cells, len(mesh.points))
    middles = (mesh.points[edges.low] + mesh.points[edges.high]) / 2
    order = _along_curve(middles)
    points = np.concatenate([mesh.points, middles[order]])
    number = np.empty_like(order)
    number[order] = np.arange(len(mesh.points), len(points))
    cells = np.empty((len(mesh.cells), 8, 4), dtype=np.int64)
    for start in range(0, len(cells), _PART):
        part = slice(start, start + _PART)
        _split(np.hstack([mesh.cells[part], number[edges.of_pair[part]]]), points, cells[part])
    regions = tuple(replace(region, rows=_children(region)) for region in mesh.regions)
    return MeshData(points, cells.reshape(-1, 4), materials=mesh.materials, regions=regions)


def _along_curve(points: Floats) -> Integers:
    """The order of points along Morton's curve, on which neighbours are mostly close to each other."""
    low = points.min(axis=0, initial=np.inf)
    extent = float(np.max(points - low, initial=0)) or 1.0
    code = np.zeros(len(points), dtype=np.int64)
    cell = ((points - low) * ((1 << _CURVE_BITS) - 1) / extent).astype(np.int64)
    for axis in range(3):
        bits = cell[:, axis]
        for bit in range(_CURVE_BITS):
            code |= ((bits >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def _split(nodes: Integers, points: Floats, children: Integers) -> None:
    """Set the ``children`` of tetrahedra with these ten points each."""
    lengths = np.stack([_squared(points[nodes[:, j]] - points[nodes[:, i]]) for i, j in _DIAGONALS.tolist()])
    shortest = np.argmin(lengths, axis=0)
    children[:, :4] = nodes[:, _CORNERS]
    rows = np.arange(len(nodes))[:, None, None]
    children[:, 4:] = nodes[rows, _AROUND[shortest]]


def _squared(vectors: Floats) -> Floats:
    return np.einsum("ij,ij->i", vectors, vectors)


def _children(region: Region) -> Integers:
    return (8 * np.asarray(region.rows)[:, None] + np.arange(8)).ravel()
