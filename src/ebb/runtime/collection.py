"""Python's collector of garbage, while kernels are compiled.

The nodes of a kernel are many, and live. Each few thousand of them the collector goes through what lives, now and then
through all that the process has, which takes longer than compiling a kernel that is in the cache.
"""

from __future__ import annotations

import gc
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def uncollected() -> Generator[None, None, None]:
    """Collects no garbage within the block; what there is by then is collected after it."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
