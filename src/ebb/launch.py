"""What becomes of a kernel once it is checked: specialisations, and their launches on sets of rows.

A repeated launch takes the fast path: while the structure epoch is the one at which it was settled, it evaluates its
uniforms and runs what is bound. Otherwise it settles first, which may take its time.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Any

from ebb.backends.backend import ANYWHERE, Backend, Bound, CheckedKernel, Executable, How, Once
from ebb.backends.select import current_backend
from ebb.compiler.arguments import uniform_values
from ebb.compiler.elaborate.guards import Guard
from ebb.compiler.elaborate.parameters import ParameterType
from ebb.compiler.facts import LaunchFacts
from ebb.compiler.inputs import Inputs
from ebb.compiler.phases.stencil import check_stencil, collect_stencil, stays_inside
from ebb.records import field, record
from ebb.relations.field import Field
from ebb.relations.layout import consider_layout, may_convert
from ebb.relations.ordering import consider_order, may_reorder
from ebb.relations.reach import Pace
from ebb.relations.subset import RowSet
from ebb.runtime.epoch import structure
from ebb.runtime.recording import anyone_records, recorder, suspended
from ebb.runtime.threads import launching

SETTLING_RUNS = 8
"""The first runs of a launch all settle, if there is a choice: by then storage order and layout have been decided."""


@record(frozen=False, eq=False)
class Specialisation:
    """A kernel for one relation and one set of parameter types, as long as its guards hold."""

    checked: CheckedKernel
    facts: LaunchFacts
    guards: tuple[Guard, ...]
    types: tuple[ParameterType, ...]
    inputs: Inputs
    executables: dict[Backend, Executable] = field(default_factory=dict[Backend, Executable])

    def holds(self, parameters: tuple[Any, ...]) -> bool:
        """Whether the captured names still are what this was made for."""
        return all([guard.holds(parameters) for guard in self.guards])

    def uniforms(self, parameters: tuple[Any, ...]) -> tuple[Any, ...]:
        """The values of the uniforms, evaluated the long way.

        Raises:
            KernelTypeError: a captured name or an operation has no value, or one that does not fit.
        """
        kernel = self.facts.outline
        return uniform_values(kernel.name, kernel.uniforms, parameters)

    @property
    def indexes(self) -> tuple[Field, ...]:
        """The grouped key fields whose index the kernel uses."""
        return tuple([field for field, phase in self.facts.phases.fields.items() if phase.queried])

    @property
    def written(self) -> tuple[Field, ...]:
        """The fields that the kernel may change."""
        return tuple([field for field, phase in self.facts.phases.fields.items() if phase.changed])

    def pace(self) -> Pace:
        """How the kernel goes over its rows."""
        return self.facts.pace

    def check_rows(self, rows: RowSet) -> None:
        """Checks that no access leaves its grid when the kernel runs on ``rows``.

        Raises:
            BoundsError: some do; all of them are reported.
        """
        if not stays_inside(self.facts.moves, rows):
            kernel = self.checked.kernel
            check_stencil(kernel, collect_stencil(kernel), rows)

    def refresh(self) -> None:
        """Makes the groupings that the kernel queries valid."""
        for index in self.indexes:
            assert index.grouping is not None, f"{index.path} is queried, so that it is grouped"
            index.grouping.refresh()

    def executable(self, backend: Backend) -> Executable:
        """This specialisation, ready to run on ``backend``."""
        executable = self.executables.get(backend)
        if executable is None:
            executable = self.executables[backend] = backend.prepare(self.checked)
        return executable


class Launch:
    """A specialisation on a set of rows for which its stencil has been checked."""

    __slots__ = (
        "_bound",
        "_chooses",
        "_epoch",
        "_runs",
        "_set_keys",
        "_written_keys",
        "_written_values",
        "rows",
        "specialisation",
        "take",
    )

    def __init__(self, specialisation: Specialisation, rows: RowSet) -> None:
        self.specialisation = specialisation
        self.rows = rows
        self.take = specialisation.inputs.take
        self._written_values = [each for each in specialisation.written if not each.holds_keys]
        self._written_keys = [each for each in specialisation.written if each.holds_keys]
        self._set_keys = self._keys_set()
        self._chooses = may_reorder(rows, specialisation.facts.reaches) or may_convert(specialisation.facts.reaches)
        self._bound: Bound | None = None
        self._epoch: object = None
        self._runs = 0

    def run(self, uniforms: Sequence[Any]) -> None:
        """Runs the kernel once, on the current backend. Launches from several Python threads wait for one another.

        Args:
            uniforms: their values, of ``take``, which gives None where it cannot, or of the specialisation.

        Raises:
            EbbError: the data does not allow it, or the kernel failed for some row.
        """
        with launching():
            bound = self._bound
            if bound is None or self._epoch is not structure.epoch:
                bound = self._settle_or_record(uniforms)
                if bound is None:
                    return
            try:
                bound.run(uniforms)
            finally:
                self.note_changes()
            for keys in self._set_keys:
                keys.all_set()

    @property
    def bound(self) -> Bound:
        """What ``settle`` has bound."""
        assert self._bound is not None, "the launch has been settled"
        return self._bound

    def note_changes(self) -> None:
        """Says that the kernel has written its fields."""
        for values in self._written_values:
            values.version += 1
        for keys in self._written_keys:
            keys.rewritten()

    def _keys_set(self) -> list[Field]:
        """The key fields of which no key is unset any more once the kernel has run for all of its rows."""
        return [] if self.rows.size < self.rows.relation.size else list(self.specialisation.facts.sets)

    def _settle_or_record(self, uniforms: Sequence[Any]) -> Bound | None:
        """What to run, or None where the launch was taken down for a step instead."""
        by = recorder()
        if by is None:
            return self.settle()
        with suspended():
            self.settle()
        self._epoch = None  # the next launch comes here too
        by.record_launch(self, uniforms)
        return None

    def how(self) -> How:
        """How the launch goes on the current backend, for the data as it is."""
        with launching(), suspended():
            self.specialisation.refresh()
            return self.specialisation.executable(current_backend()).how(self.rows)

    def inspect(self, stage: str) -> str | None:
        """The text of a stage that the current backend, or any, has beyond KIR; None for what is no stage."""
        specialisation = self.specialisation
        with launching(), suspended():
            specialisation.refresh()
            text = specialisation.executable(current_backend()).inspect(stage)
            if text is not None or stage not in ANYWHERE:
                return text
            from ebb.backends.devices.stages import text_without_device  # here: few programs ask for it

            return text_without_device(specialisation.checked, stage)

    @property
    def is_decided(self) -> bool:
        """Whether order and layout are decided, and what is bound is good for more than one run."""
        return (not self._chooses or self._runs >= SETTLING_RUNS) and not isinstance(self._bound, Once)

    def settle(self, changing: AbstractSet[Field] = frozenset()) -> Bound:
        """Looks at all that the launch relies on besides values, and binds the code to it. Holds ``launching()``.

        Args:
            changing: key fields whose values may be others when the code runs; the kernel queries none of them.

        Raises:
            RelationError: a writable view of a field that the kernel uses is open.
            BackendError: the backend cannot compile the kernel.
        """
        # Taken first: what changes while this looks, also by its own doing, is looked at again before the next run.
        epoch = structure.epoch
        specialisation = self.specialisation
        backend = current_backend()
        if backend.reorders:
            consider_order(self.rows, specialisation.facts.reaches, self._runs, changing)
        consider_layout(self.rows, specialisation.facts.reaches, specialisation.pace, self._runs)
        specialisation.refresh()
        for used in specialisation.facts.phases.fields:
            used.check_no_view()
        bound = specialisation.executable(backend).bind(self.rows, changing)
        self._runs += 1
        self._bound = bound
        fast = self.is_decided and not changing and not anyone_records()
        self._epoch = epoch if fast else None
        return bound
