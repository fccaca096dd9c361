"""The examples on every backend, and while the backend changes: before every step, and before every launch."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache

import numpy as np
import pytest

import ebb
from backends import lacking, runnable
from ebb.runtime.recording import recorder
from example_runs import EXAMPLES, Example

STEPS = 9
TURNS = ("cpu", "opencl", "reference", "opencl", "cpu", "reference")
"""Each backend is followed by each of the others."""


TOLERANCES = {"spring_mass": 1e-4, "heat": 1e-11}  # of the others 1e-5


@contextmanager
def changing(backends: Sequence[str], each: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """Gives what to call before every step, so that ``backends`` take turns, step by step or launch by launch."""
    turns = itertools.cycle(backends)
    with ebb.backend(next(turns)), monkeypatch.context() as patch:
        if each == "step":
            yield lambda: ebb.set_backend(next(turns))
            return
        launch = ebb.Kernel.__call__

        def turn_and_launch(*arguments: object, **named: object) -> None:
            if recorder() is None:  # a step that is captured runs wherever the launch before it did
                ebb.set_backend(next(turns))
            launch(*arguments, **named)

        patch.setattr(ebb.Kernel, "__call__", turn_and_launch)
        yield lambda: None


def run(make: Callable[[], Example], backends: Sequence[str], each: str, monkeypatch: pytest.MonkeyPatch) -> list:
    """What the example printed, then all that its relations hold."""
    with changing(backends, each, monkeypatch) as before_step:
        step, relations = make()
        printed = []
        for number in range(STEPS):
            before_step()
            printed.append(step(number))
    return [np.array(printed), *(field.to_numpy() for relation in relations for field in relation.fields.values())]


@cache
def on_cpu(example: str) -> list:
    """What the example gives on cpu; tests look at it only."""
    with pytest.MonkeyPatch.context() as patch:
        return run(EXAMPLES[example], ("cpu",), "step", patch)


@pytest.mark.parametrize(
    ("backends", "each"),
    [(("reference",), "step"), (("opencl",), "step"), (TURNS, "step"), (TURNS, "launch")],
    ids=["reference", "opencl", "a turn a step", "a turn a launch"],
)
@pytest.mark.parametrize("example", EXAMPLES)
def test_every_backend_gives_what_cpu_gives(example, backends, each, monkeypatch) -> None:
    if not runnable(*backends):
        pytest.skip(lacking(*backends))
    tolerance, results = TOLERANCES.get(example, 1e-5), run(EXAMPLES[example], runnable(*backends), each, monkeypatch)
    for found, value in zip(results, on_cpu(example), strict=True):
        if value.dtype.kind == "f":
            np.testing.assert_allclose(found, value, rtol=tolerance, atol=tolerance * max(1, np.abs(value).max()))
        else:
            np.testing.assert_array_equal(found, value)
