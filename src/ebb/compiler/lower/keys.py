"""Keys: coordinates of grid rows, affine maps, identities, and where a value of a field lies."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, lcm

from ebb.compiler import kir, lir
from ebb.compiler.lower.builder import Values, index
from ebb.compiler.lower.context import Context, Moved
from ebb.compiler.lower.facts import target
from ebb.compiler.lower.sites import AffineSite, ComponentSite, KeySite
from ebb.diagnostics.span import Span
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.types.types import ScalarType, Type, int64, uint32, uint64

# ---- Coordinates ----


def coordinates(ctx: Context, grid: Relation, position: lir.Value) -> Values:
    """The coordinates of the row at ``position``, int64: known, or had by division."""
    known = ctx.coordinates.get(position.number) if isinstance(position, lir.Temp) else None
    match known:
        case None:
            return _divided(ctx, grid, position)
        case Moved(base, offsets):
            at = coordinates(ctx, grid, base)
            return tuple(ctx.build.add_index(c, offset) for c, offset in zip(at, offsets, strict=True))
        case _:
            return known


def _divided(ctx: Context, grid: Relation, position: lir.Value) -> Values:
    """Unsigned division, in 32 bits where that is enough: it is the slowest instruction there is."""
    b = ctx.build
    scalar = uint32 if grid.key_dtype.itemsize == 4 else uint64
    rest, result = b.convert(position, scalar), list[lir.Value]()
    for dimension in range(grid.ndim - 1, 0, -1):
        extent = b.convert(ctx.extent(grid, dimension), scalar)
        result.append(b.convert(b.binary("%", rest, extent), int64))
        rest = b.binary("//", rest, extent)
    return (b.convert(rest, int64), *reversed(result))


def linear(ctx: Context, grid: Relation, at: Sequence[lir.Value]) -> lir.Value:
    """The position of the row at the coordinates ``at``, which become known for it."""
    b = ctx.build
    position = at[0]
    for dimension in range(1, grid.ndim):
        position = b.add_index(b.scale_index(position, ctx.extent(grid, dimension)), at[dimension])
    if isinstance(position, lir.Temp):
        ctx.coordinates[position.number] = tuple(at)
    return position


def identity(ctx: Context, relation: Relation, position: lir.Value) -> lir.Value:
    """The number at its creation of the row at ``position``, int64."""
    if relation not in ctx.facts.permuted:
        return position
    return ctx.build.convert(ctx.build.load(ctx.slot(lir.RowOrder(relation)), position), int64)


# ---- Affine maps ----


def affine(ctx: Context, node: kir.Affine, base: lir.Value) -> lir.Value:
    """The position of the row that ``node`` maps the row at ``base`` to."""
    source, grid = target(node.key.type), target(node.type)
    offsets = _offsets(node, source, grid)
    if offsets is not None and not any(offsets):
        return base
    if offsets is not None and _stays_inside(ctx, node, grid, offsets):
        position = _moved(ctx, grid, base, offsets)
    else:
        position = _mapped(ctx, node, source, grid, base)
    if ctx.line is not None:
        ctx.line.note_move(base, offsets, position)
    return position


def _mapped(ctx: Context, node: kir.Affine, source: Relation, grid: Relation, base: lir.Value) -> lir.Value:
    """The position in ``grid`` by the coordinates of ``base``."""
    at = coordinates(ctx, source, base)
    asked = tuple(_row(ctx, row, at) for row in node.matrix)
    reached = tuple(_reached(row, source) for row in node.matrix)
    settled = tuple(_settled(ctx, node, grid, d, asked[d], reached[d]) for d in range(grid.ndim))
    _check(ctx, node, grid, asked, settled, reached)
    return linear(ctx, grid, settled)


def row_at(ctx: Context, node: kir.RowAt, asked: Values) -> lir.Value:
    """The position of the row at the coordinates ``asked``, int64."""
    grid = target(node.type)
    settled = tuple(_settled(ctx, node, grid, dimension, at, None) for dimension, at in enumerate(asked))
    _check(ctx, node, grid, asked, settled, (None,) * grid.ndim)
    return linear(ctx, grid, settled)


def _offsets(node: kir.Affine, source: Relation, grid: Relation) -> tuple[int, ...] | None:
    """The offset in each dimension where ``node`` moves by whole numbers on one grid."""
    if source is not grid:
        return None
    for dimension, row in enumerate(node.matrix):
        unit = all(entry == (1 if column == dimension else 0) for column, entry in enumerate(row[:-1]))
        if not unit or row[-1].denominator != 1:
            return None
    return tuple(int(row[-1]) for row in node.matrix)


def _stays_inside(ctx: Context, node: kir.Affine, grid: Relation, offsets: tuple[int, ...]) -> bool:
    """Whether the launch has checked the access and no dimension that it moves in wraps or clamps."""
    if node not in ctx.unchecked or node.edge is kir.Edge.CLAMP or not grid.size:
        return False
    return not any(offset and wraps for offset, wraps in zip(offsets, grid.periodic, strict=True))


def _moved(ctx: Context, grid: Relation, base: lir.Value, offsets: tuple[int, ...]) -> lir.Value:
    b = ctx.build
    position, stride = base, index(1)
    for dimension in range(grid.ndim - 1, -1, -1):
        if offsets[dimension]:
            position = b.add_index(position, b.scale_index(stride, offsets[dimension]))
        if dimension and any(offsets[:dimension]):
            stride = b.scale_index(stride, ctx.extent(grid, dimension))
    if isinstance(position, lir.Temp):
        ctx.coordinates[position.number] = Moved(base, offsets)
    return position


def _row(ctx: Context, entries: Sequence[kir.Entry], at: Values) -> lir.Value:
    """``floor(entries @ [*at, 1])`` in integers, by the common denominator."""
    b = ctx.build
    scale = lcm(*(entry.denominator for entry in entries))
    total: lir.Value = index(int(entries[-1] * scale))
    for entry, coordinate in zip(entries, at, strict=False):
        if entry:
            total = b.add_index(b.scale_index(coordinate, int(entry * scale)), total)
    if ctx.line is not None:
        ctx.line.note_row(tuple(entries), at, total)
    return total if scale == 1 else b.binary("//", total, index(scale))


def _reached(entries: Sequence[kir.Entry], source: Relation) -> range:
    """The coordinates that a map may ask for, from any row of ``source``: none if that has no rows."""
    if not source.size:
        return range(0)
    ends = [sorted((0, entry * (extent - 1))) for entry, extent in zip(entries, source.shape, strict=False)]
    low, high = (sum(end[side] for end in ends) + entries[-1] for side in (0, 1))
    return range(floor(low), floor(high) + 1)


def _within(reached: range | None, low: int, high: int) -> bool:
    """Whether all that is asked for lies from ``low`` on and below ``high``."""
    return reached is not None and (not reached or (reached.start >= low and reached.stop <= high))


def _settled(
    ctx: Context, node: kir.Affine | kir.RowAt, grid: Relation, dimension: int, asked: lir.Value, reached: range | None
) -> lir.Value:
    """The coordinate wrapped or clamped, where some row may ask for one beyond the grid."""
    size = grid.shape[dimension]
    bends = grid.periodic[dimension] or node.edge is kir.Edge.CLAMP
    if not bends or _within(reached, 0, size):
        return asked
    offset = None if ctx.line is None else ctx.line.offset(asked)
    if ctx.line is None or offset is None:
        return _bent(ctx, grid, dimension, asked, reached)
    if ctx.line.inside:
        return asked
    ctx.line.note_end(offset, size)
    bent = _bent(ctx, grid, dimension, asked, reached)
    if isinstance(bent, lir.Temp):
        ctx.line.offsets[bent.number] = offset
    return bent


def _bent(ctx: Context, grid: Relation, dimension: int, asked: lir.Value, reached: range | None) -> lir.Value:
    """The coordinate wrapped in a dimension that is periodic, or else clamped."""
    b = ctx.build
    size, extent = grid.shape[dimension], ctx.extent(grid, dimension)
    if grid.periodic[dimension]:
        if _within(reached, 0, 2 * size):
            return b.select(b.compare(">=", asked, extent), b.binary("-", asked, extent), asked)
        if _within(reached, -size, size):
            return b.select(b.compare("<", asked, index(0)), b.binary("+", asked, extent), asked)
        return _wrapped(ctx, asked, extent)
    last = b.add_index(extent, -1)
    return b.binary("max", b.binary("min", asked, last), index(0))


def _wrapped(ctx: Context, asked: lir.Value, extent: lir.Value) -> lir.Value:
    """The coordinate modulo the extent: within a period of the grid by a sum, else, which is rare, by a division."""
    b = ctx.build
    above = b.select(b.compare("<", asked, index(0)), b.binary("+", asked, extent), asked)
    near = b.select(b.compare(">=", above, extent), b.binary("-", above, extent), above)
    wrapped = b.declare("wrapped", int64, 1)
    b.store_var(wrapped, 0, near)
    with b.body() as beyond:
        b.store_var(wrapped, 0, b.binary("%", asked, extent))
    # From a period below to one above: in one comparison, as in ``outside``.
    periods = b.binary("+", extent, b.binary("+", extent, extent))
    b.add(lir.If(b.outside(b.binary("+", asked, extent), periods), tuple(beyond), ()))
    return b.load_var(wrapped)


def _check(
    ctx: Context,
    node: kir.Affine | kir.RowAt,
    grid: Relation,
    asked: Values,
    settled: Values,
    reached: Sequence[range | None],
) -> None:
    """Fails where the row does not exist, unless none asks for such; in a grid without rows that is always so."""
    if not grid.size:
        checked = list(range(grid.ndim))
    elif node in ctx.unchecked or node.edge is kir.Edge.CLAMP:
        checked = []
    else:
        may_leave = [not _within(span, 0, size) for span, size in zip(reached, grid.shape, strict=True)]
        checked = [d for d in range(grid.ndim) if may_leave[d] and not grid.periodic[d]]
    outside = [ctx.build.outside(settled[d], ctx.extent(grid, d)) for d in checked]
    if outside:
        ctx.fail_if(ctx.build.any(outside), AffineSite(node), asked)


# ---- Places ----


def part(ctx: Context, indices: Sequence[kir.Expr], values: Sequence[lir.Value], type_: Type) -> tuple[lir.Value, int]:
    """Where the part of a value of ``type_`` that ``indices`` select starts, and its size, in components."""
    b = ctx.build
    start: lir.Value = index(0)
    size = type_.size
    for axis, (expr, value) in enumerate(zip(indices, values, strict=True)):
        extent = type_.shape[axis]
        size //= extent
        at = b.convert(value, int64)
        if not _in_range(ctx, expr, extent):
            ctx.fail_if(b.outside(at, index(extent)), ComponentSite(expr.span, axis, type_), (at,))
        start = b.add_index(start, b.scale_index(at, size))
    return start, size


def _in_range(ctx: Context, expr: kir.Expr, extent: int) -> bool:
    match expr:
        case kir.Const():
            return True
        case kir.ReadLocal(local) if local.uid in ctx.ranges:
            first, last = ctx.ranges[local.uid]
            return first >= 0 and last < extent
        case kir.Cast(operand):
            return _in_range(ctx, operand, extent)
        case _:
            return False


@record
class Place:
    """Where components of a row lie in the slot of a field.

    Attributes:
        first: the index of the first of them.
        step: from one to the next.
    """

    first: lir.Value
    step: lir.Value

    def component(self, ctx: Context, k: int) -> lir.Value:
        """The index of the component ``k`` after the first."""
        return ctx.build.add_index(self.first, ctx.build.scale_index(self.step, k))


def place(ctx: Context, field: Field, position: lir.Value, start: lir.Value) -> Place:
    """Where the components from ``start`` on of the row at ``position`` lie. The one place that knows the layouts."""
    b = ctx.build
    if field not in ctx.facts.columns:
        return Place(b.add_index(b.scale_index(position, field.type.size), start), index(1))
    step = ctx.argument(lir.ColumnStride(field.relation, field.type.dtype.itemsize), int64)
    return Place(b.add_index(b.scale_index(start, step), position), step)


def read_field(ctx: Context, field: Field, position: lir.Value, start: lir.Value, size: int, span: Span) -> Values:
    """``size`` components of a field's value in a row, from ``start`` on. Keys among them must be set."""
    b = ctx.build
    if ctx.line is not None:
        ctx.line.note_read(field, position)
    slot, at = ctx.slot(lir.FieldData(field)), place(ctx, field, position, start)
    loaded = [b.load(slot, at.component(ctx, k)) for k in range(size)]
    if isinstance(field.type.scalar, ScalarType):
        return tuple(loaded)
    keys = [b.convert(key, int64) for key in loaded]
    if field in ctx.facts.unset and keys:
        unset = b.any([b.compare("<", key, index(0)) for key in keys])
        ctx.fail_if(unset, KeySite(span, field), (position,))
    return tuple(keys)
