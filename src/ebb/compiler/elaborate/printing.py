"""``print`` in a kernel."""

from __future__ import annotations

import ast

from ebb.compiler import kir
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.convert import typed
from ebb.compiler.elaborate.errors_syntax import PrintForm
from ebb.compiler.elaborate.values import Poison, Static, Value
from ebb.types.rules import is_bool, is_float, is_key
from ebb.types.types import Type

Parts = list[str | tuple[kir.Expr, str]]

_PLAIN = (-1, ord("r"), ord("s"))


def print_statement(ctx: Context, node: ast.Call) -> None:
    """``print(a, f"{b:.3f}", sep=", ")``: one line."""
    separator = _separator(ctx, node)
    parts: Parts = []
    for position, argument in enumerate(node.args):
        if position:
            parts.append(separator)
        mark = len(ctx.out)
        more = _argument(ctx, argument)
        parts = _kept(ctx, mark, parts)
        parts += more
    ctx.emit(kir.Print(_joined(parts), ctx.span(node)))


def _separator(ctx: Context, node: ast.Call) -> str:
    separator = " "
    for keyword in node.keywords:
        if keyword.arg == "sep" and isinstance(keyword.value, ast.Constant) and isinstance(keyword.value.value, str):
            separator = keyword.value.value
        else:
            ctx.report(PrintForm(ctx.span(keyword), f"'{keyword.arg or '**'}='"))
    return separator


def _argument(ctx: Context, node: ast.expr) -> Parts:
    if not isinstance(node, ast.JoinedStr):
        return _part(ctx, ctx.value(node), "")
    parts: Parts = []
    for piece in node.values:
        mark = len(ctx.out)
        more = _piece(ctx, piece)
        parts = _kept(ctx, mark, parts)
        parts += more
    return parts


def _piece(ctx: Context, node: ast.expr) -> Parts:
    match node:
        case ast.Constant(value=str() as text):
            return [text]
        case ast.FormattedValue(value=value, conversion=conversion, format_spec=spec) if conversion in _PLAIN:
            return _part(ctx, ctx.value(value), _spec(ctx, spec), spec)
        case _:
            ctx.report(PrintForm(ctx.span(node), "the conversion '!a'"))
            return []


def _spec(ctx: Context, node: ast.expr | None) -> str:
    match node:
        case None:
            return ""
        case ast.JoinedStr(values=[]):
            return ""
        case ast.JoinedStr(values=[ast.Constant(value=str() as text)]):
            return text
        case _:
            ctx.report(PrintForm(ctx.span(node), "a format that is computed"))
            return ""


def _part(ctx: Context, value: Value, spec: str, node: ast.expr | None = None) -> Parts:
    match value:
        case Poison():
            return []
        case Static(str() as text, _, _):
            return [format(text, spec)]
        case _:
            expr = typed(ctx, value)
    if expr is None:
        return []
    if not _formats(expr.type, spec):
        span = expr.span if node is None else ctx.span(node)
        ctx.report(PrintForm(span, f"the format '{spec}' for a value of type {expr.type!r}"))
        return []
    return [(expr, spec)]


def _formats(type_: Type, spec: str) -> bool:
    sample = "" if is_key(type_) else False if is_bool(type_) else 0.0 if is_float(type_) else 0
    try:
        format(sample, spec)
    except ValueError:
        return False
    return True


def _kept(ctx: Context, mark: int, parts: Parts) -> Parts:
    exprs = ctx.keep_exprs(mark, tuple(part[0] for part in parts if not isinstance(part, str)))
    rest = iter(exprs)
    return [part if isinstance(part, str) else (next(rest), part[1]) for part in parts]


def _joined(parts: Parts) -> tuple[str | tuple[kir.Expr, str], ...]:
    """``parts`` with neighbouring texts made one."""
    joined: Parts = []
    for part in parts:
        if isinstance(part, str) and joined and isinstance(joined[-1], str):
            joined[-1] += part
        else:
            joined.append(part)
    return tuple(joined)
