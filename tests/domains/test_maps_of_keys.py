"""Affine maps from keys in fields: checked and wrapped exactly where some row could leave the grid."""

from __future__ import annotations

import re
from fractions import Fraction

import numpy as np
import pytest

import ebb
from ebb.domains import Grid3D, Particles

MAPS = [(1, 0), (1, 1), (1, -1), (1, 3), (1, -4), (1, 9), (-1, 3), (-1, 5), (2, 0), (2, -3), (Fraction(1, 2), 0)]
MAPS += [(Fraction(1, 2), Fraction(-1, 2)), (0, 2), (0, 5), (Fraction(-3, 2), 4)]


def mapped(source, target, factor, shift, periodic):
    """A program that follows a map from each of ``source`` rows into ``target`` rows; the index, or None outside."""
    cells = ebb.Relation("cells", shape=(source,))
    others = ebb.Relation("others", shape=(target,), periodic=(periodic,))
    others.new_field("number", ebb.int32, init=lambda i: i)
    rows = ebb.Relation("rows", size=source)
    rows.new_field("cell", cells, init=np.arange(source)[:, None])
    rows.new_field("found", ebb.int32, init=-1)

    @ebb.kernel
    def follow(r: rows):
        r.found = ebb.affine(others, [[factor, shift]], r.cell).number

    return follow, rows


@pytest.mark.parametrize(("factor", "shift"), MAPS)
@pytest.mark.parametrize("periodic", [False, True])
def test_every_map_gives_the_row_or_an_error(backend, factor, shift, periodic):
    for source, target in ((4, 4), (4, 5), (5, 3), (1, 4), (4, 1)):
        follow, rows = mapped(source, target, factor, shift, periodic)
        asked = np.array([int(np.floor(float(factor * i + shift))) for i in range(source)])
        outside = [] if periodic else np.flatnonzero((asked < 0) | (asked >= target))
        if len(outside):
            with pytest.raises(ebb.BoundsError, match=rf"E403.*row rows\[{outside[0]}\]"):
                follow(rows)
        else:
            follow(rows)
            np.testing.assert_array_equal(rows.found.to_numpy(), asked % target)


def failures_of(kernel, rows):
    return len(re.findall(r"\bfail\b", kernel.inspect(rows, "lir")))


def test_no_cell_around_a_dual_cell_is_checked():
    grid = Grid3D((5, 4, 3))
    grid.cells.new_field("u", ebb.float32)
    particles = Particles.in_cells(grid)
    particles.couple(grid)
    particles.new_field("u", ebb.float32)

    @ebb.kernel
    def inside(p: particles):
        p.u = p.dual_cell.cell(0, 0, 0).u + p.dual_cell.cell(1, 0, 1).u + p.dual_cell.cell(1, 1, 1).u

    @ebb.kernel
    def beyond(p: particles):
        p.u = p.cell(1, 0, 0).u

    with ebb.backend("cpu"):
        assert failures_of(inside, particles) == 0
        assert failures_of(beyond, particles) == 1
