"""The code of one kernel: compiled for each way in which its rows and its data have been met, and bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from ebb.backends.backend import Bound, Hints
from ebb.compiler import lir
from ebb.compiler.kir_key import KernelKey
from ebb.compiler.lower import Launched, lower
from ebb.compiler.lower.facts import Facts, FactSources, State
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


@record(eq=False)
class Draft:
    """A program before it is lowered, which takes most of the time of a kernel that is in the cache.

    Attributes:
        step: the kernel.
        lowering: how it becomes a program.
        sources: where the facts come from.
        state: those that hold.
        launched: how the rows are given.
        stores: whether what they write may stay in the cache.
    """

    step: Step
    lowering: Lowering
    sources: FactSources
    state: State
    launched: Launched
    stores: lir.Stores

    @property
    def name(self) -> str:
        """The name of the kernel."""
        return self.step.outline.name

    def lower(self) -> lir.Program:
        """The program: each time another one, but always the same text and the same sites."""
        return self.lowering.lower(self.step, self.sources.facts(self.state), self.launched, self.stores)

    def key(self) -> KernelKey:
        """The text of the kernel, which is all that the program depends on beside ``choices``."""
        return self.step.outline.key

    @property
    def choices(self) -> str:
        """What the program depends on beside the kernel. The facts are in the order of their sources in the kernel."""
        how = (self.lowering.precision, self.lowering.updates, self.launched, self.stores)
        return f"{[each.name for each in how]} {self.lowering.group_size} {self.state}"


class KernelCode(Generic[CodeT, BindingT]):
    """One kernel on one backend."""

    def __init__(
        self,
        step: Step,
        lowering: Lowering,
        load: Callable[[Draft], CodeT],
        attach: Callable[[Draft, CodeT, RowSet], BindingT],
    ) -> None:
        """A kernel of which nothing is compiled yet.

        Args:
            step: the kernel.
            lowering: how it becomes a program.
            load: compiles a program and loads it.
            attach: binds what is loaded to rows.
        """
        self._step = step
        self._lowering = lowering
        self._load = load
        self._attach = attach
        self._sources = step.outline.sources
        self._row_bytes = sum(field.type.size * field.type.dtype.itemsize for field in step.phases.fields)
        self._compiled: dict[tuple[Launched, lir.Stores, State], tuple[Draft, CodeT]] = {}
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
            draft, code = self._compile(launched_as(rows), self._stores(rows), state)
            binding = self._bindings[rows, state] = self._attach(draft, code, rows)
        return binding

    def program(self, rows: RowSet) -> lir.Program:
        """The program for a launch on ``rows`` and the data as they are."""
        return self._draft(launched_as(rows), self._stores(rows), self._sources.state()).lower()

    def _draft(self, launched: Launched, stores: lir.Stores, state: State) -> Draft:
        return Draft(self._step, self._lowering, self._sources, state, launched, stores)

    def _stores(self, rows: RowSet) -> lir.Stores:
        """Whether caches hold what a launch on ``rows`` goes through, so that the next one may find it there."""
        return lir.Stores.KEPT if rows.size * self._row_bytes < _MOST_CACHED else lir.Stores.STREAMED

    def _compile(self, launched: Launched, stores: lir.Stores, state: State) -> tuple[Draft, CodeT]:
        found = self._compiled.get((launched, stores, state))
        if found is None:
            draft = self._draft(launched, stores, state)
            with uncollected():
                found = self._compiled[launched, stores, state] = draft, self._load(draft)
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


def precision_of(hints: Hints) -> lir.Precision:
    """What the optimiser may do to floats."""
    return lir.Precision.FAST if hints.fastmath else lir.Precision.CONTRACT
