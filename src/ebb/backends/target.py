"""Targets: what to compile for, a row a kind of machine."""

from __future__ import annotations

from functools import cache
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from ebb.backends.llvm.hooks import Hooks, cpu_hooks
from ebb.backends.llvm.vector_math import VERSIONS
from ebb.errors import BackendError
from ebb.records import record
from ebb.runtime.errors import NoMachineCode
from ebb.runtime.symbols import libmvec_versions


@record(eq=False)
class Target:
    """A machine to compile for.

    Attributes:
        triple: LLVM's name of the kind of machine.
        cpu: LLVM's name of the processor.
        features: the instruction sets that may be used, as LLVM spells them.
        vector_math: the versions of the library of vector functions that this process has.
    """

    triple: str
    cpu: str
    features: str
    vector_math: tuple[tuple[int, int], ...]

    @property
    def hooks(self) -> Hooks:
        """What the emitter needs to know, found out when something is compiled."""
        return _hooks(self)

    @property
    def machine(self) -> Any:
        """LLVM's target machine, made when something is compiled: what is in the cache needs none.

        Raises:
            BackendError: LLVM has no code generator for it.
        """
        return _machine(self)

    @property
    def fingerprint(self) -> str:
        """All that the object code depends on beside the program."""
        version = ".".join(map(str, llvm.llvm_version_info))
        libraries = f"llvmlite {llvmlite.__version__} llvm {version} libmvec {self.vector_math}"
        return f"{self.triple} {self.cpu} {self.features} {libraries}"


_TUNING = {"znver": "+prefer-no-gather,+prefer-no-scatter"}
"""What LLVM is told besides, by the beginning of the processor's name. AMD's processors run a gather or a scatter as
microcode: loads and stores of single elements take between a half and a tenth of the time.
"""


@cache
def host() -> Target:
    """The processor that this process runs on, with all of its instruction sets.

    Raises:
        BackendError: LLVM has no code generator for it.
    """
    triple = llvm.get_process_triple()
    try:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    except RuntimeError as error:
        raise BackendError(NoMachineCode(triple, str(error))) from error
    tuned = [tuning for family, tuning in _TUNING.items() if cpu.startswith(family)]
    vector_math = tuple(libmvec_versions(VERSIONS)) if triple.startswith("x86_64") else ()
    return Target(triple, cpu, ",".join((features, *tuned)), vector_math)


@cache
def _hooks(target: Target) -> Hooks:
    return cpu_hooks(target.features, target.vector_math)


@cache
def _machine(target: Target) -> Any:
    try:
        return llvm.Target.from_triple(target.triple).create_target_machine(
            cpu=target.cpu, features=target.features, opt=3, reloc="pic", codemodel="small"
        )
    except RuntimeError as error:
        raise BackendError(NoMachineCode(target.triple, str(error))) from error
