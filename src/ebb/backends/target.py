"""Targets: what to compile for, a row a kind of machine."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import cache, partial
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from ebb.backends.llvm.hooks import Hooks, cpu_hooks
from ebb.backends.llvm.vector_math import VERSIONS
from ebb.errors import BackendError
from ebb.records import record
from ebb.runtime.device import Feature
from ebb.runtime.errors import NoMachineCode
from ebb.runtime.symbols import libmvec_versions


class Form(Enum):
    """What programs are compiled to. The values are the stages of ``kernel.inspect`` that show it as text."""

    OBJECT = "asm"
    SPIRV = "spirv"
    PTX = "ptx"


@record(eq=False)
class Target:
    """A machine to compile for.

    Attributes:
        form: what it takes.
        triple: LLVM's name of the kind of machine.
        cpu: LLVM's name of the processor.
        features: the instruction sets that may be used, as LLVM spells them.
        libraries: the version of what else the code depends on.
        find_hooks: finds out what the emitter needs to know.
    """

    form: Form
    triple: str
    cpu: str
    features: str
    libraries: str
    find_hooks: Callable[[], Hooks]

    @property
    def hooks(self) -> Hooks:
        """What the emitter needs to know, found out when something is compiled."""
        return self.find_hooks()

    @property
    def machine(self) -> Any:
        """LLVM's target machine, made when something is compiled: what is in the cache needs none.

        Raises:
            BackendError: LLVM has no code generator for it.
        """
        return _machine(self)

    def image(self, module: Any) -> bytes:
        """What the machine takes of an LLVM module."""
        match self.form:
            case Form.OBJECT:
                return bytes(self.machine.emit_object(module))
            case Form.PTX:
                return self.assembly(module).encode()
            case Form.SPIRV:
                from ebb.backends.llvm.spirv_code import spirv_binary

                return spirv_binary(module)

    def assembly(self, module: Any) -> str:
        """An LLVM module in the machine's assembly language."""
        if self.form is Form.SPIRV:
            from ebb.backends.llvm.spirv_code import spirv_text

            return spirv_text(module)
        return str(self.machine.emit_assembly(module))

    @property
    def fingerprint(self) -> str:
        """All that the compiled code depends on beside the program."""
        version = ".".join(map(str, llvm.llvm_version_info))
        libraries = f"llvmlite {llvmlite.__version__} llvm {version} {self.libraries}"
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
    return Target(
        Form.OBJECT,
        triple,
        cpu,
        ",".join((features, *tuned)),
        f"libmvec {vector_math}",
        cache(partial(cpu_hooks, features, vector_math)),
    )


_FLOAT_ADDS = {32: Feature.FLOAT32_ADD, 64: Feature.FLOAT64_ADD}


@cache
def spirv(lacks: frozenset[Feature] = frozenset()) -> Target:
    """OpenCL devices that take SPIR-V.

    Args:
        lacks: what the device does not have. What it lacks of atomic additions becomes loops; nothing stands in for
            the rest, which programs may need (``compile.needs``).
    """
    from ebb.backends.llvm.spirv import TRIPLE, spirv_hooks

    adds = frozenset(bits for bits, feature in _FLOAT_ADDS.items() if feature not in lacks)
    libraries = f"atomic addition of floats of {sorted(adds)} bits"
    return Target(Form.SPIRV, TRIPLE, "", "", libraries, cache(partial(spirv_hooks, adds)))


@cache
def nvptx(capability: int) -> Target:
    """NVIDIA's GPUs of a compute capability, 10 major + minor, and later ones."""
    from ebb.backends.llvm.libdevice import libdevice_version
    from ebb.backends.llvm.nvptx import NVPTX, TRIPLE, architecture

    return Target(Form.PTX, TRIPLE, architecture(capability), "", f"libdevice {libdevice_version()}", lambda: NVPTX)


@cache
def _machine(target: Target) -> Any:
    if target.form is not Form.OBJECT:
        _initialize_devices()
    try:
        return llvm.Target.from_triple(target.triple).create_target_machine(
            cpu=target.cpu, features=target.features, opt=3, reloc="pic", codemodel="small"
        )
    except RuntimeError as error:
        raise BackendError(NoMachineCode(target.triple, str(error))) from error


@cache
def _initialize_devices() -> None:
    """Sets up LLVM's other code generators."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
