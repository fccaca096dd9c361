"""How the addresses of a loop go from turn to turn."""

from __future__ import annotations

from ebb.compiler import lir
from ebb.compiler.lir_walk import operands, statements


def is_unit(loop: lir.RowLoop) -> bool:
    """Whether each access of the innermost turns goes on by one element from turn to turn, or stays where it is."""
    return _Strides(loop).all_unit()


class _Strides:
    def __init__(self, loop: lir.RowLoop) -> None:
        self.body, self.counter = loop.body, loop.index[-1].number
        self.varying = {self.counter}
        self.ones = {self.counter}

    def all_unit(self) -> bool:
        for stmt in statements(self.body):
            match stmt:
                case lir.Let(temp, operation):
                    self.note(temp.number, operation)
                    if isinstance(operation, lir.Load) and not self.fits(operation.index):
                        return False
                case lir.Store(_, index, _) if not self.fits(index):
                    return False
                case lir.For() | lir.While():
                    return False
                case _:
                    pass
        return True

    def note(self, number: int, operation: lir.Operation) -> None:
        if isinstance(operation, lir.LoadVar) or any(map(self.varies, operands(operation))):
            self.varying.add(number)
        match operation:
            case lir.Binary("+", left, right) if self.is_one(left) and not self.varies(right):
                self.ones.add(number)
            case lir.Binary("+", left, right) if self.is_one(right) and not self.varies(left):
                self.ones.add(number)
            case lir.Binary("-", left, right) if self.is_one(left) and not self.varies(right):
                self.ones.add(number)
            case _:
                pass

    def varies(self, value: lir.Value) -> bool:
        return isinstance(value, lir.Temp) and value.number in self.varying

    def is_one(self, value: lir.Value) -> bool:
        return isinstance(value, lir.Temp) and value.number in self.ones

    def fits(self, index: lir.Value) -> bool:
        return self.is_one(index) or not self.varies(index)
