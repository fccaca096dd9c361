"""Python's collector of garbage, while kernels are compiled.

The nodes of a kernel are many, and live. Each few thousand of them the collector goes through what lives, now and then
through all that the process has, which takes longer than compiling a kernel that is in the cache.
"""

from __future__ import annotations

import gc
import itertools
from collections.abc import Generator
from contextlib import contextmanager

_PATIENCE = 128
"""How many blocks may end before what they left behind is collected."""

_ended = itertools.count(1)


@contextmanager
def uncollected() -> Generator[None, None, None]:
    """Collects no garbage within the block, nor what it made young right after it, since most of that lives on."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        if next(_ended) % _PATIENCE == 0:
            gc.collect()
        elif gc.get_freeze_count() == 0:  # else the program has set objects apart, which `unfreeze` would undo
            # All that is young counts as old, without a look at it: it is gone through when all is.
            gc.freeze()
            gc.unfreeze()
        gc.enable()
