"""Elements of a row that are chosen at run time, and ones that are stored on both sides of a condition."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.runtime.buffer import Buffer, Layout

from .harness import rows_with

SIZE = 40
HOLES = (13, 31)


@pytest.fixture(params=Layout, ids=[layout.value for layout in Layout])
def rows(request, monkeypatch):
    """Rows of a vector in either layout, and a subset of runs."""

    def buffer(shape, dtype):
        return Buffer(shape, dtype, request.param if len(shape) > 1 else Layout.ROWS)

    monkeypatch.setattr("ebb.relations.field.Buffer", buffer)
    made = rows_with(
        x=(ebb.float64, np.arange(SIZE)), q=(ebb.vec3d, np.full((SIZE, 3), -1)), out=(ebb.float64, np.zeros(SIZE))
    )
    made.new_subset("runs", np.isin(np.arange(SIZE), HOLES, invert=True))
    return made


def rows_of(rows, selection):
    """What a kernel runs on, and which rows those are."""
    if selection == "all":
        return rows, np.ones(SIZE, dtype=bool)
    return rows.runs, np.isin(np.arange(SIZE), HOLES, invert=True)


@pytest.mark.parametrize("selection", ["all", "runs"])
@pytest.mark.parametrize("k", [1, 2])
def test_an_element_chosen_at_run_time_is_the_one_that_is_read(backend, rows, selection, k):
    chosen = ebb.Global(ebb.int32, k)

    @ebb.kernel
    def put(r):
        r.q[chosen.value] = ebb.sqrt(r.x) + 1.0
        r.out = r.q[2]

    target, on = rows_of(rows, selection)
    put(target)
    expected = np.full((SIZE, 3), -1.0)
    expected[on, k] = np.sqrt(np.arange(SIZE))[on] + 1
    np.testing.assert_allclose(rows.q.to_numpy(), expected)
    np.testing.assert_allclose(rows.out.to_numpy(), np.where(on, expected[:, 2], 0))


@pytest.mark.parametrize("selection", ["all", "runs"])
def test_both_sides_store(backend, rows, selection):
    @ebb.kernel
    def put(r):
        before = r.q
        if r.x > 10:
            r.q[2] = ebb.sqrt(r.x) / (2 + r.x)
        else:
            r.q = r.x * ebb.sqrt(r.x) * [1.0, 2.0, 3.0]
        r.out = before[2]

    target, on = rows_of(rows, selection)
    put(target)
    x, expected = np.arange(SIZE, dtype=float), np.full((SIZE, 3), -1.0)
    high, low = on & (x > 10), on & (x <= 10)
    expected[high, 2] = (np.sqrt(x) / (2 + x))[high]
    expected[low] = (x * np.sqrt(x))[low, None] * [1, 2, 3]
    np.testing.assert_allclose(rows.q.to_numpy(), expected)
    np.testing.assert_allclose(rows.out.to_numpy(), np.where(on, -1, 0))
