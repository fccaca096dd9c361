"""Attributes and indices where they are read: fields and members of keys, components of vectors, parts of objects."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from types import CodeType
from typing import Any

from ebb.compiler import kir
from ebb.compiler.elaborate.capture import attribute_of, captured, elements_of, item_of
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.convert import component, operand, typed
from ebb.compiler.elaborate.errors_names import NoMeaning, UnknownAttribute
from ebb.compiler.elaborate.errors_types import IndexRange, IndexType, NotIndexable
from ebb.compiler.elaborate.function import member_function
from ebb.compiler.elaborate.inline import inline_member
from ebb.compiler.elaborate.values import (
    BoundMember,
    Poison,
    Projection,
    Query,
    Sequence,
    Static,
    Typed,
    Value,
    Weak,
    is_items,
    noun,
)
from ebb.compiler.host import HostConst
from ebb.diagnostics.span import Span
from ebb.records import replace
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.member import Member
from ebb.relations.relation import Relation
from ebb.relations.subset import Subset
from ebb.types.rules import is_integer
from ebb.types.types import KeyType, MatrixType, Type, VectorType, int32, shaped_type

COMPONENTS = "xyzw"


def attribute(ctx: Context, base: Value, name: str, span: Span, name_span: Span) -> Value:
    """``base.name``."""
    match base:
        case Poison():
            return base
        case Typed(expr) if isinstance(expr.type, KeyType):
            return key_attribute(ctx, expr, name, span, name_span)
        case Query(_, _, path, _):
            return replace(base, path=(*path, Projection(name, name_span)), span=span)
        case Static(Global(), _, _) if name != "value":
            return _value_attribute(ctx, base, name, span, name_span)
        case Static(tuple() | list(), _, _):
            return _value_attribute(ctx, base, name, span, name_span)
        case Static():
            return attribute_of(ctx, base, name, span, name_span)
        case _:
            return _value_attribute(ctx, base, name, span, name_span)


def key_attribute(ctx: Context, key: kir.Expr, name: str, span: Span, name_span: Span) -> Value:
    """A field or member of the row ``key``."""
    relation = relation_of(key)
    match relation.attribute(name):
        case Field() as field:
            return Typed(kir.ReadField(field, key, field.type, span))
        case Member() as member:
            return member_value(ctx, member, key, span)
        case Subset():
            return ctx.poison(NoMeaning(name_span, name, f"the subset '{name}'", "launch the kernel on the subset"))
        case None:
            return ctx.poison(
                UnknownAttribute(name_span, f"a row of '{relation.name}'", name, attribute_names(relation))
            )


def member_value(ctx: Context, member: Member, key: kir.Expr, span: Span) -> Value:
    """``key.member``: its value, or where it has further parameters, what a call makes the value of."""
    code = getattr(member_function(member.function), "__code__", None)
    if isinstance(code, CodeType) and code.co_argcount > 1:
        return BoundMember(member, key, span)
    return inline_member(ctx, member.function, member, [Typed(key)], span)


def attribute_names(relation: Relation) -> tuple[str, ...]:
    """The fields and members of a row, for suggestions."""
    names = relation._attributes  # pyright: ignore[reportPrivateUsage]
    return tuple(name for name, found in names.items() if not isinstance(found, Subset) and name != "__call__")


def relation_of(key: kir.Expr) -> Relation:
    """The relation whose rows a key refers to."""
    assert isinstance(key.type, KeyType) and isinstance(key.type.target, Relation)
    return key.type.target


def indexed(ctx: Context, base: Value, indices: list[Value], span: Span) -> Value:
    """``base[i]`` or ``base[i, j]``."""
    match base:
        case Poison():
            return base
        case Typed(expr) if isinstance(expr.type, KeyType):
            return _key_item(ctx, expr, indices, span)
        case Static(items, host, _) if is_items(items):
            return _captured_item(ctx, base, items, host, indices, span)
        case Static(dict(), _, _):
            return _dictionary_item(ctx, base, indices, span)
        case Sequence(elements, _) if len(indices) == 1 and isinstance(indices[0], Weak):
            position = constant_index(ctx, indices[0], len(elements), None)
            return Poison(span) if position is None else elements[position]
        case Query():
            return _query_item(ctx, base, indices, span)
        case _:
            pass
    expr = typed(ctx, base)
    if expr is None:
        return Poison(span)
    return _component(ctx, expr, indices, span)


def checked_indices(ctx: Context, type_: Type, indices: list[Value], span: Span) -> tuple[kir.Expr, ...] | None:
    """``indices`` into a vector or matrix, in range where constant; None, and an error, where they are wrong."""
    extents = type_.shape
    if not 1 <= len(indices) <= len(extents):
        ctx.report(NotIndexable(span, f"a value of type {type_!r}", len(indices)))
        return None
    checked = [
        _index(ctx, index, extent, type_) for index, extent in zip(indices, extents[: len(indices)], strict=True)
    ]
    return None if None in checked else tuple(each for each in checked if each is not None)


def constant_index(ctx: Context, index: Weak, extent: int, type_: Type | None) -> int | None:
    """A Python number as an index, counted from 0; None, and an error, where it is none or out of range."""
    value = index.value
    if isinstance(value, bool) or not isinstance(value, int):
        ctx.report(IndexType(index.span, noun(index)))
        return None
    ctx.guard_value(index.host, value)
    if not -extent <= value < extent:
        ctx.report(IndexRange(index.span, value, extent, type_ or shaped_type(int32, (extent,))))
        return None
    return value % extent


def part(expr: kir.Expr, indices: tuple[kir.Expr, ...], span: Span) -> kir.Expr:
    """``expr[indices]``, with the two steps of ``M[i][j]`` made one."""
    if not indices:
        return expr
    type_ = shaped_type(expr.type.scalar, expr.type.shape[len(indices) :])
    if isinstance(expr, kir.Component) and isinstance(expr.operand.type, MatrixType):
        return kir.Component(expr.operand, (*expr.indices, *indices), type_, span)
    return kir.Component(expr, indices, type_, span)


def component_index(name: str, type_: Type) -> int | None:
    """The index that ``.x .y .z .w`` is on a vector, None where it is none."""
    if isinstance(type_, VectorType) and len(name) == 1 and name in COMPONENTS[: type_.n]:
        return COMPONENTS.index(name)
    return None


def attribute_span(whole: Span, name: str) -> Span:
    """Where the ``name`` after the dot stands."""
    start = max(whole.end_column - len(name), 0)
    return Span(whole.source, whole.end_line, start, whole.end_line, whole.end_column, whole.caller)


def _attribute(ctx: Context, node: ast.Attribute) -> Value:
    base, span = ctx.value(node.value), ctx.span(node)
    return attribute(ctx, base, node.attr, span, attribute_span(span, node.attr))


def _subscript(ctx: Context, node: ast.Subscript) -> Value:
    nodes = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    base, *indices = ctx.values([node.value, *nodes])
    return indexed(ctx, base, indices, ctx.span(node))


def _value_attribute(ctx: Context, base: Value, name: str, span: Span, name_span: Span) -> Value:
    """``.x`` of a vector or ``.T`` of a matrix."""
    found = operand(ctx, base)
    expr = None if found is None else typed(ctx, found)
    if expr is None:
        return Poison(span)
    index = component_index(name, expr.type)
    if index is not None:
        return Typed(replace_span(component(expr, (index,)), span))
    if name == "T" and isinstance(expr.type, MatrixType):
        transposed = MatrixType(expr.type.scalar, expr.type.cols, expr.type.rows)
        return Typed(kir.Call("transpose", (expr,), transposed, span))
    known = (
        ("T",)
        if isinstance(expr.type, MatrixType)
        else tuple(COMPONENTS[: expr.type.shape[0]])
        if expr.type.shape
        else ()
    )
    advice = "use v[i] for the other components" if isinstance(expr.type, VectorType) else None
    return ctx.poison(UnknownAttribute(name_span, f"a value of type {expr.type!r}", name, known, advice))


def replace_span(expr: kir.Expr, span: Span) -> kir.Expr:
    """``expr`` as written at ``span``."""
    return replace(expr, span=span)


def _key_item(ctx: Context, key: kir.Expr, indices: list[Value], span: Span) -> Value:
    """``c[name]``: the field or member whose name is known when the kernel is compiled."""
    match indices:
        case [Static(str() as name, _, where)]:
            return key_attribute(ctx, key, name, span, where)
        case [Static(Field() as field, _, where)] if field.relation is relation_of(key):
            return key_attribute(ctx, key, field.name, span, where)
        case _ if any(isinstance(index, Poison) for index in indices):
            return Poison(span)
        case _:
            advice = 'give the name of a field: c["pos"], or a parameter that is one'
            return ctx.poison(NotIndexable(span, f"a key of '{relation_of(key).name}'", len(indices), advice))


def _query_item(ctx: Context, query: Query, indices: list[Value], span: Span) -> Value:
    """``q[name]``: the query of a field or member whose name is known when the kernel is compiled."""
    match indices:
        case [Static(str() as name, _, where)]:
            return attribute(ctx, query, name, span, where)
        case _ if any(isinstance(index, Poison) for index in indices):
            return Poison(span)
        case _:
            return ctx.poison(NotIndexable(span, "a query", len(indices), "loop over it with 'for'"))


def _captured_item(ctx: Context, base: Static, items: Any, host: Any, indices: list[Value], span: Span) -> Value:
    if len(indices) == 1 and isinstance(indices[0], Weak):
        ctx.guard_structure(base.host, items)
        position = constant_index(ctx, indices[0], len(items), None)
        return (
            Poison(span)
            if position is None
            else captured(ctx, item_of(host, position, items[position]), items[position], span)
        )
    expr = typed(ctx, elements_of(ctx, base))
    return Poison(span) if expr is None else _component(ctx, expr, indices, span)


def _dictionary_item(ctx: Context, base: Static, indices: list[Value], span: Span) -> Value:
    items, host = base.object, base.host
    match indices:
        case [Static(str() as name, _, where)] if name not in items:
            return ctx.poison(UnknownAttribute(where, f"'{base.name}'", name, tuple(map(str, items))))
        case [Static(str() as name, _, _)]:
            return captured(ctx, item_of(host, name, items[name]), items[name], span)
        case _:
            return ctx.poison(NotIndexable(span, "a captured dictionary", len(indices), "index it by a string"))


def _component(ctx: Context, expr: kir.Expr, indices: list[Value], span: Span) -> Value:
    checked = checked_indices(ctx, expr.type, indices, span)
    return Poison(span) if checked is None else Typed(part(expr, checked, span))


def _index(ctx: Context, index: Value, extent: int, type_: Type) -> kir.Expr | None:
    found = operand(ctx, index)
    if found is None:
        return None
    if isinstance(found, Weak):
        position = constant_index(ctx, found, extent, type_)
        return None if position is None else kir.Const(position, int32, found.span)
    expr = typed(ctx, found)
    if expr is None:
        return None
    if not is_integer(expr.type) or expr.type.shape:
        ctx.report(IndexType(found.span, noun(found)))
        return None
    if isinstance(expr, kir.Const):
        position = constant_index(ctx, Weak(HostConst(expr.value), expr.value, expr.span), extent, type_)
        return None if position is None else kir.Const(position, int32, expr.span)
    return expr


EXPRESSIONS: Mapping[type[ast.expr], Callable[[Context, Any], Value]] = {
    ast.Attribute: _attribute,
    ast.Subscript: _subscript,
}
