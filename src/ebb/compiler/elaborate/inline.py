"""Funcs and members: bound to their arguments and inlined where they are used."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ebb.compiler import kir
from ebb.compiler.elaborate.capture import OBJECTS, captured
from ebb.compiler.elaborate.context import Context, is_simple
from ebb.compiler.elaborate.convert import Operand, common_type_of, convert, operand, typed
from ebb.compiler.elaborate.errors_calls import CallArguments, MayEndWithoutValue, NoValue
from ebb.compiler.elaborate.errors_names import Recursion
from ebb.compiler.elaborate.function import Func, member_function
from ebb.compiler.elaborate.operators import no_common_type
from ebb.compiler.elaborate.parameters import check_signature, declared_type, positional
from ebb.compiler.elaborate.scope import (
    Bound,
    Frame,
    Returns,
    Stores,
    Variable,
    find_stores,
    parameter_names,
    raw_lookup,
)
from ebb.compiler.elaborate.source import SourceFunction, source_of
from ebb.compiler.elaborate.values import (
    BoundMember,
    Nothing,
    Poison,
    Query,
    Sequence,
    Static,
    Typed,
    Value,
    WeakChoice,
)
from ebb.compiler.host import HostConst
from ebb.compiler.kir_walk import map_bodies
from ebb.diagnostics.span import Span
from ebb.errors import EbbError
from ebb.records import record, replace
from ebb.relations.member import Member
from ebb.types.types import bool_, int32


def inline_func(ctx: Context, func: Func, given: list[Value], named: Mapping[str, Value], span: Span) -> Value:
    """A call of ``func``."""
    try:
        source = func.source
    except EbbError as error:
        return _unreadable(ctx, error, span)
    return _inline(ctx, ctx.trail.func_entered(func, source), func.name, given, named, span)


def inline_member(
    ctx: Context,
    function: Callable[..., Any],
    member: Member,
    given: list[Value],
    span: Span,
    named: Mapping[str, Value] | None = None,
) -> Value:
    """A use of one of the functions of ``member``: its value, setter or a reducer."""
    try:
        source = source_of(member_function(function))
        check_signature(source)
    except EbbError as error:
        return _unreadable(ctx, error, span)
    return _inline(ctx, ctx.trail.member_entered(member, function, source), member.name, given, named or {}, span)


def new_frame(source: SourceFunction, title: str, parent: Frame | None, call: Span | None, label: kir.Label) -> Frame:
    """What is known of a function before its body is elaborated."""
    stores = find_stores(source.node)
    nested = not _ends_in_its_return(source.node)
    return Frame(source, title, stores, local_names(source, stores), Returns(label, nested), parent, call)


def local_names(source: SourceFunction, stores: Stores) -> frozenset[str]:
    """The names that are local to a function, as in Python: its parameters and what it assigns.

    What only ``+=`` changes and exists outside is not, nor is a relation or field that ``=`` would hide: these are
    errors, or reductions into a global, which say so where they stand.
    """
    names = {*parameter_names(source.node), *stores.loops}
    for name in stores.count:
        outside = raw_lookup(source, name)
        hides = outside is not None and isinstance(outside[1], OBJECTS)
        if not hides and (name in stores.plain or outside is None):
            names.add(name)
    return frozenset(names)


def function_body(node: ast.FunctionDef) -> list[ast.stmt]:
    """The statements of a function after its docstring."""
    match node.body[0]:
        case ast.Expr(value=ast.Constant(value=str())):
            return node.body[1:]
        case _:
            return node.body


def return_value(ctx: Context, node: ast.Return) -> None:
    """``return`` in an inlined function."""
    returns, span = ctx.frame.returns, ctx.span(node)
    value = None if node.value is None else ctx.value(node.value)
    if returns.nested:
        # What the function gives is known when all of its returns are: until then the number of the return stands here.
        number = kir.Const(len(returns.values), int32, span)
        ctx.emit(kir.Assign(_pending(returns.label), (), number, span))
        ctx.emit(kir.Leave(returns.label, span))
    returns.values.append((isinstance(node.value, ast.Tuple), value, span))
    ctx.frame.live = None


# ---- Binding ----


def _inline(
    ctx: Context, source: SourceFunction, title: str, given: list[Value], named: Mapping[str, Value], span: Span
) -> Value:
    cycle = _cycle(ctx.frame, source, title)
    if cycle is not None:
        return ctx.poison(Recursion(span, cycle))
    arguments = _matched(ctx, source, title, given, named, span)
    if arguments is None or any(isinstance(each, Poison) for each in arguments.values()):
        return Poison(span)
    caller = ctx.frame
    frame = new_frame(source, title, caller, span, ctx.new_label(title))
    bound = [_bind(ctx, frame, name, value) for name, value in arguments.items()]
    if not all(bound):
        return Poison(span)
    ctx.frame = frame
    try:
        if not frame.returns.nested:
            ctx.run(function_body(source.node))
            return _only_value(frame, span)
        with ctx.nested() as body:
            ctx.run(function_body(source.node))
    finally:
        ctx.frame = caller
    return _with_returns(ctx, frame, body, span)


def _matched(
    ctx: Context, source: SourceFunction, title: str, given: list[Value], named: Mapping[str, Value], span: Span
) -> dict[str, Value] | None:
    """The arguments by parameter, with defaults; None, and an error, where they do not fit."""
    names = parameter_names(source.node)
    defaults = source.function.__defaults__ or ()
    with_default = dict(zip(names[len(names) - len(defaults) :], defaults, strict=True))

    def wrong(complaint: str, unknown: str | None = None) -> None:
        signature = f"def {title}({ast.unparse(source.node.args)})"
        ctx.report(CallArguments(span, title, complaint, signature, tuple(names), unknown))

    if len(given) > len(names):
        return wrong(f"takes {len(names)} argument{'' if len(names) == 1 else 's'}, not {len(given)}")
    matched = dict(zip(names, given, strict=False))
    for name, value in named.items():
        if name not in names:
            return wrong(f"has no parameter '{name}'", name)
        if name in matched:
            return wrong(f"gets two values for '{name}'")
        matched[name] = value
    missing = [name for name in names if name not in matched and name not in with_default]
    if missing:
        return wrong(f"lacks a value for {', '.join(repr(name) for name in missing)}")
    return {
        name: matched[name]
        if name in matched
        else captured(ctx, HostConst(with_default[name]), with_default[name], span)
        for name in names
    }


def _bind(ctx: Context, frame: Frame, name: str, value: Value) -> bool:
    """Binds a parameter of ``frame`` to an argument of the caller; False, and an error, where it does not take it."""
    parameter = next(each for each in positional(frame.source.node) if each.arg == name)
    try:
        declared = declared_type(frame.source, parameter)
    except EbbError as error:
        _unreadable(ctx, error, value.span)
        return False
    place = f"the parameter '{name}' of '{frame.title}'"
    if declared is str:
        if not (isinstance(value, Static) and isinstance(value.object, str)):
            complaint = f"takes the name of a field for '{name}'"
            ctx.report(CallArguments(value.span, frame.title, complaint, f"{name}: str", ()))
            return False
    elif declared is not None and not isinstance(declared, type):
        expr = convert(ctx, value, declared, place)
        if expr is None:
            return False
        value = Typed(expr)
    span = frame.source.span(parameter)
    if frame.once(name):
        return _bind_once(ctx, frame, name, value, span)
    expr = typed(ctx, value)
    if expr is None:
        return False
    _declare(ctx, frame, name, expr, span)
    return True


def _bind_once(ctx: Context, frame: Frame, name: str, value: Value, span: Span) -> bool:
    """A parameter that the function does not assign stands for its argument; what costs something is computed once."""
    match value:
        case Nothing(function, where):
            ctx.report(NoValue(where, function))
            return False
        case Typed(expr) if not is_simple(expr):
            _declare(ctx, frame, name, expr, span)
        case _:
            frame.bind(name, Bound(repeatable(ctx, value), span))
    return True


def repeatable(ctx: Context, value: Value) -> Value:
    """``value`` so that using it several times costs and means no more than once."""
    match value:
        case Typed(expr):
            return Typed(ctx.simple(expr))
        case WeakChoice(condition):
            return replace(value, condition=ctx.simple(condition))
        case Sequence(elements):
            return replace(value, elements=tuple(repeatable(ctx, element) for element in elements))
        case Query(_, key) | BoundMember(_, key):
            return replace(value, key=ctx.simple(key))
        case _:
            return value


def _declare(ctx: Context, frame: Frame, name: str, expr: kir.Expr, span: Span) -> None:
    local = ctx.new_local(name, expr.type)
    ctx.emit(kir.Assign(local, (), expr, expr.span))
    frame.bind(name, Variable(local, span))


def _cycle(frame: Frame, source: SourceFunction, title: str) -> tuple[str, ...] | None:
    """The functions from the first use of ``source`` to this one, None where it is not being inlined already."""
    names = [title]
    current: Frame | None = frame
    while current is not None:
        names.append(current.title)
        if current.source.function is source.function:
            return tuple(reversed(names))
        current = current.parent
    return None


def _unreadable(ctx: Context, error: EbbError, span: Span) -> Poison:
    for diagnostic in error.diagnostics:
        ctx.report(diagnostic, type(error))
    return Poison(span)


# ---- Returning ----


@record
class _Result:
    """Where the value of a function with several returns is kept, and how one of them gets there."""

    value: Value
    store: Callable[[Value], bool]


def _ends_in_its_return(node: ast.FunctionDef) -> bool:
    """Whether the only return of a function, if it has one, is its last statement."""
    returns = list(_returns(node.body))
    return not returns or (len(returns) == 1 and returns[0] is node.body[-1])


def _returns(body: list[ast.stmt]) -> Iterator[ast.Return]:
    for statement in body:
        if isinstance(statement, ast.Return):
            yield statement
        elif not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from _returns(getattr(statement, "body", []))
            yield from _returns(getattr(statement, "orelse", []))


def _only_value(frame: Frame, span: Span) -> Value:
    value = frame.returns.values[0][1] if frame.returns.values else None
    return Nothing(frame.title, span) if value is None else value


def _with_returns(ctx: Context, frame: Frame, body: list[kir.Stmt], span: Span) -> Value:
    values = [value for _, value, _ in frame.returns.values]
    if any(isinstance(value, Poison) for value in values):
        return Poison(span)
    given = [value for value in values if value is not None]
    if given and (len(given) < len(values) or frame.live is not None):
        return ctx.poison(MayEndWithoutValue(span, frame.title))
    result = _Result(Nothing(frame.title, span), lambda value: True)
    if given:
        found = _tuple_result(ctx, frame, given, span) or _single_result(ctx, frame, given, span)
        if found is None:
            return Poison(span)
        result = found
    stored = _stored(ctx, frame.returns, tuple(body), result)
    ctx.emit(kir.Block(frame.returns.label, stored, span))
    return result.value


def _single_result(ctx: Context, frame: Frame, given: list[Value], span: Span) -> _Result | None:
    operands = [operand(ctx, value) for value in given]
    known: list[Operand] = [value for value in operands if value is not None]
    if len(known) < len(given):
        return None
    common = common_type_of(ctx, known)
    if common is None:
        no_common_type(ctx, f"the values that '{frame.title}' returns", known, span)
        return None
    local = ctx.new_local(frame.title, common)

    def store(value: Value) -> bool:
        expr = convert(ctx, value, common, "the result")
        if expr is not None:
            ctx.emit(kir.Assign(local, (), expr, expr.span))
        return expr is not None

    return _Result(Typed(kir.ReadLocal(local, common, span)), store)


def _tuple_result(ctx: Context, frame: Frame, given: list[Value], span: Span) -> _Result | None:
    """``return a, b`` in each place: a result for each element. None where some return is no tuple."""
    written = all(is_tuple for is_tuple, _, _ in frame.returns.values)
    rows = [value.elements for value in given if isinstance(value, Sequence)]
    if not written or len({len(row) for row in rows}) != 1:
        return None
    parts = [_single_result(ctx, frame, list(column), span) for column in zip(*rows, strict=True)]
    known = [each for each in parts if each is not None]
    if len(known) < len(parts):
        return _Result(Poison(span), lambda value: False)

    def store(value: Value) -> bool:
        assert isinstance(value, Sequence)
        return all(each.store(element) for each, element in zip(known, value.elements, strict=True))

    return _Result(Sequence(tuple(each.value for each in known), span), store)


def _pending(label: kir.Label) -> kir.Local:
    """Stands for the result of a function until all of its returns are known."""
    return kir.Local(label.name, -label.uid, bool_)


def _stored(ctx: Context, returns: Returns, body: kir.Body, result: _Result) -> kir.Body:
    """``body`` with the numbers of the returns replaced by what stores their values."""
    pending = _pending(returns.label)
    statements: list[kir.Stmt] = []
    for statement in body:
        if isinstance(statement, kir.Assign) and statement.local == pending:
            assert isinstance(statement.value, kir.Const)
            value = returns.values[int(statement.value.value)][1]
            with ctx.nested() as stores:
                if value is not None:
                    result.store(value)
            statements += stores
        else:
            statements.append(map_bodies(statement, lambda inner: _stored(ctx, returns, inner, result)))
    return tuple(statements)
