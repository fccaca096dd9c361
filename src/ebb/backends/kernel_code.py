"""The code of one kernel: compiled for each way in which its rows and its data have been met, and bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from ebb.backends.backend import Bound, CheckedKernel, Hints
from ebb.compiler import lir
from ebb.compiler.lower import Launched, lower, sources_of
from ebb.compiler.lower.facts import Facts, State
from ebb.compiler.scatter.step import Step
from ebb.records import record
from ebb.relations.subset import RowSet
from ebb.runtime import random
from ebb.runtime.collection import uncollected

CodeT = TypeVar("CodeT")
"""What a program is compiled to and loaded as."""

BindingT = TypeVar("BindingT", bound=Bound)
"""Code with what it takes, on one set of rows."""

_MOST_CACHED = 32 << 20
"""The most bytes that a launch goes through for which stores wait in the cache for who reads them."""


@record
class Lowering:
    """How kernels become programs.

    Attributes:
        precision: what the optimiser may do to floats.
        updates: how rows reduce into other rows.
        group_size: the threads of a work-group, None on the processor.
    """

    precision: lir.Precision
    updates: lir.Updates
    group_size: int | None = None

    def lower(self, step: Step, facts: Facts, launched: Launched, stores: lir.Stores = lir.Stores.KEPT) -> lir.Program:
        """The program of ``step`` for data of which ``facts`` hold and rows that are given as ``launched``."""
        return lower(
            step.kernel, step.phases, step.unchecked, facts, launched,
            self.precision, self.updates, self.group_size, stores,
        )  # fmt: skip


class KernelCode(Generic[CodeT, BindingT]):
    """One kernel on one backend."""

    def __init__(
        self,
        step: Step,
        lowering: Lowering,
        load: Callable[[lir.Program], CodeT],
        attach: Callable[[Step, lir.Program, CodeT, RowSet], BindingT],
    ) -> None:
        """A kernel of which nothing is compiled yet.

        Args:
            step: the kernel.
            lowering: how it becomes a program.
            load: compiles a program and loads it.
            attach: binds it to rows.
        """
        self._step = step
        self._lowering = lowering
        self._load = load
        self._attach = attach
        self._sources = sources_of(step.kernel)
        self._row_bytes = sum(field.type.size * field.type.dtype.itemsize for field in step.phases.fields)
        self._compiled: dict[tuple[Launched, lir.Stores, State], tuple[lir.Program, CodeT]] = {}
        self._bindings: dict[tuple[RowSet, State], BindingT] = {}

    def bind(self, rows: RowSet) -> BindingT:
        """The code for the data as it is, bound to ``rows``: compiled, where it is met so for the first time.

        Args:
            rows: what it runs on, at least one row. The groupings that the kernel queries are valid.

        Raises:
            BackendError: the code cannot be compiled.
        """
        state = self._sources.state()
        binding = self._bindings.get((rows, state))
        if binding is None:
            program, code = self._compile(launched_as(rows), self._stores(rows), state)
            binding = self._bindings[rows, state] = self._attach(self._step, program, code, rows)
        return binding

    def program(self, rows: RowSet) -> lir.Program:
        """The program for a launch on ``rows`` and the data as they are."""
        facts = self._sources.facts(self._sources.state())
        return self._lowering.lower(self._step, facts, launched_as(rows), self._stores(rows))

    def _stores(self, rows: RowSet) -> lir.Stores:
        """Whether caches hold what a launch on ``rows`` goes through, so that the next one may find it there."""
        return lir.Stores.KEPT if rows.size * self._row_bytes < _MOST_CACHED else lir.Stores.STREAMED

    def _compile(self, launched: Launched, stores: lir.Stores, state: State) -> tuple[lir.Program, CodeT]:
        found = self._compiled.get((launched, stores, state))
        if found is None:
            with uncollected():
                program = self._lowering.lower(self._step, self._sources.facts(state), launched, stores)
                found = self._compiled[launched, stores, state] = program, self._load(program)
        return found


class Bindings:
    """Kernels that run one after the other in the place of one.

    Attributes:
        bindings: the bound kernels.
    """

    __slots__ = ("bindings",)

    def __init__(self, bindings: Sequence[Bound]) -> None:
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


def step_of(checked: CheckedKernel) -> Step:
    """The kernel as it was written, in one step."""
    return Step(checked.kernel, checked.phases, tuple(access.node for access in checked.stencil))


def precision_of(hints: Hints) -> lir.Precision:
    """What the optimiser may do to floats."""
    return lir.Precision.FAST if hints.fastmath else lir.Precision.CONTRACT
