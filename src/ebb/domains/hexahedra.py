"""Hexahedra as arrays: their faces and neighbours, what they are checked for, and lattices of them.

The corners of a hexahedron are numbered as in VTK and LULESH: 0 to 3 around its lower face, 4 to 7 above them. In its
own frame corner 0 is at (0, 0, 0), 1 at (1, 0, 0), 2 at (1, 1, 0), 3 at (0, 1, 0), and 4 to 7 at the same x and y with
z = 1.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt

from ebb.domains.checks import are_turned, check_rows, refuse_repeated
from ebb.domains.generators import require_count
from ebb.domains.grid import Grid3D
from ebb.domains.io.data import Floats, Integers, MeshData
from ebb.domains.io.errors import DegenerateElement, FoldedElement, InvertedElement, NonManifold, WrongArray
from ebb.errors import MeshFormatError
from ebb.records import record, replace

# The sides of an element in its own frame, and the corners there, with the normal outwards.
SIDES = ("xneg", "xpos", "yneg", "ypos", "zneg", "zpos")
FACES = np.array([(0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7)])

# The corners at the other ends of the edges from each corner, so ordered that the three turn right-handed.
_NEXT = np.array([(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3)])

# Where each corner is in the frame of its element.
PLACES = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])

# Exchanges the lower face with the upper one, which turns an inverted element.
_TURNED = np.array([4, 5, 6, 7, 0, 1, 2, 3])

# A corner is flat when the box of its three edges has less than this share of the volume of the cube of the longest.
_FLAT = 1e-14

# So many elements are checked at a time, to take little memory.
_AT_ONCE = 1 << 16


@record(eq=False)
class Bricks:
    """A box of elements in rows: its points, the corners of the elements, and the neighbours at their six sides."""

    points: Floats
    cells: Integers
    neighbors: Integers


def brick_points(shape: tuple[Any, Any, Any], size: tuple[float, float, float]) -> Floats:
    """The points of a box with a corner at the origin, of ``shape`` elements: of shape (nx + 1, ny + 1, nz + 1, 3).

    Raises:
        ValueError: a count is no integer >= 1, or a length not positive.
    """
    counts = [require_count(name, n, 1) for name, n in zip(("nx", "ny", "nz"), shape, strict=True)]
    if not all(0 < length < inf for length in size):
        raise ValueError(f"size should be three positive lengths, not {size!r}")
    axes = [np.linspace(0, length, n + 1) for length, n in zip(size, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def bricks(points: npt.ArrayLike) -> Bricks:
    """The elements between points of the shape (nx + 1, ny + 1, nz + 1, 3), numbered with the last axis fastest.

    Where there is no neighbour, an element is its own.

    Raises:
        MeshFormatError: another shape, or no numbers (E712).
    """
    array = np.asarray(points)
    if array.ndim != 4 or array.shape[3] != 3 or min(array.shape[:3]) < 2 or array.dtype.kind not in "iuf":
        found = f"{array.dtype} of the shape {array.shape}"
        raise MeshFormatError(WrongArray("points", "numbers of the shape (nx + 1, ny + 1, nz + 1, 3)", found))
    nx, ny, nz = (n - 1 for n in array.shape[:3])
    point, element = _numbers((nx + 1, ny + 1, nz + 1)), _numbers((nx, ny, nz))
    cells = np.empty((nx, ny, nz, 8), dtype=np.int64)
    for corner, (i, j, k) in enumerate(PLACES.tolist()):
        cells[..., corner] = point[i : nx + i, j : ny + j, k : nz + k]
    neighbors = np.empty((nx, ny, nz, 6), dtype=np.int64)
    neighbors[...] = element[..., None]
    neighbors[1:, :, :, 0], neighbors[:-1, :, :, 1] = element[:-1], element[1:]
    neighbors[:, 1:, :, 2], neighbors[:, :-1, :, 3] = element[:, :-1], element[:, 1:]
    neighbors[:, :, 1:, 4], neighbors[:, :, :-1, 5] = element[:, :, :-1], element[:, :, 1:]
    places = np.array(array.reshape(-1, 3), dtype=np.float64)
    return Bricks(places, cells.reshape(-1, 8), neighbors.reshape(-1, 6))


def grid_points(grid: Grid3D | npt.ArrayLike) -> npt.NDArray[Any]:
    """The vertices of a grid, of shape (nx + 1, ny + 1, nz + 1, 3), or the array that is given instead.

    Raises:
        ValueError: the grid is periodic.
    """
    if not isinstance(grid, Grid3D):
        return np.asarray(grid)
    if any(grid.periodic):
        raise ValueError("a periodic grid has no boundary: give one that is not periodic")
    axes = [
        start + length * np.linspace(0, 1, count + 1)
        for start, length, count in zip(grid.origin, grid.extent, grid.shape, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def named_sides(names: Iterable[str]) -> set[str]:
    """The sides that are planes of symmetry.

    Raises:
        ValueError: a name is none of a side.
    """
    chosen = set(names)
    if not chosen <= set(SIDES):
        raise ValueError(f"symmetry should name sides of {', '.join(SIDES)}, not {sorted(chosen - set(SIDES))}")
    return chosen


def brick_sides(shape: tuple[int, int, int]) -> dict[str, Integers]:
    """The points at each side of a lattice of ``shape`` points."""
    point = _numbers(shape)
    ends = [point.take(end, axis).ravel() for axis in range(3) for end in (0, -1)]
    return dict(zip(SIDES, ends, strict=True))


def check_hexahedra(mesh: MeshData, *, fix_orientation: bool | None, largest: float) -> tuple[MeshData, int]:
    """Check that all elements have eight corners, at each of which the three edges are right-handed.

    That is what makes the map from the unit cube invertible at the corners (Knupp, "Achieving finite element mesh
    quality via optimization of the Jacobian matrix norm", 2000).

    Args:
        mesh: points and the corners of the elements.
        fix_orientation: whether to exchange the lower and the upper face of inverted elements, rather than to raise;
            with None, that is done if all are inverted.
        largest: what no coordinate may be beyond.

    Returns:
        The mesh, and how many of its elements have been turned.

    Raises:
        MeshFormatError: E705 to E708, E715.
    """
    check_rows(mesh, "element", largest)
    cells = mesh.cells
    flat, inverted, folded = (np.zeros(len(cells), dtype=bool) for _ in range(3))
    for start in range(0, len(cells), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        signs = _corner_signs(mesh.points, cells[part])
        ordered = np.sort(cells[part], axis=1)
        flat[part] = (signs == 0).all(axis=1) | (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
        inverted[part] = ~flat[part] & (signs <= 0).all(axis=1) & (signs < 0).any(axis=1)
        folded[part] = ~flat[part] & ~inverted[part] & (signs <= 0).any(axis=1)
        # Turning an inverted element over leaves its flat corners flat.
        folded[part] |= inverted[part] & (signs == 0).any(axis=1)
    _refuse_flat(mesh, flat)
    turned = int(inverted.sum())
    if not are_turned(turned, len(cells), fix_orientation):
        _refuse_inverted(mesh, inverted)
    _refuse_folded(mesh, folded)
    if turned:
        cells = cells.copy()
        cells[inverted] = cells[inverted][:, _TURNED]
        mesh = replace(mesh, cells=cells)
    return mesh, turned


def face_neighbors(mesh: MeshData) -> Integers:
    """The element beyond each of the six sides of each element, of shape (n, 6), or the element itself.

    Raises:
        MeshFormatError: more than two elements share a face (E709), or two have the same corners (E719).
    """
    n = max(len(mesh.points), 1)
    corners = np.sort(mesh.cells[:, FACES].reshape(-1, 4), axis=1)
    low, high = corners[:, 0] * n + corners[:, 1], corners[:, 2] * n + corners[:, 3]
    order = np.lexsort((high, low))
    low, high = low[order], high[order]
    starts = np.flatnonzero(np.concatenate([[True], (low[1:] != low[:-1]) | (high[1:] != high[:-1])])[: len(order)])
    counts = np.diff(starts, append=len(order))
    crowded = np.flatnonzero(counts > 2)
    one, other = order[starts[counts == 2]] // 6, order[starts[counts == 2] + 1] // 6
    sums = mesh.cells.sum(axis=1)
    if crowded.size or (sums[one] == sums[other]).any():
        refuse_repeated(mesh, "element")
    if crowded.size:
        first = int(order[starts[crowded[0]]])
        shared = tuple(mesh.cells[first // 6, FACES[first % 6]].tolist())
        raise MeshFormatError(NonManifold("element", first // 6, mesh.origin, shared, int(counts[crowded[0]]), "two"))
    neighbors = np.repeat(np.arange(len(mesh.cells)), 6)
    neighbors[order[starts[counts == 2]]], neighbors[order[starts[counts == 2] + 1]] = other, one
    return neighbors.reshape(-1, 6)


def hex_volumes(points: Floats, cells: Integers) -> Floats:
    """The volumes of trilinear hexahedra.

    By the divergence theorem over their faces; that of a bilinear face is the mean over its two pairs of triangles.
    """
    corners = points[cells] - points[cells[:, :1]]
    total = np.zeros(len(cells))
    for face in FACES:
        a, b, c, d = (corners[:, i] for i in face)
        total += _det(a, b, c) + _det(a, c, d) + _det(a, b, d) + _det(b, c, d)
    return total / 12


def _numbers(shape: tuple[int, int, int]) -> Integers:
    """The numbers of a lattice's members, the last axis fastest."""
    return np.arange(shape[0] * shape[1] * shape[2], dtype=np.int64).reshape(shape)


def _corner_signs(points: Floats, cells: Integers) -> npt.NDArray[np.int8]:
    """Whether the three edges at each corner are right-handed (1), left-handed (-1), or in a plane (0)."""
    corners = points[cells]
    signs = np.empty(cells.shape, dtype=np.int8)
    for corner, ends in enumerate(_NEXT):
        edges = corners[:, ends] - corners[:, corner, None]
        longest = np.sqrt(np.einsum("nij,nij->ni", edges, edges).max(axis=1))
        volume = _det(edges[:, 0], edges[:, 1], edges[:, 2])
        signs[:, corner] = np.where(np.abs(volume) <= _FLAT * longest**3, 0, np.sign(volume))
    return signs


def _det(a: Floats, b: Floats, c: Floats) -> Floats:
    return np.einsum("ij,ij->i", np.cross(a, b), c)


def _refuse_flat(mesh: MeshData, flat: npt.NDArray[np.bool_]) -> None:
    if flat.any():
        row = int(np.argmax(flat))
        corners, count = tuple(mesh.cells[row].tolist()), int(flat.sum())
        raise MeshFormatError(DegenerateElement("element", row, mesh.origin, corners, "volume", count, len(mesh.cells)))


def _refuse_inverted(mesh: MeshData, inverted: npt.NDArray[np.bool_]) -> None:
    if inverted.any():
        row = int(np.argmax(inverted))
        corners, count = tuple(mesh.cells[row].tolist()), int(inverted.sum())
        volume = float(hex_volumes(mesh.points, mesh.cells[row : row + 1])[0])
        raise MeshFormatError(InvertedElement("element", row, mesh.origin, corners, volume, count, len(mesh.cells)))


def _refuse_folded(mesh: MeshData, folded: npt.NDArray[np.bool_]) -> None:
    if folded.any():
        row = int(np.argmax(folded))
        signs = _corner_signs(mesh.points, mesh.cells[row : row + 1])[0]
        usual = 1 if (signs > 0).any() else -1
        bad = mesh.cells[row, np.flatnonzero(signs != usual)].tolist()
        corners, count = tuple(mesh.cells[row].tolist()), int(folded.sum())
        raise MeshFormatError(FoldedElement("element", row, mesh.origin, corners, tuple(bad), count, len(mesh.cells)))
