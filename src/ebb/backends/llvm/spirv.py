"""The hooks of OpenCL devices that take SPIR-V: LLVM's target of that name and OpenCL's own functions.

LLVM knows the functions by OpenCL's mangled names: ``_Z3sinf`` is ``sin`` of a ``float``.
"""

from __future__ import annotations

from ebb.backends.llvm.hooks import FUNCTIONS, INSTRUCTIONS, NOT_ALWAYS_RIGHT, PURE, Call, Groups, Hooks, Strips
from ebb.records import replace

TRIPLE = "spirv64v1.0-unknown-unknown"
"""The oldest version of SPIR-V, which all devices take that take any."""

EXTENSIONS = ("SPV_EXT_shader_atomic_float_add",)
"""What modules may use beside the core of SPIR-V, where a program has such instructions."""

_MANGLED = {name: f"_Z{len(called)}{called}{{operands}}" for name, called in FUNCTIONS.items()}

_LOCAL_FENCE = "i32 1"

_GROUPS = Groups(
    kernel="spir_kernel",
    global_memory=" addrspace(1)",
    group_memory=" addrspace(3)",
    thread=Call("i64", "_Z12get_local_idj", "i32 0", PURE),
    group=Call("i64", "_Z12get_group_idj", "i32 0", PURE),
    groups=Call("i64", "_Z14get_num_groupsj", "i32 0", PURE),
    barrier=Call("void", "_Z7barrierj", _LOCAL_FENCE, " convergent nounwind"),
    scope=' syncscope("device")',
    float_adds=frozenset(),
    atomic_bits=32,
    notes={"reqd_work_group_size": "!{{{{i32 {group_size}, i32 1, i32 1}}}}"},
    # A hint that makes Intel's runtime for processors compile a kernel as it stands. Its vectoriser ends the process
    # where a loop of different length in each row carries one value into another: a, b = b, a + b.
    loop_notes={"vec_type_hint": "!{{{{<2 x i32> undef, i32 1}}}}"},
    # Without the first, a * b + c must not be fused. The second is the version of OpenCL C that has what is used.
    module_notes={"opencl.enable.FP_CONTRACT": "!{{}}", "opencl.ocl.version": "!{{i32 2, i32 0}}"},
)


def spirv_hooks(float_adds: frozenset[int]) -> Hooks:
    """The hooks of a device that adds floats of ``float_adds`` bits atomically by an instruction."""
    return Hooks(
        math={**INSTRUCTIONS, **_MANGLED},
        convention="spir_func ",
        # No reassoc: SPIR-V says that only together with there being no NaN and no infinity.
        fast=" nsz arcp contract afn",
        missing=NOT_ALWAYS_RIGHT,
        attributes="nounwind",
        strips=Strips.NONE,
        vector_math={},
        groups=replace(_GROUPS, float_adds=float_adds),
    )
