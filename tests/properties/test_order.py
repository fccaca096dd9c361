"""A kernel that the phase checker accepts gives the same bits whatever the order of its rows."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.table import PhaseKind

from .programs import accepted, interpret, orders, programs
from .worlds import difference

QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck)}


def check_orders(program):
    kernel = accepted(program)
    assume(kernel is not None)
    first, second = orders(program)
    assert difference(interpret(program, kernel, first), interpret(program, kernel, second)) is None


# Hypothesis counts the examples that ``assume`` lets pass, so that these are 2,000 accepted kernels.
@pytest.mark.parametrize("salt", range(4))
@settings(max_examples=500, derandomize=True, **QUIET)
@given(data=st.data())
def test_rows_of_an_accepted_kernel_run_in_any_order(salt, data):
    check_orders(data.draw(programs(salt)))


@pytest.mark.slow
@settings(max_examples=5_000, **QUIET)
@given(program=programs())
def test_rows_of_many_accepted_kernels_run_in_any_order(program):
    check_orders(program)


def test_random_kernels_reach_what_they_are_for():
    """The property says nothing of kernels that are not accepted, and little of those that touch their own row only."""
    tables = []

    @settings(max_examples=200, derandomize=True, database=None, **QUIET)
    @given(program=programs(salt=5))
    def collect(program):
        kernel = accepted(program)
        tables.append(None if kernel is None else check_phases(kernel))

    collect()
    taken = [table for table in tables if table is not None]
    reducing = [t for t in taken if any(phase.kind is PhaseKind.REDUCE for phase in t.fields.values())]
    querying = [t for t in taken if any(phase.queried for phase in t.fields.values())]
    assert 0.4 < len(taken) / len(tables) < 0.95
    assert len(reducing) > 0.3 * len(taken)
    assert len(querying) > 0.3 * len(taken)
