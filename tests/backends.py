"""The backends that tests run on."""

from __future__ import annotations

import platform
import sys
from functools import cache

import ebb
from ebb.backends import target

BACKENDS = ("cpu", "reference", "opencl")
COMPILED = ("cpu", "opencl")
HAS_WHEELS = sys.platform == "linux" and platform.machine() == "x86_64"
"""Whether the extra ``dev`` brings an OpenCL device and ``ptxas``: there tests fail where one does not work."""


@cache
def lacking(backend: str) -> str | None:
    """Why tests skip ``backend`` on this machine, or None."""
    if backend == "opencl" and not hasattr(target, "spirv"):
        return "there is no such backend yet"
    if backend != "opencl" or HAS_WHEELS:
        return None
    try:
        with ebb.backend(backend):
            return None
    except ebb.BackendError as error:
        return str(error)


def runnable(*backends: str) -> tuple[str, ...]:
    """Those of ``backends``, or of all, that tests run on here."""
    return tuple(name for name in backends or BACKENDS if lacking(name) is None)
