"""Keys that kernels write are a change of the structure only where something depends on them."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from backends import BACKENDS, lacking
from ebb.compiler.lir import BLOCK_ROWS
from ebb.runtime.epoch import structure

ROWS = 6 * BLOCK_ROWS
"""Enough for reductions into other rows to be planned."""


@pytest.fixture(params=[name for name in BACKENDS if name != "reference"])
def backend(request):
    if lacking(request.param):
        pytest.skip(lacking(request.param))
    with ebb.backend(request.param):
        yield request.param


class Walkers:
    """Rows with a key each, that a kernel moves on, and that take from and give to the row that it refers to."""

    def __init__(self, size=ROWS):
        self.places = places = ebb.Relation("places", shape=(size,), periodic=True)
        self.rows = rows = ebb.Relation("rows", size=size, reorder=False)
        places.new_field("total", ebb.int64)
        places.new_field("value", ebb.int64, init=np.arange(size))
        rows.new_field("at", places, init=np.arange(size)[:, None])
        rows.new_field("found", ebb.int64)

        @ebb.kernel
        def move(r: rows, by: ebb.int32):
            r.at = ebb.row_at(places, [ebb.coords(r.at).x + by])

        @ebb.kernel
        def give(r: rows):
            r.at.total += ebb.id(r)

        @ebb.kernel
        def take(r: rows):
            r.found = r.at.value

        self.move, self.give, self.take = move, give, take
        self.moved = 0

    def check_taken(self):
        expected = (np.arange(self.rows.size) + self.moved) % self.rows.size
        np.testing.assert_array_equal(self.rows.found.to_numpy(), expected)

    def walk(self, by):
        self.move(self.rows, by)
        self.moved += by

    def given(self):
        return np.roll(np.arange(self.rows.size), self.moved)


def settled(*launches, times=12):
    for _ in range(times):
        for launch in launches:
            launch()
    return structure.epoch


def test_keys_that_nothing_depends_on_leave_the_structure_as_it_is(backend) -> None:
    walkers = Walkers()

    def step():
        walkers.walk(1)
        walkers.take(walkers.rows)

    epoch = settled(step)
    for _ in range(5):
        step()
    assert structure.epoch is epoch and not walkers.rows.at.followed
    walkers.check_taken()


def test_a_captured_step_that_moves_keys_is_not_prepared_again(backend, monkeypatch) -> None:
    walkers = Walkers()
    with ebb.capture() as step:
        walkers.move(walkers.rows, 1)
        walkers.take(walkers.rows)
        walkers.give(walkers.rows)
    step.run()
    step.run()
    prepared = []
    usual = type(step)._prepare
    monkeypatch.setattr(type(step), "_prepare", lambda self: (prepared.append(1), usual(self)))
    for _ in range(4):
        step.run(3)
    walkers.moved = 14
    walkers.check_taken()
    expected = sum(np.roll(np.arange(ROWS), by) for by in range(1, 15))
    np.testing.assert_array_equal(walkers.places.total.to_numpy(), expected)
    assert not prepared


def test_a_plan_is_made_again_for_keys_that_change_now_and_then(backend) -> None:
    walkers, expected = Walkers(), np.zeros(ROWS, dtype=np.int64)
    for by in (3, 5, 1000, 7):
        for _ in range(10):
            walkers.give(walkers.rows)
            expected += walkers.given()
        walkers.walk(by)
        walkers.give(walkers.rows)
        expected += walkers.given()
    np.testing.assert_array_equal(walkers.places.total.to_numpy(), expected)


def test_reductions_by_keys_that_always_move_leave_other_launches_alone(backend) -> None:
    walkers, expected = Walkers(), np.zeros(ROWS, dtype=np.int64)

    def step():
        walkers.walk(2)
        walkers.give(walkers.rows)
        walkers.take(walkers.rows)
        np.add(expected, walkers.given(), out=expected)

    epoch = settled(step)
    for _ in range(5):
        step()
    assert structure.epoch is epoch
    walkers.check_taken()
    np.testing.assert_array_equal(walkers.places.total.to_numpy(), expected)
    for _ in range(20):  # they stay: the reductions are planned
        walkers.give(walkers.rows)
        expected += walkers.given()
    walkers.walk(1)
    walkers.give(walkers.rows)
    expected += walkers.given()
    np.testing.assert_array_equal(walkers.places.total.to_numpy(), expected)


def test_a_grouping_follows_its_keys(backend) -> None:
    walkers = Walkers(300)
    walkers.rows.group_by("at")
    rows, places = walkers.rows, walkers.places

    @ebb.kernel
    def collect(p: places):
        for r in ebb.where(rows.at, p):
            p.total += ebb.id(r)

    for _ in range(14):
        places.total.fill(0)
        collect(places)
        np.testing.assert_array_equal(places.total.to_numpy(), walkers.given())
        walkers.walk(7)


def test_keys_that_come_to_be_set_are_not_asked_for_again(backend) -> None:
    walkers = Walkers(300)
    rows = walkers.rows
    rows.new_field("later", walkers.places)

    @ebb.kernel
    def keep(r: rows):
        r.later = r.at

    @ebb.kernel
    def take(r: rows):
        r.found = r.later.value

    with pytest.raises(ebb.EbbError, match="not set"):
        take(rows)
    epoch = settled(lambda: (walkers.walk(1), keep(rows), take(rows)))
    walkers.check_taken()
    keep(rows)
    assert structure.epoch is epoch and not rows.later.maybe_unset


def test_rows_that_are_set_one_subset_after_the_other(backend) -> None:
    walkers = Walkers(300)
    rows = walkers.rows
    rows.new_field("later", walkers.places)
    lower = rows.new_subset("lower", np.arange(300) < 150)
    upper = rows.new_subset("upper", np.arange(300) >= 150)

    @ebb.kernel
    def keep(r: rows):
        r.later = r.at

    @ebb.kernel
    def take(r: rows):
        r.found = r.later.value

    for _ in range(10):
        keep(lower)
    with pytest.raises(ebb.EbbError, match="not set"):
        take(rows)
    for _ in range(10):
        keep(upper)
        take(rows)
    walkers.check_taken()


def test_keys_that_are_loaded_change_the_structure() -> None:
    walkers = Walkers(300)
    epoch = settled(lambda: walkers.take(walkers.rows))
    walkers.rows.at.load(np.roll(np.arange(300), -4)[:, None])
    assert structure.epoch is not epoch
    walkers.take(walkers.rows)
    walkers.moved = 4
    walkers.check_taken()


def test_rows_are_looked_at_again_where_keys_have_scattered() -> None:
    size = 400_000
    target = ebb.Relation("target", size=size)
    source = ebb.Relation("source", size=size)
    target.new_field("x", ebb.float32, init=np.arange(size))
    rng = np.random.default_rng(0)
    source.new_field("key", target, init=np.arange(size))
    source.new_field("other", target, init=rng.permutation(size))
    source.new_field("found", ebb.float32)

    @ebb.kernel
    def take(s: source):
        s.found = s.key.x

    @ebb.kernel
    def scatter(s: source):
        s.key = s.other

    for _ in range(12):
        take(source)
    assert source.storage.order is None and target.storage.order is None
    scatter(source)
    for _ in range(12):
        take(source)
    assert source.storage.order is not None or target.storage.order is not None
    np.testing.assert_array_equal(source.found.to_numpy(), target.x.to_numpy()[source.key.to_numpy()])
