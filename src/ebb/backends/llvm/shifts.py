"""Which values of a loop differ by the turn alone: what one turn computes, another has computed, or will."""

from __future__ import annotations

from typing import TypeAlias

from ebb.compiler import lir
from ebb.compiler.lir_walk import operands
from ebb.records import record

Key: TypeAlias = "tuple[object, ...]"


@record
class Known:
    """What a temporary is: ``key`` is the same for all that differ by the turn alone, which is ``shift`` later.

    ``shift`` is None where the value is the same in all turns.
    """

    key: Key
    shift: int | None


@record
class Linear:
    """A sum of products of what is the same in all turns, of the counter ``steps`` times, and of a constant."""

    terms: frozenset[tuple[Key, int]]
    steps: int
    constant: int


class Names:
    """Names the temporaries of a straight-line body by how they are computed."""

    def __init__(self, counter: lir.Temp) -> None:
        self.linear: dict[int, Linear] = {counter.number: Linear(frozenset(), 1, 0)}
        self.known: dict[int, Known] = {}

    def name(self, stmt: lir.Let) -> Known:
        """What the temporary is that ``stmt`` defines; all before it have been named."""
        operation, number = stmt.operation, stmt.temp.number
        sum_ = self._sum(operation)
        if sum_ is not None:
            self.linear[number] = sum_
        known = self.known[number] = self._name(stmt, sum_)
        return known

    def _name(self, stmt: lir.Let, sum_: Linear | None) -> Known:
        alone = Known(("temp", stmt.temp.number), 0)
        match stmt.operation:
            case lir.Load(slot, index) if slot.access is lir.Access.READ:
                place = self._linear(index)
                if place is None or place.steps == 0:
                    return alone if place is None else Known(("load", slot.number, place), None)
                shift, rest = divmod(place.constant, place.steps)
                return Known(("load", slot.number, place.terms, place.steps, rest), shift)
            case lir.Load() | lir.LoadVar() | lir.ThreadNumber():
                return alone
            case lir.LoadArgument(argument):
                return Known(("argument", argument.number), None)
            case operation if sum_ is not None:
                return Known(("sum", sum_, type(operation)), None if sum_.steps == 0 else 0)
            case operation:
                return self._composed(operation, stmt.temp)

    def _composed(self, operation: lir.Operation, temp: lir.Temp) -> Known:
        parts = [self.of(value) for value in operands(operation)]
        shifts = [part.shift for part in parts if part.shift is not None]
        first = shifts[0] if shifts else None
        named = tuple((part.key, None if part.shift is None or first is None else part.shift - first) for part in parts)
        how = (type(operation), getattr(operation, "op", None), getattr(operation, "function", None), temp.type)
        return Known((how, named), first)

    def of(self, value: lir.Value) -> Known:
        """What a value is."""
        match value:
            case lir.Literal(number, scalar):
                return Known(("literal", repr(number), scalar), None)
            case lir.Temp(number, _):
                # Defined outside of the body, where it is the same in all turns, or the counter.
                return self.known.get(number, Known(("temp", number), 0 if number in self.linear else None))

    # ---- Index arithmetic ----

    def _sum(self, operation: lir.Operation) -> Linear | None:
        match operation:
            case lir.Binary("+", left, right):
                a, b = self._linear(left), self._linear(right)
                return None if a is None or b is None else _add(a, b)
            case lir.Binary("*", left, right):
                a, b = self._linear(left), self._linear(right)
                return None if a is None or b is None else _multiply(a, b)
            case _:
                return None

    def _linear(self, value: lir.Value) -> Linear | None:
        """``value``, if it is an int64 that is a sum."""
        if value.type.name != "int64":
            return None
        match value:
            case lir.Literal(number, _):
                return Linear(frozenset(), 0, int(number))
            case lir.Temp(number, _) if number in self.linear:
                return self.linear[number]
            case _:
                known = self.of(value)
                return None if known.shift is not None else Linear(frozenset({(known.key, 1)}), 0, 0)


def _add(a: Linear, b: Linear) -> Linear:
    terms = dict(a.terms)
    for key, factor in b.terms:
        terms[key] = terms.get(key, 0) + factor
    return Linear(
        frozenset((key, factor) for key, factor in terms.items() if factor), a.steps + b.steps, a.constant + b.constant
    )


def _multiply(a: Linear, b: Linear) -> Linear | None:
    """The product, if one of the two is a number, or both are the same in all turns."""
    for number, other in ((a, b), (b, a)):
        if not number.terms and not number.steps:
            by = number.constant
            terms = frozenset((key, factor * by) for key, factor in other.terms if by)
            return Linear(terms, other.steps * by, other.constant * by)
    if a.steps or b.steps:
        return None
    return Linear(frozenset({(("product", frozenset({a, b}) if a != b else (a,)), 1)}), 0, 0)
