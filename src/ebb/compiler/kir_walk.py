"""Walks over KIR: the parts of a node, all nodes below one, and copies of a node with other parts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from operator import attrgetter, is_
from typing import Any, TypeAlias

from ebb.compiler import kir
from ebb.compiler.kir import Body, Expr, Stmt
from ebb.records import replace
from ebb.relations.field import Field

_Operands: TypeAlias = Callable[[Any], tuple[Expr, ...]]
_Inside: TypeAlias = Callable[[Any], tuple[Body, ...]]

_LEAVES: tuple[type[Any], ...] = (kir.Const, kir.Uniform, kir.ReadLocal, kir.ReadGlobal, kir.Random)

_EXPRESSIONS: tuple[tuple[_Operands, tuple[type[Any], ...]], ...] = (
    (lambda expr: (expr.key,), (kir.ReadField, kir.Affine, kir.RowId, kir.Coords, kir.QuerySize)),
    (lambda expr: (expr.operand,), (kir.Unary, kir.Cast, kir.Splat, kir.RowAt)),
    (attrgetter("left", "right"), (kir.Binary, kir.Compare, kir.Logic)),
    (attrgetter("condition", "then", "other"), (kir.Choose,)),
    (attrgetter("elements"), (kir.Build,)),
    (lambda expr: (expr.operand, *expr.indices), (kir.Component,)),
    (attrgetter("arguments"), (kir.Call,)),
)

_STATEMENTS: tuple[tuple[_Operands, tuple[type[Any], ...]], ...] = (
    (lambda stmt: (*stmt.indices, stmt.value), (kir.Assign, kir.ReduceGlobal)),
    (lambda stmt: (stmt.key, *stmt.indices, stmt.value), (kir.WriteField, kir.ReduceField)),
    (lambda stmt: (stmt.condition,), (kir.If, kir.While, kir.Assert)),
    (attrgetter("start", "stop", "step"), (kir.ForRange,)),
    (lambda stmt: (stmt.key,), (kir.ForQuery,)),
    (lambda stmt: tuple([part[0] for part in stmt.parts if not isinstance(part, str)]), (kir.Print,)),
    (lambda stmt: (), (kir.Break, kir.Continue, kir.Block, kir.Leave, kir.Breakpoint)),
)

_BODIES: tuple[tuple[_Inside, tuple[type[Any], ...]], ...] = (
    (attrgetter("then", "orelse"), (kir.If,)),
    (lambda stmt: (stmt.body,), (kir.ForRange, kir.ForQuery, kir.While, kir.Block)),
)

# By type: kernels are walked so often that to try one type after the other took a tenth of a compilation.
_INNER: dict[type[Any], _Operands] = {kind: take for take, kinds in _EXPRESSIONS for kind in kinds}
_CHILDREN: dict[type[Any], _Operands] = {**_INNER, **dict.fromkeys(_LEAVES, lambda _: ())}
_OPERANDS: dict[type[Any], _Operands] = {kind: take for take, kinds in _STATEMENTS for kind in kinds}
_BODIES_OF: dict[type[Any], _Inside] = {kind: take for take, kinds in _BODIES for kind in kinds}


def children(expr: Expr) -> tuple[Expr, ...]:
    """The operands of ``expr``, in the order in which they are evaluated."""
    return _CHILDREN[type(expr)](expr)


def operands(stmt: Stmt) -> tuple[Expr, ...]:
    """The expressions that stand in ``stmt`` itself, not in the bodies inside it."""
    return _OPERANDS[type(stmt)](stmt)


def bodies(stmt: Stmt) -> tuple[Body, ...]:
    """The bodies inside ``stmt``."""
    take = _BODIES_OF.get(type(stmt))
    return () if take is None else take(stmt)


def statements(body: Body) -> list[Stmt]:
    """All statements in ``body``, at any depth, in source order."""
    found: list[Stmt] = []
    _collect_statements(body, found)
    return found


def _collect_statements(body: Body, found: list[Stmt]) -> None:
    for stmt in body:
        found.append(stmt)
        take = _BODIES_OF.get(type(stmt))
        if take is not None:
            for inner in take(stmt):
                _collect_statements(inner, found)


def subexpressions(expr: Expr) -> list[Expr]:
    """``expr`` and all expressions inside it, operands before what uses them."""
    return _inside([expr])


def expressions_in(stmt: Stmt) -> list[Expr]:
    """The expressions that stand in ``stmt`` itself and all inside them, operands before what uses them."""
    return _inside([*_OPERANDS[type(stmt)](stmt)])


def _inside(waiting: list[Expr]) -> list[Expr]:
    """``waiting``, which is emptied, and all expressions inside, operands before what uses them."""
    # From the last one back, what uses before its operands, and that turned round: twice as quick as a recursion.
    found: list[Expr] = []
    while waiting:
        expr = waiting.pop()
        found.append(expr)
        take = _INNER.get(type(expr))
        if take is not None:
            waiting.extend(take(expr))
    found.reverse()
    return found


def expressions(body: Body) -> list[Expr]:
    """All expressions in ``body``, at any depth."""
    return _inside([operand for stmt in statements(body) for operand in _OPERANDS[type(stmt)](stmt)])


def queried_fields(kernel: kir.Kernel) -> tuple[Field, ...]:
    """The grouped key fields whose index the kernel uses, each once, in source order."""
    return queried_in(statements(kernel.body), expressions(kernel.body))


def queried_in(stmts: Iterable[Stmt], exprs: Iterable[Expr]) -> tuple[Field, ...]:
    """The same for who has walked the kernel already: of its statements and its expressions."""
    loops = [stmt.index for stmt in stmts if isinstance(stmt, kir.ForQuery)]
    sizes = [expr.index for expr in exprs if isinstance(expr, kir.QuerySize)]
    return tuple(dict.fromkeys((*loops, *sizes)))


def draws(kernel: kir.Kernel) -> bool:
    """Whether the kernel draws random numbers, so that each of its launches has a number of its own."""
    # A random number is the whole right side of an assignment, and stands nowhere else.
    return any(
        [isinstance(stmt, kir.Assign) and isinstance(stmt.value, kir.Random) for stmt in statements(kernel.body)]
    )


def map_children(expr: Expr, change: Callable[[Expr], Expr]) -> Expr:  # noqa: C901 - one case a kind of expression
    """A copy of ``expr`` with ``change`` applied to each operand; ``expr`` itself where none changes."""
    take = _INNER.get(type(expr))
    if take is None:
        return expr
    old = take(expr)
    new = tuple([change(child) for child in old])
    if all(map(is_, old, new)):
        return expr
    match expr:
        case kir.ReadField() | kir.Affine() | kir.RowId() | kir.Coords() | kir.QuerySize():
            return replace(expr, key=new[0])
        case kir.Unary() | kir.Cast() | kir.Splat() | kir.RowAt():
            return replace(expr, operand=new[0])
        case kir.Binary() | kir.Compare() | kir.Logic():
            return replace(expr, left=new[0], right=new[1])
        case kir.Choose():
            return replace(expr, condition=new[0], then=new[1], other=new[2])
        case kir.Build():
            return replace(expr, elements=new)
        case kir.Component():
            return replace(expr, operand=new[0], indices=new[1:])
        case kir.Call():
            return replace(expr, arguments=new)
        case kir.Const() | kir.Uniform() | kir.ReadLocal() | kir.ReadGlobal() | kir.Random():
            return expr


def map_operands(stmt: Stmt, change: Callable[[Expr], Expr]) -> Stmt:
    """A copy of ``stmt`` with ``change`` applied to each of its own expressions; ``stmt`` itself where none changes."""
    old = operands(stmt)
    new = tuple([change(operand) for operand in old])
    if all(map(is_, old, new)):
        return stmt
    match stmt:
        case kir.Assign() | kir.ReduceGlobal():
            return replace(stmt, indices=new[:-1], value=new[-1])
        case kir.WriteField() | kir.ReduceField():
            return replace(stmt, key=new[0], indices=new[1:-1], value=new[-1])
        case kir.If() | kir.While() | kir.Assert():
            return replace(stmt, condition=new[0])
        case kir.ForRange():
            return replace(stmt, start=new[0], stop=new[1], step=new[2])
        case kir.ForQuery():
            return replace(stmt, key=new[0])
        case kir.Print():
            rest = iter(new)
            return replace(
                stmt, parts=tuple(part if isinstance(part, str) else (next(rest), part[1]) for part in stmt.parts)
            )
        case kir.Break() | kir.Continue() | kir.Block() | kir.Leave() | kir.Breakpoint():
            return stmt


def map_bodies(stmt: Stmt, change: Callable[[Body], Body]) -> Stmt:
    """A copy of ``stmt`` with ``change`` applied to each body inside it; ``stmt`` itself where none changes."""
    take = _BODIES_OF.get(type(stmt))
    if take is None:
        return stmt
    old = take(stmt)
    new = tuple([change(body) for body in old])
    if all(map(is_, old, new)):
        return stmt
    match stmt:
        case kir.If():
            return replace(stmt, then=new[0], orelse=new[1])
        case kir.ForRange() | kir.ForQuery() | kir.While() | kir.Block():
            return replace(stmt, body=new[0])
        case _:
            return stmt


def map_body(body: Body, change: Callable[[Expr], Expr]) -> Body:
    """A copy of ``body`` with ``change`` applied to the expressions of its statements, at any depth."""
    new = tuple([map_operands(map_bodies(stmt, lambda inner: map_body(inner, change)), change) for stmt in body])
    return body if all(map(is_, body, new)) else new
