"""The backends that tests run on."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterator
from functools import cache

import pytest

import ebb

BACKENDS = ("cpu", "reference", "opencl")
COMPILED = ("cpu", "opencl")
HAS_WHEELS = sys.platform == "linux" and platform.machine() == "x86_64"
"""Whether the extra ``dev`` brings an OpenCL device and ``ptxas``: there tests fail where one does not work."""


@cache
def lacking(backend: str) -> str | None:
    """Why tests skip ``backend`` on this machine, or None."""
    if backend != "opencl" or HAS_WHEELS:
        return None
    try:
        with ebb.backend(backend):
            return None
    except ebb.BackendError as error:
        return str(error)


def require(backend: str) -> None:
    """Skips the test where ``backend`` is not."""
    reason = lacking(backend)
    if reason is not None:
        pytest.skip(reason)


def running_on(backend: str) -> Iterator[str]:
    """Runs what follows on ``backend``: for fixtures."""
    require(backend)
    with ebb.backend(backend):
        yield backend


def runnable(*backends: str) -> tuple[str, ...]:
    """Those of ``backends``, or of all, that tests run on here."""
    return tuple(name for name in backends or BACKENDS if lacking(name) is None)
