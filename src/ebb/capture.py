"""``ebb.capture``: a sequence of launches, swaps and sets of globals, recorded once and replayed without Python.

Inside the ``with`` statement everything is checked as a launch checks it, and taken down. A run makes sure that what
was taken down still fits the data, which it does unless the structure has changed, and hands it to the backend. Where
the backend cannot run it by itself, or the data do not allow it, the step is replayed launch by launch.
"""

from __future__ import annotations

import operator
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any, TypeAlias

import numpy as np

from ebb.backends.backend import Replay, RunKernel, SetGlobal, SwapFields
from ebb.backends.select import current_backend
from ebb.compiler.phases.order import InOrder
from ebb.errors import BackendError, EbbError, trimmed
from ebb.launch import Launch
from ebb.records import record
from ebb.relations.family import join
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.runtime.buffer import Array
from ebb.runtime.epoch import structure
from ebb.runtime.errors import BadRepeatCount, IndexInCapture
from ebb.runtime.heap import return_freed
from ebb.runtime.recording import recording, refuse
from ebb.runtime.threads import launching

MOST_PASSES = 32
"""How often the launches of a step are settled until none disturbs another; a few times more than they need."""


@record(eq=False)
class _Launched:
    """A recorded launch, with the values that its uniforms had."""

    launch: Launch
    uniforms: tuple[Any, ...]


_Recorded: TypeAlias = _Launched | SwapFields | SetGlobal


class Step:
    """What ``ebb.capture`` has recorded."""

    __slots__ = ("_changing", "_epoch", "_recorded", "_replay")

    def __init__(self) -> None:
        self._recorded: tuple[_Recorded, ...] = ()
        self._changing: frozenset[Field] = frozenset()
        self._epoch: object = None
        self._replay: Replay | None = None

    def run(self, n: int = 1) -> None:
        """Runs what was recorded ``n`` times, in the order in which it was recorded; on devices it is queued.

        The results are those of the launches themselves. Captured numbers and parameters have the values that they had
        when they were recorded; fields, globals and random numbers are what they are when the step runs.

        Args:
            n: how often, from 0 on.

        Raises:
            EbbError: a kernel failed for some row, and what comes after it has not run; a writable view of a field is
                open; ``n`` is no number of times; or a step is being captured.
        """
        try:
            count = _checked_count(n)
            refuse("running a captured step", "run it when the with statement is over")
            if count and self._recorded:
                with launching():
                    self._run(count)
        except EbbError as error:
            raise trimmed(error) from error.__cause__

    def __repr__(self) -> str:
        launches = sum(isinstance(each, _Launched) for each in self._recorded)
        return f"<captured step: {launches} launches, {len(self._recorded) - launches} swaps and sets of globals>"

    def _take(self, recorded: Sequence[_Recorded], changing: frozenset[Field]) -> None:
        self._recorded = tuple(recorded)
        self._changing = changing

    def _run(self, count: int) -> None:
        if self._epoch is not structure.epoch:
            self._prepare()
        if self._replay is None:
            self._replay_in_python(count)
            return
        try:
            self._replay.run(count)
        finally:
            for each in self._recorded:
                match each:
                    case _Launched(launch):
                        launch.note_changes()
                    case SwapFields(left, right):
                        left.rewritten()
                        right.rewritten()
                    case SetGlobal():
                        pass

    def _prepare(self) -> None:
        """Has the backend make a program of the step, if it can and the data allow it."""
        self._replay = None
        begins = self._epoch is None
        if begins:
            return_freed()  # that of making meshes and of compiling, before memory is taken for other layouts
        swaps = [each for each in self._recorded if isinstance(each, SwapFields)]
        for each in swaps:
            each.left.check_no_view()
            each.right.check_no_view()
            if each.left.type.shape:
                join(each.left, each.right)  # before the launches choose a layout, which is then that of both
        epoch, settled = self._settle()
        if settled and all([_are_alike(each.left, each.right) for each in swaps]):
            self._replay = current_backend().replay([self._bound(each) for each in self._recorded])
        self._epoch = epoch
        if begins:
            return_freed()  # that of the former layouts

    def _settle(self) -> tuple[object, bool]:
        """Settles the launches until none disturbs another; the epoch of that, and whether it came to it."""
        launches = list(dict.fromkeys([each.launch for each in self._recorded if isinstance(each, _Launched)]))
        settled_at: dict[Launch, object] = {}
        for _ in range(MOST_PASSES):
            epoch = structure.epoch
            for launch in launches:
                if settled_at.get(launch) is not epoch or not launch.is_decided:
                    settled_at[launch] = structure.epoch
                    launch.settle(self._changing)
            if structure.epoch is epoch and all([launch.is_decided for launch in launches]):
                return epoch, True
        return structure.epoch, False

    def _bound(self, each: _Recorded) -> RunKernel | SwapFields | SetGlobal:
        if isinstance(each, _Launched):
            return RunKernel(each.launch.bound, each.uniforms)
        return each

    def _replay_in_python(self, count: int) -> None:
        for _ in range(count):
            for each in self._recorded:
                match each:
                    case _Launched(launch, uniforms):
                        launch.run(uniforms)
                    case SwapFields(left, right):
                        left.check_no_view()
                        right.check_no_view()
                        left.swap_with(right)
                    case SetGlobal(globl, value):
                        globl.buffer.overwrite(value)


class _Recorder:
    """Takes down what the ``with`` statement does (``Recorder``)."""

    def __init__(self) -> None:
        self.recorded: list[_Recorded] = []
        self.changes: dict[Field, str] = {}
        self._queries: dict[Field, str] = {}

    def record_launch(self, launch: Launch, uniforms: Sequence[Any]) -> None:
        """Takes down a launch; arrays are copied, since the program may change them."""
        kernel = launch.specialisation.facts.outline
        if kernel.in_order is InOrder.PRINTS:
            refuse(f"a launch of kernel '{kernel.name}', which prints,", "launch it when the step has run")
        for field in launch.specialisation.written:
            if field.holds_keys:
                self.changes.setdefault(field, f"kernel '{kernel.name}'")
        for field in launch.specialisation.indexes:
            self._queries.setdefault(field, kernel.name)
        self._check_indexes()
        self.recorded.append(_Launched(launch, tuple([np.array(v) if np.ndim(v) else v for v in uniforms])))

    def record_swap(self, left: Field, right: Field) -> None:
        """Takes down that two fields exchange their values."""
        if left.holds_keys:
            for field in (left, right):
                self.changes.setdefault(field, f"the swap of {left.path} and {right.path}")
        self._check_indexes()
        self.recorded.append(SwapFields(left, right))

    def record_set(self, globl: Global, value: Array) -> None:
        """Takes down that a global is set."""
        self.recorded.append(SetGlobal(globl, value))

    def _check_indexes(self) -> None:
        """Raises where keys change by which rows are looked up: when the step runs nobody could rebuild the index."""
        for field, kernel in self._queries.items():
            if field in self.changes:
                raise BackendError(IndexInCapture(self.changes[field], field.path, kernel))


@contextmanager
def capture() -> Generator[Step, None, None]:
    """Records launches, swaps and sets of globals within a ``with`` statement, without running them.

    ``with ebb.capture() as step:`` is followed by ``step.run(n)``, which runs what was recorded ``n`` times with no
    Python in between. What the statement does beyond that, it does once, as it stands; whatever would look at fields or
    globals or change them otherwise is an error. If the statement ends with an exception, nothing is recorded.

    Raises:
        BackendError: what is done cannot be recorded.
    """
    refuse("beginning another capture", "record one step after the other, and run them in turn")
    step, recorder = Step(), _Recorder()
    with recording(recorder):
        yield step
    step._take(recorder.recorded, frozenset(recorder.changes))  # pyright: ignore[reportPrivateUsage]


def _are_alike(left: Field, right: Field) -> bool:
    """Whether code for one of the fields does for the other: otherwise a swap calls for other code."""
    return left.buffer.layout is right.buffer.layout and left.maybe_unset == right.maybe_unset


def _checked_count(n: Any) -> int:
    try:
        count = operator.index(n)
    except TypeError:
        count = -1
    if count < 0 or isinstance(n, bool):
        raise BackendError(BadRepeatCount(n))
    return count
