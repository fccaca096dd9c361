"""A module a system: ``PROGRAMS`` maps the name of a code to what prepares it, ``version()`` says which one runs.

A worker imports one of them in a process of its own, after it has set the environment variables of
``registry.environment``, which say how many threads there are and where compiled code is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from benchmarks.data import Arrays


@dataclass(frozen=True, slots=True)
class Prepared:
    """A program with its data: ``run(n)`` makes n steps and waits for them, ``outputs()`` are the results so far."""

    run: Callable[[int], None]
    outputs: Callable[[], Arrays]


Programs = Mapping[str, Callable[[Arrays], Prepared]]
