from __future__ import annotations

import os

import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st

import ebb
from ebb.compiler.kir_verify import verify_kernel
from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.stencil import check_stencil, collect_stencil
from ebb.compiler.pipeline import PASSES, run_passes
from .programs import Program, defined, elaborated, interpret, orders, programs
from .worlds import difference

QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck)}


def accepted(program: Program):
    """The kernel, where the compiler takes it; the example is dropped where it does not, by an ``EbbError`` alone."""
    try:
        kernel = elaborated(program)
        check_phases(kernel)
        check_stencil(kernel, collect_stencil(kernel), program.relation)
    except ebb.EbbError as error:
        assert str(error).startswith("error[E")
        assume(False)
        raise
    return kernel


@given(programs(), st.integers(0, 2**32 - 1))
@settings(max_examples=2000, **QUIET)
def test_rows_of_an_accepted_kernel_run_in_any_order(program, seed):
    kernel = accepted(program)
    first, second = orders(program, seed)
    assert difference(interpret(program, kernel, first), interpret(program, kernel, second)) is None
