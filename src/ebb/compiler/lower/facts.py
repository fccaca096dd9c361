"""What code depends on of the data: a few bits, read at each launch. Other facts, other code."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias, TypeVar

from ebb.compiler import kir
from ebb.compiler.kir_walk import expressions, queried_in, statements
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.runtime.buffer import Layout
from ebb.types.types import KeyType, Type

_Source = TypeVar("_Source", Field, Relation)

State: TypeAlias = tuple[bool, ...]
"""The facts of one moment, in the order of their sources: hashable, and cheap to compare."""


@record
class Facts:
    """What holds of the data while the code that was lowered with it runs.

    Attributes:
        unset: key fields that may hold unset keys.
        permuted: relations whose rows are not stored in the order of their identities.
        indirect: grouped key fields whose groups are lists of positions.
        columns: fields of several components that lie in columns.
    """

    unset: frozenset[Field]
    permuted: frozenset[Relation]
    indirect: frozenset[Field]
    columns: frozenset[Field]


@record
class FactSources:
    """Where the facts of one kernel come from. The grouping of each queried field is valid when they are read."""

    keys: tuple[Field, ...]
    numbered: tuple[Relation, ...]
    queried: tuple[Field, ...]
    shaped: tuple[Field, ...]

    def state(self) -> State:
        """The facts now."""
        return (
            *[field.maybe_unset for field in self.keys],
            *[relation.storage.order is not None for relation in self.numbered],
            *[field.grouping is not None and field.grouping.rows is not None for field in self.queried],
            *[field.buffer.layout is Layout.COLUMNS for field in self.shaped],
        )

    def facts(self, state: State) -> Facts:
        """``state`` with the names of what it is about."""
        bits = iter(state)

        def holding(sources: tuple[_Source, ...]) -> frozenset[_Source]:
            return frozenset(source for source in sources if next(bits))

        return Facts(
            unset=holding(self.keys),
            permuted=holding(self.numbered),
            indirect=holding(self.queried),
            columns=holding(self.shaped),
        )


def sources_of(kernel: kir.Kernel) -> FactSources:
    """What of the data the code of ``kernel`` depends on."""
    found = expressions(kernel.body)
    stmts = statements(kernel.body)
    drawn = (kernel.relation for expr in found if isinstance(expr, kir.Random))
    named = (target(expr.key.type) for expr in found if isinstance(expr, kir.RowId))
    read = [expr.field for expr in found if isinstance(expr, kir.ReadField)]
    changed = [stmt.field for stmt in stmts if isinstance(stmt, kir.WriteField | kir.ReduceField)]
    return FactSources(
        keys=_once(field for field in read if field.target is not None),
        numbered=_once((*drawn, *named)),
        queried=queried_in(stmts, found),
        shaped=_once(field for field in (*read, *changed) if field.type.size > 1),
    )


def facts_of(kernel: kir.Kernel) -> Facts:
    """The facts of the data that ``kernel`` uses, now. The groupings that it queries are valid."""
    sources = sources_of(kernel)
    return sources.facts(sources.state())


def target(key: Type) -> Relation:
    """The relation that a key type refers to."""
    assert isinstance(key.scalar, KeyType) and isinstance(key.scalar.target, Relation)
    return key.scalar.target


def _once(sources: Iterable[_Source]) -> tuple[_Source, ...]:
    return tuple(dict.fromkeys(sources))
