"""Loops: over ranges and queries, unrolled over tuples and vectors, ``while``, and what leaves them."""

from __future__ import annotations

import ast
import builtins
from collections.abc import Callable, Mapping
from typing import Any

from ebb.compiler import kir
from ebb.compiler.elaborate.assignments import elements_to_unpack, snapshot, store
from ebb.compiler.elaborate.attributes import attribute
from ebb.compiler.elaborate.capture import elements_of
from ebb.compiler.elaborate.context import Context, is_simple
from ebb.compiler.elaborate.convert import Operand, adapted, component, fit, lone_scalar, operand
from ebb.compiler.elaborate.errors_calls import NotIterable, RangeArguments
from ebb.compiler.elaborate.errors_names import MaybeUnset
from ebb.compiler.elaborate.errors_syntax import RejectedSyntax
from ebb.compiler.elaborate.inline import repeatable
from ebb.compiler.elaborate.operators import condition
from ebb.compiler.elaborate.rejected import REJECTED_CLAUSES, REJECTED_EXPRESSIONS
from ebb.compiler.elaborate.scope import Bound, Loop, State, Variable, raw_lookup
from ebb.compiler.elaborate.values import Poison, Query, Sequence, Static, Typed, Value, Weak, noun
from ebb.diagnostics.span import Span
from ebb.relations.relation import Relation
from ebb.types.rules import is_integer
from ebb.types.types import ScalarType, Type, bool_, int32, int64, uint64

_CHANGED = "a loop further down makes it something else, which the next turn would read here"
_LOST = "the loop before may have been left by 'break' in any of its turns, each of which has its own '{name}'"


def for_loop(ctx: Context, node: ast.For) -> None:
    """``for``: over a range, a query, or unrolled."""
    if node.orelse:
        ctx.report(RejectedSyntax(ctx.span(node.orelse[0]), *REJECTED_CLAUSES["for-else"]))
    bounds = _range_nodes(ctx, node.iter)
    if bounds is not None:
        _for_range(ctx, node, bounds)
        return
    value = ctx.value(node.iter)
    match value:
        case Poison():
            _skip(ctx, node)
        case Query():
            _for_query(ctx, node, value)
        case Sequence(elements, _):
            changing = {name for name in ctx.frame.stores.count if not ctx.frame.once(name)}
            unroll(ctx, node, [snapshot(ctx, element, changing) for element in elements])
        case Static(tuple() | list(), _, _):
            unroll(ctx, node, list(elements_of(ctx, value).elements))
        case Typed(expr) if expr.type.shape:
            whole = ctx.simple(expr)
            if isinstance(whole, kir.ReadLocal) and ctx.frame.rebinds(whole.local.name):
                whole = ctx.temporary(whole.local.name, whole)  # the loop goes over what the name was at its start
            unroll(ctx, node, [Typed(component(whole, (index,))) for index in range(expr.type.shape[0])])
        case _:
            ctx.report(NotIterable(ctx.span(node.iter), noun(value), _advice(value)))
            _skip(ctx, node)


def while_loop(ctx: Context, node: ast.While) -> None:
    """``while``: what the condition emits runs before each test."""
    if node.orelse:
        ctx.report(RejectedSyntax(ctx.span(node.orelse[0]), *REJECTED_CLAUSES["while-else"]))
    span, frame = ctx.opening(node), ctx.frame
    entry, loop = frame.live, Loop()
    frame.loops.append(loop)
    with ctx.nested() as before_test:
        value = ctx.value(node.test)
        test = condition(ctx, value, "while")
    frame.loops.pop()
    with ctx.nested() as body:
        _run_body(ctx, node.body, loop)
    endless = isinstance(value, Weak) and value.literal and value.value is True
    _after(ctx, entry, loop, [] if endless else [entry, frame.live, *loop.continues])
    if test is None:
        return
    if before_test:
        stop = kir.If(kir.Unary("not", test, bool_, test.span), (kir.Break(test.span),), (), test.span)
        body = [*before_test, stop, *body]
        test = kir.Const(True, bool_, test.span)
    ctx.emit(kir.While(test, tuple(body), span))


def break_loop(ctx: Context, node: ast.Break) -> None:
    loop, span = ctx.frame.loops[-1], ctx.span(node)
    loop.breaks.append(ctx.frame.live)
    ctx.emit(kir.Break(span) if loop.end is None else kir.Leave(loop.end, span))
    ctx.frame.live = None


def continue_loop(ctx: Context, node: ast.Continue) -> None:
    loop, span = ctx.frame.loops[-1], ctx.span(node)
    loop.continues.append(ctx.frame.live)
    ctx.emit(kir.Continue(span) if loop.turn is None else kir.Leave(loop.turn, span))
    ctx.frame.live = None


# ---- Ranges ----


def _range_nodes(ctx: Context, node: ast.expr) -> list[ast.expr] | None:
    """The arguments of ``range``, None where the loop is over something else."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name) or node.func.id in ctx.frame.locals:
        return None
    outside = raw_lookup(ctx.frame.source, node.func.id)
    if outside is None or outside[1] is not builtins.range:
        return None
    if node.keywords:
        ctx.report(RangeArguments(ctx.span(node), "names"))
    return node.args


def _for_range(ctx: Context, node: ast.For, nodes: list[ast.expr]) -> None:
    span, frame = ctx.opening(node), ctx.frame
    bounds = _bounds(ctx, nodes, ctx.span(node.iter))
    if bounds is None or not isinstance(node.target, ast.Name):
        if bounds is not None:
            elements_to_unpack(ctx, Typed(bounds[0]), 2, ctx.span(node.target))
        _skip(ctx, node)
        return
    start, stop, step = bounds
    entry, loop = frame.live, Loop()
    local = _loop_local(ctx, node.target, start.type)
    with ctx.nested() as body:
        _run_body(ctx, node.body, loop)
    _after(ctx, entry, loop, [*([] if _runs(start, stop, step) else [entry]), frame.live, *loop.continues])
    ctx.emit(kir.ForRange(local, start, stop, step, tuple(body), span))


def _bounds(ctx: Context, nodes: list[ast.expr], span: Span) -> tuple[kir.Expr, kir.Expr, kir.Expr] | None:
    values = ctx.values(nodes)
    if any(isinstance(value, Poison) for value in values):
        return None
    if not 1 <= len(values) <= 3:
        ctx.report(RangeArguments(span, f"{len(values)} values"))
        return None
    found = [_bound(ctx, value) for value in values]
    known = [value for value in found if value is not None]
    if len(known) < len(found):
        return None
    type_ = int64 if any(_scalar(value) != int32 for value in known) else int32
    exprs = [_as_bound(ctx, value, type_) for value in known]
    ready = [expr for expr in exprs if expr is not None]
    if len(ready) < len(exprs):
        return None
    if len(ready) == 3 and isinstance(ready[2], kir.Const) and ready[2].value == 0:
        ctx.report(RangeArguments(ready[2].span, "a step of 0"))
        return None
    zero, one = kir.Const(0, type_, span), kir.Const(1, type_, span)
    match ready:
        case [stop]:
            return zero, stop, one
        case [start, stop]:
            return start, stop, one
        case _:
            return ready[0], ready[1], ready[2]


def _bound(ctx: Context, value: Value) -> Operand | None:
    found = operand(ctx, value)
    if found is None:
        return None
    scalar = _scalar(found)
    if scalar is None or not is_integer(scalar) or scalar == uint64:
        ctx.report(RangeArguments(found.span, noun(found)))
        return None
    return found


def _scalar(value: Operand) -> ScalarType | None:
    match value:
        case Typed(expr):
            return expr.type if isinstance(expr.type, ScalarType) else None
        case Sequence():
            return None
        case weak:
            return lone_scalar(weak)


def _as_bound(ctx: Context, value: Operand, type_: ScalarType) -> kir.Expr | None:
    match value:
        case Typed(expr):
            return fit(expr, type_)
        case Sequence():
            return None
        case weak:
            return adapted(ctx, weak, type_)


def _runs(start: kir.Expr, stop: kir.Expr, step: kir.Expr) -> bool:
    """Whether a range surely has a number in it."""
    match start, stop, step:
        case kir.Const(first), kir.Const(last), kir.Const(by):
            return len(range(first, last, by)) > 0
        case _:
            return False


# ---- Queries ----


def _for_query(ctx: Context, node: ast.For, query: Query) -> None:
    span, frame, target = ctx.opening(node), ctx.frame, node.target
    relation = query.index.relation
    entry, loop = frame.live, Loop()
    if isinstance(target, ast.Name) and not query.path:
        local = _loop_local(ctx, target, relation.key_type)
        with ctx.nested() as body:
            _run_body(ctx, node.body, loop)
    else:
        local = ctx.new_local("row", relation.key_type)
        with ctx.nested() as body:
            value: Value = Typed(kir.ReadLocal(local, local.type, query.span))
            for step in query.path:
                value = attribute(ctx, value, step.name, query.span, step.span)
            _store_turn(ctx, target, value)
            _run_body(ctx, node.body, loop)
    _after(ctx, entry, loop, [entry, frame.live, *loop.continues])
    ctx.emit(kir.ForQuery(local, query.index, query.key, tuple(body), span))


# ---- Unrolled loops ----


def unroll(ctx: Context, node: ast.For, elements: list[Value]) -> None:
    """A turn for each element, in which the loop's variables are known when the kernel is compiled.

    A local that a turn assigns first is that turn's own: so a key that each turn computes is bound once.
    """
    frame, span = ctx.frame, ctx.opening(node)
    targets = {name for name in _target_names(node.target) if frame.only_loops(name)}
    outer = set(frame.bindings) - targets
    loop = Loop(end=ctx.new_label("loop"))
    with ctx.nested() as turns:
        for element in elements:
            frame.forget(set(frame.bindings) - outer)
            loop.turn, loop.continues = ctx.new_label("turn"), []
            with ctx.nested() as body:
                _store_turn(ctx, node.target, element)
                _run_body(ctx, node.body, loop)
            if loop.continues:
                turns.append(kir.Block(loop.turn, tuple(body), span))
            else:
                turns += body
            frame.join([frame.live, *loop.continues])
            if frame.live is None:
                break  # every way left the loop
    frame.join([frame.live, *loop.breaks])
    if not loop.breaks:
        ctx.out += turns
        return
    own = set(frame.bindings) - outer
    frame.lost |= {name: _LOST.format(name=name) for name in own}
    frame.forget(own)
    assert loop.end is not None
    ctx.emit(kir.Block(loop.end, tuple(turns), span))


def _target_names(target: ast.expr) -> set[str]:
    return {each.id for each in ast.walk(target) if isinstance(each, ast.Name)}


# ---- What loops share ----


def _run_body(ctx: Context, body: list[ast.stmt], loop: Loop) -> None:
    ctx.frame.loops.append(loop)
    ctx.run(body)
    ctx.frame.loops.pop()


def _loop_local(ctx: Context, target: ast.Name, type_: Type) -> kir.Local:
    """The variable of a loop: that of before, or where it had another type, a new one."""
    frame, name, span = ctx.frame, target.id, ctx.span(target)
    binding = frame.binding(name)
    if not (isinstance(binding, Variable) and binding.local.type == type_):
        binding = Variable(ctx.new_local(name, type_), span)
    frame.bind(name, binding)
    return binding.local


def _after(ctx: Context, entry: State, loop: Loop, ways: list[State]) -> None:
    """What has values after a loop that is left by ``ways`` and by its breaks.

    A turn that binds a name to something else than the turn before must not read what it was.
    """
    frame = ctx.frame
    for state in (frame.live, *loop.continues):
        for name, binding in (entry or {}).items():
            read = loop.reads.get((name, id(binding)))
            if state is not None and state.get(name) is not binding and read is not None:
                ctx.report(MaybeUnset(read, name, binding.span, _CHANGED))
    frame.join([*ways, *loop.breaks])


def _store_turn(ctx: Context, target: ast.expr, value: Value) -> None:
    """Gives the variables of an unrolled loop the values of one turn."""
    match target:
        case ast.Name(id=name) if ctx.frame.only_loops(name):
            if isinstance(value, Typed) and not is_simple(value.expr):
                value = Typed(ctx.temporary(name, value.expr))
            value = repeatable(ctx, value)
            ctx.frame.bind(name, Bound(value, ctx.span(target)))
        case ast.Tuple(elts=targets) | ast.List(elts=targets):
            elements = elements_to_unpack(ctx, value, len(targets), ctx.span(target))
            for position, each in enumerate(targets):
                _store_turn(ctx, each, Poison(ctx.span(each)) if elements is None else elements[position])
        case ast.Starred():
            ctx.report(RejectedSyntax(ctx.span(target), *REJECTED_EXPRESSIONS[ast.Starred]))
        case _:
            store(ctx, target, value, ctx.span(target))


def _skip(ctx: Context, node: ast.For) -> None:
    """Looks for errors in the body of a loop that cannot be elaborated."""
    entry = ctx.frame.live
    with ctx.nested():
        _store_turn(ctx, node.target, Poison(ctx.span(node.iter)))
        _run_body(ctx, node.body, Loop())
    ctx.frame.live = entry


def _advice(value: Value) -> str:
    if isinstance(value, Static) and isinstance(value.object, Relation):
        return f"launch a kernel on '{value.object.name}', or loop over a query: ebb.where({value.name}.key, row)"
    return "loop over range(...), a query, a tuple or a vector"


STATEMENTS: Mapping[type[ast.stmt], Callable[[Context, Any], None]] = {
    ast.For: for_loop,
    ast.While: while_loop,
    ast.Break: break_loop,
    ast.Continue: continue_loop,
}
