"""Walks over LIR: the values that an operation or a statement takes, and all statements of a body."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ebb.compiler import lir


def operands(operation: lir.Operation) -> tuple[lir.Value, ...]:
    """The values that ``operation`` takes."""
    match operation:
        case lir.Unary(_, operand) | lir.Convert(operand):
            return (operand,)
        case lir.Binary(_, left, right) | lir.Compare(_, left, right):
            return (left, right)
        case lir.Select(condition, then, other):
            return (condition, then, other)
        case lir.Math(_, values):
            return values
        case lir.Load(_, index) | lir.LoadVar(_, index):
            return (index,)
        case lir.LoadArgument() | lir.ThreadNumber():
            return ()


def values(stmt: lir.Stmt) -> tuple[lir.Value, ...]:
    """The values that stand in ``stmt`` itself, not in the bodies inside it."""
    match stmt:
        case lir.Let(_, operation):
            return operands(operation)
        case lir.StoreVar() | lir.Store() | lir.Accumulate() | lir.AtomicUpdate():
            return (stmt.index, stmt.value)
        case lir.If() | lir.While():
            return (stmt.condition,)
        case lir.For():
            return (stmt.start, stmt.stop)
        case lir.Fail():
            return (stmt.position, *stmt.payload)
        case lir.Print():
            return (stmt.position, *stmt.values)
        case lir.Declare() | lir.Block() | lir.Leave() | lir.RowLoop() | lir.Barrier():
            return ()


def bodies(stmt: lir.Stmt) -> tuple[lir.Body, ...]:
    """The bodies inside ``stmt``."""
    match stmt:
        case lir.If():
            return (stmt.then, stmt.orelse)
        case lir.While():
            return (stmt.head, stmt.body)
        case lir.RowLoop(inside=lir.Inside() as inside):
            return (stmt.body, inside.body)
        case lir.For() | lir.Block() | lir.RowLoop():
            return (stmt.body,)
        case _:
            return ()


def statements(body: lir.Body) -> Iterator[lir.Stmt]:
    """All statements in ``body``, at any depth, in their order."""
    for stmt in body:
        yield stmt
        for inner in bodies(stmt):
            yield from statements(inner)


def variable_reads(body: lir.Body) -> Counter[int]:
    """How often ``body`` reads each variable, by number."""
    return Counter(
        stmt.operation.var.number
        for stmt in statements(body)
        if isinstance(stmt, lir.Let) and isinstance(stmt.operation, lir.LoadVar)
    )
