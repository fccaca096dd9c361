"""Whether this thread records a step (``ebb.capture``), and what may not be done meanwhile.

What a program may do inside a capture is handed to the recorder of its thread; everything else that would look at data
or change it calls ``refuse``, since it would be done once, now, and not when the step runs.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from threading import get_ident
from typing import Any, Protocol

from ebb.errors import BackendError
from ebb.runtime.buffer import Array
from ebb.runtime.epoch import structure_changed
from ebb.runtime.errors import HostStepInCapture
from ebb.runtime.threads import launching


class Recorder(Protocol):
    """What takes down the launches, swaps and sets of globals of a step; fields and globals by what they are."""

    def record_launch(self, launch: Any, uniforms: Sequence[Any]) -> None:
        """Takes down a launch with the values of its uniforms."""
        ...

    def record_swap(self, left: Any, right: Any) -> None:
        """Takes down that two fields exchange their values."""
        ...

    def record_set(self, globl: Any, value: Array) -> None:
        """Takes down that a global is set."""
        ...


_recorders: dict[int, Recorder] = {}
"""The recorder of each thread that records."""


def recorder() -> Recorder | None:
    """What records the step of this thread, or None."""
    return _recorders.get(get_ident()) if _recorders else None


def anyone_records() -> bool:
    """Whether some thread records: launches then go the long way, on which they ask whether it is theirs."""
    return bool(_recorders)


def refuse(action: str, instead: str) -> None:
    """Raises while this thread records a step.

    Args:
        action: what the program does, as the subject of a sentence: "loading vertices.pos".
        instead: what to do.

    Raises:
        BackendError: this thread records.
    """
    if recorder() is not None:
        raise BackendError(HostStepInCapture(action, instead))


@contextmanager
def recording(by: Recorder) -> Generator[None, None, None]:
    """Hands to ``by`` what this thread does within a ``with`` statement."""
    thread = get_ident()  # now: a generator that is abandoned within is closed by any thread
    try:
        with launching():
            _recorders[thread] = by
            structure_changed()  # so that every launch goes the long way
        yield
    finally:
        _recorders.pop(thread, None)


@contextmanager
def suspended() -> Generator[None, None, None]:
    """Within a ``with`` statement this thread does not record: what the runtime does is its own affair."""
    found = _recorders.pop(get_ident(), None)
    try:
        yield
    finally:
        if found is not None:
            _recorders[get_ident()] = found
