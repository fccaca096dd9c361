"""Edges, faces and boundaries of meshes of simplices, by sorting."""

from __future__ import annotations

from itertools import combinations
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ebb.domains.io.data import Floats, Integers
from ebb.records import record

# The faces of a tetrahedron of positive volume, each with its normal outwards; the i-th is opposite corner i.
OUTWARD_FACES = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])


@record(eq=False)
class DirectedEdges:
    """The edges of a mesh, each in both directions, sorted by tail and then by head.

    ``of_cell`` has the shape (cells, corners, corners): the edge from corner i to corner j. On the diagonal it is the
    self edge of the corner, or -1 where there are none. ``diagonal`` is the self edge of each vertex, or None.
    """

    tail: Integers
    head: Integers
    of_cell: Integers
    diagonal: Integers | None


def directed_edges(cells: Integers, n_vertices: int, self_edges: bool = False) -> DirectedEdges:
    """The directed edges between the corners of each cell, and from each vertex to itself if wanted."""
    loops = np.arange(n_vertices if self_edges else 0)
    n_vertices = max(n_vertices, 1)
    low, high, of_pair = undirected_edges(cells, n_vertices)
    # Sorting by tail * n + head needs int64 codes: they fit for 3e9 vertices.
    code = np.concatenate([low * n_vertices + high, high * n_vertices + low, loops * n_vertices + loops])
    order = np.argsort(code, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    up, down, self_rank = np.split(rank, [len(low), 2 * len(low)])

    corners = cells.shape[1]
    of_cell = np.full((len(cells), corners, corners), -1, dtype=np.int64)
    for column, (i, j) in enumerate(combinations(range(corners), 2)):
        forward = cells[:, i] < cells[:, j]
        edge = of_pair[:, column]
        of_cell[:, i, j] = np.where(forward, up[edge], down[edge])
        of_cell[:, j, i] = np.where(forward, down[edge], up[edge])
    if self_edges:
        for i in range(corners):
            of_cell[:, i, i] = self_rank[cells[:, i]]
    code = code[order]
    return DirectedEdges(code // n_vertices, code % n_vertices, of_cell, self_rank if self_edges else None)


def undirected_edges(cells: Integers, n_vertices: int) -> tuple[Integers, Integers, Integers]:
    """The lower and the higher end of each edge, and the edge of each pair of corners of each cell.

    The pairs are in the order of ``itertools.combinations``; the edges are sorted by (lower, higher).
    """
    n_vertices = max(n_vertices, 1)
    pairs = list(combinations(range(cells.shape[1]), 2))
    code = np.empty((len(cells), len(pairs)), dtype=np.int64)
    for column, (i, j) in enumerate(pairs):
        a, b = cells[:, i], cells[:, j]
        np.add(np.minimum(a, b) * n_vertices, np.maximum(a, b), out=code[:, column])
    distinct = sorted_distinct(code)
    return distinct // n_vertices, distinct % n_vertices, rank_in(distinct, code)


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
    than two tetrahedra: (its points, a tetrahedron at it, how many there are).
    """

    boundary: Integers
    crowded: tuple[tuple[int, ...], int, int] | None


def faces_of_tetrahedra(cells: Integers, n_vertices: int) -> Faces:
    """The boundary of tetrahedra of positive volume, in the order of their tetrahedra."""
    _, _, of_pair = undirected_edges(cells, n_vertices)
    columns = {pair: column for column, pair in enumerate(combinations(range(4), 2))}
    # A face is told by its highest point and the edge of the other two, which is the lowest-numbered of its edges.
    code = np.empty((len(cells), 4), dtype=np.int64)
    for face, (i, j, k) in enumerate(OUTWARD_FACES.tolist()):
        edges = [of_pair[:, columns[min(pair), max(pair)]] for pair in ((i, j), (j, k), (k, i))]
        lowest = np.minimum(np.minimum(edges[0], edges[1]), edges[2])
        highest = np.maximum(np.maximum(cells[:, i], cells[:, j]), cells[:, k])
        code[:, face] = lowest * n_vertices + highest
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
    return Faces(boundary, crowded)


def corner_rows(cells: Integers) -> tuple[Integers, Integers]:
    """The incidence of vertices and cells as rows (vertex, cell), sorted by vertex and then by cell."""
    vertex = cells.ravel()
    order = np.argsort(vertex, kind="stable")
    return vertex[order], order // cells.shape[1]


def used_points(cells: Integers) -> tuple[Integers, Integers]:
    """The points that cells use, in rising order, and the cells numbered among these."""
    used = sorted_distinct(cells)
    return used, rank_in(used, cells)
