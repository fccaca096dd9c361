"""How the addresses of a loop go from turn to turn."""

from __future__ import annotations

from ebb.compiler import lir
from ebb.compiler.lir_walk import operands, statements


def is_unit(body: lir.Body, counter: lir.Temp) -> bool:
    """Whether each access goes on by one element from turn to turn of ``counter``, or stays where it is."""
    return is_even(body, counter, {})


def is_even(body: lir.Body, counter: lir.Temp, sizes: dict[int, int]) -> bool:
    """Whether each access stays where it is from turn to turn, or goes on by so many elements as a row has.

    Args:
        body: what runs each turn.
        counter: of the turns.
        sizes: the elements of a row, by the number of the slot; 1 where nothing is said.
    """
    return _Steps(counter).all_even(body, sizes)


def meets_itself(body: lir.Body, counters: tuple[lir.Temp, ...]) -> bool:
    """Whether a turn may change what a later one reads, at places of which nothing is known, as behind a key.

    LLVM 22 makes vectors of such loops, and loses changes where turns of one vector meet, if it has to compare other
    addresses at run time: then it forgets what it knew of these.
    """
    return _Steps(*counters).any_unknown(body)


class _Steps:
    """By how much temporaries grow from turn to turn, by number: 0 where nothing is said, None where it differs."""

    def __init__(self, *counters: lir.Temp) -> None:
        self.steps: dict[int, int | None] = dict.fromkeys((counter.number for counter in counters), 1)

    def all_even(self, body: lir.Body, sizes: dict[int, int]) -> bool:
        for stmt in statements(body):
            match stmt:
                case lir.Let(_, lir.Load(slot, index)) | lir.Store(slot, index, _) if self.of(index) not in (
                    0,
                    sizes.get(slot.number, 1),
                ):
                    return False
                case lir.Let(temp, operation):
                    self.steps[temp.number] = self.result(operation)
                case lir.For() | lir.While():
                    return False
                case _:
                    pass
        return True

    def any_unknown(self, body: lir.Body) -> bool:
        changed, read = set[tuple[type, int]](), set[tuple[type, int]]()
        for stmt in statements(body):
            match stmt:
                case lir.Let(temp, operation):
                    self.steps[temp.number] = self.result(operation)
                    if isinstance(operation, lir.Load):
                        read.add((lir.Slot, operation.slot.number))
                    if isinstance(operation, lir.LoadVar):
                        read.add((lir.Var, operation.var.number))
                case lir.Store(slot, index, _) if self.of(index) is None:
                    changed.add((lir.Slot, slot.number))
                case lir.StoreVar(var, index, _) if self.of(index) is None:
                    changed.add((lir.Var, var.number))
                case lir.Accumulate(var, index, _, _) if self.of(index) is None:
                    return True
                case _:
                    pass
        return not changed.isdisjoint(read)

    def of(self, value: lir.Value) -> int | None:
        return self.steps.get(value.number, 0) if isinstance(value, lir.Temp) else 0

    def result(self, operation: lir.Operation) -> int | None:
        if isinstance(operation, lir.LoadVar):
            return None
        match operation:
            case lir.Binary("+" | "-" as op, left, right):
                a, b = self.of(left), self.of(right)
                if a is not None and b is not None:
                    return a + b if op == "+" else a - b
            case lir.Binary("*", factor, lir.Literal(number, _)) | lir.Binary("*", lir.Literal(number, _), factor):
                step = self.of(factor)
                if step is not None and isinstance(number, int):
                    return step * number
            case _:
                pass
        return 0 if all(self.of(value) == 0 for value in operands(operation)) else None
