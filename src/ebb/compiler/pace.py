"""How a kernel goes over its rows: whether LLVM makes code of it that computes several at once, and what that gains."""

from __future__ import annotations

from ebb.compiler import kir
from ebb.compiler.cost import Cost, cost_of
from ebb.compiler.kir_walk import statements
from ebb.compiler.phases.centered import find_centered
from ebb.relations.reach import Pace

OPERATIONS_A_BYTE = 0.5
"""From how many operations on a byte on the time surely goes into arithmetic, not into waiting for memory. A product of
two matrices has about 0.4 and does not gain by columns, a determinant has 0.7 and does.
"""


def is_straight(kernel: kir.Kernel) -> bool:
    """Whether rows have neither loops nor ways out: several are computed at once, whatever they read and change."""
    straight = kir.Assign | kir.WriteField | kir.ReduceField | kir.ReduceGlobal | kir.If | kir.Assert
    return all([isinstance(stmt, straight) for stmt in statements(kernel.body)])


def pace_of(kernel: kir.Kernel, cost: Cost | None = None) -> Pace:
    """How ``kernel`` goes over its rows, a row of which has this cost, if that is known."""
    centered = find_centered(kernel)
    for stmt in statements(kernel.body):
        match stmt:
            case kir.WriteField() | kir.Assign() | kir.If() | kir.ReduceGlobal() | kir.Breakpoint():
                pass
            case kir.ReduceField(key=key) if centered.is_centered(key):
                pass
            case _:
                return Pace.SCALAR
    cost = cost or cost_of(kernel)
    return Pace.VECTOR if cost.operations >= OPERATIONS_A_BYTE * cost.bytes else Pace.MEMORY
