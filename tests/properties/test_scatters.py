"""Every way to reduce into other rows gives what the reference gives, whatever way the model would take.

Blocks have two rows here, so that the small worlds of these tests have some; floats are exact, so it is to the bit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ebb.backends.cpu import tiles
from ebb.compiler import lir
from ebb.compiler.scatter import choose
from ebb.compiler.scatter.choose import Way

from .programs import programs
from .test_backends import check_backends

QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck)}


class Forced:
    """What the planner takes: ``way`` wherever it can be taken; ``offered`` are the ways that it had."""

    def __init__(self) -> None:
        self.way = Way.IN_ORDER
        self.offered = set[Way]()
        self.taken = Counter[Way]()

    def __call__(self, times: Mapping[Way, float]) -> Way:
        self.offered.update(times)
        found = self.way if self.way in times else Way.IN_ORDER
        self.taken[found] += 1
        return found


@pytest.fixture
def forced(monkeypatch, tmp_path):
    """Makes the planner take each way wherever it can be taken, and sees to it that all were."""
    planner = Forced()
    monkeypatch.setattr(choose, "quickest", planner)
    monkeypatch.setattr(choose, "FEW_BLOCKS", 0)
    for module in (lir, tiles, choose):
        monkeypatch.setattr(module, "BLOCK_ROWS", 2)
    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("ebb.backends.cpu.backend._plans", lambda _: None)  # what is kept is not chosen
    yield planner
    assert min(planner.taken[way] for way in Way) > 20


@settings(max_examples=150, derandomize=True, **QUIET)
@given(data=st.data())
def test_every_way_gives_what_the_reference_gives(forced, data):
    program = data.draw(programs(40))
    forced.way, forced.offered = Way.IN_ORDER, {Way.IN_ORDER}
    check_backends(program)
    for way in Way:
        if way in forced.offered - {Way.IN_ORDER}:
            forced.way = way
            check_backends(program)
