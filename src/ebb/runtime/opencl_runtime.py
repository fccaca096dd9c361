"""Shows pyopencl all OpenCL runtimes that are installed: those of the system, and the one that comes as a wheel.

OpenCL programs link to a loader. It reads a folder of ``.icd`` files when it is first called, each the name of a
vendor's library. The ``.icd`` file in the wheel ``intel-opencl-rt`` names a path that is not there, since wheels know
no paths; so the loader is given a folder that has all those of the system and one more.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import sys
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import llvmlite.binding as llvm

from ebb.errors import BackendError
from ebb.records import record
from ebb.runtime.errors_devices import MissingPackage

if TYPE_CHECKING:
    import pyopencl as cl

WHEEL = "intel-opencl-rt"
"""The wheel with an OpenCL runtime for the processor; the wheels after it have libraries that it links to."""

HAS_WHEEL = sys.platform == "linux" and platform.machine() == "x86_64"
"""Whether there is such a wheel for this machine."""

_WHEELS = (WHEEL, "intel-cmplr-lib-rt", "tbb")

_DRIVER = "libintelocl"

_LINKED = ("libintlc", "libimf", "libirng", "libsvml", "libtbb")
"""What the driver links to, each before those that need it."""

_LIBRARY = re.compile(r"(lib\w+)\.so(\.\d+)?")
"""The files that the linker looks for; those with longer versions are copies of them."""

_VENDORS = "OCL_ICD_VENDORS"
"""What names the folder to the loaders of Khronos and of ocl-icd, which is the one in pyopencl's wheel."""

_INSTRUCTIONS = "CL_CONFIG_CPU_TARGET_ARCH"
"""What names the instructions that Intel's runtime for processors compiles for."""

_CACHE_FAILURES = "PYOPENCL_CACHE_FAILURE_FATAL"
"""What pyopencl asks, and expects to be there, when it cannot use what it has kept of compiled programs."""

_STANDARD_VENDORS = ("/etc/OpenCL/vendors", f"{sys.prefix}/etc/OpenCL/vendors")
"""Where loaders look by themselves: that of the system, and that of a conda environment."""


@record
class Wheel:
    """The runtime from the wheels: its driver, and why it cannot be loaded, if so."""

    driver: Path
    fault: str | None


@cache
def platforms() -> tuple[cl.Platform, ...]:
    """The OpenCL platforms of this machine, in the loader's order.

    Raises:
        BackendError: pyopencl is not installed, or cannot be imported.
    """
    runtime = wheel()
    try:
        import pyopencl as cl
    except ModuleNotFoundError as error:
        reason = "it is not installed" if error.name == "pyopencl" else str(error)
        raise BackendError(MissingPackage("opencl", "pyopencl", "opencl", reason)) from error
    except ImportError as error:
        raise BackendError(MissingPackage("opencl", "pyopencl", "opencl", str(error))) from error
    found: list[cl.Platform] = []
    # Without a platform, loaders do not say that there are none, but fail.
    with _all_vendors(runtime), suppress(cl.Error):
        found += cl.get_platforms()
    # A runtime that is installed twice, or named by two folders, is loaded once.
    return tuple(dict.fromkeys(found))


@cache
def wheel() -> Wheel | None:
    """The runtime from the wheels, None where it is not installed."""
    libraries: Mapping[str, Path] = _libraries() if HAS_WHEEL else {}
    if _DRIVER not in libraries:
        return None
    return Wheel(libraries[_DRIVER], _load(libraries))


def _libraries() -> Mapping[str, Path]:
    """The libraries of the wheels by their names without ``.so``, wherever pip has put them."""
    found: dict[str, Path] = {}
    for distribution in _WHEELS:
        with suppress(PackageNotFoundError):
            for file in files(distribution) or ():
                match = _LIBRARY.fullmatch(file.name)
                # libtbb.so.12 rather than libtbb.so, which is for linkers, or a second copy
                if match and (match[1] not in found or match[2]):
                    found[match[1]] = Path(str(file.locate())).resolve()
    return {name: path for name, path in found.items() if path.is_file()}


def _load(libraries: Mapping[str, Path]) -> str | None:
    """Loads the driver after what it links to, so that the linker need not know where that lies; says what it lacks.

    All that has been loaded is found by its name. The names in the libraries stay out of the global scope, where
    their own ``sin`` and the like might be found instead of the C library's.
    """
    for name in _LINKED:
        with suppress(KeyError, OSError):  # the driver will say what it misses
            ctypes.CDLL(str(libraries[name]), mode=os.RTLD_NOW | os.RTLD_LOCAL)
    try:
        ctypes.CDLL(str(libraries[_DRIVER]), mode=os.RTLD_NOW | os.RTLD_LOCAL)
    except OSError as error:
        return str(error)
    return None


@contextmanager
def _all_vendors(runtime: Wheel | None) -> Generator[None, None, None]:
    """Lets the loader, which looks once, find ``runtime`` besides all that it would find by itself.

    The variable is set for as long as the loader looks: nothing else in the process, and no process started from it,
    shall see another environment or a folder that is gone.
    """
    if runtime is None or runtime.fault is not None:
        yield
        return
    with TemporaryDirectory(prefix="ebb-opencl-") as folder:
        for number, driver in enumerate((*_vendors(os.environ.get(_VENDORS)), str(runtime.driver))):
            Path(folder, f"{number:03}.icd").write_text(f"{driver}\n", encoding="utf-8")
        with _environment(_VENDORS, folder):
            yield


@contextmanager
def right_instructions() -> Generator[str, None, None]:
    """Has Intel's runtime for processors compile for AVX2 where it would for AVX-512, unless the user says for what.

    With AVX-512 its release 2026.2.0 has an instruction wrong: where a kernel run row by row takes ``~min(i, n)``,
    the register that should have all bits set is left as it was. It looks when a context is made.

    It then takes no code that it has compiled for AVX-512. Where pyopencl has such in a cache of its own, it compiles
    anew and warns, if a variable is there; without that it fails for the lack of the variable.

    Yields:
        What it then compiles for, empty for all that the processor has.
    """
    given = os.environ.get(_INSTRUCTIONS)
    if given is not None or not llvm.get_host_cpu_features().get("avx512f"):
        yield given or ""
        return
    os.environ.setdefault(_CACHE_FAILURES, "")
    with _environment(_INSTRUCTIONS, "core-avx2"):
        yield "core-avx2"


@contextmanager
def _environment(name: str, value: str) -> Generator[None, None, None]:
    """Gives a variable of the environment a value for a while."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def _vendors(setting: str | None) -> list[str]:
    """The drivers that the loader would find, given what ``OCL_ICD_VENDORS`` is: a folder, a file, or a driver."""
    path = os.environ.get("OPENCL_VENDOR_PATH")
    folders = [Path(path)] if path else [Path(folder) for folder in _STANDARD_VENDORS]
    if not setting:
        return [driver for folder in folders for driver in _drivers_in(folder)]
    if os.path.isdir(setting):
        return _drivers_in(Path(setting))
    if not setting.endswith(".icd"):
        return [setting]
    places = [Path(setting)] if "/" in setting else [*(folder / setting for folder in folders), Path(setting)]
    return [driver for place in places if (driver := _driver_of(place))][:1]


def _drivers_in(folder: Path) -> list[str]:
    return [driver for file in sorted(folder.glob("*.icd")) if (driver := _driver_of(file))]


def _driver_of(file: Path) -> str | None:
    """The driver that an ``.icd`` file names, which is its first line."""
    with suppress(OSError, UnicodeDecodeError):
        return file.read_text(encoding="utf-8").partition("\n")[0].strip() or None
    return None
