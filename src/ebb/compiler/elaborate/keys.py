"""Functions of keys: queries, affine maps and coordinates both ways, row numbers, and each row's random numbers."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ebb.compiler import kir
from ebb.compiler.elaborate.attributes import relation_of
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.convert import convert, typed
from ebb.compiler.elaborate.errors_calls import (
    AffineArguments,
    KeyArgument,
    NotGrouped,
    RandomType,
    RowAtArguments,
    WhereArguments,
)
from ebb.compiler.elaborate.errors_types import NotCompileTime
from ebb.compiler.elaborate.values import Poison, Query, Sequence, Static, Typed, Value, Weak, is_items, noun
from ebb.compiler.host import HostConst
from ebb.diagnostics.span import Span
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.types.types import KeyType, Kind, ScalarType, VectorType, float64, int32, int64

Matrix = tuple[tuple[kir.Entry, ...], ...]
_Wrong = type[AffineArguments] | type[RowAtArguments]

_MOST_UNITS = 1 << 31
"""The most that the factors and the offset of a row may sum to, in units of their common denominator.

Backends compute ``floor(row @ [*coordinates, 1])`` in 64 bits, and coordinates may need half of them.
"""


def where(ctx: Context, given: list[Value], named: Mapping[str, Value], span: Span) -> Value:
    """``ebb.where(edges.tail, v)``."""
    if len(given) != 2 or named:
        return ctx.poison(WhereArguments(span, f"takes a key field and a key, not {len(given) + len(named)} values"))
    match given[0]:
        case Static(Field() as field, _, _) if isinstance(field.type, KeyType):
            pass
        case Static(Field() as field, _, where_span):
            return ctx.poison(
                WhereArguments(where_span, f"takes a field of keys, and '{field.path}' is {field.type!r}")
            )
        case other:
            return ctx.poison(WhereArguments(other.span, f"takes a field of a relation first, not {noun(other)}"))
    if field.grouping is None:
        return ctx.poison(NotGrouped(given[0].span, field.path, field.relation.name, field.name))
    key = convert(ctx, given[1], field.type, f"the field '{field.path}'")
    return Poison(span) if key is None else Query(field, key, (), span)


def affine(ctx: Context, given: list[Value], named: Mapping[str, Value], span: Span) -> Value:
    """``ebb.affine(target, matrix, key, edge="clamp")``."""
    names = ("target", "matrix", "key", "edge")
    matched = dict(zip(names, given, strict=False)) | dict(named)
    if len(given) + len(named) != len(matched) or set(matched) - {"edge"} != set(names[:3]) or len(given) > 4:
        return ctx.poison(AffineArguments(span, "takes a target, a matrix and a key, and perhaps an edge"))
    target = _grid(ctx, matched["target"], AffineArguments)
    key = typed(ctx, matched["key"])
    if target is None or key is None:
        return Poison(span)
    if not isinstance(key.type, KeyType) or not relation_of(key).is_grid:
        found = f"a key of '{relation_of(key).name}'" if isinstance(key.type, KeyType) else repr(key.type)
        return ctx.poison(AffineArguments(key.span, f"takes a key of a grid, not {found}"))
    matrix = _matrix(ctx, matched["matrix"])
    edge = _edge(ctx, matched.get("edge"), AffineArguments)
    if matrix is None or edge is None:
        return Poison(span)
    shape = (target.ndim, relation_of(key).ndim + 1)
    if (len(matrix), *{len(row) for row in matrix}) != shape:
        sizes = " and ".join(str(len(row)) for row in matrix)
        text = f"takes a {shape[0]} x {shape[1]} matrix here, not {len(matrix)} rows of {sizes}"
        return ctx.poison(AffineArguments(matched["matrix"].span, text))
    return Typed(kir.Affine(matrix, key, edge, target.key_type, span))


def row_at(ctx: Context, given: list[Value], named: Mapping[str, Value], span: Span) -> Value:
    """``ebb.row_at(target, coordinates, edge="clamp")``."""
    names = ("target", "coordinates", "edge")
    matched = dict(zip(names, given, strict=False)) | dict(named)
    if len(given) + len(named) != len(matched) or set(matched) - {"edge"} != set(names[:2]) or len(given) > 3:
        return ctx.poison(RowAtArguments(span, "takes a target and coordinates, and perhaps an edge"))
    target = _grid(ctx, matched["target"], RowAtArguments)
    edge = _edge(ctx, matched.get("edge"), RowAtArguments)
    if target is None or edge is None:
        return Poison(span)
    wanted = VectorType(int64, target.ndim)
    coordinates = convert(ctx, matched["coordinates"], wanted, f"the coordinates of a row of '{target.name}'")
    return Poison(span) if coordinates is None else Typed(kir.RowAt(coordinates, edge, target.key_type, span))


def _grid(ctx: Context, value: Value, wrong: _Wrong) -> Relation | None:
    match value:
        case Static(Relation() as relation, _, _) if relation.is_grid:
            return relation
        case Static(Relation() as relation, _, span):
            ctx.report(wrong(span, f"takes a grid first, and '{relation.name}' has no shape"))
        case Poison():
            pass
        case other:
            ctx.report(wrong(other.span, f"takes a grid first, not {noun(other)}"))
    return None


def _edge(ctx: Context, value: Value | None, wrong: _Wrong) -> kir.Edge | None:
    match value:
        case None:
            return kir.Edge.CHECK
        case Static(str() as text, _, _) if text in ("check", "clamp"):
            return kir.Edge(text)
        case Poison():
            return None
        case other:
            ctx.report(wrong(other.span, 'takes edge="check" or edge="clamp"'))
            return None


def _matrix(ctx: Context, value: Value) -> Matrix | None:
    """The matrix of an affine map: numbers that are known when the kernel is compiled."""
    rows = [_entries(ctx, row) for row in _rows(ctx, value) or ()]
    if not rows:
        if not isinstance(value, Poison):
            ctx.report(AffineArguments(value.span, "takes a matrix: a list of rows"))
        return None
    return None if None in rows else tuple(row for row in rows if row is not None)


def _rows(ctx: Context, value: Value) -> list[Value] | None:
    match value:
        case Sequence(elements, _):
            return list(elements)
        case Static(items, host, span) if is_items(items):
            ctx.guard_value(host, items)
            return [Static(item, host, span) for item in items]
        case Typed(expr):
            items = ctx.known(expr)
            if not isinstance(items, np.ndarray) or items.ndim != 2:
                return None
            return [Static(row.tolist(), HostConst(None), expr.span) for row in items]
        case _:
            return None


def _entries(ctx: Context, row: Value) -> tuple[kir.Entry, ...] | None:
    match row:
        case Sequence(elements, _):
            entries = [_entry(ctx, element) for element in elements]
        case Static(items, _, span) if is_items(items):
            entries = [_fraction(ctx, item, span) for item in items]
        case Poison():
            return None
        case _:
            ctx.report(AffineArguments(row.span, "takes a matrix whose rows are lists of numbers"))
            return None
    exact = tuple(entry for entry in entries if entry is not None)
    if len(exact) < len(entries):
        return None
    scale = math.lcm(*(entry.denominator for entry in exact))
    if sum(abs(entry) for entry in exact) * scale > _MOST_UNITS:
        text = "takes whole numbers and simple fractions: these are too large, or have too large a common denominator"
        ctx.report(AffineArguments(row.span, text))
        return None
    return exact


def _entry(ctx: Context, value: Value) -> kir.Entry | None:
    match value:
        case Poison():
            return None
        case Weak(host, number, span):
            ctx.guard_value(host, number)
            return _fraction(ctx, number, span)
        case Static(number, host, span) if _is_fraction(number):
            ctx.guard_value(host, number)
            return _fraction(ctx, number, span)
        case Typed(kir.Const(number, ScalarType(), span)):
            return _fraction(ctx, number, span)
        case Typed(expr) if isinstance(number := ctx.known(expr), np.generic):
            return _fraction(ctx, number.item(), expr.span)
        case other:
            ctx.report(NotCompileTime(other.span, "an entry of the matrix of 'ebb.affine'"))
            return None


def _fraction(ctx: Context, number: Any, span: Span) -> kir.Entry | None:
    """``number`` as it was meant: the fraction of a small denominator that it was rounded from, if there is one."""
    if isinstance(number, int) or (isinstance(number, float) and number.is_integer()):
        return int(number)
    from fractions import Fraction  # here: few maps have any, and the import takes longer than a launch may

    try:
        exact = Fraction(number)
    except (TypeError, ValueError, OverflowError):
        ctx.report(AffineArguments(span, f"takes numbers, not {number!r}"))
        return None
    near = exact.limit_denominator(1_000_000)
    meant = near if float(near) == float(exact) else exact
    return meant.numerator if meant.denominator == 1 else meant


def _is_fraction(value: Any) -> bool:
    return "fractions" in sys.modules and isinstance(value, sys.modules["fractions"].Fraction)


# ---- ebb.id, ebb.coords, ebb.rand, ebb.randn ----


def _row_id(ctx: Context, given: list[Value], span: Span) -> Value:
    key = _key(ctx, "id", given, span)
    return Poison(span) if key is None else Typed(kir.RowId(key, int64, span))


def _coords(ctx: Context, given: list[Value], span: Span) -> Value:
    key = _key(ctx, "coords", given, span)
    if key is None:
        return Poison(span)
    relation = relation_of(key)
    if not relation.is_grid:
        return ctx.poison(
            KeyArgument(key.span, "coords", "a key of a grid", f"a key of '{relation.name}', which is none")
        )
    return Typed(kir.Coords(key, VectorType(int32, relation.ndim), span))


def _key(ctx: Context, name: str, given: list[Value], span: Span) -> kir.Expr | None:
    if len(given) != 1:
        ctx.report(KeyArgument(span, name, "one key", f"{len(given)} values"))
        return None
    key = typed(ctx, given[0])
    if key is not None and not isinstance(key.type, KeyType):
        ctx.report(KeyArgument(key.span, name, "a key", f"a value of type {key.type!r}"))
        return None
    return key


def _random(name: str) -> Callable[[Context, list[Value], Span], Value]:
    def draw(ctx: Context, given: list[Value], span: Span) -> Value:
        match given:
            case []:
                scalar = float64
            case [Static(ScalarType(kind=Kind.FLOAT) as scalar, _, _)]:
                pass
            case _:
                return ctx.poison(RandomType(span, name))
        return Typed(ctx.temporary(name, kir.Random(name, scalar, span)))

    return draw


FORMS: Mapping[str, Callable[[Context, list[Value], Span], Value]] = {
    "id": _row_id,
    "coords": _coords,
    "rand": _random("rand"),
    "randn": _random("randn"),
}

INTRINSICS: Mapping[str, Callable[[Context, list[Value], Mapping[str, Value], Span], Value]] = {
    "where": where,
    "affine": affine,
    "row_at": row_at,
}
