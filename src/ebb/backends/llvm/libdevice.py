"""libdevice, NVIDIA's library of mathematical functions for LLVM: found where it is installed, linked where it is used.

It is bitcode. What a module calls is taken out of it before the two are linked, since the whole of it is five hundred
functions. They ask LLVM what to do with subnormal numbers (``__nvvm_reflect``), and LLVM's passes answer: keep them.
"""

from __future__ import annotations

import os
import re
import sys
from functools import cache
from importlib.util import find_spec

import llvmlite.binding as llvm

from ebb.errors import BackendError
from ebb.runtime.errors_devices import NoLibdevice

PREFIX = "__nv_"
"""What the names of its functions begin with."""

_FILE = os.path.join("nvvm", "libdevice", "libdevice.10.bc")

_WHEELS = ("cuda_nvcc", "cu13")
"""The folders of the package ``nvidia`` in which the wheels of CUDA 12 and 13 have it."""


def link(module: llvm.ModuleRef) -> None:
    """Links what ``module`` calls of libdevice into it, as functions of its own; most modules call nothing.

    Raises:
        BackendError: it calls something, and libdevice is not installed.
    """
    called = [function.name for function in module.functions if function.name.startswith(PREFIX)]
    if not called:
        return
    path = find_libdevice()
    if path is None:
        raise BackendError(NoLibdevice(tuple(name.removeprefix(PREFIX) for name in called)))
    library = llvm.parse_bitcode(_functions(path, frozenset(called)))
    library.triple, library.data_layout = module.triple, module.data_layout
    module.link_in(library)
    for name in called:
        module.get_function(name).linkage = llvm.Linkage.internal


@cache
def find_libdevice() -> str | None:
    """The path of libdevice: of a wheel in this environment, else of a CUDA toolkit, else None."""
    spec = find_spec("nvidia")
    packages = spec.submodule_search_locations if spec is not None else None
    roots = [os.path.join(package, wheel) for package in packages or () for wheel in _WHEELS]
    roots += [os.environ[name] for name in ("CUDA_HOME", "CUDA_PATH") if name in os.environ]
    roots += [sys.prefix, "/usr/local/cuda"]  # conda's toolkit lies in the environment itself
    paths = (os.path.join(root, _FILE) for root in roots)
    return next((path for path in paths if os.path.isfile(path)), None)


def libdevice_version() -> str:
    """Something that tells one libdevice from another, for the key of the cache."""
    path = find_libdevice()
    if path is None:
        return "none"
    there = os.stat(path)
    return f"{there.st_size} {there.st_mtime_ns}"


@cache
def _functions(path: str, names: frozenset[str]) -> bytes:
    """The bitcode of the functions ``names`` and of all that they need."""
    with open(path, "rb") as file:
        library = llvm.parse_bitcode(file.read())
    for function in library.functions:
        if function.name not in names and not function.is_declaration:
            function.linkage = llvm.Linkage.internal
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    # No machine: dead code is dead on all of them.
    passes.run(library, llvm.create_pass_builder(None, llvm.create_pipeline_tuning_options()))
    return _without_double(library).as_bitcode()


_SCALED_IN_DOUBLE = re.compile(
    r"(%\d+) = sitofp i64 (%\d+) to double\n"
    r"  (%\d+) = fmul double \1, 0x3BF921FB54442D19\n"
    r"  (%\d+) = fptrunc double \3 to float\n"
)
_SCALED = r"\1 = sitofp i64 \2 to float\n  \3 = fmul float \1, 0x3BF921FB60000000\n  \4 = fmul float \3, 1.0\n"


def _without_double(library: llvm.ModuleRef) -> llvm.ModuleRef:
    """``library`` with sin, cos and tan of float32 in float32 throughout.

    For angles beyond 105,615 they take the angle modulo pi/2 in integers, and scale what is left by pi/2 and 2**-64 in
    float64, which is slow on many GPUs, and which a kernel in float32 does not have anywhere else. In float32 that is
    a rounding or two more of an angle below pi/4.
    """
    text, found = _SCALED_IN_DOUBLE.subn(_SCALED, str(library))
    return llvm.parse_assembly(text) if found else library
