"""The backend ``cpu``: kernels as machine code, on all cores."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from ebb.backends.backend import Bound, CheckedKernel
from ebb.backends.binding import Binding
from ebb.backends.cache import ObjectCache, cache_directory
from ebb.backends.compile import assembly_text, check_private_bytes, llvm_text, object_code
from ebb.backends.target import Target, host
from ebb.compiler import lir, lir_print
from ebb.compiler.kir_walk import draws
from ebb.compiler.lower import Launched, lower, sources_of, variable_bytes
from ebb.compiler.lower.facts import State
from ebb.records import record
from ebb.relations.subset import RowSet
from ebb.runtime import random
from ebb.runtime.cpu import CpuCode, CpuDevice
from ebb.runtime.threads import thread_count

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
    """

    device: CpuDevice
    cache: ObjectCache
    name: str = "cpu"
    stages: tuple[str, ...] = tuple(_STAGES)

    def prepare(self, checked: CheckedKernel) -> CpuExecutable:
        """The kernel, to be compiled when it is launched: only then is it known what the code depends on.

        Raises:
            BackendError: the variables of one row do not fit on a thread's stack.
        """
        check_private_bytes(checked.kernel.name, variable_bytes(checked.kernel))
        return CpuExecutable(checked, self)


def cpu_backend(threads: int | None = None) -> CpuBackend:
    """The backend ``cpu``.

    Args:
        threads: how many threads a launch may use; ``EBB_NUM_THREADS`` or all cores by default.

    Raises:
        BackendError: ``threads`` is no number of threads.
    """
    return _backend_of(thread_count(threads), cache_directory())


@cache
def _backend_of(threads: int, directory: Path) -> CpuBackend:
    """One for each choice of options, so that a kernel that meets it again is compiled."""
    return CpuBackend(CpuDevice(threads), ObjectCache(directory))


class CpuExecutable:
    """A kernel on the backend ``cpu``: machine code for each way in which its rows and its data have been met."""

    def __init__(self, checked: CheckedKernel, backend: CpuBackend) -> None:
        self._checked = checked
        self._backend = backend
        self._sources = sources_of(checked.kernel)
        self._compiled: dict[tuple[Launched, State], tuple[lir.Program, CpuCode]] = {}
        self._bindings: dict[tuple[RowSet, State], Binding] = {}

    def bind(self, rows: RowSet) -> Bound:
        """The code for the data as it is, bound to ``rows``: compiled, where it is met so for the first time.

        Args:
            rows: the kernel's relation or a subset of it. The groupings that the kernel queries are valid.

        Raises:
            BackendError: the code cannot be compiled.
        """
        if rows.size == 0:
            return _NoRows(draws(self._checked.kernel))
        state = self._sources.state()
        binding = self._bindings.get((rows, state))
        if binding is None:
            program, code = self._compile(_launched(rows), state)
            device = self._backend.device
            binding = self._bindings[rows, state] = Binding(self._checked.kernel, program, code, device, rows)
        binding.settle()
        return binding

    def inspect(self, stage: str) -> str | None:
        """The text of the stage ``lir``, ``llvm`` or ``asm`` for a launch on all rows; None for any other."""
        if stage not in _STAGES:
            return None
        program = self._lower(_launched(self._checked.kernel.relation), self._sources.state())
        return _STAGES[stage](program, host())

    def _compile(self, launched: Launched, state: State) -> tuple[lir.Program, CpuCode]:
        found = self._compiled.get((launched, state))
        if found is None:
            program = self._lower(launched, state)
            code = self._backend.device.load(program.name, object_code(program, host(), self._backend.cache))
            found = self._compiled[launched, state] = program, code
        return found

    def _lower(self, launched: Launched, state: State) -> lir.Program:
        checked = self._checked
        return lower(
            checked.kernel,
            checked.phases,
            [access.node for access in checked.stencil],
            self._sources.facts(state),
            launched,
            lir.Precision.FAST if checked.hints.fastmath else lir.Precision.CONTRACT,
        )


@record
class _NoRows:
    """A launch on no rows at all: nothing is run, but a launch that would draw random numbers counts."""

    draws: bool

    def run(self, uniforms: tuple[Any, ...]) -> None:
        del uniforms
        if self.draws:
            random.next_launch()


def _launched(rows: RowSet) -> Launched:
    if rows.boxes is not None:
        return Launched.BOXES
    return Launched.ALL if rows.row_positions() is None else Launched.LISTED
