"""Reductions into globals: a private sum for each block, and a finish that adds the blocks up in their order.

A group of threads has a private sum each, which a tree combines; so do those that share the finish. So the result does
not depend on which thread runs when.
"""

from __future__ import annotations

from ebb.compiler import kir, lir
from ebb.compiler.kir_walk import statements
from ebb.compiler.lower.builder import index
from ebb.compiler.lower.context import Context, value_scalar
from ebb.compiler.lower.trees import Tree
from ebb.relations.globals import Global
from ebb.types.arithmetic import identity_of
from ebb.types.types import ScalarType, int64


def reduced_globals(kernel: kir.Kernel) -> dict[Global, str]:
    """The globals that ``kernel`` reduces, each with its operator, in the order of their first use."""
    found: dict[Global, str] = {}
    for stmt in statements(kernel.body):
        if isinstance(stmt, kir.ReduceGlobal):
            found.setdefault(stmt.globl, stmt.op.value)
    return found


def open_accumulators(ctx: Context, reduced: dict[Global, str]) -> None:
    """Declares a private sum for each of ``reduced`` at the start of the block."""
    for globl, op in reduced.items():
        scalar = value_scalar(globl.type.scalar)
        var = ctx.build.declare("sum", scalar, globl.type.size)
        ctx.accumulators[globl] = var
        ctx.build.store_all(var, [_identity(op, scalar)] * var.size)


def store_partials(ctx: Context, reduced: dict[Global, str], block: lir.Value, group_size: int | None) -> None:
    """Stores what the block has summed."""
    if not reduced:
        return
    b, tree = ctx.build, Tree(ctx.build, group_size or 1)
    for reduction, (globl, op) in enumerate(reduced.items()):
        var = ctx.accumulators[globl]
        slot = ctx.slot(lir.Partials(reduction, var))
        first = b.scale_index(block, var.size)
        for k in range(var.size):
            with tree.combined(op, (var, k)) as place:
                b.add(lir.Store(slot, b.add_index(first, k), b.load_var(*place)))


def combine_partials(ctx: Context, reduced: dict[Global, str], group_size: int | None) -> None:
    """Adds the sums of the blocks up and into the globals."""
    if not reduced:
        return
    b, tree = ctx.build, Tree(ctx.build, group_size or 1)
    for reduction, (globl, op) in enumerate(reduced.items()):
        size, scalar = globl.type.size, value_scalar(globl.type.scalar)
        total = b.declare("total", scalar, size)
        b.store_all(total, [_identity(op, scalar)] * size)
        partials = ctx.slot(lir.Partials(reduction, ctx.accumulators[globl]))
        counter, blocks = b.temp(int64), ctx.argument(lir.BlockCount(), int64)
        with b.body() as turn:
            first = b.scale_index(tree.item(counter), size)
            for k in range(size):
                partial = b.load(partials, b.add_index(first, k))
                b.store_var(total, k, b.binary(op, b.load_var(total, k), partial))
        b.add(lir.For(counter, index(0), tree.turns(blocks), tuple(turn), lir.Turns.IN_ORDER))
        slot = ctx.slot(lir.GlobalData(globl))
        for k in range(size):
            with tree.combined(op, (total, k)) as place:
                b.add(lir.Store(slot, index(k), b.binary(op, b.load(slot, index(k)), b.load_var(*place))))


def _identity(op: str, scalar: ScalarType) -> lir.Literal:
    return lir.Literal(identity_of(op, scalar.dtype).item(), scalar)
