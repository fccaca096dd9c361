"""Polygons and polyhedra of simple shapes, as arrays. ``PolyMesh`` offers them as ``PolyMesh.goldberg`` and so on."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ebb.domains import generators
from ebb.domains.generators import require_count
from ebb.domains.hexahedra import FACES, brick_points, bricks
from ebb.domains.io.data import Floats, Integers, PolyData, Ragged
from ebb.domains.polyhedra import cell_faces, merged_faces, ragged
from ebb.domains.topology import faces_of_tetrahedra, sorted_distinct

# The six edges of a tetrahedron of positive volume, each followed by the two other corners in the order in which they
# come as one turns left about the edge.
_ABOUT_EDGES = ((0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 2, 0), (2, 3, 0, 1))


def surface(points: Floats, faces: Ragged) -> PolyData:
    """Faces without cells."""
    return PolyData(points, faces, ragged("cells", [], None))


def grid(nx: int, ny: int, size: tuple[float, float], split: Literal["none", "checkered"]) -> PolyData:
    """A rectangle in the plane z = 0 in nx x ny squares; with ``"checkered"`` every second is two triangles.

    Raises:
        ValueError: ``split`` is neither of the two.
    """
    if split not in ("none", "checkered"):
        raise ValueError(f"split should be 'none' or 'checkered', not {split!r}")
    nx, ny = require_count("nx", nx, 1), require_count("ny", ny, 1)
    x, y = np.meshgrid(np.linspace(0, size[0], nx + 1), np.linspace(0, size[1], ny + 1), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    i, j = (each.ravel() for each in np.indices((nx, ny)))
    a = i * (ny + 1) + j
    b, c, d = a + ny + 1, a + ny + 2, a + 1
    squares = ragged("faces", np.stack([a, b, c, d], axis=1), None)
    if split == "none":
        return surface(points, squares)
    # A square gives six corners, of which it keeps the first four where it stays whole.
    halves = (i + j) % 2 == 1
    corners = np.where(halves[:, None], np.stack([a, b, c, a, c, d], axis=1), np.stack([a, b, c, d, d, d], axis=1))
    kept = halves[:, None] | (np.arange(6) < 4)
    lengths = np.where(halves[:, None], 3, [4, 0]).ravel()
    return surface(points, Ragged.of_lengths(lengths[lengths > 0], corners[kept]))


def globe(n_around: int, n_up: int, radius: float) -> PolyData:
    """A sphere about the origin, of quadrangles between circles of latitude and triangles at the poles."""
    n, m = require_count("n_around", n_around, 3), require_count("n_up", n_up, 2)
    turn, tilt = 2 * np.pi * np.arange(n) / n, np.pi * np.arange(1, m) / m
    rings = np.stack(
        [
            np.outer(np.sin(tilt), np.cos(turn)),
            np.outer(np.sin(tilt), np.sin(turn)),
            np.repeat(np.cos(tilt)[:, None], n, axis=1),
        ],
        axis=-1,
    )
    points = np.concatenate([rings.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    top, bottom, last = n * (m - 1), n * (m - 1) + 1, n * (m - 2)
    faces: list[list[int]] = []
    for i in range(n):
        j = (i + 1) % n
        faces.append([top, i, j])
        faces += [[k + i, k + n + i, k + n + j, k + j] for k in range(0, last, n)]
        faces.append([bottom, last + j, last + i])
    return surface(points * radius, ragged("faces", faces, None))


def goldberg(subdivisions: int, radius: float) -> PolyData:
    """A sphere of 12 pentagons and otherwise hexagons, the dual of an icosphere (Goldberg 1937)."""
    points, triangles = generators.icosphere(subdivisions, 1.0)
    centres = points[triangles].mean(axis=1)
    centres *= radius / np.linalg.norm(centres, axis=1, keepdims=True)
    # At each point, from the next corner of a triangle there to the one before: the way around the point.
    way: list[dict[int, tuple[int, int]]] = [{} for _ in points]
    for number, (a, b, c) in enumerate(triangles.tolist()):
        for point, following, before in ((a, b, c), (b, c, a), (c, a, b)):
            way[point][following] = (before, number)
    faces = [_walk(steps, next(iter(steps))) for steps in way]
    return surface(centres, ragged("faces", faces, None))


def box(shape: tuple[int, int, int], size: tuple[float, float, float]) -> PolyData:
    """A box with a corner at the origin, in ``shape`` bricks."""
    made = bricks(brick_points(shape, size))
    return PolyData(made.points, *merged_faces(*cell_faces(made.cells, FACES.tolist())))


def dual(points: Floats, tetrahedra: Integers) -> PolyData:
    """The polyhedra about the points of a solid: one face across each edge, with corners at the tetrahedra's centres.

    At the boundary the cell of a point is cut off by the boundary itself, through the centres of the triangles and the
    middles of the edges there.

    Raises:
        ValueError: at an edge the tetrahedra are in several parts.
    """
    boundary = faces_of_tetrahedra(tetrahedra, len(points)).boundary
    used, middles = sorted_distinct(boundary), _boundary_edges(boundary)
    n_cells, n_triangles = len(tetrahedra), len(boundary)
    numbers = {edge: n_cells + n_triangles + i for i, edge in enumerate(middles)}
    corner: dict[int, int] = {point: n_cells + n_triangles + len(middles) + i for i, point in enumerate(used.tolist())}
    ends = np.array(middles, dtype=np.int64).reshape(-1, 2)
    places = [points[tetrahedra].mean(axis=1), points[boundary].mean(axis=1), points[ends].mean(axis=1), points[used]]

    faces: list[list[int]] = []
    cells: list[list[int]] = [[] for _ in range(len(points))]
    triangle = {tuple(sorted(row)): n_cells + i for i, row in enumerate(boundary.tolist())}
    for edge, steps in _ways_about_edges(tetrahedra).items():
        for point in edge:
            cells[point].append(len(faces))
        faces.append(_dual_face(edge, steps, triangle, numbers))
    corners: list[list[int]] = boundary.tolist()
    for number, (a, b, c) in enumerate(corners):
        for point, following, before in ((a, b, c), (b, c, a), (c, a, b)):
            cells[point].append(len(faces))
            ahead, behind = (numbers[min(point, other), max(point, other)] for other in (following, before))
            faces.append([corner[point], ahead, n_cells + number, behind])
    filled = [cell for cell in cells if cell]
    return PolyData(np.concatenate(places), ragged("faces", faces, None), ragged("cells", filled, None))


def _boundary_edges(boundary: Integers) -> list[tuple[int, int]]:
    pairs = {(min(a, b), max(a, b)) for row in boundary.tolist() for a, b in zip(row, row[1:] + row[:1], strict=True)}
    return sorted(pairs)


def _ways_about_edges(tetrahedra: Integers) -> dict[tuple[int, int], dict[int, tuple[int, int]]]:
    """For each edge: from a corner beside it to the next as one turns left about it, and the tetrahedron between."""
    ways: dict[tuple[int, int], dict[int, tuple[int, int]]] = {}
    for number, cell in enumerate(tetrahedra.tolist()):
        for i, j, k, l in _ABOUT_EDGES:  # noqa: E741
            tail, head, first, second = cell[i], cell[j], cell[k], cell[l]
            if tail > head:
                tail, head, first, second = head, tail, second, first
            ways.setdefault((tail, head), {})[first] = (second, number)
    return ways


def _dual_face(
    edge: tuple[int, int],
    steps: dict[int, tuple[int, int]],
    triangle: dict[tuple[int, ...], int],
    middle: dict[tuple[int, int], int],
) -> list[int]:
    """The centres of the tetrahedra about an edge; at the boundary the way begins and ends at it."""
    starts = steps.keys() - {after for after, _ in steps.values()}
    if not starts:
        face = _walk(steps, min(steps))
    else:
        start = min(starts)
        face = _walk(steps, start)
        last = next(after for after, number in steps.values() if number == face[-1])
        face = [middle[edge], triangle[tuple(sorted((*edge, start)))], *face, triangle[tuple(sorted((*edge, last)))]]
    if len(face) < len(steps) or len(starts) > 1:
        raise ValueError(f"at the edge of the points {edge} the tetrahedra are in several parts")
    return face


def _walk(steps: dict[int, tuple[int, int]], start: int) -> list[int]:
    """What lies on the way from ``start`` along ``steps``, until it ends or comes back."""
    passed: list[int] = []
    at = start
    while at in steps and len(passed) < len(steps):
        at, number = steps[at]
        passed.append(number)
        if at == start:
            break
    return passed
