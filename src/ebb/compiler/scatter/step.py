"""A step of a launch: one kernel of those that run one after the other in the place of the one that was written."""

from __future__ import annotations

from ebb.compiler import kir
from ebb.compiler.phases.table import PhaseTable
from ebb.records import record


@record(eq=False)
class Step:
    """A kernel, and what the lowering knows of it.

    Attributes:
        kernel: the kernel.
        phases: of its fields and globals.
        unchecked: its affine accesses that are known to stay within their grids.
    """

    kernel: kir.Kernel
    phases: PhaseTable
    unchecked: tuple[kir.Affine, ...]
