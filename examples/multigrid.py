"""Equations ``(shift - laplace) x = b`` for a field of the cells of a grid: diffusion, and with a shift of 0 pressure.

Three ways to solve them, from slow to fast:

- ``jacobi``: each cell goes 4/5 of the way to the value that would satisfy its own equation;
- ``gauss-seidel``: red cells first, then black ones, as on a chessboard: the second see what the first became;
- ``multigrid``: a V-cycle over ``Grid.coarsen()``. A few turns of red-black Gauss-Seidel leave an error that is smooth,
  and so can be found on the grid of half as many cells, where it is restricted to by means (``C.down(i, j)``) and comes
  back from by linear interpolation. An error goes down by the same factor a cycle on all grids (Trottenberg,
  Oosterlee and Schueller, "Multigrid", 2001, chapters 2 and 5; cells: Mohr and Wienands, "Cell-centred multigrid
  revisited", 2004).

Walls are ``INSULATED``, the derivative is 0 there, or ``HELD`` at 0; periodic dimensions wrap. Where no wall is held
and the shift is 0, only differences of ``x`` matter: its mean is made 0, as is that of ``b``, or there is no solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import product
from math import cos, pi, sqrt
from typing import Any

import numpy as np

import ebb

METHODS = ("jacobi", "gauss-seidel", "multigrid")
BATCH = 16
"""How many turns of the plain methods come between two looks at the residual."""


class Walls(Enum):
    """What holds where the domain ends."""

    INSULATED = 0
    HELD = 1


@dataclass(frozen=True)
class Solved:
    """What solving took.

    Attributes:
        turns: cycles of multigrid, or sweeps over all cells.
        residuals: the largest of any cell, over the largest of the right hand side: at the start, and after each look.
        converged: whether the last is within the tolerance.
    """

    turns: int
    residuals: tuple[float, ...]
    converged: bool


class Hierarchy:
    """A grid and the coarser ones below it, prepared for solvers, which may share it.

    Cells get ``wall_sides``, the number of their sides that are walls, and ``coarse(i, j)``: of the coarser cells,
    those around their centre.
    """

    def __init__(self, grid: Any) -> None:
        """Coarsen as long as all counts are even and above 3."""
        self.grids = [grid]
        while all(count > 3 and count % 2 == 0 for count in self.grids[-1].shape):
            self.grids.append(self.grids[-1].coarsen())
        for each in self.grids:
            each.cells.new_field("wall_sides", grid.precision, init=count_walls(each))
            if each.coarse is not None:
                add_corners(each.cells, each.coarse.cells)


def count_walls(grid: Any) -> np.ndarray:
    """For each cell, how many of its sides are walls."""
    count = np.zeros(grid.shape)
    for axis, wraps in enumerate(grid.periodic):
        if not wraps:
            ends = np.moveaxis(count, axis, 0)
            ends[0] += 1
            ends[-1] += 1
    return count


def add_corners(cells: ebb.Relation, coarser: ebb.Relation) -> None:
    """The member ``coarse``: with 0 the coarser cell below the centre of a cell, with 1 that above, along each axis."""
    if cells.ndim == 2:

        @cells.member("coarse")
        def corner_2d(c, i, j):
            return ebb.affine(coarser, [[0.5, 0, i - 0.5], [0, 0.5, j - 0.5]], c, edge="clamp")

    else:

        @cells.member("coarse")
        def corner_3d(c, i, j, k):
            return ebb.affine(
                coarser, [[0.5, 0, 0, i - 0.5], [0, 0.5, 0, j - 0.5], [0, 0, 0.5, k - 0.5]], c, edge="clamp"
            )


# ---- What kernels do at a cell ----


@ebb.func
def around_2d(c, x):
    return c.clamped(-1, 0)[x] + c.clamped(1, 0)[x] + c.clamped(0, -1)[x] + c.clamped(0, 1)[x]


@ebb.func
def around_3d(c, x):
    sides = c.clamped(-1, 0, 0)[x] + c.clamped(1, 0, 0)[x] + c.clamped(0, -1, 0)[x] + c.clamped(0, 1, 0)[x]
    return sides + c.clamped(0, 0, -1)[x] + c.clamped(0, 0, 1)[x]


@ebb.func
def color_2d(c):
    at = ebb.coords(c)
    return (at.x + at.y) & 1


@ebb.func
def color_3d(c):
    at = ebb.coords(c)
    return (at.x + at.y + at.z) & 1


@ebb.func
def child_2d(c, corner):
    return c.down(corner[0], corner[1])


@ebb.func
def child_3d(c, corner):
    return c.down(corner[0], corner[1], corner[2])


@ebb.func
def from_coarse_2d(c, x, number):
    odd = ebb.coords(c) & 1
    high_x, high_y = 0.75 - 0.5 * number(odd.x), 0.75 - 0.5 * number(odd.y)
    low = (1 - high_x) * c.coarse(0, 0)[x] + high_x * c.coarse(1, 0)[x]
    high = (1 - high_x) * c.coarse(0, 1)[x] + high_x * c.coarse(1, 1)[x]
    return (1 - high_y) * low + high_y * high


@ebb.func
def layer_from_coarse(c, x, high_x, high_y, k):
    low = (1 - high_x) * c.coarse(0, 0, k)[x] + high_x * c.coarse(1, 0, k)[x]
    high = (1 - high_x) * c.coarse(0, 1, k)[x] + high_x * c.coarse(1, 1, k)[x]
    return (1 - high_y) * low + high_y * high


@ebb.func
def from_coarse_3d(c, x, number):
    odd = ebb.coords(c) & 1
    high_x, high_y = 0.75 - 0.5 * number(odd.x), 0.75 - 0.5 * number(odd.y)
    below, above = layer_from_coarse(c, x, high_x, high_y, 0), layer_from_coarse(c, x, high_x, high_y, 1)
    return below + (0.75 - 0.5 * number(odd.z)) * (above - below)


@ebb.func
def size(value):
    return abs(value)


@ebb.func
def size_of_vector(value):
    return ebb.length(value)


# ---- Solvers ----


class Solver:
    """Solves ``(shift - laplace) x = b`` for two fields of the cells of a grid, numbers or vectors, again and again."""

    def __init__(
        self,
        hierarchy: Hierarchy,
        x: str,
        b: str,
        *,
        walls: Walls = Walls.INSULATED,
        method: str = "multigrid",
        shift: float = 0.0,
    ) -> None:
        """Add what it works with to the cells, where it is missing: ``x``, ``b``, and ``x`` with ``new_`` before it.

        Args:
            hierarchy: of the grid.
            x: the name of the field that is solved for; what it holds is the first guess.
            b: the name of the right hand side, of the same type.
            walls: what holds at the walls.
            method: one of ``METHODS``.
            shift: at least 0; ``solver.shift.value`` may be changed later.
        """
        assert method in METHODS, method
        self.grids, self.x, self.b, self.walls, self.method = hierarchy.grids, x, b, walls, method
        self.cells = self.grids[0].cells
        kind, precision = self.cells.fields[x].type, self.grids[0].precision
        for grid in self.grids if method == "multigrid" else self.grids[:1]:
            for name in {x, f"new_{x}", b} - grid.cells.fields.keys():
                grid.cells.new_field(name, kind)
        self.new_x = f"new_{x}"
        self.shift = ebb.Global(precision, shift)
        self.worst = ebb.Global(precision, 0.0)
        wide = ebb.vector(ebb.float64, kind.shape[0]) if kind.shape else ebb.float64
        self.total = ebb.Global(wide, 0.0)
        norm = size_of_vector if kind.shape else size
        self._define_equation(self.cells.ndim, precision, norm)
        self._define_transfers(self.cells.ndim, precision)
        self._define_sums(kind, norm, wide)
        self._turns = self._capture()

    @property
    def singular(self) -> bool:
        """Whether only differences of ``x`` matter."""
        grid = self.grids[0]
        return self.shift.value == 0 and (self.walls is Walls.INSULATED or all(grid.periodic))

    def solve(self, tolerance: float = 1e-4, most: int = 100) -> Solved:
        """Make cycles, or batches of sweeps, until the residual of no cell is above ``tolerance`` times the largest b.

        Args:
            tolerance: of the largest residual, relative to the largest of ``b``.
            most: at most so many cycles or batches. Multigrid also stops where rounding lets it come no closer.
        """
        if self.singular:
            self._center(self.b)
        self.worst.value = 0.0
        self._find_largest(self.cells, self.b)
        largest = float(self.worst.value)
        if largest == 0:
            self.cells.fields[self.x].fill(0)
            return Solved(0, (0.0,), converged=True)
        residuals = [self._residual() / largest]
        while residuals[-1] > tolerance and len(residuals) <= most and not self._stuck(residuals):
            self._turns.run(1)
            residuals.append(self._residual() / largest)
        if self.singular:
            self._center(self.x)
        turns = (len(residuals) - 1) * (1 if self.method == "multigrid" else BATCH)
        return Solved(turns, tuple(residuals), converged=residuals[-1] <= tolerance)

    def _stuck(self, residuals: list[float]) -> bool:
        """Whether a cycle of multigrid gains nothing any more: what is left are errors of rounding."""
        return self.method == "multigrid" and len(residuals) > 2 and residuals[-1] > 0.8 * residuals[-2]

    def _residual(self) -> float:
        self.worst.value = 0.0
        self._find_residual(self.cells, self._per_area(0))
        return float(self.worst.value)

    def _center(self, field: str) -> None:
        """Make the mean of a field 0."""
        self.total.value = 0.0
        self._add_up(self.cells, field)
        self._subtract_mean(self.cells, field, float(self.cells.size))

    def _per_area(self, level: int) -> float:
        """One over the square of the side of a cell; all sides are alike."""
        return 1 / self.grids[level].spacing[0] ** 2

    def _capture(self) -> Any:
        """What one cycle does, or a batch of sweeps, to be run without Python in between."""
        with ebb.capture() as turns:
            if self.method == "multigrid":
                self._cycle(0)
            else:
                self._sweep(0, BATCH)
        return turns

    def _cycle(self, level: int) -> None:
        if level == len(self.grids) - 1:
            self._sweep(level, *overrelaxed(self.grids[level]))
            return
        cells, coarser = self.grids[level].cells, self.grids[level + 1].cells
        self._sweep(level, 2)
        self._keep_residual(cells, self._per_area(level))
        self._restrict(coarser)
        self._cycle(level + 1)
        self._correct(cells)
        self._sweep(level, 1)

    def _sweep(self, level: int, times: int, factor: float = 1.0) -> None:
        """Go over all cells ``times``: each is moved by ``factor`` of what would satisfy its equation."""
        cells, per_area = self.grids[level].cells, self._per_area(level)
        for _ in range(times):
            if self.method == "jacobi":
                self._relax_all(cells, per_area, 0.8)
                cells.swap(self.x, self.new_x)
                continue
            for color in (0, 1):
                self._relax(cells, per_area, factor, color)
                cells.swap(self.x, self.new_x)

    def _define_equation(self, ndim: int, precision: Any, norm: Any) -> None:
        around, color_of = (around_2d, color_2d) if ndim == 2 else (around_3d, color_3d)
        x, new_x, b, shift, worst = self.x, self.new_x, self.b, self.shift, self.worst
        # Beyond a wall, ``clamped`` gives the cell itself: so it is insulated. Where 0 is held, the value there is -x.
        sides, of_wall = 2.0 * ndim, 2.0 * self.walls.value

        @ebb.func
        def residual(c, per_area):
            near = around(c, x) - (sides + of_wall * c.wall_sides) * c[x]
            return c[b] - shift.value * c[x] + per_area * near

        @ebb.func
        def missing(c, per_area):
            return residual(c, per_area) / (shift.value + per_area * (sides + (of_wall - 1) * c.wall_sides))

        @ebb.kernel
        def relax(c, per_area: precision, factor: precision, color: ebb.int32):
            c[new_x] = c[x] + (factor * missing(c, per_area) if color_of(c) == color else 0 * c[x])

        @ebb.kernel
        def relax_all(c, per_area: precision, factor: precision):
            c[new_x] = c[x] + factor * missing(c, per_area)

        @ebb.kernel
        def keep_residual(c, per_area: precision):
            c[new_x] = residual(c, per_area)

        @ebb.kernel
        def find_residual(c, per_area: precision):
            worst.value = max(worst.value, norm(residual(c, per_area)))

        self._relax, self._relax_all, self._keep_residual = relax, relax_all, keep_residual
        self._find_residual = find_residual

    def _define_transfers(self, ndim: int, precision: Any) -> None:
        child, from_coarse = (child_2d, from_coarse_2d) if ndim == 2 else (child_3d, from_coarse_3d)
        x, new_x, b = self.x, self.new_x, self.b
        corners, children = tuple(product((0, 1), repeat=ndim)), 2.0**ndim

        @ebb.kernel
        def restrict(c):
            total = 0 * c[b]
            for corner in corners:
                total += child(c, corner)[new_x]
            c[b] = total / children
            c[x] = 0 * total

        @ebb.kernel
        def correct(c):
            c[x] += from_coarse(c, x, precision)

        self._restrict, self._correct = restrict, correct

    def _define_sums(self, kind: Any, norm: Any, wide: Any) -> None:
        worst, total = self.worst, self.total

        @ebb.kernel
        def find_largest(c, field: str):
            worst.value = max(worst.value, norm(c[field]))

        @ebb.kernel
        def add_up(c, field: str):
            total.value += wide(c[field])

        @ebb.kernel
        def subtract_mean(c, field: str, count: ebb.float64):
            c[field] -= kind(total.value / count)

        self._find_largest, self._add_up, self._subtract_mean = find_largest, add_up, subtract_mean


def overrelaxed(grid: Any) -> tuple[int, float]:
    """How many sweeps over a coarsest grid solve its equation well enough, and the best factor of overrelaxation.

    Young, "Iterative Solution of Large Linear Systems", 1971, chapter 6. Where the two colours meet themselves, around
    a periodic dimension with an odd number of cells, overrelaxation may diverge.
    """
    axes = tuple(zip(grid.shape, grid.periodic, strict=True))
    longest = max(count // 2 if wraps else count for count, wraps in axes)
    if any(wraps and count % 2 for count, wraps in axes):
        return min(8 + longest**2, 400), 1.0
    ndim = len(grid.shape)
    jacobi = (ndim - 1 + cos(pi / (longest + 1))) / ndim
    return 8 + 2 * longest, 2 / (1 + sqrt(1 - jacobi**2))
