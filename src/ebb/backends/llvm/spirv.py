"""The hooks of OpenCL devices that take SPIR-V: LLVM's target of that name and OpenCL's own functions.

LLVM knows the functions by OpenCL's mangled names: ``_Z3sinf`` is ``sin`` of a ``float``.
"""

from __future__ import annotations

from ebb.backends.llvm.hooks import INTRINSICS, NOT_ALWAYS_RIGHT, Call, Groups, Hooks, Strips
from ebb.records import replace

_FUNCTIONS = {
    name: name
    for name in ("cbrt", "expm1", "log1p", "asinh", "acosh", "atanh", "hypot", "erf", "erfc", "lgamma", "fmod")
} | {"gamma": "tgamma"}

_MANGLED = {name: f"_Z{len(called)}{called}{{operands}}" for name, called in _FUNCTIONS.items()}

_LOCAL_FENCE = "i32 1"

_GROUPS = Groups(
    kernel="spir_kernel",
    global_memory=" addrspace(1)",
    group_memory=" addrspace(3)",
    thread=Call("i64", "_Z12get_local_idj", "i32 0"),
    group=Call("i64", "_Z12get_group_idj", "i32 0"),
    groups=Call("i64", "_Z14get_num_groupsj", "i32 0"),
    barrier=Call("void", "_Z7barrierj", _LOCAL_FENCE),
    scope=' syncscope("device")',
    float_adds=frozenset(),
    atomic_bits=32,
    notes={"reqd_work_group_size": "!{{i32 {group_size}, i32 1, i32 1}}"},
)


def spirv_hooks(float_adds: frozenset[int]) -> Hooks:
    """The hooks of a device that adds floats of ``float_adds`` bits atomically by an instruction."""
    return Hooks(
        math={**INTRINSICS, **_MANGLED},
        convention="spir_func ",
        missing=NOT_ALWAYS_RIGHT,
        attributes="nounwind",
        strips=Strips.NONE,
        vector_math={},
        groups=replace(_GROUPS, float_adds=float_adds),
    )
