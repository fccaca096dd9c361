"""The hooks of NVIDIA's GPUs: LLVM's target of PTX, with the functions of libdevice.

What LLVM does with an intrinsic is taken where it is IEEE's: division and square root round correctly there.
"""

from __future__ import annotations

from ebb.backends.llvm.hooks import FAST, FUNCTIONS, INSTRUCTIONS, Call, Groups, Hooks, Strips

TRIPLE = "nvptx64-nvidia-cuda"

_KNOWN = (60, 61, 62, 70, 72, 75, 80, 86, 87, 89, 90, 100, 103, 120, 121)
"""The compute capabilities that LLVM and the drivers of CUDA 12 know."""

NVPTX = Hooks(
    math={
        **INSTRUCTIONS,
        **{name: f"__nv_{called}{{suffix}}" for name, called in FUNCTIONS.items()},
    },
    convention="",
    fast=FAST,
    missing=frozenset(),
    # Exactly so many threads: ptxas gives each as many registers as there are for so many.
    attributes='nounwind "nvvm.reqntid"="{group_size}"',
    strips=Strips.NONE,
    vector_math={},
    groups=Groups(
        kernel="ptx_kernel",
        global_memory=" addrspace(1)",
        group_memory=" addrspace(3)",
        thread=Call("i32", "llvm.nvvm.read.ptx.sreg.tid.x"),
        group=Call("i32", "llvm.nvvm.read.ptx.sreg.ctaid.x"),
        groups=Call("i32", "llvm.nvvm.read.ptx.sreg.nctaid.x"),
        barrier=Call("void", "llvm.nvvm.barrier.cta.sync.aligned.all", "i32 0"),
        scope=' syncscope("device")',
        float_adds=frozenset({32, 64}),
        atomic_bits=8,  # LLVM makes them of those on 32-bit words
        notes={},
        loop_notes={},
        module_notes={},
    ),
)


def architecture(capability: int) -> str:
    """What LLVM calls GPUs of a compute capability: the newest that it knows and that is not newer.

    The driver compiles PTX for its own device, which may be newer.
    """
    return f"sm_{max(known for known in _KNOWN if known <= capability)}"
