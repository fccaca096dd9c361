"""The backend ``cpu``: what it makes of kernels, and how it plans their launches."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ebb.backends.backend import CheckedKernel, How, Operation
from ebb.backends.cache import Content, ObjectCache, cache_directory
from ebb.backends.compile import driver_code, stages_of
from ebb.backends.cpu.binding import Binding
from ebb.backends.cpu.replay import Replay
from ebb.backends.cpu.tiles import block_starts
from ebb.backends.executable import CompiledExecutable
from ebb.backends.kernel_code import Draft, Lowering, precision_of
from ebb.backends.known import known_code, package_state
from ebb.backends.target import host
from ebb.compiler import lir
from ebb.compiler.interface import Interface
from ebb.compiler.phases.order import InOrder
from ebb.compiler.scatter.choose import ANY_ORDER, ATOMICALLY, BLOCK_TOTALS, ROW_AFTER_ROW, Plan, Run
from ebb.compiler.scatter.waves import in_order
from ebb.records import record
from ebb.relations.subset import RowSet
from ebb.runtime.cpu import CpuCode, CpuDevice, Driver
from ebb.runtime.digest import key_of
from ebb.runtime.threads import openmp, thread_count


@record(frozen=False, eq=False)
class CpuBackend:
    """Compiles kernels with LLVM and runs them on this machine's cores.

    Attributes:
        processor: the cores.
        cache: where object code is kept between processes.
        reorders: whether launches may permute relations so that kernels find rows closer together.
        updates: how rows reduce into other rows: the bits of atomic sums depend on the threads.
    """

    processor: CpuDevice
    cache: ObjectCache
    reorders: bool = True
    updates: lir.Updates = lir.Updates.PLAIN
    name: str = "cpu"
    device: None = None

    @property
    def facts_cache(self) -> ObjectCache:
        """Where facts of kernels are kept between processes."""
        return self.cache

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages beyond KIR that ``kernel.inspect`` can show."""
        return stages_of(host())

    def prepare(self, checked: CheckedKernel) -> CpuExecutable:
        """The kernel, to be compiled when it is launched: only then is it known what the code depends on.

        Raises:
            BackendError: the variables of one row do not fit on a thread's stack.
        """
        return CpuExecutable(checked, self)

    def driver(self) -> Driver:
        """What takes launches through the code of kernels."""
        return _driver(self.processor, self.cache)

    def replay(self, operations: Sequence[Operation]) -> Replay | None:
        """A captured step as one piece of machine code, or None where there is no OpenMP to run its launches with."""
        if self.processor.threads > 1 and openmp() is None:
            return None
        return Replay(self.driver(), operations)


def cpu_backend(threads: int | None = None, reorder: bool = True, atomics: bool = False) -> CpuBackend:
    """The backend ``cpu``.

    Args:
        threads: how many threads a launch may use; ``EBB_NUM_THREADS`` or all cores by default.
        reorder: whether launches may permute relations so that kernels find rows closer together.
        atomics: whether reductions into other rows are atomic updates, whose bits depend on the threads.

    Raises:
        BackendError: ``threads`` is no number of threads.
    """
    updates = lir.Updates.ATOMIC if atomics else lir.Updates.PLAIN
    return _backend_of(thread_count(threads), cache_directory(), reorder, updates)


@cache
def _backend_of(threads: int, directory: Path, reorders: bool, updates: lir.Updates) -> CpuBackend:
    """One for each choice of options, so that a kernel that meets it again is compiled."""
    return CpuBackend(CpuDevice(threads), ObjectCache(directory), reorders, updates)


@cache
def _driver(device: CpuDevice, objects: ObjectCache) -> Driver:
    """What takes launches through the code of kernels, which is the same for all."""
    return device.load_driver(driver_code(host(), objects, package_state()))


@record(eq=False)
class _KeptPlans:
    """Plans in the folder of compiled kernels, by this state of the package."""

    cache: ObjectCache
    package: str

    def get(self, name: str) -> bytes | None:
        return self.cache.get(key_of(name, self.package), Content.PLAN)

    def put(self, name: str, content: bytes) -> None:
        self.cache.put(key_of(name, self.package), content, Content.PLAN)


def _plans(objects: ObjectCache) -> _KeptPlans | None:
    package = package_state()
    return None if package is None or not objects.limit else _KeptPlans(objects, package)


class CpuExecutable(CompiledExecutable[tuple[Interface, CpuCode], Binding]):
    """A kernel on the backend ``cpu``."""

    def __init__(self, checked: CheckedKernel, backend: CpuBackend) -> None:
        lowering = Lowering(precision_of(checked.hints), backend.updates)
        super().__init__(checked, lowering, host(), How(ROW_AFTER_ROW, BLOCK_TOTALS, ANY_ORDER))
        self._backend = backend
        self._in_order = checked.step.outline.in_order

    def plan(self, rows: RowSet) -> Plan:
        """As ``CompiledExecutable.plan``."""
        match self._in_order:
            case None:
                return Plan((Run(self.step, rows, None),), "", None, ())
            case InOrder.PRINTS:
                waves = in_order(len(block_starts(rows)) - 1)
                order = f"one after the other, {InOrder.PRINTS.value}"
                return Plan((Run(self.step, rows, waves),), ROW_AFTER_ROW, order, ())
            case InOrder.SHARED_SUMS if self._backend.updates is lir.Updates.ATOMIC:
                return Plan((Run(self.step, rows, None),), ATOMICALLY, None, ())
            case InOrder.SHARED_SUMS:
                return self._planned(rows, lambda: block_starts(rows), _plans(self._backend.cache))

    def _load(self, draft: Draft) -> tuple[Interface, CpuCode]:
        backend = self._backend
        interface, image = known_code(draft, host(), backend.cache, self.checked.verify)
        return interface, backend.processor.load(draft.name, image)

    def _attach(self, draft: Draft, code: tuple[Interface, CpuCode], rows: RowSet) -> Binding:
        return Binding(draft, *code, self._backend.driver(), self._backend.processor, rows)

    def _settle(self, binding: Binding, run: Run) -> None:
        binding.settle(run.waves)
