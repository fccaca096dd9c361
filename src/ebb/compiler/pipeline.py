"""The passes over KIR, in order, and the one driver that runs them.

A pass is a pure function ``Kernel -> Kernel`` in a file of its own under ``passes``. After each the driver checks the
kernel, so that a fault is blamed on the pass that made it, and logs its time (logger ``ebb.compiler``, DEBUG).
Where the environment variable ``EBB_DUMP`` asks for it, it prints the kernel to stderr: ``EBB_DUMP=all`` after
elaboration and each pass that changes something, ``EBB_DUMP=step,move`` only for the kernels of these names.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

from ebb.compiler import kir, kir_print
from ebb.compiler.kir_verify import CompilerBug, verify_kernel
from ebb.compiler.passes.flatten_blocks import flatten_blocks
from ebb.compiler.passes.fold_constants import fold_constants
from ebb.compiler.passes.prune_branches import prune_branches
from ebb.compiler.passes.simplify_powers import simplify_powers

Pass: TypeAlias = Callable[[kir.Kernel], kir.Kernel]

PASSES: tuple[Pass, ...] = (fold_constants, prune_branches, flatten_blocks, simplify_powers)


def run_passes(kernel: kir.Kernel, passes: Sequence[Pass] = PASSES) -> kir.Kernel:
    """``kernel`` after ``passes``.

    Raises:
        CompilerBug: the elaborator or a pass made a kernel that is none.
    """
    _verify(kernel, "elaborate")
    dump(kernel.name, "elaborate", partial(kir_print.text, kernel))
    for run_pass in passes:
        start = time.perf_counter()
        changed = run_pass(kernel)
        name = run_pass.__name__
        log_time(kernel.name, name, start)
        if changed is not kernel and changed.body is not kernel.body:
            _verify(changed, name)
            dump(kernel.name, name, partial(kir_print.text, changed))
        kernel = changed
    return kernel


def _verify(kernel: kir.Kernel, stage: str) -> None:
    try:
        verify_kernel(kernel)
    except CompilerBug as bug:
        raise CompilerBug(f"kernel {kernel.name!r} after {stage}: {bug}") from bug


def log_time(kernel: str, stage: str, start: float) -> None:
    """Logs how long ``stage`` of ``kernel`` took, which began at ``start`` of ``time.perf_counter``."""
    if "logging" in sys.modules:  # else nobody can have asked for it, and the import takes 2 ms
        import logging

        milliseconds = 1e3 * (time.perf_counter() - start)
        logging.getLogger("ebb.compiler").debug("%s: %s took %.2f ms", kernel, stage, milliseconds)


def dump(kernel: str, stage: str, text: Callable[[], str]) -> None:
    """Prints ``text`` to stderr where ``EBB_DUMP`` asks for the stages of the kernel of that name."""
    asked = os.environ.get("EBB_DUMP", "")
    if asked == "all" or kernel in asked.split(","):
        print(f"# {kernel} after {stage}\n{text()}\n", file=sys.stderr)
