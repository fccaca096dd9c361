"""The stencils in Ebb."""

from __future__ import annotations

import ebb
from benchmarks.constants import STENCIL_CENTER, STENCIL_SIDE
from benchmarks.data import Arrays
from benchmarks.stencils import JACOBI, WEIGHTS
from benchmarks.systems import Prepared, Programs

CENTER, SIDE = STENCIL_CENTER, STENCIL_SIDE
ALONE, FACE, EDGE, CORNER = WEIGHTS


@ebb.kernel
def stencil27(c):
    middle = ALONE * c.old + FACE * c.faces(0) + EDGE * c.corners(0)
    c.new = middle + c.side(-1) + c.side(1)


@ebb.kernel
def relax(c):
    sides = c(-1, 0, 0).old + c(1, 0, 0).old + c(0, -1, 0).old + c(0, 1, 0).old + c(0, 0, -1).old + c(0, 0, 1).old
    c.new = CENTER * c.old + SIDE * sides


@ebb.kernel
def jacobi(c):
    c.new = JACOBI * (c(-1, 0).old + c(1, 0).old + c(0, -1).old + c(0, 1).old)


def cells_of(arrays: Arrays, periodic: bool) -> ebb.Relation:
    shape = arrays["old"].shape
    cells = ebb.Relation("cells", shape=shape, periodic=(periodic,) * len(shape))
    cells.new_field("old", ebb.float32, init=arrays["old"])
    cells.new_field("new", ebb.float32, init=arrays["new"])
    return cells


def solid(arrays: Arrays, periodic: bool) -> ebb.Relation:
    cells = cells_of(arrays, periodic)

    @cells.member("__call__")
    def neighbor(c, i, j, k):
        return ebb.affine(cells, [[1, 0, 0, i], [0, 1, 0, j], [0, 0, 1, k]], c)

    @cells.member("faces")
    def faces(c, k):
        return c(-1, 0, k).old + c(1, 0, k).old + c(0, -1, k).old + c(0, 1, k).old

    @cells.member("corners")
    def corners(c, k):
        return c(-1, -1, k).old + c(-1, 1, k).old + c(1, -1, k).old + c(1, 1, k).old

    @cells.member("side")
    def side(c, k):
        return FACE * c(0, 0, k).old + EDGE * c.faces(k) + CORNER * c.corners(k)

    return cells


def plane(arrays: Arrays) -> ebb.Relation:
    cells = cells_of(arrays, periodic=False)

    @cells.member("__call__")
    def neighbor(c, i, j):
        return ebb.affine(cells, [[1, 0, i], [0, 1, j]], c)

    return cells


def steps_of(kernel: ebb.Kernel, cells: ebb.Relation) -> Prepared:
    """Steps of the kernel on all cells of a grid that wraps, or those within one that does not."""
    inner = (slice(1, -1),) * cells.ndim
    rows = cells if all(cells.periodic) else cells.new_subset("interior", inner)

    def run(steps: int) -> None:
        for _ in range(steps):
            kernel(rows)
            cells.swap("old", "new")

    return Prepared(run, lambda: {"old": cells.old.to_numpy()})


PROGRAMS: Programs = {
    "stencil-27": lambda arrays: steps_of(stencil27, solid(arrays, periodic=False)),
    "stencil-periodic": lambda arrays: steps_of(relax, solid(arrays, periodic=True)),
    "jacobi": lambda arrays: steps_of(jacobi, plane(arrays)),
}
