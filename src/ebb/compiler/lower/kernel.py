"""A kernel as an LIR program: the loop over rows, and what stands around it."""

from __future__ import annotations

from collections.abc import Iterable

from ebb.compiler import kir, lir
from ebb.compiler.kir_walk import statements
from ebb.compiler.lower.bindings import variables
from ebb.compiler.lower.context import Context, Launched, value_scalar
from ebb.compiler.lower.facts import Facts
from ebb.compiler.lower.line import Line
from ebb.compiler.lower.reductions import combine_partials, open_accumulators, reduced_globals, store_partials
from ebb.compiler.lower.rows import row_loop
from ebb.compiler.phases.order import InOrder, shares_sums, why_in_order
from ebb.compiler.phases.table import PhaseTable
from ebb.types.types import int64


def lower(
    kernel: kir.Kernel,
    phases: PhaseTable,
    unchecked: Iterable[kir.Affine],
    facts: Facts,
    launched: Launched,
    precision: lir.Precision,
    updates: lir.Updates = lir.Updates.PLAIN,
    group_size: int | None = None,
    stores: lir.Stores = lir.Stores.KEPT,
) -> lir.Program:
    """``kernel`` as LIR.

    Args:
        kernel: a checked kernel.
        phases: of its fields and globals.
        unchecked: its affine accesses that ``check_stencil`` checks before each launch.
        facts: what holds of the data whenever the program runs.
        launched: how the rows of the launches are given.
        precision: what the optimiser may do to floats.
        updates: how rows reduce into other rows.
        group_size: how many threads share a block; None where a block is for one thread. Where rows run in order, the
            program has one thread a group.
        stores: whether what rows write may stay in the cache; only threads that take whole blocks go past it.
    """
    ctx = Context(kernel, phases, frozenset(unchecked), facts, updates)
    reduced = reduced_globals(kernel)
    rows = _rows(kernel, phases, updates, group_size)
    if group_size is not None and rows is lir.Rows.IN_ORDER:
        group_size = 1
    strided = group_size is not None and (reduced or rows is lir.Rows.IN_ORDER)
    block_number = ctx.build.temp(int64)
    if rows is lir.Rows.INDEPENDENT and group_size is None and launched is not Launched.LISTED:
        ctx.line = Line(kernel.relation.shape[-1])
    with ctx.build.body() as block:
        open_accumulators(ctx, reduced)
        loop = row_loop(ctx, launched, rows, stores)
        ctx.build.add(loop)
        store_partials(ctx, reduced, block_number, group_size)
    with ctx.build.body() as finish:
        combine_partials(ctx, reduced, group_size)
    return lir.Program(
        name=kernel.name,
        space=lir.Space.BOX if launched is Launched.BOXES else lir.Space.LINE,
        dimensions=len(loop.index),
        group_size=group_size,
        coverage=lir.Coverage.STRIDED if strided else lir.Coverage.ONE,
        precision=precision,
        slots=tuple(ctx.slots.values()),
        arguments=tuple(ctx.arguments.values()),
        block_number=block_number,
        block=tuple(block),
        finish=tuple(finish),
        private_bytes=ctx.build.private_bytes,
        sites=tuple(ctx.sites),
        prints=tuple(ctx.prints),
        print_words=ctx.print_words,
    )


def _rows(kernel: kir.Kernel, phases: PhaseTable, updates: lir.Updates, group_size: int | None) -> lir.Rows:
    """Whether rows run in order: for plain shared sums, and for prints, but those of groups are sorted by the host."""
    prints = group_size is None and why_in_order(kernel, phases) is InOrder.PRINTS
    shares = updates is lir.Updates.PLAIN and shares_sums(phases)
    return lir.Rows.IN_ORDER if prints or shares else lir.Rows.INDEPENDENT


def variable_bytes(kernel: kir.Kernel) -> int:
    """The size of the locals of ``kernel`` that need memory; ``Program.private_bytes`` is at least that."""
    return _bytes(variables(kernel))


def most_variable_bytes(kernel: kir.Kernel) -> int:
    """At least ``variable_bytes``, and sooner known: the size of all locals, whether they need memory or not."""
    bound = [
        stmt.local for stmt in statements(kernel.body) if isinstance(stmt, kir.Assign | kir.ForRange | kir.ForQuery)
    ]
    return _bytes(dict.fromkeys((kernel.row, *bound)))


def _bytes(locals_: Iterable[kir.Local]) -> int:
    return sum([value_scalar(local.type.scalar).bits // 8 * local.type.size for local in locals_])
