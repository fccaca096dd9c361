"""Memory that has been freed, but that the C library keeps for later."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


def return_freed() -> None:
    """Hands the pages on which everything has been freed back to the system, where the C library is glibc.

    It keeps them unless they are the last ones: what generating meshes and compiling leave behind would be held besides
    the fields for as long as a simulation runs. It takes some tenths of a millisecond.
    """
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


@cache
def _malloc_trim() -> Any:
    try:
        trim: Any = getattr(ctypes.CDLL(None), "malloc_trim", None)
    except (OSError, TypeError):  # where a process cannot be asked for its symbols
        return None
    if trim is not None:
        trim.argtypes = (ctypes.c_size_t,)
    return trim
