"""What the planners of lanes have in common: what a loop must be fit for, and what is a sum into a place.

Turns of a loop over a query (``strips``) and rows (``row_plan``) run at once in the lanes of vector registers, where
every target computes the same operations. A planner demands what it needs; a loop of which that does not hold is taken
as it is.
"""

from __future__ import annotations

from collections.abc import Mapping

from ebb.backends.llvm.transpose import LANES
from ebb.backends.llvm.vector_math import VectorForms
from ebb.compiler import lir
from ebb.records import record
from ebb.types.types import Kind

SUMS = frozenset({"+", "*", "min", "max", "&", "|", "^"})
"""What places are changed by, in whatever order."""

CHANGES = SUMS | {"-"}

_BINARY = CHANGES | {"/"}

_MATH = frozenset({"sqrt", "abs", "floor", "ceil", "trunc", "round", "copysign"})
"""The functions that every target computes for all lanes at once."""


class Unfit(Exception):  # noqa: N818 - no error: the loop is taken as it is
    """The loop cannot run in lanes."""


def demand(holds: bool) -> None:
    """Gives the loop up unless that holds."""
    if not holds:
        raise Unfit


def is_failure(stmt: lir.If) -> bool:
    """Whether ``stmt`` does nothing but fail."""
    arms = [arm for arm in (stmt.then, stmt.orelse) if arm]
    return len(arms) == 1 and len(arms[0]) == 1 and isinstance(arms[0][0], lir.Fail)


def demand_lanes(temp: lir.Temp, operation: lir.Operation, vector_math: VectorForms) -> None:
    """Gives the loop up unless ``operation`` can be computed for all lanes at once."""
    match operation:
        case lir.Binary(op, _, _):
            demand(op in _BINARY and (op != "/" or temp.type.kind is Kind.FLOAT))
        case lir.Math(function, _):
            forms = vector_math.get((function, temp.type.bits), ())
            demand(function in _MATH or any(form.lanes == LANES for form in forms))
        case _:
            pass


@record
class Change:
    """A store that changes what was in a place, by ``op`` and ``value``.

    Attributes:
        op: of ``CHANGES``.
        value: the operand that is not what was there.
        made: the numbers of the two temporaries that nothing else uses: what was there, and what is stored.
    """

    op: str
    value: lir.Value
    made: frozenset[int]


def change_of(
    place: lir.Slot | lir.Var, index: lir.Value, stored: lir.Value,
    definitions: Mapping[int, lir.Operation], uses: Mapping[int, int],
) -> Change | None:  # fmt: skip
    """How ``stored`` changes what was in a place, or None where it does not come from that, or is used again.

    Args:
        place: where a statement stores.
        index: the element of it.
        stored: what it stores.
        definitions: the operation of each temporary of the loop, by number.
        uses: how often it uses each, by number.
    """

    def was_there(value: lir.Temp) -> bool:
        match definitions.get(value.number):
            case lir.Load(read, at) | lir.LoadVar(read, at):
                return read == place and at == index and uses[value.number] == 1
            case _:
                return False

    if not isinstance(stored, lir.Temp) or uses[stored.number] != 1:
        return None
    match definitions.get(stored.number):
        case lir.Binary(op, lir.Temp() as before, value) if op in CHANGES and was_there(before):
            return Change(op, value, frozenset({before.number, stored.number}))
        case lir.Binary(op, value, lir.Temp() as before) if op in SUMS and was_there(before):
            return Change(op, value, frozenset({before.number, stored.number}))
        case _:
            return None
