"""Statements other than assignments and loops, and the table of all statements."""

from __future__ import annotations

import ast
import builtins
from collections.abc import Callable, Mapping
from typing import Any

from ebb.compiler import kir
from ebb.compiler.elaborate import assignments, loops
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.errors_syntax import (
    AssertText,
    DroppedResult,
    KernelReturnsValue,
    UselessExpression,
)
from ebb.compiler.elaborate.function import Func
from ebb.compiler.elaborate.inline import return_value
from ebb.compiler.elaborate.operators import condition
from ebb.compiler.elaborate.printing import print_statement
from ebb.compiler.elaborate.scope import raw_lookup
from ebb.compiler.elaborate.values import Nothing, Poison


def _expression(ctx: Context, node: ast.Expr) -> None:
    """A statement that is an expression: a call of something that returns nothing, or an error."""
    match node.value:
        case ast.Constant(value=value) if value is ...:
            return
        case ast.Call(func=ast.Name(id=name)) as call if _is_builtin(ctx, name, print):
            print_statement(ctx, call)
            return
        case ast.Call(func=ast.Name(id=name), args=[], keywords=[]) if _is_builtin(ctx, name, breakpoint):
            ctx.emit(kir.Breakpoint(ctx.span(node)))
            return
        case _:
            pass
    value = ctx.value(node.value)
    if isinstance(value, Nothing | Poison):
        return
    function = _called(ctx, node.value)
    span = ctx.span(node)
    ctx.report(UselessExpression(span) if function is None else DroppedResult(span, function))


def _is_builtin(ctx: Context, name: str, function: Any) -> bool:
    if name in ctx.frame.locals:
        return False
    outside = raw_lookup(ctx.frame.source, name)
    return outside is not None and outside[1] is function


def _called(ctx: Context, node: ast.expr) -> str | None:
    """The func or member that an expression calls, None for any other expression."""
    if not isinstance(node, ast.Call):
        return None
    if isinstance(node.func, ast.Name):
        outside = raw_lookup(ctx.frame.source, node.func.id)
        found = getattr(builtins, node.func.id, None) if outside is None else outside[1]
        return node.func.id if isinstance(found, Func) else None
    return ast.unparse(node.func) if isinstance(node.func, ast.Attribute) else None


def _if(ctx: Context, node: ast.If) -> None:
    test = condition(ctx, ctx.value(node.test), "if")
    frame = ctx.frame
    before = frame.live
    with ctx.nested() as then:
        ctx.run(node.body)
    after_then, frame.live = frame.live, before
    with ctx.nested() as orelse:
        ctx.run(node.orelse)
    frame.join([after_then, frame.live])
    if test is not None:
        ctx.emit(kir.If(test, tuple(then), tuple(orelse), ctx.opening(node)))


def _return(ctx: Context, node: ast.Return) -> None:
    frame = ctx.frame
    if frame.parent is not None:
        return_value(ctx, node)
        return
    if node.value is not None and not (isinstance(node.value, ast.Constant) and node.value.value is None):
        ctx.value(node.value)
        ctx.report(KernelReturnsValue(ctx.span(node), ctx.kernel))
    frame.returns.used = True
    ctx.emit(kir.Leave(frame.returns.label, ctx.span(node)))
    frame.live = None


def _assert(ctx: Context, node: ast.Assert) -> None:
    test = condition(ctx, ctx.value(node.test), "assert")
    text = ""
    match node.msg:
        case None:
            pass
        case ast.Constant(value=str() as text):
            pass
        case other:
            ctx.report(AssertText(ctx.span(other)))
    if test is not None:
        ctx.emit(kir.Assert(test, text, ctx.span(node)))


def _pass(ctx: Context, node: ast.Pass) -> None:
    del ctx, node


STATEMENTS: Mapping[type[ast.stmt], Callable[[Context, Any], None]] = {
    **assignments.STATEMENTS,
    **loops.STATEMENTS,
    ast.Expr: _expression,
    ast.If: _if,
    ast.Return: _return,
    ast.Assert: _assert,
    ast.Pass: _pass,
}
