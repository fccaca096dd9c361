"""The backend ``cpu``: kernels as machine code, on all cores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from functools import cache
from pathlib import Path

from ebb.backends.backend import Bound, CheckedKernel, How, Operation
from ebb.backends.binding import Binding
from ebb.backends.cache import ObjectCache, cache_directory
from ebb.backends.compile import assembly_text, check_private_bytes, llvm_text, object_code, replay_code
from ebb.backends.kernel_code import Bindings, KernelCode, Lowering, NoRows, precision_of, step_of
from ebb.backends.replay import Replay
from ebb.backends.target import Target, host
from ebb.backends.tiles import block_starts
from ebb.compiler import lir, lir_print
from ebb.compiler.kir_walk import draws
from ebb.compiler.lower import variable_bytes
from ebb.compiler.phases.order import InOrder, why_in_order
from ebb.compiler.scatter.choose import ANY_ORDER, ATOMICALLY, BLOCK_TOTALS, ROW_AFTER_ROW, Plan, Planner, Run
from ebb.compiler.scatter.step import Step
from ebb.compiler.scatter.waves import in_order
from ebb.errors import BackendError
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.subset import RowSet
from ebb.runtime.cpu import CpuCode, CpuDevice, ReplayCode
from ebb.runtime.epoch import structure_changed
from ebb.runtime.errors import BadSwitch
from ebb.runtime.threads import openmp, thread_count

_STAGES: dict[str, Callable[[lir.Program, Target], str]] = {
    "lir": lambda program, _: lir_print.text(program),
    "llvm": llvm_text,
    "asm": assembly_text,
}


@record(frozen=False, eq=False)
class CpuBackend:
    """Compiles kernels with LLVM and runs them on this machine's cores.

    Attributes:
        device: the processor.
        cache: where object code is kept between processes.
        reorders: whether launches may permute relations so that kernels find rows closer together.
        updates: how rows reduce into other rows: the bits of atomic sums depend on the threads.
    """

    device: CpuDevice
    cache: ObjectCache
    reorders: bool = True
    updates: lir.Updates = lir.Updates.PLAIN
    name: str = "cpu"
    stages: tuple[str, ...] = tuple(_STAGES)
    accelerator: None = None

    def prepare(self, checked: CheckedKernel) -> CpuExecutable:
        """The kernel, to be compiled when it is launched: only then is it known what the code depends on.

        Raises:
            BackendError: the variables of one row do not fit on a thread's stack.
        """
        check_private_bytes(checked.kernel.name, variable_bytes(checked.kernel))
        return CpuExecutable(checked, self)

    def replay(self, operations: Sequence[Operation]) -> Replay | None:
        """A captured step as one piece of machine code, or None where there is no OpenMP to run its launches with."""
        if self.device.threads > 1 and openmp() is None:
            return None
        return Replay(_replay_code(self.device, self.cache), operations)


def cpu_backend(threads: int | None = None, reorder: bool = True, atomics: bool = False) -> CpuBackend:
    """The backend ``cpu``.

    Args:
        threads: how many threads a launch may use; ``EBB_NUM_THREADS`` or all cores by default.
        reorder: whether launches may permute relations so that kernels find rows closer together.
        atomics: whether reductions into other rows are atomic updates, whose bits depend on the threads.

    Raises:
        BackendError: ``threads`` is no number of threads, or ``reorder`` or ``atomics`` no bool.
    """
    for option, value in (("reorder", reorder), ("atomics", atomics)):
        if not isinstance(value, bool):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise BackendError(BadSwitch("cpu", option, value))
    updates = lir.Updates.ATOMIC if atomics else lir.Updates.PLAIN
    return _backend_of(thread_count(threads), cache_directory(), reorder, updates)


@cache
def _backend_of(threads: int, directory: Path, reorders: bool, updates: lir.Updates) -> CpuBackend:
    """One for each choice of options, so that a kernel that meets it again is compiled."""
    return CpuBackend(CpuDevice(threads), ObjectCache(directory), reorders, updates)


@cache
def _replay_code(device: CpuDevice, objects: ObjectCache) -> ReplayCode:
    """The code that replays captured steps, which is the same for all."""
    return device.load_replay(replay_code(host(), objects))


class CpuExecutable:
    """A kernel on the backend ``cpu``: machine code for each way in which its rows and its data have been met."""

    def __init__(self, checked: CheckedKernel, backend: CpuBackend) -> None:
        self._checked = checked
        self._backend = backend
        self._step = step_of(checked)
        self._in_order = why_in_order(checked.kernel, checked.phases)
        self._lowering = Lowering(precision_of(checked.hints), backend.updates)
        self._codes: dict[Step, KernelCode[CpuCode, Binding]] = {}
        self._planners: dict[RowSet, Planner] = {}

    def bind(self, rows: RowSet, changing: AbstractSet[Field] = frozenset()) -> Bound:
        """The code for the data as it is, bound to ``rows``: compiled, where it is met so for the first time.

        Args:
            rows: the kernel's relation or a subset of it. The groupings that the kernel queries are valid.
            changing: key fields, none that the kernel queries, on whose values nothing may depend.

        Raises:
            BackendError: the code cannot be compiled.
        """
        if rows.size == 0:
            return NoRows(draws(self._checked.kernel))
        plan = self.plan(rows)
        if not changing.isdisjoint(plan.read):
            plan = self._planners[rows].plan_in_order("its keys change within a captured step")
        if not plan.settled:
            structure_changed()  # so that the next launch is planned again
        bound = [self._bind(run) for run in plan.runs if run.rows.size]
        return bound[0] if len(bound) == 1 else Bindings(bound)

    def plan(self, rows: RowSet) -> Plan:
        """What a launch on ``rows``, which are some, runs and in which order."""
        match self._in_order:
            case None:
                return Plan((Run(self._step, rows, None),), "", None, ())
            case InOrder.PRINTS:
                waves = in_order(len(block_starts(rows)) - 1)
                order = f"one after the other, {InOrder.PRINTS.value}"
                return Plan((Run(self._step, rows, waves),), ROW_AFTER_ROW, order, ())
            case InOrder.SHARED_SUMS if self._backend.updates is lir.Updates.ATOMIC:
                return Plan((Run(self._step, rows, None),), ATOMICALLY, None, ())
            case InOrder.SHARED_SUMS:
                planner = self._planners.get(rows)
                if planner is None:
                    planner = self._planners[rows] = Planner(self._step, rows, lambda: block_starts(rows))
                return planner.plan()

    def how(self, rows: RowSet) -> How:
        """How a launch on ``rows`` does its reductions into other rows, and in which order the rows run."""
        if rows.size == 0:
            return How(ROW_AFTER_ROW, BLOCK_TOTALS, ANY_ORDER)
        plan = self.plan(rows)
        return How(plan.how, BLOCK_TOTALS, plan.order or ANY_ORDER)

    def inspect(self, stage: str) -> str | None:
        """The text of the stage ``lir``, ``llvm`` or ``asm`` for a launch on all rows; None for any other."""
        if stage not in _STAGES:
            return None
        rows = self._checked.kernel.relation
        steps = [(self._step, rows)]
        if rows.size:
            steps = [(run.step, run.rows) for run in self.plan(rows).runs]
        programs = [self._code(step).program(of) for step, of in steps]
        return "\n".join(_STAGES[stage](program, host()) for program in programs)

    def _bind(self, run: Run) -> Binding:
        binding = self._code(run.step).bind(run.rows)
        binding.settle(run.waves)
        return binding

    def _code(self, step: Step) -> KernelCode[CpuCode, Binding]:
        code = self._codes.get(step)
        if code is None:
            code = self._codes[step] = KernelCode(step, self._lowering, self._load, self._attach)
        return code

    def _load(self, program: lir.Program) -> CpuCode:
        backend = self._backend
        return backend.device.load(program.name, object_code(program, host(), backend.cache))

    def _attach(self, step: Step, program: lir.Program, code: CpuCode, rows: RowSet) -> Binding:
        return Binding(step.kernel, program, code, self._backend.device, rows)
