"""Sides of conditions that take long and that few rows take: roots and divisions, nested, and through keys."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import sizes_for

SHARES = (0.0, 0.03, 0.5, 1.0)


@ebb.kernel
def roots(r):
    x, y = r.x, r.key.x
    slow, other = 0.5, y
    if x > 2:
        slow = ebb.sqrt(x) + r.key.y
        if y > 2:  # noqa: SIM108
            other = slow / y
        else:
            other = 1 / (x + 1)
    r.first = slow
    if not x <= 2:
        other = ebb.sqrt(other)
    elif y > 2:
        other = ebb.sqrt(y) / x
    r.second = other + slow


def of_numpy(x, y, key):
    with np.errstate(all="ignore"):
        own, far = x, x[key]
        taken, far_taken = own > 2, far > 2
        slow = np.where(taken, np.sqrt(own) + y[key], 0.5)
        other = np.where(taken, np.where(far_taken, slow / far, 1 / (own + 1)), far)
        second = np.where(~(own <= 2), np.sqrt(other), np.where(far_taken, np.sqrt(far) / own, other))
    return slow, second + slow


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("subset", ["all", "runs"])
def test_rows_take_a_side_or_not(backend, share, subset):
    for size in sizes_for(backend):
        random = np.random.default_rng(size)
        x = np.where(random.random(size) < share, 3 + random.random(size), random.random(size) + 0.1)
        if size > 60:
            x[7] = np.nan
        y, key = random.random(size), np.arange(size) if not size else random.integers(0, size, size)
        rows = ebb.Relation("rows", size=size, reorder=False)
        rows.new_field("key", rows, init=key)
        for name, values in (("x", x), ("y", y), ("first", np.zeros(size)), ("second", np.zeros(size))):
            rows.new_field(name, ebb.float64, init=values)
        mask = np.ones(size, bool)
        if subset == "runs":
            mask = np.repeat(random.random(size // 20 + 1) < 0.5, 20)[:size]
            roots(rows.new_subset("some", mask))
        else:
            roots(rows)
        for field, expected in zip((rows.first, rows.second), of_numpy(x, y, key), strict=True):
            np.testing.assert_allclose(field.to_numpy(), np.where(mask, expected, 0.0), rtol=1e-14)


@ebb.kernel
def own(r):
    root = 0.25
    if r.x > 2:
        root = ebb.sqrt(r.x)
    r.first = root


def test_rows_that_reach_nothing_else(backend):
    for size in sizes_for(backend):
        x = np.random.default_rng(size).random(size) * 2.05
        rows = ebb.Relation("rows", size=size)
        rows.new_field("x", ebb.float64, init=x)
        rows.new_field("first", ebb.float64, init=0.0)
        own(rows)
        np.testing.assert_array_equal(rows.first.to_numpy(), np.where(x > 2, np.sqrt(x), 0.25))
