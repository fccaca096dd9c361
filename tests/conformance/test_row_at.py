"""``ebb.row_at``: rows of a grid at coordinates that a kernel computes."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import define, grid, names_row, rejects


def points(at, ndim=2):
    rows = ebb.Relation("points", size=len(at))
    rows.new_field("at", ebb.vector(ebb.int32, ndim), init=np.asarray(at))
    rows.new_field("x", ebb.float64, init=-1.0)
    return rows


@pytest.mark.parametrize("shape", [(7,), (4, 5), (3, 4, 5)])
def test_coordinates_go_both_ways(backend, shape):
    cells = grid(shape)

    @ebb.kernel
    def same(c: cells):
        c.y = ebb.row_at(cells, ebb.coords(c)).x

    same(cells)
    np.testing.assert_array_equal(cells.y.to_numpy(), cells.x.to_numpy())


def test_periodic_dimensions_wrap_and_the_others_clamp(backend):
    cells = grid((4, 5), (True, False))
    at = np.array([[0, 0], [-1, 2], [4, 4], [-9, 7], [11, -3], [2**31 - 1, 2**31 - 1], [-(2**31), -(2**31)]])
    rows = points(at)

    @ebb.kernel
    def look(p: rows):
        p.x = ebb.row_at(cells, p.at, edge="clamp").x

    look(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), cells.x.to_numpy()[at[:, 0] % 4, np.clip(at[:, 1], 0, 4)])


def test_coordinates_may_be_int64(backend):
    cells = grid((5,), (True,))
    rows = points([[3]], 1)

    @ebb.kernel
    def look(p: rows):
        far = ebb.int64(p.at[0]) * 1_000_000_000_000
        p.x = ebb.row_at(cells, [far]).x + 100 * ebb.row_at(cells, [far + 1]).x

    look(rows)
    x = cells.x.to_numpy()
    np.testing.assert_array_equal(rows.x.to_numpy(), [x[0] + 100 * x[1]])


def test_outside_is_an_error_that_names_the_row(backend):
    cells = grid((4, 5), (True, False))
    rows = points([[0, 0], [9, 4], [0, 5]])

    @ebb.kernel
    def look(p: rows):
        p.x = ebb.row_at(cells, p.at).x

    assert names_row(rejects(ebb.BoundsError, "E403", lambda: look(rows)), 2)


@pytest.mark.parametrize(("shape", "periodic"), [((0,), True), ((0,), False)])
def test_a_grid_without_rows_has_none_to_clamp_to(backend, shape, periodic):
    cells = grid(shape, (periodic,))
    rows = points([[0]], 1)

    @ebb.kernel
    def look(p: rows):
        p.x = ebb.row_at(cells, p.at, edge="clamp").x

    rejects(ebb.BoundsError, "E403", lambda: look(rows))


def test_keys_may_be_stored_moved_and_reduced_through(backend):
    cells = grid((4, 5))
    cells.y.fill(0.0)
    rows = points([[0, 0], [2, 3], [2, 3]])
    rows.new_field("cell", cells)

    @ebb.kernel
    def place(p: rows):
        p.cell = ebb.row_at(cells, p.at)
        p.x = ebb.row_at(cells, p.at)(1, 1).x
        ebb.row_at(cells, p.at).y += 1.0

    place(rows)
    np.testing.assert_array_equal(rows.cell.to_numpy(), rows.at.to_numpy())
    np.testing.assert_array_equal(rows.x.to_numpy(), cells.x.to_numpy()[[1, 3, 3], [1, 4, 4]])
    expected = np.zeros((4, 5))
    expected[0, 0], expected[2, 3] = 1, 2
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)


def test_a_row_at_computed_coordinates_is_another_row():
    cells = grid((4, 5))

    @ebb.kernel
    def write(c: cells):
        ebb.row_at(cells, ebb.coords(c)).y = 1.0

    rejects(ebb.PhaseError, "E303", lambda: write(cells))


WRONG = {
    "floats": "c.y = ebb.row_at(cells, [0.5, 1.0]).x",
    "too few": "c.y = ebb.row_at(cells, [1]).x",
    "one number": "c.y = ebb.row_at(cells, 1).x",
    "a bool": "c.y = ebb.row_at(cells, [True, 1]).x",
    "no grid": "c.y = ebb.row_at(rows, [1]).z",
    "no relation": "c.y = ebb.row_at(c, [1, 1]).x",
    "an unknown edge": "c.y = ebb.row_at(cells, [1, 1], edge='wrap').x",
    "no coordinates": "c.y = ebb.row_at(cells).x",
    "too many arguments": "c.y = ebb.row_at(cells, [1, 1], 'clamp', 1).x",
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_coordinates(case):
    cells, rows = grid((4, 5)), ebb.Relation("rows", size=3)
    rows.new_field("z", ebb.float64)
    kernel = define(f"@ebb.kernel\ndef program(c: cells):\n    {WRONG[case]}\n", cells=cells, rows=rows)["program"]
    rejects(ebb.KernelTypeError, "E2", lambda: kernel(cells))
