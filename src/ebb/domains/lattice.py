"""A closed surface filled with the cubes of a lattice, each split into six tetrahedra."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ebb.domains.generators import require_count, split_cubes
from ebb.domains.io.data import Floats, Integers, MeshData
from ebb.domains.io.errors import OpenSurface
from ebb.domains.topology import rank_in, used_points
from ebb.errors import MeshFormatError
from ebb.records import record

# The lines along which the surface is cut are moved by this share of a cube, so that they miss the points and edges
# of surfaces that are aligned with the lattice. Two incommensurable numbers, far below any feature.
_SHIFT = (1.2345e-7 * 2**0.5, 1.2345e-7 * 3**0.5)


@record(eq=False)
class Lattice:
    """Cubes of one size: ``shape`` of them, from the corner ``origin``, with edges of the length ``spacing``."""

    origin: Floats
    spacing: float
    shape: tuple[int, int, int]

    def samples(self, offset: float) -> tuple[Floats, Floats, Floats]:
        """The coordinates along each axis of the corners (offset 0) or the centres (offset 0.5) of the cubes."""
        extra = 1 if offset == 0 else 0
        x, y, z = (
            start + self.spacing * (np.arange(n + extra) + offset)
            for start, n in zip(self.origin, self.shape, strict=True)
        )
        return x, y, z


def fill_surface(points: Floats, triangles: Integers, resolution: int) -> MeshData:
    """Tetrahedra of the cubes that have a corner or their centre inside the surface.

    Args:
        points: shape (n, 3).
        triangles: shape (m, 3), outward, and closed.
        resolution: how many cubes the longest side of the surface's bounding box takes.

    Raises:
        MeshFormatError: the surface is not closed (E711).
        ValueError: the resolution is no integer >= 1, or the surface has no triangles or no extent.
    """
    resolution = require_count("resolution", resolution, 1)
    check_closed(triangles, len(points))
    lattice = lattice_around(points[used_points(triangles)[0]], resolution)
    corners = inside(points, triangles, lattice.samples(0.0))
    keep = inside(points, triangles, lattice.samples(0.5))
    nx, ny, nz = lattice.shape
    for i, j, k in np.ndindex(2, 2, 2):
        keep |= corners[i : nx + i, j : ny + j, k : nz + k]
    cells = split_cubes(np.argwhere(keep), lattice.shape)
    used, cells = used_points(cells)
    index = np.stack(np.unravel_index(used, (nx + 1, ny + 1, nz + 1)), axis=1)
    return MeshData(lattice.origin + lattice.spacing * index, cells)


def lattice_around(points: Floats, resolution: int) -> Lattice:
    """The lattice about the bounding box of the points, centred, with ``resolution`` cubes along its longest side.

    Raises:
        ValueError: there are no points, or all are the same.
    """
    extent = np.ptp(points, axis=0) if len(points) else np.zeros(3)
    longest = float(extent.max())
    if not longest > 0:
        raise ValueError("the surface has no extent")
    spacing = longest / resolution
    nx, ny, nz = (max(1, int(np.ceil(side / spacing - 1e-9))) for side in extent)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    origin = centre - spacing / 2 * np.array([nx, ny, nz])
    return Lattice(origin, spacing, (nx, ny, nz))


def check_closed(triangles: Integers, n_points: int) -> None:
    """Check that each edge of the surface has as many triangles in one direction as in the other.

    Raises:
        MeshFormatError: E711.
    """
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    code = low * n_points + high
    order = np.argsort(code)
    starts = np.flatnonzero(np.diff(code[order], prepend=-1))
    balance = np.add.reduceat(np.where(tail < head, 1, -1)[order], starts) if len(starts) else starts
    open_edges = starts[balance != 0]
    if len(open_edges):
        first = order[open_edges[0]]
        raise MeshFormatError(OpenSurface(len(open_edges), (int(low[first]), int(high[first]))))


def inside(points: Floats, triangles: Integers, samples: tuple[Floats, Floats, Floats]) -> npt.NDArray[np.bool_]:
    """Which points of a lattice, of the coordinates ``samples`` along each axis, lie inside a closed surface.

    A vertical line through each column of samples is cut with the surface. A crossing adds 1 to the winding number of
    every sample above it where the surface faces down, and takes 1 off where it faces up. Overlapping parts are right.
    """
    x, y, z = samples
    triangle, column = _columns_under(points, triangles, _shifted(x, 0), _shifted(y, 1))
    p = np.stack([_shifted(x, 0)[column // len(y)], _shifted(y, 1)[column % len(y)]], axis=1)
    a, b, c = (points[triangles[triangle, i]] for i in range(3))
    ka, kb, kc = (triangles[triangle, i] for i in range(3))
    over_a, over_b, over_c = _side(b, c, kb, kc, p), _side(c, a, kc, ka, p), _side(a, b, ka, kb, p)
    up = (over_a > 0) & (over_b > 0) & (over_c > 0)
    hit = up | ((over_a < 0) & (over_b < 0) & (over_c < 0))
    weights = np.stack([over_a, over_b, over_c], axis=1)[hit]
    heights = np.stack([a[:, 2], b[:, 2], c[:, 2]], axis=1)[hit]
    height = (weights * heights).sum(axis=1) / weights.sum(axis=1)
    winding = np.zeros((len(x) * len(y), len(z) + 1), dtype=np.int64)
    np.add.at(winding, (column[hit], rank_in(z, height)), np.where(up[hit], -1, 1))
    return (np.cumsum(winding, axis=1)[:, :-1] != 0).reshape(len(x), len(y), len(z))


def _shifted(coordinates: Floats, axis: int) -> Floats:
    spacing = coordinates[1] - coordinates[0] if len(coordinates) > 1 else 1.0
    return coordinates + _SHIFT[axis] * spacing


def _columns_under(points: Floats, triangles: Integers, x: Floats, y: Floats) -> tuple[Integers, Integers]:
    """The pairs (triangle, column i * len(y) + j) in which the column is in the triangle's bounding rectangle."""
    corners = points[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    first_x, last_x = rank_in(x, low[:, 0]), rank_in(x, high[:, 0], side="right")
    first_y, last_y = rank_in(y, low[:, 1]), rank_in(y, high[:, 1], side="right")
    wide = last_y - first_y
    count = (last_x - first_x) * wide
    triangle = np.repeat(np.arange(len(triangles)), count)
    place = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    i, j = np.divmod(place, wide[triangle])
    return triangle, (first_x[triangle] + i) * len(y) + first_y[triangle] + j


def _side(a: Floats, b: Floats, ka: Integers, kb: Integers, p: Floats) -> Floats:
    """Twice the signed area of (a, b, p) seen from above: positive where p is left of the line from a to b.

    It is computed from the end with the lower number, so that the two triangles at an edge get the same number with
    opposite signs: a line that meets the edge cuts exactly one of them.
    """
    swap = (ka > kb)[:, None]
    start, stop = np.where(swap, b[:, :2], a[:, :2]), np.where(swap, a[:, :2], b[:, :2])
    u, v = stop - start, p - start
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return np.where(swap[:, 0], -area, area)
