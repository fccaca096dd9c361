"""The machine code of one kernel: compiled for each way in which its rows and its data have been met, and bound."""

from __future__ import annotations

from collections.abc import Sequence

from ebb.backends.binding import Binding
from ebb.backends.cache import ObjectCache
from ebb.backends.compile import object_code
from ebb.backends.target import host
from ebb.compiler import lir
from ebb.compiler.lower import Launched, lower, sources_of
from ebb.compiler.lower.facts import State
from ebb.compiler.scatter.step import Step
from ebb.compiler.scatter.waves import Waves
from ebb.records import record
from ebb.relations.subset import RowSet
from ebb.runtime import random
from ebb.runtime.cpu import CpuCode, CpuDevice


class KernelCode:
    """One kernel on the processor."""

    def __init__(
        self, step: Step, precision: lir.Precision, updates: lir.Updates, device: CpuDevice, cache: ObjectCache
    ) -> None:
        self._step = step
        self._precision = precision
        self._updates = updates
        self._device = device
        self._cache = cache
        self._sources = sources_of(step.kernel)
        self._compiled: dict[tuple[Launched, State], tuple[lir.Program, CpuCode]] = {}
        self._bindings: dict[tuple[RowSet, State], Binding] = {}

    def bind(self, rows: RowSet, waves: Waves | None) -> Binding:
        """The code for the data as it is, bound to ``rows``: compiled, where it is met so for the first time.

        Args:
            rows: what it runs on, at least one row. The groupings that the kernel queries are valid.
            waves: which blocks may run at once; None for all.

        Raises:
            BackendError: the code cannot be compiled.
        """
        state = self._sources.state()
        binding = self._bindings.get((rows, state))
        if binding is None:
            program, code = self._compile(launched_as(rows), state)
            binding = self._bindings[rows, state] = Binding(self._step.kernel, program, code, self._device, rows)
        binding.settle(waves)
        return binding

    def program(self, launched: Launched) -> lir.Program:
        """The program for the data as it is."""
        return self._lower(launched, self._sources.state())

    def _compile(self, launched: Launched, state: State) -> tuple[lir.Program, CpuCode]:
        found = self._compiled.get((launched, state))
        if found is None:
            program = self._lower(launched, state)
            code = self._device.load(program.name, object_code(program, host(), self._cache))
            found = self._compiled[launched, state] = program, code
        return found

    def _lower(self, launched: Launched, state: State) -> lir.Program:
        step = self._step
        facts = self._sources.facts(state)
        return lower(step.kernel, step.phases, step.unchecked, facts, launched, self._precision, self._updates)


class Bindings:
    """Kernels that run one after the other in the place of one.

    Attributes:
        bindings: the bound kernels.
    """

    __slots__ = ("bindings",)

    def __init__(self, bindings: Sequence[Binding]) -> None:
        self.bindings = tuple(bindings)

    def run(self, uniforms: Sequence[object]) -> None:
        """Runs them all; the first that fails is the last to run.

        Raises:
            EbbError: an assertion or a check of one of the kernels failed for some row.
        """
        for binding in self.bindings:
            binding.run(uniforms)


@record
class NoRows:
    """A launch on no rows at all: nothing is run, but a launch that would draw random numbers counts."""

    draws: bool

    def run(self, uniforms: Sequence[object]) -> None:
        """Counts the launch."""
        del uniforms
        if self.draws:
            random.next_launch()


def launched_as(rows: RowSet) -> Launched:
    """How the rows of a launch on ``rows`` are given."""
    if rows.boxes is not None:
        return Launched.BOXES
    return Launched.ALL if rows.row_positions() is None else Launched.LISTED
