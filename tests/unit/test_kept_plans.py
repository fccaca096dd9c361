"""Plans of reductions that are kept between processes: those of the same launch on the same keys, and of no other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ebb
from ebb.backends.cpu import backend as cpu
from ebb.compiler.scatter.choose import Planner

CELLS, NODES = 40_000, 41_000

ROUNDING = 1e-14
"""Of sums of some terms of about 1, which may cancel."""


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[str]]:
    """For each plan that was made rather than found: how it reduces."""
    plans, make = list[str](), Planner._make

    def making(planner: Planner) -> Any:
        plan = make(planner)
        plans.append(plan.how)
        return plan

    monkeypatch.setattr(Planner, "_make", making)
    monkeypatch.setattr(cpu, "package_state", lambda: "these")
    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path))
    with ebb.backend("cpu", threads=2):
        yield plans


def near(shift: int = 0) -> np.ndarray:
    return np.arange(CELLS)[:, None] + np.array([0, 1, 3, 900]) + shift


def sums(
    keys: np.ndarray,
    nodes: int = NODES,
    group: bool = False,
    chosen: Callable[[Any], Any] = lambda cells: cells,
    asserts: bool = False,
) -> np.ndarray:
    """What cells add to the nodes that they refer to, on new relations."""
    targets = ebb.Relation("nodes", size=nodes, reorder=False)
    targets.new_field("sum", ebb.float64)
    cells = ebb.Relation("cells", size=CELLS, reorder=False)
    cells.new_field("near", ebb.vector(targets, 4), init=keys)
    cells.new_field("first", targets, init=np.arange(CELLS) // 2)
    if group:
        cells.group_by("first")
    cells.new_field("x", ebb.float64, init=np.sin(np.arange(CELLS)))

    @ebb.kernel
    def scatter(c: cells):
        assert c.x < 2
        value = ebb.sin(c.x) * ebb.cos(c.x) + ebb.exp(c.x) / ebb.sqrt(c.x + 3)
        for i in range(4):
            c.near[i].sum += value * (i + 1)

    @ebb.kernel
    def scatter_once(c: cells):
        assert c.x < 2
        c.first.sum += ebb.sin(c.x)

    rows = chosen(cells)
    (scatter_once if asserts else scatter)(rows)
    return targets.sum.to_numpy()


def expected(keys: np.ndarray, rows: slice = slice(None)) -> np.ndarray:
    x = np.sin(np.arange(CELLS))
    value = np.sin(x) * np.cos(x) + np.exp(x) / np.sqrt(x + 3)
    found = np.zeros(NODES)
    np.add.at(found, keys[rows].ravel(), (value[:, None] * np.arange(1, 5))[rows].ravel())
    return found


def test_the_same_launch_finds_its_plan(made: list[str]) -> None:
    first = sums(near())
    assert len(made) == 1 and "coloured" in made[0]
    np.testing.assert_array_equal(sums(near()), first)
    assert len(made) == 1
    np.testing.assert_allclose(first, expected(near()), rtol=1e-12, atol=ROUNDING)


def test_another_launch_has_a_plan_of_its_own(made: list[str]) -> None:
    half = slice(0, CELLS // 2)
    sums(near())
    np.testing.assert_allclose(sums(near(1)), expected(near(1)), rtol=1e-12, atol=ROUNDING)
    assert len(made) == 2, "other keys"
    swapped = near()
    swapped[[5, 30_000]] = swapped[[30_000, 5]]  # two cells in the others' blocks
    np.testing.assert_allclose(sums(swapped), expected(swapped), rtol=1e-12, atol=ROUNDING)
    assert len(made) == 3, "two keys"
    np.testing.assert_allclose(sums(near(), NODES + 7)[:NODES], expected(near()), rtol=1e-12, atol=ROUNDING)
    assert len(made) == 4, "another size"

    def chosen(cells: Any) -> Any:
        return cells.new_subset("half", np.arange(CELLS) < CELLS // 2)

    np.testing.assert_allclose(sums(near(), chosen=chosen), expected(near(), half), rtol=1e-12, atol=ROUNDING)
    assert len(made) == 5, "other rows"
    sums(near(), chosen=chosen)
    assert len(made) == 5


def test_keys_that_are_grouped_are_planned_anew(made: list[str]) -> None:
    first = sums(near(), group=True, asserts=True)
    np.testing.assert_array_equal(sums(near(), group=True, asserts=True), first)
    assert len(made) == 2


def test_keys_that_change_are_planned_for_what_they_are(made: list[str]) -> None:
    targets = ebb.Relation("nodes", size=NODES, reorder=False)
    targets.new_field("sum", ebb.float64)
    cells = ebb.Relation("cells", size=CELLS, reorder=False)
    cells.new_field("near", ebb.vector(targets, 4), init=near())

    @ebb.kernel
    def count(c: cells):
        for i in range(4):
            c.near[i].sum += i + 1.0

    total = np.zeros(NODES)
    for shift in (0, 0, 5, 0, 2):
        cells.near.load(near(shift))
        count(cells)
        np.add.at(total, near(shift).ravel(), np.tile(np.arange(1.0, 5.0), CELLS))
        np.testing.assert_array_equal(targets.sum.to_numpy(), total)
