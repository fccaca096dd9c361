"""Captured launches whose blocks run through all of them: what they leave is what they leave one after the other."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

SIZE, FEW = 5000, 250  # few where Python runs them row by row
rate = ebb.Global(ebb.float64, 0.5)
total = ebb.Global(ebb.float64, 0.0)


@ebb.kernel
def grow(r):
    r.b = r.a * rate.value + 0.5 * r.b


@ebb.kernel
def square(r):
    r.c = min(r.b * r.b, 2.0) + r.next.a


@ebb.kernel
def take_back(r):
    r.b -= 0.25 * r.c


@ebb.kernel
def look(r):
    r.d = r.next.b + r.c


@ebb.kernel
def add_up(r):
    total.value += r.c


@ebb.kernel
def check(r):
    assert r.c < 1e30
    r.c += 1.0


STEPS = {
    "one after the other": lambda rows, left, right, both: [(grow, rows), (square, rows), (take_back, rows)],
    "what others look at changes": lambda rows, left, right, both: [(grow, rows), (look, rows), (take_back, rows)],
    "apart": lambda rows, left, right, both: [(k, part) for part in (left, right) for k in (grow, square, take_back)],
    "mixed": lambda rows, left, right, both: [(grow, left), (square, right), (square, left), (take_back, right)],
    "overlapping": lambda rows, left, right, both: [(grow, left), (take_back, both), (grow, right), (square, rows)],
    "sums": lambda rows, left, right, both: [(grow, rows), (square, rows), (add_up, rows), (take_back, rows)],
    "checks": lambda rows, left, right, both: [(grow, rows), (square, rows), (check, rows), (take_back, rows)],
}


def made(size):
    random = np.random.default_rng(3)
    rows = ebb.Relation("rows", size=size, reorder=False)
    rows.new_field("next", rows, init=random.permutation(size))
    for name in "abcd":
        rows.new_field(name, ebb.float64, init=random.random(size))
    mask = np.repeat(random.random(size // 25) < 0.5, 25)
    parts = [("left", mask), ("right", ~mask), ("both", np.roll(mask, 60))]
    return rows, *(rows.new_subset(*part) for part in parts)


def of(rows):
    return {name: rows.fields[name].to_numpy().copy() for name in "abcd"} | {"total": float(total.value)}


@pytest.mark.parametrize("swaps", [False, True])
@pytest.mark.parametrize("name", list(STEPS))
def test_a_step_does_what_its_launches_do(backend, name, swaps):
    seen = []
    for captures in (False, True):
        total.value = 0.0
        rows, left, right, both = made(FEW if backend == "reference" else SIZE)
        launches = STEPS[name](rows, left, right, both)

        def once(launches=launches, rows=rows):
            for kernel, on in launches:
                kernel(on)
            if swaps:
                rows.swap("b", "d")
            for kernel, on in launches:
                kernel(on)

        if captures:
            with ebb.capture() as step:
                once()
            step.run(2)
            step.run(7)
        else:
            for _ in range(9):
                once()
        seen.append(of(rows))
    for field, expected in seen[0].items():
        np.testing.assert_array_equal(seen[1][field], expected)
