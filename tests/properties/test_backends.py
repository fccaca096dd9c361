"""Compiled backends give what the reference interpreter gives: floats are exact here, so to the bit."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import ebb
from backends import require, runnable
from ebb.relations.family import family_of
from ebb.runtime.buffer import Layout

from .programs import defined, programs
from .worlds import difference

QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck)}


def run_on(program, kernel, backend, **options):
    """What all places hold after a launch, and the codes of the error that it raised."""
    program.world.restore()
    codes = ()
    with ebb.backend(backend, **options):
        try:
            kernel(program.relation)
        except ebb.EbbError as error:
            codes = error.codes
    return program.world.state(), codes


@contextmanager
def taken(program):
    """The kernel of the program; programs that the compiler refuses do not count."""
    with defined(program) as kernel:
        try:
            kernel.check(program.relation)
        except ebb.EbbError:
            assume(False)
        yield kernel


CPU = (("cpu", {"threads": 1}), ("cpu", {"threads": 3}))
OPENCL = (("opencl", {}), ("opencl", {"deterministic": True}))


def check_backends(program, backends=CPU):
    with taken(program) as kernel:
        expected, failure = run_on(program, kernel, "reference")
        for backend, options in backends:
            found, codes = run_on(program, kernel, backend, **options)
            assert codes == failure
            if not failure:
                assert difference(expected, found) is None


@pytest.mark.parametrize("salt", range(2))
@settings(max_examples=100, derandomize=True, **QUIET)
@given(data=st.data())
def test_cpu_is_the_reference(salt, data):
    check_backends(data.draw(programs(20 + salt)))


@pytest.fixture
def opencl():
    require("opencl")


@settings(max_examples=60, derandomize=True, **QUIET)
@given(data=st.data())
def test_opencl_is_the_reference(opencl, data):
    check_backends(data.draw(programs(25)), OPENCL)


@settings(max_examples=30, derandomize=True, **QUIET)
@given(data=st.data())
def test_opencl_takes_rows_in_any_order(opencl, data):
    program = data.draw(programs(35))
    random = np.random.default_rng(program.seed)
    with taken(program) as kernel:
        expected, failure = run_on(program, kernel, "reference")
        for name in ("nodes", "links"):
            relation = program.world.relations[name]
            relation.permute(random.permutation(relation.size))
        for _, options in OPENCL:
            found, codes = run_on(program, kernel, "opencl", **options)
            assert bool(codes) == bool(failure)  # of several failures another may come first
            if not failure:
                assert difference(expected, found) is None


@pytest.mark.slow
@settings(max_examples=500, **QUIET)
@given(program=programs())
def test_cpu_is_the_reference_on_many_kernels(program):
    check_backends(program)


@pytest.mark.slow
@settings(max_examples=500, **QUIET)
@given(program=programs())
def test_opencl_is_the_reference_on_many_kernels(opencl, program):
    check_backends(program, OPENCL)


@settings(max_examples=50, derandomize=True, **QUIET)
@given(data=st.data())
def test_no_layout_changes_anything(data):
    program = data.draw(programs(30))
    shaped = [field for field in program.world.fields if field.type.size > 1]
    layouts = [data.draw(st.sampled_from(Layout)) for _ in shaped]
    with taken(program) as kernel:
        expected = run_on(program, kernel, "cpu")
        for field, layout in zip(shaped, layouts, strict=True):
            family_of(field).layout = layout
            family_of(field).convert(field)
        for backend in runnable():
            found, codes = run_on(program, kernel, backend)
            assert codes == expected[1]
            if not codes:
                assert difference(expected[0], found) is None
