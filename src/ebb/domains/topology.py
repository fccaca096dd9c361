"""Edges, faces and boundaries of meshes of simplices, by sorting."""

from __future__ import annotations

from itertools import combinations
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from ebb.domains.io.data import Floats, Integers
from ebb.records import record

Keys: TypeAlias = npt.NDArray[np.signedinteger[Any]]

# The faces of a tetrahedron of positive volume, each with its normal outwards; the i-th is opposite corner i.
OUTWARD_FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])


@record(eq=False)
class Edges:
    """The edges of a mesh, sorted by their lower and then by their higher end.

    ``of_pair`` has the shape (cells, pairs): the edge of each pair of corners of each cell, in the order of
    ``itertools.combinations``. The arrays are int32 where that is enough.
    """

    low: Keys
    high: Keys
    of_pair: Keys


@record(eq=False)
class DirectedEdges:
    """The edges of a mesh, each in both directions, sorted by tail and then by head.

    ``of_cell`` has the shape (cells, corners, corners): the edge from corner i to corner j. On the diagonal it is the
    self edge of the corner, or -1 where there are none. ``diagonal`` is the self edge of each vertex, or None. The
    arrays are int32 where that is enough.
    """

    tail: Keys
    head: Keys
    of_cell: Keys
    diagonal: Keys | None


def directed_edges(
    cells: Integers, n_vertices: int, self_edges: bool = False, edges: Edges | None = None
) -> DirectedEdges:
    """The directed edges between the corners of each cell, and from each vertex to itself if wanted.

    Args:
        cells: the corners of each.
        n_vertices: how many vertices there are.
        self_edges: whether each has an edge to itself.
        edges: ``undirected_edges`` of the cells, if they are known.
    """
    edges = edges or undirected_edges(cells, n_vertices)
    low, high = edges.low, edges.high
    # A vertex has first the edges to lower ones, then that to itself, then those to higher ones.
    below, above = np.bincount(high, minlength=n_vertices), np.bincount(low, minlength=n_vertices)
    counts = below + above + self_edges
    size = int(counts.sum())
    key = _key_dtype(max(size, n_vertices))
    ends = np.cumsum(counts)
    first_above = ends - above
    up = (np.arange(len(low)) + np.repeat(first_above - (np.cumsum(above) - above), above)).astype(key)
    by_high = np.argsort(high, kind="stable")
    down = np.empty(len(low), dtype=key)
    down[by_high] = np.arange(len(low)) + np.repeat(ends - counts - (np.cumsum(below) - below), below)
    head = np.empty(size, dtype=key)
    head[up], head[down] = high, low
    diagonal = (first_above - 1).astype(key) if self_edges else None
    if diagonal is not None:
        head[diagonal] = np.arange(n_vertices)
    tail = np.repeat(np.arange(n_vertices, dtype=key), counts)
    return DirectedEdges(tail, head, _edges_of_cells(cells, edges.of_pair, up, down, diagonal), diagonal)


def _edges_of_cells(cells: Integers, of_pair: Keys, up: Keys, down: Keys, diagonal: Keys | None) -> Keys:
    corners = cells.shape[1]
    of_cell = np.full((len(cells), corners, corners), -1, dtype=up.dtype)
    for column, (i, j) in enumerate(combinations(range(corners), 2)):
        forward = cells[:, i] < cells[:, j]
        edge = of_pair[:, column]
        rising, falling = up[edge], down[edge]
        of_cell[:, i, j] = np.where(forward, rising, falling)
        of_cell[:, j, i] = np.where(forward, falling, rising)
    if diagonal is not None:
        for i in range(corners):
            of_cell[:, i, i] = diagonal[cells[:, i]]
    return of_cell


def undirected_edges(cells: Integers, n_vertices: int) -> Edges:
    """The edges between the corners of each cell."""
    n_vertices = max(n_vertices, 1)
    pairs = list(combinations(range(cells.shape[1]), 2))
    # Codes need int64: they fit for 3e9 vertices.
    code = np.empty((len(pairs), len(cells)), dtype=np.int64)
    for row, (i, j) in enumerate(pairs):
        a, b = cells[:, i], cells[:, j]
        np.minimum(a, b, out=code[row])
        code[row] *= n_vertices
        code[row] += np.maximum(a, b)
    distinct = sorted_distinct(code)
    of_pair = np.empty((len(cells), len(pairs)), dtype=_key_dtype(len(distinct)))
    for row in range(len(pairs)):
        of_pair[:, row] = rank_in(distinct, code[row])
    key = _key_dtype(n_vertices)
    return Edges((distinct // n_vertices).astype(key), (distinct % n_vertices).astype(key), of_pair)


def _key_dtype(size: int) -> type[np.int32] | type[np.int64]:
    return np.int32 if size <= np.iinfo(np.int32).max else np.int64


def rank_in(ordered: Integers | Floats, values: npt.ArrayLike, side: Literal["left", "right"] = "left") -> Integers:
    """``np.searchsorted`` with the type that it has."""
    ranks: Any = np.searchsorted(ordered, values, side=side)  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
    return ranks


def sorted_distinct(values: Integers) -> Integers:
    """The distinct values in rising order. (``np.unique`` is some times slower on codes of this kind.)"""
    ordered = np.sort(values, axis=None)
    keep = np.ones(len(ordered), dtype=bool)
    keep[1:] = ordered[1:] != ordered[:-1]
    return ordered[keep]


@record(eq=False)
class Faces:
    """The triangles of a tetrahedral mesh.

    ``boundary`` has the shape (faces, 3): those of one tetrahedron, outward. ``crowded`` is None, or a face of more
    than two tetrahedra: (its points, a tetrahedron at it, how many there are). ``folded`` tells whether two tetrahedra
    at one face have the fourth corner, too, in common.
    """

    boundary: Integers
    crowded: tuple[tuple[int, ...], int, int] | None
    folded: bool


def faces_of_tetrahedra(cells: Integers, n_vertices: int, edges: Edges | None = None) -> Faces:
    """The boundary of tetrahedra of positive volume, in the order of their tetrahedra.

    ``edges`` are ``undirected_edges`` of the cells, if they are known.
    """
    of_pair = (edges or undirected_edges(cells, n_vertices)).of_pair
    columns = {pair: column for column, pair in enumerate(combinations(range(4), 2))}
    # A face is told by its highest point and the edge of the other two, which is the lowest-numbered of its edges.
    code = np.empty((len(cells), 4), dtype=np.int64)
    for face, (i, j, k) in enumerate(OUTWARD_FACES.tolist()):
        sides = [of_pair[:, columns[min(pair), max(pair)]] for pair in ((i, j), (j, k), (k, i))]
        lowest = np.minimum(np.minimum(sides[0], sides[1]), sides[2])
        highest = np.maximum(np.maximum(cells[:, i], cells[:, j]), cells[:, k])
        code[:, face] = lowest
        code[:, face] *= n_vertices
        code[:, face] += highest
    flat = code.ravel()
    order = np.argsort(flat, kind="stable")
    starts = np.flatnonzero(np.diff(flat[order], prepend=-1))
    counts = np.diff(starts, append=len(flat))
    single = np.sort(order[starts[counts == 1]])
    boundary = cells[single[:, None] // 4, OUTWARD_FACES[single % 4]]
    crowded = None
    if counts.size and counts.max() > 2:
        worst = int(np.argmax(counts > 2))
        first = int(order[starts[worst]])
        points = tuple(cells[first // 4, OUTWARD_FACES[first % 4]].tolist())
        crowded = (points, first // 4, int(counts[worst]))
    pairs, opposite = starts[counts == 2], cells.ravel()  # the number of a face is that of the corner opposite to it
    folded = bool((opposite[order[pairs]] == opposite[order[pairs + 1]]).any())
    return Faces(boundary, crowded, folded)


def corner_rows(cells: Integers) -> tuple[Integers, Integers]:
    """The incidence of vertices and cells as rows (vertex, cell), sorted by vertex and then by cell."""
    vertex = cells.ravel()
    order = np.argsort(vertex, kind="stable")
    return vertex[order], order // cells.shape[1]


def used_points(cells: Integers) -> tuple[Integers, Integers]:
    """The points that cells use, in rising order, and the cells numbered among these."""
    used = sorted_distinct(cells)
    return used, rank_in(used, cells)
