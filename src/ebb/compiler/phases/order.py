"""Whether the rows of a kernel may run in any order, on any thread: for the lowering and for ``explain``."""

from __future__ import annotations

from enum import Enum

from ebb.compiler import kir
from ebb.compiler.kir_walk import statements
from ebb.compiler.phases.table import PhaseKind, PhaseTable


class InOrder(Enum):
    """Why rows run one after the other: the text is for ``explain``."""

    PRINTS = "so that what they print comes in order"
    SHARED_SUMS = "so that sums in other rows do not depend on the threads"


def why_in_order(kernel: kir.Kernel, phases: PhaseTable) -> InOrder | None:
    """Why the rows of ``kernel`` run one after the other, or None: then blocks of rows run on all threads."""
    if any(isinstance(stmt, kir.Print) for stmt in statements(kernel.body)):
        return InOrder.PRINTS
    return InOrder.SHARED_SUMS if shares_sums(phases) else None


def shares_sums(phases: PhaseTable) -> bool:
    """Whether rows reduce into rows that others reduce into."""
    return any(phase.kind is PhaseKind.REDUCE for phase in phases.fields.values())
