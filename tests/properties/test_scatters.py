"""Every way to reduce into other rows gives what the reference gives, whatever way the model would take.

Blocks have two rows here, so that the small worlds of these tests have some; floats are exact, so it is to the bit.
"""

from __future__ import annotations

from collections import Counter

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


@pytest.fixture(params=Way, ids=lambda way: way.value)
def way(request, monkeypatch, tmp_path):
    """Makes the planner take this way wherever it can be taken, and sees to it that it was."""
    taken = Counter()

    def forced(times):
        found = request.param if request.param in times else Way.IN_ORDER
        taken[found] += 1
        return found

    monkeypatch.setattr(choose, "quickest", forced)
    monkeypatch.setattr(choose, "FEW_BLOCKS", 0)
    for module in (lir, tiles, choose):
        monkeypatch.setattr(module, "BLOCK_ROWS", 2)
    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path))
    yield request.param
    assert taken[request.param] > 20


@settings(max_examples=150, derandomize=True, **QUIET)
@given(data=st.data())
def test_every_way_gives_what_the_reference_gives(way, data):
    check_backends(data.draw(programs(40)))
