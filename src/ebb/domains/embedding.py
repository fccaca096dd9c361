"""Points placed in a tetrahedral mesh: for each, a tetrahedron and four barycentric weights."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from ebb.domains.io.data import Floats, Integers
from ebb.domains.topology import rank_in
from ebb.records import record

# Pairs of a point and a candidate that are looked at in one step, so that memory stays within some 100 MB.
_CHUNK = 400_000

# A weight above minus this counts as inside: points on a face may get either of its tetrahedra.
_ROUNDING = 1e-9


@record(eq=False)
class _Bins:
    """A grid of cubes over the mesh; bin b holds the tetrahedra ``cells[starts[b] : starts[b + 1]]``."""

    origin: Floats
    spacing: float
    shape: Integers
    starts: Integers
    cells: Integers
    nearest: Integers

    def of(self, points: Floats) -> Integers:
        """The bin that holds each point, or the nearest bin that holds tetrahedra."""
        # Cut off before they become integers, which do not hold all of them.
        index = np.clip(np.floor((points - self.origin) / self.spacing), 0, self.shape - 1).astype(np.int64)
        return self.nearest[np.ravel_multi_index(tuple(index.T), tuple(self.shape.tolist()))]


def embed_points(points: Floats, positions: Floats, cells: Integers) -> tuple[Integers, Floats]:
    """The tetrahedron that holds each point, or one near it, and the point's barycentric weights there.

    A point outside every tetrahedron gets one among those of its neighbourhood whose hull comes closest, and weights
    of which some are negative. Either way the weights sum to 1 and give the point back.

    Args:
        points: shape (n, 3), finite.
        positions: the points of the mesh, shape (v, 3).
        cells: the corners of its tetrahedra, shape (m, 4); m is at least 1.

    Returns:
        The rows of the tetrahedra, shape (n,), and the weights, shape (n, 4).
    """
    rows, weights = _choose(points, positions, cells, _make_bins(positions, cells, 0))
    outside = np.flatnonzero(weights.min(axis=1, initial=0) < -_ROUNDING)
    if outside.size:
        wider = _make_bins(positions, cells, 1)
        rows[outside], weights[outside] = _choose(points[outside], positions, cells, wider)
    return rows, weights


def _choose(points: Floats, positions: Floats, cells: Integers, bins: _Bins) -> tuple[Integers, Floats]:
    """The nearest of the tetrahedra in each point's bin."""
    base = positions[cells[:, 0]]
    edges = np.stack([positions[cells[:, i]] - base for i in (1, 2, 3)], axis=2)
    to_weights = np.linalg.inv(edges)
    bin_of = bins.of(points)
    counts = bins.starts[bin_of + 1] - bins.starts[bin_of]
    rows = np.zeros(len(points), dtype=np.int64)
    weights = np.zeros((len(points), 4))
    for start, stop in _chunks(counts):
        count = counts[start:stop]
        starts = np.cumsum(count) - count
        point = np.repeat(np.arange(start, stop), count)
        place = np.arange(len(point)) - np.repeat(starts, count)
        cell = bins.cells[bins.starts[bin_of[point]] + place]
        inner = np.einsum("nij,nj->ni", to_weights[cell], points[point] - base[cell])
        full = np.column_stack([1 - inner.sum(axis=1), inner])
        best = _first_minimum(_distance(full, edges, cell), starts, count)
        rows[start:stop], weights[start:stop] = cell[best], full[best]
    return rows, weights


def _distance(weights: Floats, edges: Floats, cell: Integers) -> Floats:
    """How far each point is from a point of its candidate: that of the weights with the negative ones cut off."""
    distance = np.zeros(len(weights))
    outside = np.flatnonzero((weights < 0).any(axis=1))
    cut = np.maximum(weights[outside], 0)
    cut /= cut.sum(axis=1, keepdims=True)
    gap = np.einsum("nij,nj->ni", edges[cell[outside]], (cut - weights[outside])[:, 1:])
    distance[outside] = np.linalg.norm(gap, axis=1)
    return distance


def _first_minimum(values: Floats, starts: Integers, counts: Integers) -> Integers:
    least = np.repeat(np.minimum.reduceat(values, starts), counts)
    found: Integers = np.flatnonzero(values <= least)
    return found[rank_in(found, starts)]


def _chunks(counts: Integers) -> list[tuple[int, int]]:
    """Ranges of points whose candidates together stay below the limit, as far as single points do."""
    block = np.cumsum(counts) // _CHUNK
    cuts: list[int] = [0, *(np.flatnonzero(np.diff(block)) + 1).tolist(), len(counts)]
    return [(start, stop) for start, stop in pairwise(cuts) if stop > start]


def _make_bins(positions: Floats, cells: Integers, reach: int) -> _Bins:
    """Bins of the tetrahedra that touch them, or touch one of their neighbours if ``reach`` is 1."""
    corners = positions[cells]
    low: Floats = np.min(corners, axis=1)
    high: Floats = np.max(corners, axis=1)
    origin = low.min(axis=0)
    extent: Floats = np.max(high, axis=0) - origin
    # A bin about as large as a tetrahedron, and at most some millions of bins, however thin the mesh. The grid starts
    # half a bin early, so that the cubes of a lattice do not touch bins on both of their sides.
    spacing = max(float((high - low).mean()), float(extent.max()) / 200)
    origin = origin - spacing / 2
    shape = np.ceil(extent / spacing).astype(np.int64) + 1
    first = np.maximum(np.floor((low - origin) / spacing).astype(np.int64) - reach, 0)
    last = np.minimum(np.floor((high - origin) / spacing).astype(np.int64) + reach, shape - 1)
    sides = last - first + 1
    count = sides.prod(axis=1)
    cell = np.repeat(np.arange(len(cells)), count)
    place = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)
    across = sides[cell]
    k = place % across[:, 2]
    j = place // across[:, 2] % across[:, 1]
    i = place // (across[:, 2] * across[:, 1])
    index = first[cell] + np.stack([i, j, k], axis=1)
    bins: Integers = np.asarray(np.ravel_multi_index(tuple(index.T), tuple(shape.tolist())))
    order = np.argsort(bins, kind="stable")
    starts = rank_in(bins[order], np.arange(int(shape.prod()) + 1))
    return _Bins(origin, spacing, shape, starts, cell[order], _nearest_filled(np.diff(starts) > 0, shape))


def _nearest_filled(filled: npt.NDArray[np.bool_], shape: Integers) -> Integers:
    """For each bin the nearest that is filled, by spreading from filled bins to their neighbours step by step."""
    grid = np.where(filled, np.arange(len(filled)), -1).reshape(tuple(shape.tolist()))
    while (grid < 0).any():
        for axis in range(3):
            # Views with the axis first: what is written to them is written to the grid.
            to, source = np.moveaxis(grid, axis, 0), np.moveaxis(grid.copy(), axis, 0)
            np.copyto(to[1:], source[:-1], where=to[1:] < 0)
            np.copyto(to[:-1], source[1:], where=to[:-1] < 0)
    return grid.ravel()
