"""Garbage is not collected while kernels are compiled, and is afterwards."""

from __future__ import annotations

import gc

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
