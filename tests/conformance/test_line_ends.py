"""Rows near the ends of lines of a grid, where coordinates wrap or are held, and those between."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import kernel_of

SHAPES = [(1,), (3, 2), (2, 1, 3)]


def moves(ndim):
    """Offsets by one, two and four in each dimension, more than small grids have, and one in all dimensions."""
    along = [tuple(step * (axis == d) for d in range(ndim)) for axis in range(ndim) for step in (-2, -1, 1, 2, 4)]
    return (*along, (-1,) * ndim, (1,) * ndim)


def numbered(shape, periodic=None):
    cells = ebb.Relation("cells", shape=shape, periodic=periodic)
    cells.new_field("x", ebb.float64, init=np.arange(cells.size, dtype=float).reshape(shape) ** 2)
    cells.new_field("y", ebb.float64)
    return cells


def moved(offset, key="c", edge=""):
    """The text of an affine map by ``offset``."""
    rows = [[int(d == axis) for d in range(len(offset))] + [step] for axis, step in enumerate(offset)]
    return f"ebb.affine(cells, {rows}, {key}{edge})"


def summing(cells, edge=""):
    terms = " + ".join(f"{moved(offset, edge=edge)}.x" for offset in moves(cells.ndim))
    return kernel_of(f"c.y = 3.0 * c.x + {terms}", "c: cells", cells=cells)


@pytest.mark.parametrize("shape", SHAPES)
def test_all_ends_wrap(backend, shape):
    cells = numbered(shape, (True,) * len(shape))
    summing(cells)(cells)
    x = cells.x.to_numpy()
    axes = tuple(range(len(shape)))
    expected = 3 * x + sum(np.roll(x, [-step for step in offset], axes) for offset in moves(len(shape)))
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)


@pytest.mark.parametrize("shape", SHAPES)
def test_all_ends_are_held(backend, shape):
    cells = numbered(shape)
    summing(cells, ', edge="clamp"')(cells)
    x = cells.x.to_numpy()
    padded = np.pad(x, 4, mode="edge")
    expected = 3.0 * x
    for offset in moves(len(shape)):
        expected += padded[tuple(slice(4 + step, 4 + step + n) for step, n in zip(offset, shape, strict=True))]
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)


def test_moves_that_follow_one_another(backend):
    cells = numbered((3, 20), (False, True))
    twice = moved((0, 1), moved((0, 1)))
    back = moved((0, -3), moved((0, 1)))
    kernel_of(f"c.y = {twice}.x - 2.0 * {back}.x", "c: cells", cells=cells)(cells)
    x = cells.x.to_numpy()
    np.testing.assert_array_equal(cells.y.to_numpy(), np.roll(x, -2, 1) - 2 * np.roll(x, 2, 1))


def test_subsets_that_hold_ends_or_none(backend):
    boxes = [np.s_[1:3, :7], np.s_[0:1, 4:39], np.s_[3:4, 39:]]
    for selection in (np.s_[:, 1:-1], np.s_[:, :1], np.s_[:, -1:], boxes):
        cells = numbered((4, 40), (True, True))
        rows = cells.new_subset("some", selection)
        kernel_of(f"c.y = {moved((0, 1))}.x - 2.0 * {moved((1, -1))}.x", "c: cells", cells=cells)(rows)
        x, mask = cells.x.to_numpy(), np.zeros(cells.shape, dtype=bool)
        for box in boxes if selection is boxes else [selection]:
            mask[box] = True
        expected = np.where(mask, np.roll(x, -1, 1) - 2 * np.roll(x, (-1, 1), (0, 1)), 0)
        np.testing.assert_array_equal(cells.y.to_numpy(), expected)


def test_other_grids_and_other_dimensions_may_be_shorter(backend):
    cells = ebb.Relation("cells", shape=(30, 30))
    points = ebb.Relation("points", shape=(31, 20), periodic=(True, True))
    points.new_field("x", ebb.float64, init=np.arange(620.0).reshape(31, 20))
    cells.new_field("y", ebb.float64)
    kernel_of(
        "c.y = ebb.affine(points, [[0, 1, 2], [0, 1, 0]], c).x - ebb.affine(points, [[1, 0, 1], [0, 1, -1]], c).x",
        "c: cells",
        cells=cells,
        points=points,
    )(cells)
    x, (i, j) = points.x.to_numpy(), np.indices((30, 30))
    np.testing.assert_array_equal(cells.y.to_numpy(), x[(j + 2) % 31, j % 20] - x[i + 1, (j - 1) % 20])


def test_the_first_failure_is_that_of_the_first_row(backend):
    cells = numbered((2, 30), (True, True))
    check = kernel_of(
        f'assert {moved((0, 1))}.x != limit, "met"\nc.y = {moved((0, -1))}.x', "c: cells, limit", cells=cells
    )
    for row, limit in (((0, 29), 0.0), ((0, 0), 1.0), ((1, 7), 38.0**2)):
        with pytest.raises(ebb.KernelAssertionError, match=rf"row cells\[{row[0]}, {row[1]}\]"):
            check(cells, limit)
