"""Polygons and polyhedra as arrays: their edges, areas and volumes, and what they are checked for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from ebb.domains.checks import check_points
from ebb.domains.io.data import Floats, Integers, PolyData, Ragged
from ebb.domains.io.errors import (
    DegenerateElement,
    InconsistentOrientation,
    IndexOutOfRange,
    NonManifold,
    OpenCell,
    OverlappingCells,
    TooFewParts,
    WrongArray,
)
from ebb.domains.topology import rank_in, sorted_distinct
from ebb.errors import MeshFormatError
from ebb.records import record

# As in checks.py: shares of the square or cube of the extent below which double precision no longer tells the sign.
_FLAT = 1e-14


@record(eq=False)
class PolygonEdges:
    """The edges of faces, sorted by the lower end and then by the higher.

    ``of_corner`` is the edge from each corner of the faces to the next, and ``forward`` whether it goes there from its
    lower end to its higher.
    """

    low: Integers
    high: Integers
    of_corner: Integers
    forward: npt.NDArray[np.bool_]


@record(eq=False)
class FaceShapes:
    """The mean of the corners of each face, and its area as a vector along the normal: both of the shape (n, 3)."""

    centers: Floats
    areas: Floats


@record(eq=False)
class Cells:
    """For each face of each cell, whether it turns so that its normal leaves the cell (1) or enters it (-1).

    ``volumes`` are those of the cells.
    """

    signs: Integers
    volumes: Floats


def ragged(name: str, given: Any, offsets: Any) -> Ragged:
    """Rows of integers, given as lists, as an array of the shape (n, k), or as all their values and offsets.

    Raises:
        MeshFormatError: the rows are no integers, or the offsets do not divide the values (E712).
    """
    if offsets is not None:
        return _divided(name, given, offsets)
    array = cast("npt.NDArray[Any]", given)
    if isinstance(given, np.ndarray) and array.ndim == 2 and array.dtype.kind in "iu":
        return Ragged(np.arange(len(array) + 1) * array.shape[1], array.astype(np.int64).ravel())
    try:
        rows = [list(row) for row in cast("Iterable[Iterable[Any]]", given)]
    except TypeError:
        raise MeshFormatError(WrongArray(name, "rows of integers", repr(cast(object, given))[:60])) from None
    values = np.array(list(chain.from_iterable(rows)))
    if values.size and (values.ndim != 1 or values.dtype.kind not in "iu"):
        raise MeshFormatError(WrongArray(name, "rows of integers", f"rows of {values.dtype}"))
    starts = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    return Ragged(starts.astype(np.int64), values.astype(np.int64))


def _divided(name: str, given: Any, offsets: Any) -> Ragged:
    values, starts = np.asarray(given), np.asarray(offsets)
    for what, array in ((name, values), (f"the offsets of {name}", starts)):
        if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
            found = f"{array.dtype} of the shape {array.shape}"
            raise MeshFormatError(WrongArray(what, "integers of the shape (n,)", found))
    starts = starts.astype(np.int64)
    if not len(starts) or starts[0] != 0 or starts[-1] != len(values) or (np.diff(starts) < 0).any():
        expected = f"rising from 0 to {len(values)}, the number of values"
        raise MeshFormatError(WrongArray(f"the offsets of {name}", expected, str(starts[:6].tolist())))
    return Ragged(starts, values.astype(np.int64))


def polygon_edges(faces: Ragged, n_points: int) -> PolygonEdges:
    """The edges between the corners of each face and the next."""
    n = max(n_points, 1)
    tail, head = faces.values, faces.following
    code = np.minimum(tail, head) * n + np.maximum(tail, head)
    distinct = sorted_distinct(code)
    return PolygonEdges(distinct // n, distinct % n, rank_in(distinct, code), tail < head)


def face_shapes(points: Floats, faces: Ragged) -> FaceShapes:
    """The middles of faces, and their areas by Newell's formula."""
    corners = points[faces.values]
    centers = faces.sums(corners) / np.maximum(faces.lengths, 1)[:, None]
    corners -= centers[faces.rows]
    return FaceShapes(centers, faces.sums(np.cross(corners, faces.after(corners))) / 2)


def check_polygons(mesh: PolyData, largest: float) -> FaceShapes:
    """Check that each face has three corners or more, all different, and an area; gives their shapes.

    No coordinate may be beyond ``largest``.

    Raises:
        MeshFormatError: E705 to E707, E718.
    """
    check_points(mesh.points, mesh.origin, largest)
    faces = mesh.faces
    _check_members(mesh, "face", faces, len(mesh.points), "corner", "points")
    _check_lengths(mesh, "face", faces, 3, "corners")
    repeated = _repeated(faces)
    if repeated is not None:
        raise MeshFormatError(DegenerateElement("face", repeated, mesh.origin, faces.row(repeated), "area"))
    shapes = face_shapes(mesh.points, faces)
    sides = mesh.points[faces.following] - mesh.points[faces.values]
    flat = np.linalg.norm(shapes.areas, axis=1) <= _FLAT * faces.sums(np.einsum("ij,ij->i", sides, sides))
    if flat.any():
        row, count = int(np.argmax(flat)), int(flat.sum())
        raise MeshFormatError(DegenerateElement("face", row, mesh.origin, faces.row(row), "area", count, len(faces)))
    return shapes


def check_surface(mesh: PolyData, edges: PolygonEdges) -> None:
    """Check that at most two faces meet at an edge, and that neighbours turn the same way.

    Raises:
        MeshFormatError: E709, E710.
    """
    order, starts, counts = _groups(edges.of_corner)
    rows, tail, head = mesh.faces.rows, mesh.faces.values, mesh.faces.following
    crowded = np.flatnonzero(counts > 2)
    if crowded.size:
        first = int(order[starts[crowded[0]]])
        shared, count = (int(tail[first]), int(head[first])), int(counts[crowded[0]])
        raise MeshFormatError(NonManifold("face", int(rows[first]), mesh.origin, shared, count, "one or two"))
    one, other = order[starts[counts == 2]], order[starts[counts == 2] + 1]
    same = np.flatnonzero(tail[one] == tail[other])
    if same.size:
        i, j = int(one[same[0]]), int(other[same[0]])
        edge = (int(tail[i]), int(head[i]))
        raise MeshFormatError(InconsistentOrientation("face", int(rows[j]), mesh.origin, int(rows[i]), edge))


def check_cells(mesh: PolyData, edges: PolygonEdges, shapes: FaceShapes) -> Cells:
    """Check that the faces of each cell enclose it, and that no two cells lie on one side of a face.

    Raises:
        MeshFormatError: E705, E707, E709, E716 to E718.
    """
    cells, faces = mesh.cells, mesh.faces
    _check_members(mesh, "cell", cells, len(faces), "face", "faces")
    _check_lengths(mesh, "cell", cells, 4, "faces")
    repeated = _repeated(cells)
    if repeated is not None:
        raise MeshFormatError(TooFewParts("cell", repeated, mesh.origin, "names one face twice"))
    order, starts, counts = _groups(cells.values)
    crowded = np.flatnonzero(counts > 2)
    if crowded.size:
        first = int(order[starts[crowded[0]]])
        shared, count = faces.row(int(cells.values[first])), int(counts[crowded[0]])
        raise MeshFormatError(NonManifold("cell", int(cells.rows[first]), mesh.origin, shared, count, "two"))
    signs = _turn_outwards(mesh, edges)
    volumes = _volumes(mesh, shapes, signs)
    signs = signs * np.where(volumes < 0, -1, 1)[cells.rows]
    one, other = order[starts[counts == 2]], order[starts[counts == 2] + 1]
    same = np.flatnonzero(signs[one] == signs[other])
    if same.size:
        i, j = int(one[same[0]]), int(other[same[0]])
        face, rows = int(cells.values[i]), cells.rows
        raise MeshFormatError(OverlappingCells("cell", int(rows[j]), mesh.origin, int(rows[i]), face))
    return Cells(signs, np.abs(volumes))


def distinct_pairs(first: Integers, second: Integers, n_second: int) -> tuple[Integers, Integers]:
    """The different pairs, sorted by ``first`` and then by ``second``, which is below ``n_second``."""
    n = max(n_second, 1)
    code = sorted_distinct(first * n + second)
    return code // n, code % n


def _turn_outwards(mesh: PolyData, edges: PolygonEdges) -> Integers:
    """Signs of the faces of cells with which each edge of a cell is passed once in each direction.

    The first face of each cell gets 1, and from there signs spread across the edges.
    """
    cells = mesh.cells
    places = mesh.faces.places(cells.values)
    side = places.rows
    edge = edges.of_corner[places.values]
    order, starts, counts = _groups(cells.rows[side] * max(len(edges.low), 1) + edge)
    odd = np.flatnonzero(counts != 2)
    if odd.size:
        first = int(order[starts[odd[0]]])
        ends = (int(edges.low[edge[first]]), int(edges.high[edge[first]]))
        count = int(counts[odd[0]])
        reason = f"at the edge of the points {ends} it has {count} face{'s' if count > 1 else ''}"
        raise MeshFormatError(OpenCell("cell", int(cells.rows[side[first]]), mesh.origin, reason))
    one, other = order[starts], order[starts + 1]
    forward = edges.forward[places.values]
    # Two faces that turn alike pass their edge in opposite directions.
    alike = np.where(forward[one] != forward[other], 1, -1)
    a, b = side[one], side[other]
    signs = np.zeros(len(cells.values), dtype=np.int64)
    signs[cells.offsets[:-1]] = 1
    while True:
        to_b, to_a = (signs[a] != 0) & (signs[b] == 0), (signs[b] != 0) & (signs[a] == 0)
        if not (to_a.any() or to_b.any()):
            break
        signs[b[to_b]] = (signs[a] * alike)[to_b]
        signs[a[to_a]] = (signs[b] * alike)[to_a]
    for bad, reason in (
        (cells.rows[signs == 0], "its faces are in several parts that share no edge"),
        (cells.rows[a[signs[a] * signs[b] != alike]], "its faces cannot all turn outwards"),
    ):
        if bad.size:
            raise MeshFormatError(OpenCell("cell", int(bad.min()), mesh.origin, reason))
    return signs


def _volumes(mesh: PolyData, shapes: FaceShapes, signs: Integers) -> Floats:
    """The volumes that the faces, each a fan about the mean of its corners, enclose: negative if they turn inwards.

    Raises:
        MeshFormatError: a cell has no volume (E707).
    """
    cells = mesh.cells
    at = shapes.centers[cells.values]
    middle = cells.sums(at) / np.maximum(cells.lengths, 1)[:, None]
    apart = at - middle[cells.rows]
    volumes = cells.sums(signs * np.einsum("ij,ij->i", apart, shapes.areas[cells.values])) / 3
    surface = cells.sums(np.linalg.norm(shapes.areas, axis=1)[cells.values])
    flat = np.abs(volumes) <= _FLAT * surface**1.5
    if flat.any():
        row, count = int(np.argmax(flat)), int(flat.sum())
        corners = tuple(sorted(set(mesh.faces.take(np.array(cells.row(row))).values.tolist())))
        raise MeshFormatError(DegenerateElement("cell", row, mesh.origin, corners, "volume", count, len(cells)))
    return volumes


def _check_members(mesh: PolyData, kind: str, rows: Ragged, size: int, part: str, target: str) -> None:
    bad = (rows.values < 0) | (rows.values >= size)
    if bad.any():
        place = int(np.argmax(bad))
        row, index = int(rows.rows[place]), int(rows.values[place])
        raise MeshFormatError(IndexOutOfRange(kind, row, mesh.origin, index, size, 0, part, target))


def _check_lengths(mesh: PolyData, kind: str, rows: Ragged, least: int, parts: str) -> None:
    short = rows.lengths < least
    if short.any():
        row = int(np.argmax(short))
        reason = f"has {rows.lengths[row]} {parts}, and {least} is the least"
        raise MeshFormatError(TooFewParts(kind, row, mesh.origin, reason))


def _repeated(rows: Ragged) -> int | None:
    """The first row that has a value twice, or None."""
    row, values = rows.rows, rows.values
    order = np.lexsort((values, row))
    twice = (values[order][1:] == values[order][:-1]) & (row[order][1:] == row[order][:-1])
    return int(row[order][1:][twice].min()) if twice.any() else None


def _groups(values: Integers) -> tuple[Integers, Integers, Integers]:
    """The order that sorts the values, where in it each different value begins, and how often it occurs."""
    order = np.argsort(values, kind="stable")
    starts = np.flatnonzero(np.diff(values[order], prepend=-1))
    return order, starts, np.diff(starts, append=len(values))


def cell_faces(corners: Integers, scheme: Sequence[Sequence[int]]) -> tuple[Ragged, Integers]:
    """The faces of elements of one kind, element by element, and how many each has.

    Args:
        corners: of each element, shape (n, k).
        scheme: which of the corners each face has.
    """
    lengths = np.tile([len(face) for face in scheme], len(corners))
    values = corners[:, [corner for face in scheme for corner in face]]
    return Ragged.of_lengths(lengths, values), np.full(len(corners), len(scheme))


def merged_faces(faces: Ragged, counts: Integers) -> tuple[Ragged, Ragged]:
    """Faces and cells, where faces with the same points, in whatever order, are one.

    Args:
        faces: those of the first cell, then those of the second, and so on.
        counts: how many each cell has.

    Returns:
        The different faces, in the order in which they first occur, and the cells as lists of these.
    """
    n = int(faces.values.max(initial=0)) + 1
    first = np.empty(len(faces), dtype=np.int64)
    for length in sorted(set(faces.lengths.tolist())):
        rows = np.flatnonzero(faces.lengths == length)
        corners = np.sort(faces.take(rows).values.reshape(-1, length), axis=1)
        # Two points to a number: there are half as many columns to sort by.
        codes = [corners[:, i] * n + corners[:, min(i + 1, length - 1)] for i in range(0, length, 2)]
        order = np.lexsort(codes) if codes else np.arange(len(rows))
        new = np.zeros(len(rows), dtype=bool)
        for code in codes:
            new |= np.diff(code[order], prepend=-1) != 0
        first[rows[order]] = rows[order[np.flatnonzero(new)[np.cumsum(new) - 1]]]
    distinct = sorted_distinct(first)
    return faces.take(distinct), Ragged.of_lengths(counts, rank_in(distinct, first))
