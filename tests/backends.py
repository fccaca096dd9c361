"""The backends that tests run on."""

from __future__ import annotations

import platform
import sys
from functools import cache

import ebb
from ebb.backends import select

BACKENDS = ("cpu", "reference", "opencl")
COMPILED = ("cpu", "opencl")


@cache
def lacking(backend: str) -> str | None:
    """Why tests skip ``backend`` on this machine, or None.

    On Linux x86-64 the extra ``dev`` brings an OpenCL device, so there tests fail where it does not work.
    """
    if backend == "opencl" and backend not in select.BACKENDS:
        return "there is no such backend yet"
    if backend != "opencl" or (sys.platform == "linux" and platform.machine() == "x86_64"):
        return None
    try:
        with ebb.backend(backend):
            return None
    except ebb.BackendError as error:
        return str(error)


def runnable(*backends: str) -> tuple[str, ...]:
    """Those of ``backends``, or of all, that tests run on here."""
    return tuple(name for name in backends or BACKENDS if lacking(name) is None)
