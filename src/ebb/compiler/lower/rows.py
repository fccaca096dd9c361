"""The loop over the rows of a block: its body, that of the rows inside, and what passes by the cache."""

from __future__ import annotations

from ebb.compiler import kir, lir
from ebb.compiler.kir_walk import draws, expressions, statements
from ebb.compiler.lower.bindings import variables
from ebb.compiler.lower.context import Context, Launched, value_scalar
from ebb.compiler.lower.keys import linear
from ebb.compiler.lower.line import Line
from ebb.compiler.lower.statements import bind, lower_body
from ebb.compiler.phases.residency import overwritten
from ebb.relations.field import Field
from ebb.types.types import int64, uint64


def row_loop(ctx: Context, launched: Launched, rows: lir.Rows, stores: lir.Stores) -> lir.RowLoop:
    """The loop over the rows of a block.

    Args:
        ctx: where nothing is lowered yet. Its ``line`` is set if rows need not all run the same code.
        launched: how the rows of the launches are given.
        rows: whether they run in order.
        stores: whether what they write may stay in the cache.
    """
    kernel, b = ctx.kernel, ctx.build
    index = tuple(b.temp(int64) for _ in range(kernel.relation.ndim if launched is Launched.BOXES else 1))
    body = _body(ctx, index, launched)
    inside = None
    if ctx.line is not None and launched is Launched.BOXES and 0 < sum(ctx.line.ends) < ctx.line.extent:
        inside = _inside(ctx, index, ctx.line)
    streaming = None
    if ctx.line is not None and stores is lir.Stores.STREAMED:
        streaming = _streaming(ctx, ctx.line)
    return lir.RowLoop(index, rows, body, inside, streaming)


def _inside(ctx: Context, index: tuple[lir.Temp, ...], line: Line) -> lir.Inside:
    """The body again, for rows that are not near the ends of a line. Its variables take the place of the others."""
    line.inside = True
    used = ctx.build.private_bytes
    body = _body(ctx, index, Launched.BOXES)
    ctx.build.private_bytes = used
    relation = ctx.kernel.relation
    length = lir.Extent(relation, relation.ndim - 1)
    if length not in ctx.arguments:
        ctx.arguments[length] = lir.Argument(len(ctx.arguments), int64, length)
    return lir.Inside(line.ends, ctx.arguments[length], body)


def _body(ctx: Context, index: tuple[lir.Temp, ...], launched: Launched) -> lir.Body:
    b, kernel = ctx.build, ctx.kernel
    for known in (ctx.values, ctx.variables, ctx.ranges, ctx.coordinates, ctx.labels):
        known.clear()
    with b.body() as body:
        match launched:
            case Launched.ALL:
                ctx.row = index[0]
            case Launched.LISTED:
                ctx.row = b.load(ctx.slot(lir.LaunchPositions()), index[0])
            case Launched.BOXES:
                ctx.row = linear(ctx, kernel.relation, index)
        if ctx.line is not None:
            ctx.line.begin(index, ctx.row)
        for local in variables(kernel):
            ctx.variables[local.uid] = b.declare(local.name, value_scalar(local.type.scalar), local.type.size)
        if draws(kernel):
            ctx.drawn = b.declare("drawn", uint64, 1)
        bind(ctx, kernel.row, (ctx.row,))
        lower_body(ctx, kernel.body)
    return tuple(body)


def _streaming(ctx: Context, line: Line) -> lir.Streaming | None:
    """What rows only write, and what they read of other lines of the grid."""
    fields = [field for field in _only_written(ctx) if _passes(ctx, field)]
    if not fields or ctx.row is None:
        return None
    return lir.Streaming(
        tuple(_place(ctx, field, ctx.row) for field in fields),
        tuple(
            _place(ctx, field, position)
            for field, (moved, position) in line.farthest.items()
            if any(moved[:-1]) and field not in ctx.facts.columns
        ),
    )


def _place(ctx: Context, field: Field, position: lir.Value) -> lir.RowPlace:
    return lir.RowPlace(ctx.slot(lir.FieldData(field)), position, field.type.size)


def _only_written(ctx: Context) -> list[Field]:
    """The fields that the kernel writes whole in every row and never looks at."""
    read = {expr.field for expr in expressions(ctx.kernel.body) if isinstance(expr, kir.ReadField)}
    read |= {stmt.field for stmt in statements(ctx.kernel.body) if isinstance(stmt, kir.ReduceField)}
    return [field for field in ctx.phases.fields if field in overwritten(ctx.kernel, ctx.phases) - read]


def _passes(ctx: Context, field: Field) -> bool:
    """Whether values of ``field`` may be stored past the cache: they lie row after row, in words."""
    return field.type.dtype.itemsize >= 4 and field not in ctx.facts.columns
