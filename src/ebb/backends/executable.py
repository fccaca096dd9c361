"""A kernel on a backend that compiles: what the processor and the devices have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from typing import Generic

from ebb.backends.backend import Bound, CheckedKernel, How, Once
from ebb.backends.compile import MOST_PRIVATE_BYTES, check_private_bytes, stage_text, stages_of
from ebb.backends.kernel_code import Bindings, BindingT, CodeT, Draft, KernelCode, Lowering, NoRows
from ebb.backends.target import Target
from ebb.compiler.lower import variable_bytes
from ebb.compiler.scatter.choose import Plan, Planner, Run
from ebb.compiler.scatter.kept_plans import PlanStore
from ebb.compiler.scatter.step import Step
from ebb.relations.field import Field
from ebb.relations.subset import RowSet
from ebb.runtime.buffer import Array


class CompiledExecutable(ABC, Generic[CodeT, BindingT]):
    """A kernel on one backend: code for each way in which its rows and its data have been met."""

    def __init__(self, checked: CheckedKernel, lowering: Lowering, target: Target, usual: How) -> None:
        """The kernel, to be compiled when it is launched: only then is it known what the code depends on.

        Args:
            checked: the kernel.
            lowering: how it becomes programs.
            target: what these are compiled for.
            usual: how launches go that no plan says more of.

        Raises:
            BackendError: the variables of one row do not fit into the memory of a thread.
        """
        if checked.step.outline.variable_bytes > MOST_PRIVATE_BYTES:
            check_private_bytes(checked.kernel.name, variable_bytes(checked.kernel))
        self.checked = checked
        self.step = checked.step
        self._lowering = lowering
        self._target = target
        self._usual = usual
        self._codes: dict[Step, KernelCode[CodeT, BindingT]] = {}
        self._planners: dict[RowSet, Planner] = {}

    def bind(self, rows: RowSet, changing: AbstractSet[Field] = frozenset()) -> Bound:
        """The code for the data as it is, bound to ``rows``: compiled, where it is met so for the first time.

        Args:
            rows: the kernel's relation or a subset of it. The groupings that the kernel queries are valid.
            changing: key fields, none that the kernel queries, on whose values nothing may depend.

        Raises:
            BackendError: the code cannot be compiled, or a device lacks what it needs.
        """
        if rows.size == 0:
            return NoRows(self.step.outline.draws)
        plan = self.plan(rows)
        if not changing.isdisjoint(plan.read):
            plan = self._planners[rows].plan_in_order("its keys change within a captured step")  # depends on none
        parts = [self._bind(run) for run in plan.runs if run.rows.size]
        bound = parts[0] if len(parts) == 1 else Bindings(parts)
        if not plan.settled:
            return Once(bound)  # the next launch is planned again, and only that one
        for keys in plan.read:
            keys.followed = True
        return bound

    def how(self, rows: RowSet) -> How:
        """How a launch on ``rows`` does its reductions, and in which order the rows run."""
        if rows.size == 0:
            return self._usual
        plan = self.plan(rows)
        return How(plan.how, self._usual.totals, plan.order or self._usual.order)

    def inspect(self, stage: str) -> str | None:
        """The text of a stage of the backend for a launch on all rows; None for any other."""
        if stage not in stages_of(self._target):
            return None
        rows = self.step.outline.relation
        steps = [(self.step, rows)]
        if rows.size:
            steps = [(run.step, run.rows) for run in self.plan(rows).runs]
        programs = [self._code(step).program(of) for step, of in steps]
        return "\n".join(stage_text(program, self._target, stage) for program in programs)

    # ---- What each backend says ----

    @abstractmethod
    def plan(self, rows: RowSet) -> Plan:
        """What a launch on ``rows``, which are some, runs and in which order."""

    @abstractmethod
    def _load(self, draft: Draft) -> CodeT:
        """The code of a program, where it can run.

        Raises:
            BackendError: it cannot be compiled, or a device does not take it.
        """

    @abstractmethod
    def _attach(self, draft: Draft, code: CodeT, rows: RowSet) -> BindingT:
        """What ``_load`` made of ``draft``, bound to ``rows``."""

    @abstractmethod
    def _settle(self, binding: BindingT, run: Run) -> None:
        """Puts in place what may have changed with the structure."""

    # ---- What they use ----

    def _planned(self, rows: RowSet, starts: Callable[[], Array] | None, kept: PlanStore | None = None) -> Plan:
        """The plan of the planner of ``rows``; ``starts`` and ``kept`` are what ``Planner`` takes."""
        planner = self._planners.get(rows)
        if planner is None:
            planner = self._planners[rows] = Planner(self.step, rows, starts, kept)
        return planner.plan()

    def _bind(self, run: Run) -> BindingT:
        binding = self._code(run.step).bind(run.rows)
        self._settle(binding, run)
        return binding

    def _code(self, step: Step) -> KernelCode[CodeT, BindingT]:
        code = self._codes.get(step)
        if code is None:
            code = self._codes[step] = KernelCode(step, self._lowering, self._load, self._attach)
        return code
