"""What differs between targets in the LLVM IR that is emitted: a target is one row of hooks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum

from ebb.backends.llvm.vector_math import VectorForms, vector_forms
from ebb.records import record, replace

INTRINSICS: Mapping[str, str] = {
    name: f"llvm.{name}.{{type}}"
    for name in (
        "sqrt", "exp", "exp2", "log", "log2", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh",
        "tanh", "floor", "ceil", "trunc", "pow", "atan2", "copysign",
    )
} | {"abs": "llvm.fabs.{type}", "round": "llvm.rint.{type}"}  # fmt: skip
"""The functions of ``lir.MATH`` that LLVM knows, by its own names."""

INSTRUCTIONS: Mapping[str, str] = {
    name: INTRINSICS[name] for name in ("abs", "sqrt", "floor", "ceil", "trunc", "round", "copysign")
}
"""Those that are an instruction, or a few, on devices. Of others LLVM would make what they do not have."""

FUNCTIONS: Mapping[str, str] = {
    name: name
    for name in (
        "cbrt", "exp", "log", "log2", "log10", "exp2", "expm1", "log1p", "sin", "cos", "tan", "asin", "acos", "atan",
        "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf", "erfc", "lgamma", "pow", "atan2", "fmod", "hypot",
    )
} | {"gamma": "tgamma"}  # fmt: skip
"""The functions of ``lir.MATH`` that devices have in a library, by C's names."""

_LIBM = ("cbrt", "expm1", "log1p", "asinh", "acosh", "atanh", "hypot", "erf", "erfc", "lgamma")

NOT_ALWAYS_RIGHT = frozenset({"llvm.minimum", "llvm.maximum", "llvm.fptosi.sat", "llvm.fptoui.sat"})
"""The intrinsics that need not be the target's: what they do is said in plain instructions as well."""

SATURATING = frozenset({"llvm.fptosi.sat", "llvm.fptoui.sat"})

FAST = " reassoc nsz arcp contract afn"
"""What LLVM may do to floats under ``fastmath``. NaN and infinity stay what they are."""

PURE = " nounwind willreturn memory(none)"
"""The attributes of a function that depends on its operands alone and does nothing else."""


class Strips(Enum):
    """Whether loops run several turns at once, in vectors of the emitter's own making."""

    NONE = "none"
    MASKED = "masked"
    """Where vector loads under a mask are instructions."""


@record
class Call:
    """A call of a function of the target's.

    Attributes:
        type: what it returns.
        name: of the function.
        operands: literals with their types, or nothing.
        attributes: of the function.
    """

    type: str
    name: str
    operands: str = ""
    attributes: str = " nounwind"


@record
class Groups:
    """What code for groups of threads wants.

    Attributes:
        kernel: the calling convention of kernels.
        global_memory: the address space of slots, as in ``ptr addrspace(1)``.
        group_memory: the address space of variables of a group.
        thread: the number of the thread in its group.
        group: the number of the group in the launch of the kernel.
        groups: how many groups that has.
        barrier: waits for all threads of the group; they see one another's stores to the group's memory.
        scope: of atomic operations that all threads of the device see.
        float_adds: the bits of floats that are added atomically by an instruction.
        atomic_bits: the width of the narrowest atomic operations.
        notes: metadata of kernels, by kind; ``{group_size}`` stands for the threads of a group.
        loop_notes: more of those, for kernels with loops.
        module_notes: metadata of modules, by name.
    """

    kernel: str
    global_memory: str
    group_memory: str
    thread: Call
    group: Call
    groups: Call
    barrier: Call
    scope: str
    float_adds: frozenset[int]
    atomic_bits: int
    notes: Mapping[str, str]
    loop_notes: Mapping[str, str]
    module_notes: Mapping[str, str]


@record
class Hooks:
    """The names and attributes that one kind of target wants.

    Attributes:
        math: the function that computes each function of ``lir.MATH`` on floats, but for those that are instructions;
            ``{type}`` stands for LLVM's ``f32`` or ``f64``, ``{suffix}`` for C's ``f`` or nothing, ``{operands}`` for
            OpenCL's ``f`` or ``d``, one an operand.
        convention: the calling convention of functions, with a space behind it if it is not C's.
        fast: the flags of instructions on floats under ``fastmath``.
        missing: the intrinsics, of ``NOT_ALWAYS_RIGHT``, in whose place instructions are emitted.
        attributes: the attributes of the functions that run rows; ``{group_size}`` stands for the threads of a group.
        strips: which loops run in strips.
        vector_math: the functions that the target has for several values at once.
        groups: of a target that runs groups of threads.
    """

    math: Mapping[str, str]
    convention: str
    fast: str
    missing: frozenset[str]
    attributes: str
    strips: Strips
    vector_math: VectorForms
    groups: Groups | None


CPU = Hooks(
    math={**INTRINSICS, "gamma": "tgamma{suffix}", **{name: f"{name}{{suffix}}" for name in _LIBM}},
    convention="",
    fast=FAST,
    missing=frozenset(),
    attributes='nounwind "prefer-vector-width"="512" "no-trapping-math"="true"',
    strips=Strips.NONE,
    vector_math={},
    groups=None,
)

STRIPS_FEATURE = "+avx2"
"""What a processor must have for strips to be quicker than plain loops."""

CONVERSIONS_FEATURE = "+avx512dq"
"""What converts several floats to integers of 64 bits at once. LLVM does not use it for ``SATURATING``."""


def cpu_hooks(features: str, vector_math: Iterable[tuple[int, int]]) -> Hooks:
    """The hooks of a processor.

    Args:
        features: what it has, as LLVM spells it.
        vector_math: the versions of the library of vector functions that are there.
    """
    own = features.split(",")
    strips = Strips.MASKED if STRIPS_FEATURE in own else Strips.NONE
    missing = SATURATING if CONVERSIONS_FEATURE in own else frozenset[str]()
    return replace(CPU, strips=strips, missing=missing, vector_math=vector_forms(features, vector_math))
