"""Captured steps that are made whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import ebb


def run_whole(step: Any, count: int, lasting: Sequence[ebb.Field | ebb.Global]) -> None:
    """Run a captured step ``count`` times.

    If an assertion fails in one of the steps, everything is as it was after the step before it. That step is found by
    going back to the start and making the steps one by one, so a step must do the same again from the same.

    Args:
        step: what `ebb.capture` gave.
        count: how many.
        lasting: all that steps take from those before them. It is held twice while they run. If there is nothing, an
            error leaves things as it finds them.

    Raises:
        KernelAssertionError: an assertion has failed.
    """
    kept = [(each, each.to_numpy() if isinstance(each, ebb.Field) else each.value) for each in lasting]
    try:
        step.run(count)
    except ebb.KernelAssertionError:
        for each, values in kept:
            if isinstance(each, ebb.Field):
                each.load(values)
            else:
                each.value = values
        if kept and count > 1:
            for _ in range(count):
                run_whole(step, 1, lasting)
        raise
