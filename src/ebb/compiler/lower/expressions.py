"""KIR expressions to LIR: each becomes the tuple of its components, row-major; a key is one int64 position."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ebb.compiler import kir, lir
from ebb.compiler.lower.builder import Values, arm, index, number
from ebb.compiler.lower.builtins import LOWERING
from ebb.compiler.lower.context import Context, value_scalar
from ebb.compiler.lower.facts import target
from ebb.compiler.lower.keys import affine, coordinates, identity, part, read_field, row_at
from ebb.compiler.lower.random import draw
from ebb.types.types import Kind, ScalarType, Type, bool_, int32, int64


def lower_expr(ctx: Context, expr: kir.Expr) -> Values:  # noqa: C901 - one case a kind of expression
    """The components of ``expr``; what computes them goes to the open body."""
    b, scalar = ctx.build, value_scalar(expr.type.scalar)
    match expr:
        case kir.Const(value):
            return tuple(number(item, scalar) for item in _flat(value))
        case kir.Uniform(uniform):
            return _uniform(ctx, uniform, expr.type, range(expr.type.size))
        case kir.ReadLocal(local):
            return ctx.values[local.uid] if local.uid in ctx.values else b.load_all(ctx.variables[local.uid])
        case kir.ReadGlobal(globl):
            slot = ctx.slot(lir.GlobalData(globl))
            return tuple(b.load(slot, index(k)) for k in range(expr.type.size))
        case kir.ReadField(field, key):
            return read_field(ctx, field, lower_scalar(ctx, key), index(0), expr.type.size, expr.span)
        case kir.Unary(op, operand):
            return tuple(b.unary(op, value) for value in lower_expr(ctx, operand))
        case kir.Binary():
            return _binary(ctx, expr, scalar)
        case kir.Compare(op, left, right):
            return tuple(b.compare(op, x, y) for x, y in _pairs(ctx, left, right))
        case kir.Logic(op, left, right):
            return _logic(ctx, op, left, right)
        case kir.Choose(condition, then, other):
            decided = lower_scalar(ctx, condition)
            return _choose(ctx, decided, then, other)
        case kir.Cast(operand):
            return tuple(b.convert(value, scalar) for value in lower_expr(ctx, operand))
        case kir.Splat(operand):
            return (lower_scalar(ctx, operand),) * expr.type.size
        case kir.Build(elements):
            return tuple(value for element in elements for value in lower_expr(ctx, element))
        case kir.Component():
            return _component(ctx, expr)
        case kir.Call(builtin, arguments):
            lowered = tuple(lower_expr(ctx, argument) for argument in arguments)
            return LOWERING[builtin](b, lowered, tuple(argument.type for argument in arguments), expr.type)
        case kir.Random():
            return (draw(ctx, expr),)
        case kir.Affine(_, key):
            return (affine(ctx, expr, lower_scalar(ctx, key)),)
        case kir.RowAt(asked):
            return (row_at(ctx, expr, lower_expr(ctx, asked)),)
        case kir.RowId(key):
            return (identity(ctx, target(key.type), lower_scalar(ctx, key)),)
        case kir.Coords(key):
            at = coordinates(ctx, target(key.type), lower_scalar(ctx, key))
            return tuple(b.convert(coordinate, int32) for coordinate in at)
        case kir.QuerySize(grouped, key):
            start, stop = group(ctx, grouped, lower_scalar(ctx, key))
            return (b.convert(b.binary("-", stop, start), int32),)


def lower_scalar(ctx: Context, expr: kir.Expr) -> lir.Value:
    """The one component of a scalar or key."""
    (value,) = lower_expr(ctx, expr)
    return value


def lower_indices(ctx: Context, indices: Sequence[kir.Expr]) -> list[lir.Value]:
    """The values of the indices of a part."""
    return [lower_scalar(ctx, expr) for expr in indices]


def group(ctx: Context, grouped: Any, key: lir.Value) -> tuple[lir.Value, lir.Value]:
    """Where the group of the row at ``key`` starts and stops."""
    b, slot = ctx.build, ctx.slot(lir.GroupOffsets(grouped))
    bounds = b.load(slot, key), b.load(slot, b.add_index(key, 1))
    return b.convert(bounds[0], int64), b.convert(bounds[1], int64)


def _flat(value: Any) -> list[Any]:
    if isinstance(value, tuple):
        return [item for inner in value for item in _flat(inner)]  # pyright: ignore[reportUnknownVariableType]
    return [value]


def _pairs(ctx: Context, left: kir.Expr, right: kir.Expr) -> list[tuple[lir.Value, lir.Value]]:
    first = lower_expr(ctx, left)
    return list(zip(first, lower_expr(ctx, right), strict=True))


def _uniform(ctx: Context, uniform: int, type_: Type, components: range) -> Values:
    scalar = value_scalar(type_.scalar)
    return tuple(ctx.argument(lir.UniformComponent(uniform, k), scalar) for k in components)


# ---- Operators ----


def _binary(ctx: Context, expr: kir.Binary, scalar: ScalarType) -> Values:
    b, pairs = ctx.build, _pairs(ctx, expr.left, expr.right)
    if expr.op == "**":
        function = "pow" if scalar.kind is Kind.FLOAT else "ipow"
        return tuple(b.math(function, x, y) for x, y in pairs)
    return tuple(b.binary(expr.op, x, y) for x, y in pairs)


def _logic(ctx: Context, op: str, left: kir.Expr, right: kir.Expr) -> Values:
    decided = lower_scalar(ctx, left)
    with ctx.build.body() as body:
        values = lower_expr(ctx, right)
    evaluated, skipped = arm(body, values), arm((), (number(op == "or", bool_),))
    if op == "and":
        return ctx.build.choose(decided, evaluated, skipped)
    return ctx.build.choose(decided, skipped, evaluated)


def _choose(ctx: Context, condition: lir.Value, then: kir.Expr, other: kir.Expr) -> Values:
    with ctx.build.body() as then_body:
        then_values = lower_expr(ctx, then)
    with ctx.build.body() as other_body:
        other_values = lower_expr(ctx, other)
    return ctx.build.choose(condition, arm(then_body, then_values), arm(other_body, other_values))


# ---- Parts of values ----


def _component(ctx: Context, expr: kir.Component) -> Values:
    operand, size = expr.operand, expr.type.size
    match operand:
        case kir.ReadField(field, key):
            position = lower_scalar(ctx, key)
            start, _ = part(ctx, expr.indices, lower_indices(ctx, expr.indices), operand.type)
            return read_field(ctx, field, position, start, size, expr.span)
        case kir.ReadLocal(local) if local.uid in ctx.variables:
            start, _ = part(ctx, expr.indices, lower_indices(ctx, expr.indices), operand.type)
            var = ctx.variables[local.uid]
            return tuple(ctx.build.load_var(var, ctx.build.add_index(start, k)) for k in range(size))
        case _:
            values = lower_expr(ctx, operand)
            start, _ = part(ctx, expr.indices, lower_indices(ctx, expr.indices), operand.type)
            return _picked(ctx, values, start, size)


def _picked(ctx: Context, values: Values, start: lir.Value, size: int) -> Values:
    """``size`` of ``values`` from ``start`` on, through memory where that is not known."""
    if isinstance(start, lir.Literal):
        return values[start.value : start.value + size]
    var = ctx.build.declare("picked", values[0].type, len(values))
    ctx.build.store_all(var, values)
    return tuple(ctx.build.load_var(var, ctx.build.add_index(start, k)) for k in range(size))
