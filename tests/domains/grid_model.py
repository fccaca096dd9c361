"""What a grid should be, from geometry alone: where the elements lie, in halves of a cell from the origin."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ebb.domains import Grid1D, Grid2D, Grid3D

GRIDS = {1: Grid1D, 2: Grid2D, 3: Grid3D}
SHAPES = {1: [(1,), (2,), (5,)], 2: [(1, 1), (1, 3), (4, 2)], 3: [(1, 1, 1), (2, 1, 3)]}
CASES = [
    (shape, periodic)
    for ndim, shapes in SHAPES.items()
    for shape in shapes
    for periodic in product((False, True), repeat=ndim)
]


@dataclass(frozen=True)
class Elements:
    """A kind of elements. ``first`` is where the first lies along each axis; from one to the next it is 2 halves."""

    relation: str
    names: tuple[str, ...]
    dimension: int | None
    first: tuple[int, ...]
    counts: tuple[int, ...]

    def indices(self):
        """The indices of all elements, of the shape ``counts + (ndim,)``."""
        return np.stack(np.indices(self.counts), axis=-1)

    def at(self, halves, cells, periodic):
        """The indices of the elements that lie at ``halves``, and which of them there are."""
        wraps = np.array(periodic)
        indices, rest = np.divmod(halves - np.array(self.first), 2)
        assert not rest.any()
        indices = np.where(wraps, indices % np.array(cells), indices)
        return indices, ((indices >= 0) & (indices < np.array(self.counts))).all(axis=-1)


def elements(cells, periodic):
    """All kinds of elements of a grid, by the name of one."""
    ndim, axes = len(cells), "xyz"
    found = []
    for points in product((False, True), repeat=ndim):
        dimension = points.count(False)
        counts = tuple(n if w or not p else n + 1 for n, w, p in zip(cells, periodic, points, strict=True))
        names = []
        if dimension == 0:
            names.append("vertex")
        if dimension == ndim:
            names.append("cell")
        if dimension == 1:
            names.append(f"{axes[points.index(False)]}edge")
        if dimension == ndim - 1:
            names.append(f"{axes[points.index(True)]}face")
        relation = {"vertex": "vertices"}.get(names[0], f"{names[0]}s")
        found.append(Elements(relation, tuple(names), dimension, tuple(0 if p else 1 for p in points), counts))
    between = tuple(n if w else n - 1 for n, w in zip(cells, periodic, strict=True))
    found.append(Elements("dual_cells", ("dual_cell",), None, (2,) * ndim, between))
    found.append(Elements("dual_vertices", ("dual_vertex",), None, (1,) * ndim, tuple(cells)))
    return found


def sides(kind, axis, all_kinds):
    """The names of the members ``xneg_face`` and so on of one axis: (name, halves to move, kind it leads to)."""
    if kind.dimension is None:
        return
    first = tuple(1 - start if d == axis else start for d, start in enumerate(kind.first))
    other = next(each for each in all_kinds if each.first == first and each.dimension is not None)
    for name in other.names:
        for sign, step in (("neg", -1), ("pos", 1)):
            yield f"{'xyz'[axis]}{sign}_{name.lstrip('xyz')}", step, other
