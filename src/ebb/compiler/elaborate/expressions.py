"""Names, literals, and the table of all expressions."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from typing import Any

from ebb.compiler import kir
from ebb.compiler.elaborate import attributes, calls, operators
from ebb.compiler.elaborate.capture import captured
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.errors_names import MaybeUnset, ReadBeforeAssignment, UndefinedName
from ebb.compiler.elaborate.errors_syntax import UnknownConstant
from ebb.compiler.elaborate.scope import Bound, Variable, raw_lookup, rejected_names, visible_names
from ebb.compiler.elaborate.values import Poison, Sequence, Static, Typed, Value, Weak, static_noun
from ebb.compiler.host import HostConst
from ebb.diagnostics.span import Span


def read_name(ctx: Context, node: ast.Name) -> Value:
    """What a name denotes where it stands."""
    frame, name, span = ctx.frame, node.id, ctx.span(node)
    if name in frame.locals:
        return _local(ctx, name, span)
    outside = raw_lookup(frame.source, name)
    if outside is None and name in rejected_names(frame.source.node):
        return Poison(span)
    if outside is None:
        return ctx.poison(UndefinedName(span, name, visible_names(frame)))
    host, value = outside
    return captured(ctx, host, value, span)


def _local(ctx: Context, name: str, span: Span) -> Value:
    frame = ctx.frame
    binding = frame.binding(name)
    if binding is None:
        return _unassigned(ctx, name, span)
    for loop in frame.loops:
        loop.reads.setdefault((name, id(binding)), span)
    if frame.live is not None and name not in frame.live:
        reason = frame.lost.get(name)
        unset = MaybeUnset(span, name, binding.span, reason) if reason else MaybeUnset(span, name, binding.span)
        ctx.report(unset)
        frame.bind(name, binding)  # once is enough
    match binding:
        case Variable(local):
            return Typed(kir.ReadLocal(local, local.type, span))
        case Bound(value):
            return _at(value, span)


def _unassigned(ctx: Context, name: str, span: Span) -> Poison:
    frame = ctx.frame
    if name in frame.lost:
        return ctx.poison(MaybeUnset(span, name, None, frame.lost[name]))
    first = frame.stores.first.get(name)
    outside = raw_lookup(frame.source, name)
    shadowed = None if outside is None else static_noun(outside[1])
    return ctx.poison(ReadBeforeAssignment(span, name, None if first is None else ctx.span(first), shadowed))


def _at(value: Value, span: Span) -> Value:
    """A value that a name stands for, as it is read at ``span``."""
    match value:
        case Typed(kir.ReadLocal(local)):
            return Typed(kir.ReadLocal(local, local.type, span))
        case Weak(host, number):
            return Weak(host, number, span)
        case Static(found, host):
            return Static(found, host, span)
        case _:
            return value


def _constant(ctx: Context, node: ast.Constant) -> Value:
    span = ctx.span(node)
    match node.value:
        case bool() | int() | float():
            return Weak(HostConst(node.value), node.value, span)
        case str() as text:
            return Static(text, HostConst(text), span)
        case other:
            return ctx.poison(UnknownConstant(span, repr(other) if other is not ... else "..."))


def _list(ctx: Context, node: ast.List | ast.Tuple) -> Value:
    elements = ctx.values(node.elts)
    span = ctx.span(node)
    if any(isinstance(element, Poison) for element in elements):
        return Poison(span)
    return Sequence(tuple(elements), span)


EXPRESSIONS: Mapping[type[ast.expr], Callable[[Context, Any], Value]] = {
    **operators.EXPRESSIONS,
    **attributes.EXPRESSIONS,
    **calls.EXPRESSIONS,
    ast.Name: read_name,
    ast.Constant: _constant,
    ast.List: _list,
    ast.Tuple: _list,
}
