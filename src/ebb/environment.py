"""What this installation has, in words: for ``ebb info`` and for reports of faults."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import llvmlite.binding as llvm
import numpy as np

import ebb
from ebb.backends.cache import cache_directory, cache_limit, cache_usage
from ebb.backends.select import BACKENDS
from ebb.errors import BackendError
from ebb.relations.table import bytes_text
from ebb.runtime import cuda, opencl
from ebb.runtime.opencl_runtime import HAS_WHEEL
from ebb.runtime.threads import describe_threads, thread_count

#: The widest vectors of a processor by the features that LLVM names, the widest first.
_VECTOR_FEATURES = (("avx512f", "AVX-512"), ("avx2", "AVX2"), ("avx", "AVX"), ("sse4.2", "SSE4.2"), ("neon", "NEON"))

#: The packages that an extra brings.
_EXTRAS = {
    "mesh": ("meshio", "scipy"),
    "viz": ("pyvista", "pymeshfix", "meshio", "scipy"),
    "openmp": ("intel-openmp",),
    "opencl": ("pyopencl", "intel-opencl-rt", "intel-cmplr-lib-rt") if HAS_WHEEL else ("pyopencl",),
    "cuda": ("cuda-bindings", "nvidia-cuda-nvcc-cu12"),
}

_DEVICES = {"opencl": opencl.describe_devices, "cuda": cuda.describe_devices}


def describe_environment() -> tuple[tuple[str, str], ...]:
    """Names and values, a row each."""
    return (
        ("ebb", f"{ebb.__version__} ({os.path.dirname(ebb.__file__)})"),
        ("python", f"{platform.python_version()} on {platform.platform()}"),
        ("numpy", np.__version__),
        ("llvmlite", version("llvmlite")),
        ("llvm", ".".join(map(str, llvm.llvm_version_info))),
        ("processor", _processor()),
        ("threads", _threads()),
        ("cache", _cache()),
        *((f"backend {name}", _backend(name)) for name in BACKENDS),
        *((f"{backend} device", device) for backend, describe in _DEVICES.items() for device in _devices(describe)),
        *((f"extra {extra}", _extra(extra)) for extra in _EXTRAS),
    )


def _processor() -> str:
    features = llvm.get_host_cpu_features()
    widest = next((label for name, label in _VECTOR_FEATURES if features.get(name)), "no vector instructions known")
    return f"{llvm.get_host_cpu_name()}, {widest}, {os.cpu_count()} cores"


def _threads() -> str:
    try:
        return f"{thread_count()} by {describe_threads()}"
    except BackendError as error:
        return error.diagnostics[0].title


def _cache() -> str:
    folder, limit = cache_directory(), cache_limit()
    if not limit:
        return "none: EBB_CACHE_SIZE is 0, so that every run compiles its kernels"
    there = next((place for place in (folder, *folder.parents) if os.path.exists(place)), folder)
    if not os.path.isdir(there) or not os.access(there, os.W_OK | os.X_OK):
        return f"{folder}, which cannot be written: set EBB_CACHE_DIR, or every run compiles its kernels again"
    kernels, taken = cache_usage(folder)
    count = f"{kernels:,} kernel{'' if kernels == 1 else 's'}"
    return f"{folder}: {count}, {bytes_text(taken)} of at most {bytes_text(limit)}"


def _backend(name: str) -> str:
    """Whether a backend can run here, or what it lacks."""
    try:
        BACKENDS[name][0]()
    except BackendError as error:
        hints = "; ".join(error.diagnostics[0].hints)
        return f"not available: {error.diagnostics[0].title}; {hints}"
    return "available"


def _devices(describe: Callable[[], tuple[str, ...]]) -> tuple[str, ...]:
    """The devices of a backend; where it cannot be asked, the row of the backend says why."""
    try:
        return describe()
    except BackendError:
        return ()


def _extra(extra: str) -> str:
    missing = [package for package in _EXTRAS[extra] if not _is_installed(package)]
    return f'not installed: pip install "ebblang[{extra}]" for {", ".join(missing)}' if missing else "installed"


def _is_installed(package: str) -> bool:
    if find_spec(package.replace("-", "_")) is not None:
        return True
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True
