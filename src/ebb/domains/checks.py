"""What every mesh is checked for before it becomes relations."""

from __future__ import annotations

from typing import Any

import numpy as np

import ebb
from ebb.domains.io.data import Floats, Integers, MeshData, Origin
from ebb.domains.io.errors import (
    DegenerateElement,
    InconsistentOrientation,
    IndexOutOfRange,
    InvertedElement,
    NonManifold,
    NotFinite,
    RepeatedElement,
    WrongArray,
)
from ebb.domains.topology import Edges, faces_of_tetrahedra, undirected_edges
from ebb.errors import MeshFormatError
from ebb.records import record, replace

# An element counts as degenerate when its volume (area) is below this share of the cube (square) of its longest
# edge: there, double precision no longer tells its sign.
_FLAT = 1e-14

# How many elements are looked at at a time.
_PART = 1 << 16

# Of float32, the type of ``pos``. Areas and volumes of larger coordinates would overflow, too.
_LARGEST = float(np.finfo(np.float32).max)


def mesh_data(points: Any, cells: Any, corners: int, cell: str) -> MeshData:
    """The arrays of a mesh, as copies of the right types.

    Raises:
        MeshFormatError: wrong shapes, coordinates that are no numbers, or indices that are no integers (E712).
    """
    return MeshData(as_points(points), _cells(cells, corners, cell))


def largest_of(precision: Any) -> float:
    """The largest coordinate of the type ``precision``, an Ebb type, whose cube float64 holds.

    Raises:
        MeshFormatError: it is neither float32 nor float64 (E712).
    """
    if precision not in (ebb.float32, ebb.float64):
        raise MeshFormatError(WrongArray("precision", "ebb.float32 or ebb.float64", repr(precision)))
    return min(float(np.finfo(precision.dtype).max), 1e100)


def check_rows(mesh: MeshData, cell: str, largest: float = _LARGEST) -> None:
    """Check that ``pos``, by default of float32, can hold the coordinates, and that the corners are points.

    Raises:
        MeshFormatError: E705, E706.
    """
    check_points(mesh.points, mesh.origin, largest)
    if mesh.cells.size and (mesh.cells.min() < 0 or mesh.cells.max() >= len(mesh.points)):
        bad = (mesh.cells < 0) | (mesh.cells >= len(mesh.points))
        row = int(np.argmax(bad.any(axis=1)))
        index = int(mesh.cells[row, np.argmax(bad[row])])
        raise MeshFormatError(IndexOutOfRange(cell, row, mesh.origin, index, len(mesh.points)))


def check_points(points: Floats, origin: Origin | None, largest: float = _LARGEST) -> None:
    """Check that no coordinate is NaN or beyond ``largest``.

    Raises:
        MeshFormatError: E706.
    """
    finite = (np.abs(points) <= largest).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise MeshFormatError(NotFinite("point", row, origin, tuple(points[row].tolist())))


def check_triangles(mesh: MeshData, manifold: bool = True) -> None:
    """Check that the triangles have areas and, if ``manifold``, that at most two meet at an edge and turn the same way.

    Raises:
        MeshFormatError: E705 to E707, E709, E710.
    """
    check_rows(mesh, "triangle")
    a, b, c = (mesh.points[mesh.cells[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    _check_flat(mesh, "triangle", "area", area <= _FLAT * _longest_edge(mesh.points, mesh.cells) ** 2)
    if manifold:
        _check_surface(mesh.cells, max(len(mesh.points), 1), mesh.origin)


@record(eq=False)
class Solid:
    """A mesh of tetrahedra of positive volume, with what its check has found: edges, boundary and volumes.

    ``turned`` of its tetrahedra were negative.
    """

    mesh: MeshData
    edges: Edges
    boundary: Integers
    volume: Floats
    turned: int


def are_turned(negative: int, total: int, fix_orientation: bool | None) -> bool:
    """Whether so many negative elements of all are turned, rather than an error.

    Where ``fix_orientation`` is None, they are if all are negative: then they follow another convention.
    """
    return negative == total if fix_orientation is None else fix_orientation


def check_tetrahedra(mesh: MeshData, *, fix_orientation: bool | None, largest: float = _LARGEST) -> Solid:
    """Check that the tetrahedra have positive volumes, that at most two meet at a face, and that none is given twice.

    What is done about negative ones, ``are_turned`` says. No coordinate may be beyond ``largest``.

    Raises:
        MeshFormatError: E705 to E709, E719.
    """
    check_rows(mesh, "tetrahedron", largest)
    volume, longest = _measures(mesh)
    _check_flat(mesh, "tetrahedron", "volume", np.abs(volume) <= _FLAT * longest**3)
    inverted = np.flatnonzero(volume < 0)
    if inverted.size and not are_turned(inverted.size, len(mesh.cells), fix_orientation):
        row = int(inverted[0])
        corners = tuple(mesh.cells[row].tolist())
        raise MeshFormatError(
            InvertedElement(
                "tetrahedron", row, mesh.origin, corners, float(volume[row]), len(inverted), len(mesh.cells)
            )
        )
    if inverted.size:
        cells = mesh.cells.copy()
        cells[inverted, 2], cells[inverted, 3] = mesh.cells[inverted, 3], mesh.cells[inverted, 2]
        mesh = replace(mesh, cells=cells)
        volume[inverted] *= -1
    n = max(len(mesh.points), 1)
    edges = undirected_edges(mesh.cells, n)
    faces = faces_of_tetrahedra(mesh.cells, n, edges)
    if faces.crowded is not None or faces.folded:
        refuse_repeated(mesh, "tetrahedron")
    if faces.crowded is not None:
        points, row, count = faces.crowded
        raise MeshFormatError(NonManifold("tetrahedron", row, mesh.origin, points, count, "two"))
    return Solid(mesh, edges, faces.boundary, volume, inverted.size)


def refuse_repeated(mesh: MeshData, cell: str) -> None:
    """Refuse a mesh in which two cells have the same corners.

    Raises:
        MeshFormatError: E719.
    """
    ordered = np.sort(mesh.cells, axis=1)
    order = np.lexsort(ordered.T)
    ordered = ordered[order]
    again = np.flatnonzero((ordered[1:] == ordered[:-1]).all(axis=1))
    if again.size:
        first = again[np.argmin(order[again + 1])]
        row, corners = int(order[first + 1]), tuple(mesh.cells[order[first + 1]].tolist())
        raise MeshFormatError(RepeatedElement(cell, row, mesh.origin, corners, int(order[first])))


def tet_volumes(points: Floats, cells: Integers) -> Floats:
    """The signed volumes of tetrahedra: positive where corners 1, 2, 3 turn right as seen from corner 0."""
    a, b, c, d = (points[cells[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0


def _measures(mesh: MeshData) -> tuple[Floats, Floats]:
    """The signed volume and the longest edge of each tetrahedron, part by part, so that little memory is taken."""
    volume, longest = np.empty(len(mesh.cells)), np.empty(len(mesh.cells))
    for start in range(0, len(mesh.cells), _PART):
        part = slice(start, start + _PART)
        volume[part] = tet_volumes(mesh.points, mesh.cells[part])
        longest[part] = _longest_edge(mesh.points, mesh.cells[part])
    return volume, longest


def _check_surface(triangles: Integers, n: int, origin: Origin | None) -> None:
    tail = triangles.ravel()
    head = np.roll(triangles, -1, axis=1).ravel()
    code = np.minimum(tail, head) * n + np.maximum(tail, head)
    order = np.argsort(code, kind="stable")
    starts = np.flatnonzero(np.diff(code[order], prepend=-1))
    counts = np.diff(starts, append=len(code))
    crowded = np.flatnonzero(counts > 2)
    if crowded.size:
        first = order[starts[crowded[0]]]
        shared = (int(tail[first]), int(head[first]))
        count = int(counts[crowded[0]])
        raise MeshFormatError(NonManifold("triangle", int(first) // 3, origin, shared, count, "one or two"))
    pairs = starts[counts == 2]
    one, other = order[pairs], order[pairs + 1]
    same = np.flatnonzero(tail[one] == tail[other])
    if same.size:
        i, j = int(one[same[0]]), int(other[same[0]])
        edge = (int(tail[i]), int(head[i]))
        raise MeshFormatError(InconsistentOrientation("triangle", j // 3, origin, i // 3, edge))


def _check_flat(mesh: MeshData, cell: str, measure: str, flat: np.ndarray[Any, Any]) -> None:
    if flat.any():
        row, count = int(np.argmax(flat)), int(np.count_nonzero(flat))
        corners = tuple(mesh.cells[row].tolist())
        raise MeshFormatError(DegenerateElement(cell, row, mesh.origin, corners, measure, count, len(mesh.cells)))


def _longest_edge(points: Floats, cells: Integers) -> Floats:
    longest = np.zeros(len(cells))
    for i in range(cells.shape[1]):
        for j in range(i):
            edge = points[cells[:, i]] - points[cells[:, j]]
            np.maximum(longest, np.einsum("ij,ij->i", edge, edge), out=longest)
    return np.sqrt(longest)


def as_points(points: Any) -> Floats:
    """Coordinates as a copy of the right type.

    Raises:
        MeshFormatError: another shape than (n, 3), or no numbers (E712).
    """
    array = _array("positions", points)
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, 3))
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iuf":
        raise MeshFormatError(WrongArray("positions", "numbers of the shape (n, 3)", _describe(array)))
    return np.array(array, dtype=np.float64, order="C")


def _cells(cells: Any, corners: int, cell: str) -> Integers:
    array = _array(cell, cells)
    if array.size == 0 and array.ndim <= 2:
        return np.empty((0, corners), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != corners or array.dtype.kind not in "iu":
        raise MeshFormatError(WrongArray(cell, f"integers of the shape (n, {corners})", _describe(array)))
    return np.array(array, dtype=np.int64, order="C")


def _array(name: str, given: Any) -> np.ndarray[Any, Any]:
    try:
        return np.asarray(given)
    except ValueError:
        raise MeshFormatError(WrongArray(name, "an array", "rows of different lengths")) from None


def _describe(array: np.ndarray[Any, Any]) -> str:
    return f"{array.dtype} of the shape {array.shape}"
