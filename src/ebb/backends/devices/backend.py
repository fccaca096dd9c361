"""The backends for devices: kernels as programs for work-groups, with the data where the device has them."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from functools import cached_property

from ebb.backends.backend import Bound, CheckedKernel, How, Operation
from ebb.backends.cache import ObjectCache
from ebb.backends.compile import check_private_bytes, needs, object_code
from ebb.backends.devices.binding import DeviceBinding
from ebb.backends.devices.failures import FailureRecords
from ebb.backends.devices.stages import STAGES
from ebb.backends.kernel_code import Bindings, KernelCode, Lowering, NoRows, precision_of, step_of
from ebb.backends.target import Target
from ebb.compiler import lir
from ebb.compiler.kir_walk import draws
from ebb.compiler.lower import variable_bytes
from ebb.compiler.phases.order import InOrder, shares_sums, why_in_order
from ebb.compiler.scatter.choose import ROW_AFTER_ROW, Plan, Planner, Run
from ebb.compiler.scatter.step import Step
from ebb.errors import BackendError
from ebb.relations.field import Field
from ebb.relations.subset import RowSet
from ebb.runtime.device import Device, Entry, Feature
from ebb.runtime.epoch import structure_changed
from ebb.runtime.errors_devices import DeviceLacks

ATOMICALLY = "into other rows, atomically, in any order: the bits of sums of floats may differ from launch to launch"

GROUP_TOTALS = "one partial result a work-group, by a tree of its threads; then one work-group combines these"


class DeviceBackend:
    """Compiles kernels for one device and runs them there.

    Attributes:
        name: what ``ebb.set_backend`` calls it.
        device: the device.
        target: what kernels are compiled for.
        cache: where code is kept between processes.
        deterministic: whether reductions into other rows have the same bits at each run, whatever that costs.
        reorders: whether launches may permute relations so that kernels find rows closer together.
        stages: what ``kernel.inspect`` can show.
    """

    def __init__(
        self,
        name: str,
        device: Device,
        target: Target,
        assembly: str,
        cache: ObjectCache,
        deterministic: bool,
        reorders: bool,
    ) -> None:
        """``assembly`` is the stage that the device's own language is."""
        self.name = name
        self.device = device
        self.target = target
        self.cache = cache
        self.deterministic = deterministic
        self.reorders = reorders
        self.stages = ("lir", "llvm", assembly)

    @cached_property
    def failures(self) -> FailureRecords:
        """Where kernels say which rows have failed."""
        return FailureRecords(self.device)

    @property
    def accelerator(self) -> Device:
        """The device."""
        return self.device

    def prepare(self, checked: CheckedKernel) -> DeviceExecutable:
        """The kernel, to be compiled when it is launched: only then is it known what the code depends on.

        Raises:
            BackendError: the variables of one row do not fit into the memory of a thread.
        """
        check_private_bytes(checked.kernel.name, variable_bytes(checked.kernel))
        return DeviceExecutable(checked, self)

    def replay(self, operations: Sequence[Operation]) -> None:
        """None: captured operations are queued one by one, as they were launched."""
        del operations


class DeviceExecutable:
    """A kernel on a device: code for each way in which its rows and its data have been met."""

    def __init__(self, checked: CheckedKernel, backend: DeviceBackend) -> None:
        self._checked = checked
        self._backend = backend
        self._step = step_of(checked)
        updates = lir.Updates.PLAIN if backend.deterministic else lir.Updates.ATOMIC
        self._lowering = Lowering(precision_of(checked.hints), updates, checked.hints.block_size)
        self._codes: dict[Step, KernelCode[tuple[Entry, ...], DeviceBinding]] = {}
        self._planners: dict[RowSet, Planner] = {}

    def bind(self, rows: RowSet, changing: AbstractSet[Field] = frozenset()) -> Bound:
        """The code for the data as it is, bound to ``rows``: compiled, where it is met so for the first time.

        Args:
            rows: the kernel's relation or a subset of it. The groupings that the kernel queries are valid.
            changing: key fields, none that the kernel queries, on whose values nothing may depend.

        Raises:
            BackendError: the code cannot be compiled, or the device lacks what it needs.
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
        if not (self._backend.deterministic and shares_sums(self._checked.phases)):
            return Plan((Run(self._step, rows, None),), ATOMICALLY, None, ())
        if why_in_order(self._checked.kernel, self._checked.phases) is InOrder.PRINTS:
            order = "one after the other, since the kernel prints as well as it sums in other rows"
            return Plan((Run(self._step, rows, None),), ROW_AFTER_ROW, order, ())
        planner = self._planners.get(rows)
        if planner is None:
            planner = self._planners[rows] = Planner(self._step, rows, None)
        return planner.plan()

    def how(self, rows: RowSet) -> How:
        """How a launch on ``rows`` does its reductions, and in which order the rows run."""
        if rows.size == 0:
            return How(ATOMICALLY, GROUP_TOTALS, self._any_order)
        plan = self.plan(rows)
        return How(plan.how, GROUP_TOTALS, plan.order or self._any_order)

    def inspect(self, stage: str) -> str | None:
        """The text of a stage of ``backend.stages`` for a launch on all rows; None for any other."""
        if stage not in self._backend.stages:
            return None
        rows = self._checked.kernel.relation
        steps = [(self._step, rows)]
        if rows.size:
            steps = [(run.step, run.rows) for run in self.plan(rows).runs]
        programs = [self._code(step).program(of) for step, of in steps]
        return "\n".join(STAGES[stage](program, self._backend.target) for program in programs)

    @property
    def _any_order(self) -> str:
        return f"any: a thread of the device takes a row, and {self._lowering.group_size} threads are a work-group"

    def _bind(self, run: Run) -> DeviceBinding:
        binding = self._code(run.step).bind(run.rows)
        binding.settle()
        return binding

    def _code(self, step: Step) -> KernelCode[tuple[Entry, ...], DeviceBinding]:
        code = self._codes.get(step)
        if code is None:
            code = self._codes[step] = KernelCode(step, self._lowering, self._load, self._attach)
        return code

    def _load(self, program: lir.Program) -> tuple[Entry, ...]:
        backend = self._backend
        lacking = needs(program) & backend.device.lacks
        if lacking:
            raise BackendError(_lacks(backend.device, program.name, lacking))
        image = object_code(program, backend.target, backend.cache)
        return backend.device.load(program.name, image, program.entries)

    def _attach(self, step: Step, program: lir.Program, entries: tuple[Entry, ...], rows: RowSet) -> DeviceBinding:
        return DeviceBinding(step, program, entries, self._backend.device, self._backend.failures, rows)


_REMEDIES = {
    Feature.FLOAT64: "keep numbers in ebb.float32: fields, globals and annotated parameters",
    Feature.ATOMICS64: "reduce into 32-bit numbers, or do without atomic operations: deterministic=True",
}


def _lacks(device: Device, kernel: str, lacking: frozenset[Feature]) -> DeviceLacks:
    features = sorted(lacking, key=list(Feature).index)
    remedies = [_REMEDIES[feature] for feature in features if feature in _REMEDIES]
    names = tuple(feature.value for feature in features)
    return DeviceLacks(device.name, kernel, names, (*remedies, 'run on the processor: ebb.set_backend("cpu")'))
