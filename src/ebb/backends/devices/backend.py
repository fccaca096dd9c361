"""The backends for devices: kernels as programs for work-groups, with the data where the device has them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from ebb.backends.backend import CheckedKernel, How, Operation
from ebb.backends.cache import ObjectCache
from ebb.backends.compile import needs, object_code, stages_of
from ebb.backends.devices.binding import DeviceBinding
from ebb.backends.devices.failures import FailureRecords
from ebb.backends.executable import CompiledExecutable
from ebb.backends.kernel_code import Draft, Lowering, precision_of
from ebb.backends.target import Target
from ebb.compiler import lir
from ebb.compiler.phases.order import InOrder, shares_sums
from ebb.compiler.scatter.choose import ROW_AFTER_ROW, Plan, Run
from ebb.errors import BackendError
from ebb.relations.subset import RowSet
from ebb.runtime.device import Device, Entry, Feature
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
        cache: ObjectCache,
        deterministic: bool,
        reorders: bool,
    ) -> None:
        self.name = name
        self.device = device
        self.target = target
        self.cache = cache
        self.deterministic = deterministic
        self.reorders = reorders
        self.stages = stages_of(target)

    @property
    def facts_cache(self) -> None:
        """None: kernels are lowered in each process."""
        return None

    @cached_property
    def failures(self) -> FailureRecords:
        """Where kernels say which rows have failed."""
        return FailureRecords(self.device)

    def prepare(self, checked: CheckedKernel) -> DeviceExecutable:
        """The kernel, to be compiled when it is launched: only then is it known what the code depends on.

        Raises:
            BackendError: the variables of one row do not fit into the memory of a thread.
        """
        return DeviceExecutable(checked, self)

    def replay(self, operations: Sequence[Operation]) -> None:
        """None: captured operations are queued one by one, as they were launched."""
        del operations


class DeviceExecutable(CompiledExecutable[tuple[lir.Program, tuple[Entry, ...]], DeviceBinding]):
    """A kernel on a device."""

    def __init__(self, checked: CheckedKernel, backend: DeviceBackend) -> None:
        updates = lir.Updates.PLAIN if backend.deterministic else lir.Updates.ATOMIC
        size = checked.hints.block_size
        order = f"any: a thread of the device takes a row, and {size} threads are a work-group"
        lowering = Lowering(precision_of(checked.hints), updates, size)
        super().__init__(checked, lowering, backend.target, How(ATOMICALLY, GROUP_TOTALS, order))
        self._backend = backend

    def plan(self, rows: RowSet) -> Plan:
        """As ``CompiledExecutable.plan``."""
        checked = self.checked
        if not (self._backend.deterministic and shares_sums(checked.phases)):
            return Plan((Run(self.step, rows, None),), ATOMICALLY, None, ())
        if checked.step.outline.in_order is InOrder.PRINTS:
            order = "one after the other, since the kernel prints as well as it sums in other rows"
            return Plan((Run(self.step, rows, None),), ROW_AFTER_ROW, order, ())
        return self._planned(rows, None)

    def _load(self, draft: Draft) -> tuple[lir.Program, tuple[Entry, ...]]:
        backend, program = self._backend, draft.lower()
        lacking = needs(program) & backend.device.lacks
        if lacking:
            raise BackendError(_lacks(backend.device, program.name, lacking))
        image = object_code(program, backend.target, backend.cache, self.checked.verify)
        return program, backend.device.load(program.name, image, program.entries)

    def _attach(self, draft: Draft, code: tuple[lir.Program, tuple[Entry, ...]], rows: RowSet) -> DeviceBinding:
        return DeviceBinding(draft.step, *code, self._backend.device, self._backend.failures, rows)

    def _settle(self, binding: DeviceBinding, run: Run) -> None:
        del run  # there are no waves on devices
        binding.settle()


_REMEDIES = {
    Feature.FLOAT64: "keep numbers in ebb.float32: fields, globals and annotated parameters",
    Feature.ATOMICS64: "reduce into 32-bit numbers, or do without atomic operations: deterministic=True",
}


def _lacks(device: Device, kernel: str, lacking: frozenset[Feature]) -> DeviceLacks:
    features = sorted(lacking, key=list(Feature).index)
    remedies = [_REMEDIES[feature] for feature in features if feature in _REMEDIES]
    names = tuple(feature.value for feature in features)
    return DeviceLacks(device.name, kernel, names, (*remedies, 'run on the processor: ebb.set_backend("cpu")'))
