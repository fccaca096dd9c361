"""Which fields a kernel writes before it looks at them: a device needs their memory, but not what is in it."""

from __future__ import annotations

from itertools import product
from typing import TypeAlias

from ebb.compiler import kir
from ebb.compiler.kir_walk import expressions_in
from ebb.compiler.phases.table import PhaseKind, PhaseTable
from ebb.relations.field import Field

_Components: TypeAlias = "frozenset[tuple[Field, tuple[int, ...]]]"
"""What has surely been written of the row, component by component."""


def overwritten(kernel: kir.Kernel, phases: PhaseTable) -> frozenset[Field]:
    """The fields of which every row that does not fail writes all components of its own, before it reads any.

    If the launch is on all rows and none can fail, nothing is left of the values that such a field had.
    """
    of_own_row = [field for field, phase in phases.fields.items() if phase.kind is PhaseKind.EXCLUSIVE]
    candidates = {field for field in of_own_row if phases.fields[field].written}
    return _Walk(candidates).find(kernel.body)


class _Walk:
    """A walk over the ways through a kernel. All uses of the fields in question are of the own row."""

    def __init__(self, candidates: set[Field]) -> None:
        self._unread = candidates
        self._left: dict[kir.Label, list[_Components]] = {}

    def find(self, body: kir.Body) -> frozenset[Field]:
        done = self._body(body, frozenset())
        return frozenset(field for field in self._unread if done is not None and _is_whole(field, done))

    def _body(self, body: kir.Body, done: _Components) -> _Components | None:
        """What has been written at the end of ``body``, where ``done`` had been before; None if no row gets there."""
        for stmt in body:
            after = self._statement(stmt, done)
            if after is None:
                return None
            done = after
        return done

    def _statement(self, stmt: kir.Stmt, done: _Components) -> _Components | None:
        self._look_at_operands(stmt, done)
        match stmt:
            case kir.WriteField(field, indices=indices):
                return done | _written(field, indices)
            case kir.ReduceField(field):
                self._look(field, done)
            case kir.If(_, then, orelse):
                return _common([self._body(then, done), self._body(orelse, done)])
            case kir.ForRange() | kir.ForQuery() | kir.While():
                self._body(stmt.body, done)  # for what it reads: it may have no turn
            case kir.Block(label, body):
                self._left[label] = []
                end = self._body(body, done)
                return _common([end, *self._left.pop(label)])
            case kir.Leave(label):
                self._left[label].append(done)
                return None
            case kir.Break() | kir.Continue():
                return None
            case _:
                pass
        return done

    def _look_at_operands(self, stmt: kir.Stmt, done: _Components) -> None:
        for expr in expressions_in(stmt):
            if isinstance(expr, kir.ReadField):
                self._look(expr.field, done)

    def _look(self, field: Field, done: _Components) -> None:
        if field in self._unread and not _is_whole(field, done):
            self._unread.discard(field)


def _written(field: Field, indices: tuple[kir.Expr, ...]) -> _Components:
    """The components of ``field`` that a write to ``indices`` surely reaches."""
    if not all(isinstance(index, kir.Const) for index in indices):
        return frozenset()
    start = tuple(index.value for index in indices if isinstance(index, kir.Const))
    return frozenset((field, place) for place in _places(field) if place[: len(start)] == start)


def _is_whole(field: Field, done: _Components) -> bool:
    return all((field, place) in done for place in _places(field))


def _places(field: Field) -> list[tuple[int, ...]]:
    return list(product(*map(range, field.type.shape)))


def _common(ways: list[_Components | None]) -> _Components | None:
    """What has been written on all ways that come to their end."""
    ended = [way for way in ways if way is not None]
    return ended[0].intersection(*ended[1:]) if ended else None
