"""Members: functions of a key that kernels use as if they were fields (the paper's field macros)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

from ebb.errors import RelationError
from ebb.relations.errors import MemberNotAFunction, UnknownReducer

if TYPE_CHECKING:
    from ebb.relations.relation import Relation

Function: TypeAlias = Callable[..., Any]

REDUCERS = ("+", "*", "min", "max", "&", "|", "^")
"""The operators by which a member can be reduced: those of fields."""


class Member:
    """A function of a key of ``relation`` that the compiler inlines where a kernel uses it.

    With one parameter it is used as ``v.edges``, with more it is called, ``c.vertex(1, 0)``; the name ``__call__`` is
    the call of the key itself, ``c(1, 0)``. On the host a member only stores its functions.

    Attributes:
        function: gives the member's value.
        setter_function: is inlined for ``v.name = value``, with the key and the value; None where there is none.
        reducers: by operator, are inlined for ``v.name op= value``, with the key and the value.
    """

    __slots__ = ("function", "name", "reducers", "relation", "setter_function")

    def __init__(self, relation: Relation, name: str, function: Function) -> None:
        self.relation = relation
        self.name = name
        self.function = _checked(self, function)
        self.setter_function: Function | None = None
        self.reducers: dict[str, Function] = {}

    def setter(self, function: Function) -> Member:
        """Decorator: ``function(key, value)`` stands for ``key.name = value``.

        Raises:
            RelationError: ``function`` is no function.
        """
        self.setter_function = _checked(self, function)
        return self

    def reducer(self, op: str) -> Callable[[Function], Member]:
        """Decorator: ``function(key, value)`` stands for ``key.name op= value``.

        Raises:
            RelationError: ``op`` is none of ``+ * min max & | ^``, or ``function`` is no function.
        """
        if op not in REDUCERS:
            raise RelationError(UnknownReducer(self.relation.name, self.name, op, REDUCERS))

        def decorate(function: Function) -> Member:
            self.reducers[op] = _checked(self, function)
            return self

        return decorate

    def __repr__(self) -> str:
        return f"<member {self.relation.name}.{self.name}>"


def _checked(member: Member, function: Function) -> Function:
    if not callable(function):
        raise RelationError(MemberNotAFunction(member.relation.name, member.name, repr(function)))
    return function
