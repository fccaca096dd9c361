"""Which loops over constant numbers are written out turn by turn.

LLVM writes out small ones by itself. Those over the corners of an element are larger, and worth more: indexes become
constants, so that small arrays stay in registers, and what turns have in common is computed once.
"""

from __future__ import annotations

from ebb.compiler import lir
from ebb.compiler.lir_walk import bodies

MOST_STATEMENTS = 3000
"""Loops that are longer than this when written out are left to LLVM. The stiffness of a tetrahedron takes 1,900; more
would miss the cache of instructions, and takes long to compile."""

FULLY = '!"llvm.loop.unroll.full"'
"""What tells LLVM to write a loop out."""


def is_unrolled(loop: lir.For) -> bool:
    """Whether ``loop`` is to be written out."""
    statements = length(loop)
    return statements is not None and statements <= MOST_STATEMENTS


def length(stmt: lir.Stmt) -> int | None:
    """The statements of ``stmt`` when its loops are written out; None if one of them cannot be."""
    turns = 1
    match stmt:
        case lir.For(_, lir.Literal(start), lir.Literal(stop)) if stmt.turns is lir.Turns.IN_ORDER:
            turns = max(0, stop - start)
        case lir.For() | lir.While():
            return None
        case _:
            pass
    lengths = [length(inner) for body in bodies(stmt) for inner in body]
    known = [each for each in lengths if each is not None]
    return 1 + turns * sum(known) if len(known) == len(lengths) else None
