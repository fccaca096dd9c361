"""Keys of reductions as the strategies see them: which locals surely hold what they were bound to."""

from __future__ import annotations

from ebb.compiler import kir
from ebb.compiler.kir_walk import bodies, statements, subexpressions
from ebb.compiler.lower.bindings import variables


def certain_locals(kernel: kir.Kernel) -> frozenset[int]:
    """The locals, by ``uid``, that wherever they are read hold what their one binding gave them in this very turn.

    They are those that the lowering keeps in no variable, and those bound outside all loops: in one turn of a loop
    nothing is left of the turn before. Left out is what holds the last value of the variable of a loop that is over:
    another loop may go on with that variable.
    """
    held = {local.uid for local in variables(kernel)}
    outside = _bound_outside_loops(kernel.body)
    counting = {stmt.local.uid for stmt in statements(kernel.body) if isinstance(stmt, kir.ForRange | kir.ForQuery)}
    named = {stmt.local.uid for stmt in _assignments(kernel.body, frozenset(counting))}
    return frozenset(uid for uid in named if uid not in held or uid in outside)


def _bound_outside_loops(body: kir.Body) -> set[int]:
    found: set[int] = set()
    for stmt in body:
        match stmt:
            case kir.Assign(local):
                found.add(local.uid)
            case kir.If() | kir.Block():
                for inner in bodies(stmt):
                    found |= _bound_outside_loops(inner)
            case _:
                pass
    return found


def _assignments(body: kir.Body, over: frozenset[int]) -> list[kir.Assign]:
    """The assignments whose values depend on none of the variables ``over``, but for those of the loops around them."""
    found: list[kir.Assign] = []
    for stmt in body:
        if isinstance(stmt, kir.Assign) and over.isdisjoint(_read(stmt.value)):
            found.append(stmt)
        inside = over - {stmt.local.uid} if isinstance(stmt, kir.ForRange | kir.ForQuery) else over
        for inner in bodies(stmt):
            found += _assignments(inner, inside)
    return found


def _read(expr: kir.Expr) -> set[int]:
    return {part.local.uid for part in subexpressions(expr) if isinstance(part, kir.ReadLocal)}
