"""What stands on the left of an assignment: locals, fields, globals, members, and their components."""

from __future__ import annotations

import ast
from typing import TypeAlias

from ebb.compiler import kir
from ebb.compiler.elaborate.attributes import (
    attribute,
    attribute_names,
    attribute_span,
    checked_indices,
    component_index,
    indexed,
    member_value,
    part,
    relation_of,
)
from ebb.compiler.elaborate.capture import OBJECTS
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.convert import typed
from ebb.compiler.elaborate.errors_names import CapturedAssigned, NoMeaning, NotAssignable, UnknownAttribute
from ebb.compiler.elaborate.expressions import read_name
from ebb.compiler.elaborate.scope import Variable, raw_lookup
from ebb.compiler.elaborate.values import Poison, Sequence, Static, Typed, Value, noun, static_noun
from ebb.diagnostics.span import Span
from ebb.records import record, replace
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.member import Member
from ebb.relations.relation import Relation
from ebb.types.types import KeyType, Type, int32, shaped_type


@record
class LocalPlace:
    """A component of a local; locals as a whole are assigned by name.

    ``member``: of what the local is the value, which is set when the component has changed.
    """

    local: kir.Local
    indices: tuple[kir.Expr, ...]
    span: Span
    member: MemberPlace | None = None


@record
class FieldPlace:
    field: Field
    key: kir.Expr
    indices: tuple[kir.Expr, ...]
    span: Span


@record
class GlobalPlace:
    globl: Global
    name: str
    indices: tuple[kir.Expr, ...]
    span: Span


@record
class MemberPlace:
    member: Member
    key: kir.Expr
    span: Span


Place: TypeAlias = LocalPlace | FieldPlace | GlobalPlace | MemberPlace
_Whole: TypeAlias = LocalPlace | FieldPlace | GlobalPlace


def place_type(place: _Whole) -> Type:
    """The type of what is at a place."""
    whole = whole_type(place)
    return shaped_type(whole.scalar, whole.shape[len(place.indices) :])


def whole_type(place: _Whole) -> Type:
    """The type of the local, field or global of which the place is a part."""
    match place:
        case LocalPlace(local):
            return local.type
        case FieldPlace(field):
            return field.type
        case GlobalPlace(globl):
            return globl.type


def place_text(place: _Whole) -> str:
    """What the place belongs to, for messages."""
    match place:
        case LocalPlace(local, member=member):
            return f"the {'local' if member is None else 'member'} '{local.name}'"
        case FieldPlace(field):
            return f"the field '{field.path}'"
        case GlobalPlace(_, name):
            return f"the global '{name}'"


def read(place: _Whole) -> kir.Expr:
    """The value at a place."""
    match place:
        case LocalPlace(local, indices, span):
            whole: kir.Expr = kir.ReadLocal(local, local.type, span)
        case FieldPlace(field, key, indices, span):
            whole = kir.ReadField(field, key, field.type, span)
        case GlobalPlace(globl, _, indices, span):
            whole = kir.ReadGlobal(globl, globl.type, span)
    return part(whole, indices, place.span)


def place_of(ctx: Context, node: ast.expr) -> Place | None:
    """The place that ``node`` is; None, and an error, where it is none."""
    match _place_or_value(ctx, node):
        case Poison():
            return None
        case LocalPlace() | FieldPlace() | GlobalPlace() | MemberPlace() as place:
            return place
        case value:
            _not_assignable(ctx, node, value)
            return None


def _place_or_value(ctx: Context, node: ast.expr) -> Place | Value:
    match node:
        case ast.Name():
            return _name(ctx, node)
        case ast.Attribute():
            return _attribute(ctx, node)
        case ast.Subscript():
            return _subscript(ctx, node)
        case _:
            return ctx.value(node)


def _name(ctx: Context, node: ast.Name) -> Place | Value:
    value = read_name(ctx, node)
    binding = ctx.frame.binding(node.id) if node.id in ctx.frame.locals else None
    match value:
        case Typed() if isinstance(binding, Variable):
            return LocalPlace(binding.local, (), ctx.span(node))
        case Static(Global() as globl, _, span):
            return GlobalPlace(globl, node.id, (), span)
        case _:
            return value


def _attribute(ctx: Context, node: ast.Attribute) -> Place | Value:
    base, span = _opened(ctx, _place_or_value(ctx, node.value)), ctx.span(node)
    key = _as_key(base)
    if key is not None:
        return _of_key(ctx, key, node.attr, span, attribute_span(span, node.attr))
    match base:
        case LocalPlace() | FieldPlace() | GlobalPlace():
            index = component_index(node.attr, place_type(base))
            if index is not None:
                return replace(base, indices=(*base.indices, kir.Const(index, int32, span)), span=span)
            if isinstance(base, GlobalPlace) and not base.indices and node.attr == "value":
                return replace(base, span=span)
            return attribute(ctx, Typed(read(base)), node.attr, span, attribute_span(span, node.attr))
        case Static(Relation(), _, _):
            return base
        case value:
            found = attribute(ctx, value, node.attr, span, attribute_span(span, node.attr))
            if isinstance(found, Static) and isinstance(found.object, Global):
                return GlobalPlace(found.object, ast.unparse(node), (), span)
            return found


def _subscript(ctx: Context, node: ast.Subscript) -> Place | Value:
    base, span = _opened(ctx, _place_or_value(ctx, node.value)), ctx.span(node)
    mark = len(ctx.out)
    indices = ctx.values(node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice])
    key = _as_key(base)
    if key is not None:
        match indices:
            case [Static(str() as name, _, where)]:
                return _of_key(ctx, key, name, span, where)
            case [Static(Field() as field, _, where)] if field.relation is relation_of(key):
                return _of_key(ctx, key, field.name, span, where)
            case _:
                return indexed(ctx, Typed(key), indices, span)
    match base:
        case LocalPlace() | FieldPlace() | GlobalPlace():
            checked = checked_indices(ctx, place_type(base), indices, span)
            if checked is None:
                return Poison(span)
            return replace(_kept(ctx, mark, base), indices=(*base.indices, *checked), span=span)
        case value:
            return indexed(ctx, value, indices, span)


def _opened(ctx: Context, base: Place | Value) -> _Whole | Value:
    """``base`` where something of it is the place: a member stands for its value then."""
    if not isinstance(base, MemberPlace):
        return base
    value = member_value(ctx, base.member, base.key, base.span)
    expr = typed(ctx, value) if isinstance(value, Typed | Sequence) and base.member.setter_function else None
    if expr is None or isinstance(expr.type, KeyType):
        return value
    local = ctx.temporary(base.member.name, expr).local
    return LocalPlace(local, (), base.span, base)


def _kept(ctx: Context, mark: int, place: _Whole) -> _Whole:
    """``place`` with its key computed before the statements that its indices needed."""
    if isinstance(place, FieldPlace):
        (key,) = ctx.keep_exprs(mark, (place.key,))
        return replace(place, key=key)
    return place


def _as_key(base: _Whole | Value) -> kir.Expr | None:
    match base:
        case Typed(expr) if isinstance(expr.type, KeyType):
            return expr
        case LocalPlace() | FieldPlace() if isinstance(place_type(base), KeyType):
            return read(base)
        case _:
            return None


def _of_key(ctx: Context, key: kir.Expr, name: str, span: Span, name_span: Span) -> Place | Value:
    relation = relation_of(key)
    match relation.attribute(name):
        case Field() as field:
            return FieldPlace(field, key, (), span)
        case Member() as member:
            return MemberPlace(member, key, span)
        case None:
            known = attribute_names(relation)
            return ctx.poison(UnknownAttribute(name_span, f"a row of '{relation.name}'", name, known))
        case _:
            return ctx.poison(NoMeaning(name_span, name, f"the subset '{name}'", "launch the kernel on the subset"))


def _not_assignable(ctx: Context, node: ast.expr, value: Value | Place) -> None:
    span = ctx.span(node)
    outside = raw_lookup(ctx.frame.source, node.id) if isinstance(node, ast.Name) else None
    if isinstance(node, ast.Name) and outside is not None and node.id not in ctx.frame.locals:
        ctx.report(CapturedAssigned(span, node.id, captured_noun(outside[1]), captured_advice(outside[1])))
        return
    match value:
        case Static(Relation(), _, _):
            advice = f"assign it for a row: row.{node.attr} = ..." if isinstance(node, ast.Attribute) else "name a row"
            ctx.report(NotAssignable(span, f"'{span.text}', which names no row,", advice))
        case Static(found, _, _):
            what = f"'{span.text}', which belongs to {static_noun(found)},"
            ctx.report(NotAssignable(span, what, "set it on the host, between launches"))
        case Typed() if isinstance(node, ast.Attribute) and node.attr == "T":
            ctx.report(NotAssignable(span, "a transpose", "assign the matrix itself"))
        case _:
            ctx.report(NotAssignable(span, noun(value) if isinstance(value, Value) else "this", _PLACES))


def captured_noun(found: object) -> str:
    """What a captured object is, for the message that it cannot be assigned."""
    return f"a captured {type(found).__name__}" if isinstance(found, bool | int | float) else static_noun(found)


def captured_advice(found: object) -> str:
    """What to do instead of assigning a captured name."""
    if isinstance(found, OBJECTS):
        return "give the local another name"
    return "reduce into an ebb.Global, or copy it to a local of another name first"


_PLACES = "assign a local, a field of a row, or a component of one"
