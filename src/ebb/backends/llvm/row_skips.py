"""Which sides of conditions strips of rows leave out where no lane takes them.

Lanes compute both sides of a condition. A side that takes long, and that few rows take, is worth a look whether there
is one among the rows of the strip: so gas at rest costs no square roots.
"""

from __future__ import annotations

from collections.abc import Iterator

from ebb.compiler import lir
from ebb.compiler.lir_walk import statements

_QUICK = frozenset({"abs", "floor", "ceil", "trunc", "round", "copysign"})
"""The functions that take no longer than an addition or two."""


def is_left_out(side: lir.Body) -> bool:
    """Whether a side of a condition is left out where no lane takes it.

    It is where it has a division, a root or another function that takes long, and does nothing but load and calculate.
    """
    return _changes_variables(side) and any(_is_slow(operation) for operation in _operations(side))


def only_calculates(side: lir.Body) -> bool:
    """Whether a side of a condition changes nothing but variables, and loads nothing."""
    return _changes_variables(side) and not any(isinstance(operation, lir.Load) for operation in _operations(side))


def leaves_out(loop: lir.RowLoop) -> bool:
    """Whether ``loop`` has such sides."""
    conditions = [stmt for stmt in statements(loop.body) if isinstance(stmt, lir.If)]
    return any(is_left_out(side) for stmt in conditions for side in (stmt.then, stmt.orelse))


def assigned(body: lir.Body) -> Iterator[tuple[lir.Var, int]]:
    """The components of variables that ``body`` sets."""
    for stmt in statements(body):
        match stmt:
            case lir.StoreVar(var, lir.Literal(k), _):
                yield var, k
            case _:
                pass


def _changes_variables(side: lir.Body) -> bool:
    return all(isinstance(stmt, lir.Let | lir.StoreVar | lir.If) for stmt in statements(side))


def _operations(side: lir.Body) -> list[lir.Operation]:
    return [stmt.operation for stmt in statements(side) if isinstance(stmt, lir.Let)]


def _is_slow(operation: lir.Operation) -> bool:
    match operation:
        case lir.Binary("/"):
            return True
        case lir.Math(function, _):
            return function not in _QUICK
        case _:
            return False
