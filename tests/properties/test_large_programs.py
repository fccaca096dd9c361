"""Kernels on thousands of rows leave what NumPy says, in all the ways in which the processor runs rows and turns."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ebb
from ebb.backends import kernel_code
from ebb.backends.llvm import block, lines, statements

from .large_forms import Groups, Lines, Places, Rows

QUIET = {"deadline": None, "suppress_health_check": list(HealthCheck)}

ROUNDINGS = 100
"""So many roundings of its size a value may be off."""

SMALL = 50
"""Programs of up to so many rows run on the reference, too."""

EXAMPLES = st.binary(min_size=8, max_size=8)

PLANNERS = {
    "strips of rows": (block, "plan_rows"),
    "runs": (block, "plan_runs"),
    "rare": (block, "plan_rare"),
    "registers": (lines, "plan_registers"),
    "strips of turns": (statements, "plan_strips"),
}


def values_of(place):
    return place.data.copy() if isinstance(place, ebb.Global) else place.to_numpy()


def outcome(program, kernel, backend, options):
    """What all places hold after a launch from the start, and the failure."""
    before = {place: values_of(place) for place in program.expected}
    message = None
    with ebb.backend(backend, **options):
        try:
            kernel(program.rows)
        except ebb.KernelAssertionError as error:
            message = str(error)
    found = {place: values_of(place) for place in program.expected}
    for place, values in before.items():
        if isinstance(place, ebb.Global):
            place.value = values
        else:
            place.load(values)
    return found, message


def check(program):
    ways = [("cpu", {"threads": 1}), ("cpu", {"threads": 3})]
    if program.relation.size <= SMALL:
        ways.append(("reference", {}))
    with program.defined() as kernel:
        for backend, options in ways:
            found, message = outcome(program, kernel, backend, options)
            if program.fails is not None:
                assert message is not None, "no row failed"
                assert re.search(re.escape(first_failure(program)), message), message
                continue
            assert message is None, message
            for place, value in program.expected.items():
                compare(program, place, found[place].reshape(value.of.shape), value)


def first_failure(program):
    index = np.unravel_index(program.fails, program.relation.shape)
    return f"{program.relation.name}[{', '.join(map(str, index))}]"


def compare(program, place, found, value):
    name = "total" if isinstance(place, ebb.Global) else place.path
    if found.dtype.kind == "i":
        np.testing.assert_array_equal(found, value.of, err_msg=name)
        return
    error, allowed = np.abs(found - value.of), ROUNDINGS * program.epsilon * (value.size + 1)
    bad = np.argwhere(~(error <= allowed))
    if bad.size:
        at = tuple(bad[0])
        raise AssertionError(f"{name} at {at} is {found[at]}, not {value.of[at]} +- {allowed[at]}")


def program_of(form, data):
    mask, seed = (int.from_bytes(data[at : at + 4], "big") for at in (0, 4))
    return form(seed, mask | mask >> 16).program()


@pytest.fixture
def taken(monkeypatch, tmp_path):
    """How often loops have been planned in each way."""
    counts = Counter()

    def counted(way, plan):
        def planned(*arguments):
            found = plan(*arguments)
            counts[way] += found is not None
            return found

        return planned

    for way, (module, name) in PLANNERS.items():
        monkeypatch.setattr(module, name, counted(way, getattr(module, name)))
    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path))
    return counts


CASES = [
    (Lines, False, 10, ()),
    (Lines, True, 10, ("registers",)),
    (Rows, False, 20, ("strips of rows", "runs")),
    (Places, False, 20, ("rare",)),
    (Groups, False, 14, ("strips of turns",)),
]


@pytest.mark.parametrize(("form", "streams", "examples", "ways"), CASES)
def test_rows_by_the_thousand(form, streams, examples, ways, taken, monkeypatch):
    if streams:
        monkeypatch.setattr(kernel_code, "_MOST_CACHED", 0)

    @settings(max_examples=examples, derandomize=True, **QUIET)
    @given(data=EXAMPLES)
    def run(data):
        check(program_of(form, data))

    run()
    assert all(taken[way] > 1 for way in ways), taken


@pytest.mark.slow
@pytest.mark.parametrize("streams", [False, True], ids=["kept", "streamed"])
@pytest.mark.parametrize("form", [Lines, Rows, Places, Groups])
@settings(max_examples=100, **QUIET)
@given(data=EXAMPLES)
def test_many_kernels_on_rows_by_the_thousand(form, streams, data):
    with pytest.MonkeyPatch.context() as patch:
        if streams:
            patch.setattr(kernel_code, "_MOST_CACHED", 0)
        check(program_of(form, data))
