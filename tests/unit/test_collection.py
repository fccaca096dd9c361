"""Garbage is not collected while kernels are compiled, and is afterwards."""

from __future__ import annotations

import gc
import weakref

import pytest

import ebb
from ebb.runtime.collection import uncollected


def test_the_collector_is_as_it_was_afterwards():
    with uncollected():
        assert not gc.isenabled()
        with uncollected():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(ZeroDivisionError), uncollected():
        _ = 1 / 0
    assert gc.isenabled()
    gc.disable()
    try:
        with uncollected():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


class Ring:
    def __init__(self) -> None:
        self.itself = self


def test_what_a_block_made_is_old_and_collected_at_last():
    with uncollected():
        kept = Ring()
    assert any(each is kept for each in gc.get_objects(generation=2))
    assert not any(each is kept for each in gc.get_objects(generation=0))
    with uncollected():
        gone = weakref.ref(Ring())
    assert gone() is not None
    for _ in range(128):
        with uncollected():
            pass
    assert gone() is None


def test_what_a_program_set_apart_stays_apart():
    gc.freeze()
    try:
        apart = gc.get_freeze_count()
        with uncollected():
            pass
        assert 0 < gc.get_freeze_count() <= apart
    finally:
        gc.unfreeze()


def test_a_launch_leaves_the_collector_on():
    things = ebb.Relation("things", size=3)
    things.new_field("x", ebb.float64, init=1.0)

    @ebb.kernel
    def grow(t: things):
        t.x = ebb.sqrt(t.x) + 1

    @ebb.kernel
    def fall(t: things):
        t.x = t.y

    grow(things)
    assert gc.isenabled()
    with pytest.raises(ebb.KernelTypeError):
        fall(things)
    assert gc.isenabled()
