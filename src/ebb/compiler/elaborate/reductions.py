"""``x.f = min(x.f, e)``: an assignment that is a reduction, because the place stands on both sides."""

from __future__ import annotations

import ast
from typing import Any

from ebb.compiler import kir
from ebb.compiler.elaborate.calls import builtin
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.scope import raw_lookup
from ebb.compiler.elaborate.values import Poison, Static, Value
from ebb.diagnostics.span import Span
from ebb.records import record
from ebb.types.builtins import Builtin, from_python


@record
class Extremum:
    """A reduction by ``min`` or ``max``, with the arguments other than the place.

    ``of_global``: the two sides agree only if the place is a global, which is read as ``E`` and as ``E.value``.
    """

    op: kir.ReduceOp
    row: Builtin
    function: Any
    name: str
    nodes: tuple[ast.expr, ...]
    of_global: bool

    def value(self, ctx: Context, span: Span) -> Value:
        """What the place is reduced with."""
        values = ctx.values(self.nodes)
        if any(isinstance(value, Poison) for value in values):
            return Poison(span)
        return values[0] if len(values) == 1 else builtin(ctx, self.row, self.function, self.name, values, span)


def find_extremum(ctx: Context, node: ast.Assign) -> Extremum | None:
    """The reduction that an assignment is, None where it is none."""
    if len(node.targets) != 1 or not isinstance(node.value, ast.Call) or node.value.keywords:
        return None
    target, call = node.targets[0], node.value
    if isinstance(target, ast.Name) and target.id in ctx.frame.locals:
        return None
    places = [argument for argument in call.args if _same(argument, target)]
    of_global = not places
    if of_global:
        places = [argument for argument in call.args if _same(_bare(argument), _bare(target))]
    if len(places) != 1 or len(call.args) < 2 or any(isinstance(each, ast.Starred) for each in call.args):
        return None
    function = _function(ctx, call.func)
    row = function if isinstance(function, Builtin) else from_python(function)
    if row is None or row.operator is None:
        return None
    rest = tuple(argument for argument in call.args if argument is not places[0])
    return Extremum(kir.ReduceOp(row.operator), row, function, ast.unparse(call.func), rest, of_global)


def _function(ctx: Context, node: ast.expr) -> Any:
    """The captured object that ``node`` is, None where it is another expression."""
    match node:
        case ast.Name(id=name) if name not in ctx.frame.locals:
            outside = raw_lookup(ctx.frame.source, name)
            return None if outside is None else outside[1]
        case ast.Attribute(value=ast.Name(id=name)) if name not in ctx.frame.locals:
            found = ctx.value(node)
            return found.object if isinstance(found, Static) else None
        case _:
            return None


def _same(a: ast.expr, b: ast.expr) -> bool:
    return ast.unparse(a) == ast.unparse(b)


def _bare(node: ast.expr) -> ast.expr:
    """``E`` for ``E.value``, also in a component: ``E[0]`` for ``E.value[0]``."""
    match node:
        case ast.Attribute(value=base, attr="value"):
            return _bare(base)
        case ast.Attribute(value=base, attr=name):
            return ast.Attribute(_bare(base), name, ast.Load())
        case ast.Subscript(value=base, slice=index):
            return ast.Subscript(_bare(base), index, ast.Load())
        case _:
            return node
