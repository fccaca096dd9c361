"""Assignments: to locals, fields, globals and members, several at once, augmented, and reductions."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from typing import Any

from ebb.compiler import kir
from ebb.compiler.elaborate.capture import elements_of
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.convert import becomes, component, convert, converted, operand, typed
from ebb.compiler.elaborate.errors_calls import NoSetter, UnpackCount
from ebb.compiler.elaborate.errors_names import CapturedAssigned, CompileTimeOnly, UndefinedName
from ebb.compiler.elaborate.errors_syntax import RejectedSyntax
from ebb.compiler.elaborate.errors_types import ReductionTypes, TypeChanged
from ebb.compiler.elaborate.expressions import read_name
from ebb.compiler.elaborate.inline import inline_member, repeatable
from ebb.compiler.elaborate.operators import BINARY, beside, binary, unary
from ebb.compiler.elaborate.places import (
    FieldPlace,
    GlobalPlace,
    LocalPlace,
    MemberPlace,
    Place,
    captured_advice,
    captured_noun,
    place_of,
    place_text,
    place_type,
    read,
)
from ebb.compiler.elaborate.reductions import Extremum, find_extremum
from ebb.compiler.elaborate.rejected import REJECTED_CLAUSES, REJECTED_EXPRESSIONS
from ebb.compiler.elaborate.scope import Bound, Variable, raw_lookup, visible_names
from ebb.compiler.elaborate.values import BoundMember, Poison, Query, Sequence, Static, Typed, Value, noun
from ebb.compiler.phases.errors import GlobalAssigned
from ebb.diagnostics.span import Span
from ebb.errors import PhaseError
from ebb.records import replace
from ebb.relations.globals import Global
from ebb.types.rules import reduce_mismatch
from ebb.types.types import Type, as_type, is_type, uint32, uint64

_REDUCTIONS: Mapping[str, kir.ReduceOp] = {op.value: op for op in kir.ReduceOp}


# ---- Statements ----


def assign(ctx: Context, node: ast.Assign) -> None:
    """``target = value``, also of several targets; or a reduction by ``min`` or ``max``."""
    span = ctx.span(node)
    extremum = find_extremum(ctx, node)
    if extremum is not None and _reduce_extremum(ctx, node.targets[0], extremum, span):
        return
    value = ctx.value(node.value)
    if len(node.targets) > 1:
        value = repeatable(ctx, value)
    for target in node.targets:
        store(ctx, target, value, span)


def annotated(ctx: Context, node: ast.AnnAssign) -> None:
    """``x: ebb.float32 = value``."""
    if node.value is None or not isinstance(node.target, ast.Name):
        ctx.report(RejectedSyntax(ctx.span(node), *REJECTED_CLAUSES["type comment"]))
        return
    declared = ctx.value(node.annotation)
    value = ctx.value(node.value)
    if isinstance(declared, Static) and is_type(declared.object):
        expr = convert(ctx, value, as_type(declared.object), f"the local '{node.target.id}'", spread=True)
        value = Poison(value.span) if expr is None else Typed(expr)
    elif not isinstance(declared, Poison):
        ctx.report(
            RejectedSyntax(ctx.span(node.annotation), "a variable annotation that is no type", "write an Ebb type")
        )
    store(ctx, node.target, value, ctx.span(node))


def augmented(ctx: Context, node: ast.AugAssign) -> None:
    """``target op= value``: a reduction where the target is a field, a global or a member."""
    op, span, target = BINARY[type(node.op)], ctx.span(node), node.target
    if isinstance(target, ast.Name):
        if target.id in ctx.frame.locals:
            old = read_name(ctx, target)
            assign_name(ctx, target, binary(ctx, op, old, ctx.value(node.value), span), span)
            return
        if not _captured_global(ctx, target):
            ctx.value(node.value)
            _report_captured(ctx, target)
            return
    place = place_of(ctx, target)
    mark = len(ctx.out)
    value = ctx.value(node.value)
    if place is None or isinstance(value, Poison):
        return
    old = _old(ctx, mark, place, op)
    change(ctx, _kept(ctx, mark, place), op, value, old, span)


# ---- Storing ----


def store(ctx: Context, target: ast.expr, value: Value, span: Span) -> None:
    """Stores ``value`` in what ``target`` denotes."""
    match target:
        case ast.Tuple(elts=targets) | ast.List(elts=targets):
            _unpack(ctx, targets, value, span)
        case ast.Name(id=name) if name in ctx.frame.locals:
            assign_name(ctx, target, value, span)
        case ast.Name() if not _captured_global(ctx, target):
            _report_captured(ctx, target)
        case _:
            mark = len(ctx.out)
            place = place_of(ctx, target)
            (value,) = ctx.keep(mark, [value])
            if place is not None:
                _write(ctx, place, value, span)


def assign_name(ctx: Context, target: ast.Name, value: Value, span: Span) -> None:
    """Gives a local a value. The first assignment fixes its type."""
    frame, name, where = ctx.frame, target.id, ctx.span(target)
    binding = frame.binding(name)
    if isinstance(value, Poison) or (isinstance(binding, Bound) and isinstance(binding.value, Poison)):
        frame.bind(name, binding or Bound(value, where))
    elif _is_known(value):
        _bind_known(ctx, name, value, where)
    elif isinstance(binding, Variable):
        _reassign(ctx, binding, value, span)
        frame.bind(name, binding)
    else:
        expr = typed(ctx, value)
        if expr is None:
            frame.bind(name, Bound(Poison(where), where))
            return
        local = ctx.new_local(name, expr.type)
        ctx.emit(kir.Assign(local, (), expr, span))
        frame.bind(name, Variable(local, where))


def _is_known(value: Value) -> bool:
    """Whether a value is known when the kernel is compiled and is no value for a local of the kernel."""
    match value:
        case Query() | BoundMember():
            return True
        case Static(found, _, _):
            return not isinstance(found, Global | str | None)
        case _:
            return False


def _bind_known(ctx: Context, name: str, value: Value, where: Span) -> None:
    if not ctx.frame.once(name):
        ctx.report(CompileTimeOnly(where, name, noun(value)))
        value = Poison(where)
    match value:
        case Query(_, key) | BoundMember(_, key):
            # The key may be a local that changes before the query is used.
            kept = ctx.temporary("key", key)
            value = (
                type(value)(value.index, kept, value.path, value.span)
                if isinstance(value, Query)
                else BoundMember(value.member, kept, value.span)
            )
        case _:
            pass
    ctx.frame.bind(name, Bound(value, where))


def _reassign(ctx: Context, binding: Variable, value: Value, span: Span) -> None:
    found = operand(ctx, value)
    fitting = None if found is None else becomes(ctx, found, binding.local.type)
    if found is None or fitting is None:
        return
    if not fitting:
        expr = typed(ctx, found)
        if expr is not None:
            first = binding.local.type
            ctx.report(TypeChanged(found.span, binding.local.name, first, expr.type, binding.span))
        return
    expr = converted(ctx, found, binding.local.type)
    if expr is not None:
        ctx.emit(kir.Assign(binding.local, (), expr, span))


def _write(ctx: Context, place: Place, value: Value, span: Span) -> None:
    if isinstance(value, Poison):
        return
    match place:
        case GlobalPlace(_, name):
            ctx.report(GlobalAssigned(name, place.span), PhaseError)
        case MemberPlace(member, key):
            if member.setter_function is None:
                ctx.report(NoSetter(place.span, member.name, member.relation.name, None))
            else:
                inline_member(ctx, member.setter_function, member, [Typed(key), value], span)
        case LocalPlace(local, indices, member=member):
            expr = convert(ctx, value, place_type(place), place_text(place), spread=True)
            if expr is not None:
                ctx.emit(kir.Assign(local, indices, expr, span))
                if member is not None:
                    _write(ctx, member, Typed(kir.ReadLocal(local, local.type, span)), span)
        case FieldPlace(field, key, indices):
            expr = convert(ctx, value, place_type(place), place_text(place), spread=True)
            if expr is not None:
                # The use of the field that the phases speak of is the place, not the whole statement.
                ctx.emit(kir.WriteField(field, key, indices, expr, place.span))


# ---- Several targets ----


def _unpack(ctx: Context, targets: list[ast.expr], value: Value, span: Span) -> None:
    starred = [target for target in targets if isinstance(target, ast.Starred)]
    if starred:
        value = ctx.poison(RejectedSyntax(ctx.span(starred[0]), *REJECTED_EXPRESSIONS[ast.Starred]))
        targets = [target for target in targets if not isinstance(target, ast.Starred)]
    elements = elements_to_unpack(ctx, value, len(targets), span)
    names = {each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)}
    if elements is not None:
        # All values are taken before the first is stored; the first needs no copy, since nothing is stored before it.
        elements = [*elements[:1], *(snapshot(ctx, element, names) for element in elements[1:])]
    for position, target in enumerate(targets):
        store(ctx, target, Poison(span) if elements is None else elements[position], span)


def elements_to_unpack(ctx: Context, value: Value, count: int, span: Span) -> list[Value] | None:
    """The ``count`` values that ``value`` consists of; None, and an error, where it does not."""
    elements: list[Value] = []
    match value:
        case Poison():
            return None
        case Sequence(found, _):
            elements = list(found)
        case Static(tuple() | list(), _, _):
            elements = list(elements_of(ctx, value).elements)
        case _:
            expr = typed(ctx, value)
            if expr is None:
                return None
            if not expr.type.shape:
                ctx.report(UnpackCount(span, count, f"a value of type {expr.type!r}"))
                return None
            whole = ctx.simple(expr)
            elements = [Typed(component(whole, (index,))) for index in range(expr.type.shape[0])]
    if len(elements) != count:
        ctx.report(UnpackCount(span, count, f"{len(elements)} value{'' if len(elements) == 1 else 's'}"))
        return None
    return elements


def snapshot(ctx: Context, value: Value, names: set[str]) -> Value:
    """``value`` so that storing into the locals ``names``, fields and globals does not change it."""
    match value:
        case Typed(kir.Const() | kir.Uniform()):
            return value
        case Typed(kir.ReadLocal(local)) if local.name not in names:
            return value
        case Typed(expr):
            return Typed(ctx.temporary("value", expr))
        case Sequence(elements, span):
            return Sequence(tuple(snapshot(ctx, element, names) for element in elements), span)
        case _:
            return repeatable(ctx, value)


# ---- Changing ----


def _old(ctx: Context, mark: int, place: Place, op: str) -> Value:
    """What is at a place that is read and then written, before the value that changes it is computed."""
    if isinstance(place, MemberPlace):
        return Poison(place.span)
    if isinstance(place, FieldPlace | GlobalPlace) and (op == "-" or op in _REDUCTIONS):
        return Poison(place.span)  # a reduction reads nothing
    (old,) = ctx.keep(mark, [Typed(read(place))])
    return old


def change(ctx: Context, place: Place, op: str, value: Value, old: Value, span: Span) -> None:
    """``place op= value``, where ``old`` is what is there."""
    match place:
        case MemberPlace():
            _change_member(ctx, place, op, value, span)
        case LocalPlace():
            _write(ctx, place, binary(ctx, op, old, value, span), span)
        case _ if op == "-":
            # Sums of terms and of their negatives commute: -= is the reduction by +.
            reduce_into(ctx, place, kir.ReduceOp.ADD, _negated(ctx, value, place_type(place)), span)
        case _ if op in _REDUCTIONS:
            reduce_into(ctx, place, _REDUCTIONS[op], value, span)
        case _:
            _write(ctx, place, binary(ctx, op, old, value, span), span)


def _negated(ctx: Context, value: Value, target: Type) -> Value:
    """``-value``; a number is negated as an unsigned one, which wraps, where the place holds such."""
    found = operand(ctx, value)
    if found is None:
        return Poison(value.span)
    if isinstance(found, Typed) or target.scalar not in (uint32, uint64):
        return unary(ctx, "-", found, value.span)
    expr = beside(ctx, found, target.scalar)
    return Poison(value.span) if expr is None else unary(ctx, "-", Typed(expr), value.span)


def reduce_into(ctx: Context, place: FieldPlace | GlobalPlace, op: kir.ReduceOp, value: Value, span: Span) -> None:
    """A reduction of a field or global, whole or in part."""
    target = place_type(place)
    found = operand(ctx, value)
    expr = None if found is None else beside(ctx, found, target.scalar)
    if found is None or expr is None:
        return
    mismatch = reduce_mismatch(op.value, target, expr.type)
    if mismatch is not None:
        ctx.report(ReductionTypes(span, mismatch))
        return
    reduced = convert(ctx, found, target, place_text(place), spread=True)
    if reduced is None:
        return
    match place:
        case FieldPlace(field, key, indices):
            ctx.emit(kir.ReduceField(field, key, indices, op, reduced, place.span))
        case GlobalPlace(globl, _, indices):
            ctx.emit(kir.ReduceGlobal(globl, indices, op, reduced, place.span))


def _change_member(ctx: Context, place: MemberPlace, op: str, value: Value, span: Span) -> None:
    """By its reducer, or where it has none, by its value and its setter."""
    member, key = place.member, place.key
    if op == "-" and "+" in member.reducers:
        op, value = "+", unary(ctx, "-", value, value.span)
    if op in member.reducers:
        inline_member(ctx, member.reducers[op], member, [Typed(key), value], span)
    elif member.setter_function is not None:
        old = inline_member(ctx, member.function, member, [Typed(key)], place.span)
        _write(ctx, place, binary(ctx, op, old, value, span), span)
    else:
        ctx.report(NoSetter(place.span, member.name, member.relation.name, op))


def _reduce_extremum(ctx: Context, target: ast.expr, extremum: Extremum, span: Span) -> bool:
    """``x.f = min(x.f, e)``; False where the place is no field, global or member, so that it is an assignment."""
    place = place_of(ctx, target)
    match place:
        case FieldPlace() | GlobalPlace():
            pass
        case MemberPlace(member, _) if extremum.op.value in member.reducers:
            pass
        case None:
            ctx.values(extremum.nodes)
            return True
        case _:
            return False
    if isinstance(place, FieldPlace) and extremum.of_global:
        return False
    mark = len(ctx.out)
    value = extremum.value(ctx, span)
    if isinstance(value, Poison):
        return True
    place = _kept(ctx, mark, place)
    if isinstance(place, MemberPlace):
        _change_member(ctx, place, extremum.op.value, value, span)
    elif not isinstance(place, LocalPlace):
        reduce_into(ctx, place, extremum.op, value, span)
    return True


# ---- Captured names ----


def _captured_global(ctx: Context, target: ast.Name) -> bool:
    if target.id in ctx.frame.locals:
        return False
    outside = raw_lookup(ctx.frame.source, target.id)
    return outside is not None and isinstance(outside[1], Global)


def _report_captured(ctx: Context, target: ast.Name) -> None:
    outside = raw_lookup(ctx.frame.source, target.id)
    span = ctx.span(target)
    if outside is None:
        ctx.report(UndefinedName(span, target.id, visible_names(ctx.frame)))
    else:
        ctx.report(CapturedAssigned(span, target.id, captured_noun(outside[1]), captured_advice(outside[1])))


def _kept(ctx: Context, mark: int, place: Place) -> Place:
    """``place`` with its key and indices computed before the statements emitted since ``mark``."""
    match place:
        case FieldPlace(_, key, indices):
            key, *rest = ctx.keep_exprs(mark, (key, *indices))
            return replace(place, key=key, indices=tuple(rest))
        case LocalPlace(_, indices) | GlobalPlace(_, _, indices):
            return replace(place, indices=ctx.keep_exprs(mark, indices))
        case MemberPlace(_, key):
            return replace(place, key=ctx.keep_exprs(mark, (key,))[0])


STATEMENTS: Mapping[type[ast.stmt], Callable[[Context, Any], None]] = {
    ast.Assign: assign,
    ast.AnnAssign: annotated,
    ast.AugAssign: augmented,
}
