"""The passes over KIR, in order, and the one driver that runs them.

A pass is a pure function ``Kernel -> Kernel`` in a file of its own under ``passes``. What each makes is verified, so
that a fault is blamed on the pass that made it; the driver logs its time (logger ``ebb.compiler``, DEBUG).
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

from ebb.compiler import kir
from ebb.compiler.kir_verify import CompilerBug, verify_kernel
from ebb.compiler.passes.flatten_blocks import flatten_blocks
from ebb.compiler.passes.fold_constants import fold_constants
from ebb.compiler.passes.prune_branches import prune_branches
from ebb.compiler.passes.simplify_powers import simplify_powers

Pass: TypeAlias = Callable[[kir.Kernel], kir.Kernel]

PASSES: tuple[Pass, ...] = (fold_constants, prune_branches, flatten_blocks, simplify_powers)


class Unverified:
    """What the elaborator and the passes made of one kernel, as long as nobody has had to verify it.

    What a program in the cache was compiled of had been verified, so only what is compiled or interpreted needs to be.
    """

    def __init__(self) -> None:
        self._stages: list[tuple[kir.Kernel, str]] = []

    def add(self, kernel: kir.Kernel, stage: str) -> None:
        """Takes down what ``stage`` made."""
        self._stages.append((kernel, stage))

    def verify(self) -> None:
        """Verifies all, once.

        Raises:
            CompilerBug: the elaborator or a pass made a kernel that is none.
        """
        for kernel, stage in self._stages:
            verify_stage(kernel, stage)
        self._stages.clear()


def verify_stage(kernel: kir.Kernel, stage: str) -> None:
    """Verifies ``kernel``, which ``stage`` made.

    Raises:
        CompilerBug: it is no kernel.
    """
    try:
        verify_kernel(kernel)
    except CompilerBug as bug:
        raise CompilerBug(f"kernel {kernel.name!r} after {stage}: {bug}") from bug


def run_passes(
    kernel: kir.Kernel,
    passes: Sequence[Pass] = PASSES,
    made: Callable[[kir.Kernel, str], None] = verify_stage,
) -> kir.Kernel:
    """``kernel`` after ``passes``.

    Args:
        kernel: what the elaborator made.
        passes: what changes it, one after the other.
        made: is told of each kernel and of the stage that made it.

    Raises:
        CompilerBug: the elaborator or a pass made a kernel that is none, where ``made`` verifies.
    """
    made(kernel, "elaborate")
    dump(kernel.name, "elaborate", partial(_text, kernel))
    for run_pass in passes:
        start = time.perf_counter()
        changed = run_pass(kernel)
        name = run_pass.__name__
        log_time(kernel.name, name, start)
        if changed is not kernel and changed.body is not kernel.body:
            made(changed, name)
            dump(kernel.name, name, partial(_text, changed))
        kernel = changed
    return kernel


def _text(kernel: kir.Kernel) -> str:
    from ebb.compiler import kir_print  # here: few programs ask for it

    return kir_print.text(kernel)


def log_time(kernel: str, stage: str, start: float) -> None:
    """Logs how long ``stage`` of ``kernel`` took, which began at ``start`` of ``time.perf_counter``."""
    if "logging" in sys.modules:  # else nobody can have asked for it, and the import takes 2 ms
        import logging

        milliseconds = 1e3 * (time.perf_counter() - start)
        logging.getLogger("ebb.compiler").debug("%s: %s took %.2f ms", kernel, stage, milliseconds)


def dumps(kernel: str) -> bool:
    """Whether ``EBB_DUMP`` asks for the stages of the kernel of that name."""
    asked = os.environ.get("EBB_DUMP", "")
    return asked == "all" or kernel in asked.split(",")


def dump(kernel: str, stage: str, text: Callable[[], str]) -> None:
    """Prints ``text`` to stderr where ``EBB_DUMP`` asks for the stages of the kernel of that name."""
    if dumps(kernel):
        print(f"# {kernel} after {stage}\n{text()}\n", file=sys.stderr)
