"""Which element of a row an access means: strips of rows keep what rows store by that, and write rows whole.

An element is known by constants alone, or is the same one wherever the loop reaches the slot. By a number that is known
at run time it could be any: the one that has just been stored, or, in a row written whole, one of the next row.
"""

from __future__ import annotations

from collections import Counter

from ebb.backends.llvm.shifts import Known, Names
from ebb.compiler import lir
from ebb.compiler.lir_walk import statements
from ebb.types.types import int64


class Elements:
    """Tells elements of rows apart in one loop."""

    def __init__(self, loop: lir.RowLoop) -> None:
        self.names = Names(loop.index[-1])
        self.definitions: dict[int, lir.Operation] = {}
        self.reached: dict[int, list[lir.Value]] = {}
        for stmt in statements(loop.body):
            match stmt:
                case lir.Let(temp, operation):
                    self.names.name(stmt)
                    self.definitions[temp.number] = operation
                    if isinstance(operation, lir.Load):
                        self.reached.setdefault(operation.slot.number, []).append(operation.index)
                case lir.Store(slot, index, _):
                    self.reached.setdefault(slot.number, []).append(index)
                case _:
                    pass

    def are_known(self, slot: int) -> bool:
        """Whether each access of ``slot`` reaches an element of a row that is known now, as far as it matters."""
        return all(self._is_of_row(self._terms(index)) for index in self.reached[slot])

    def are_of_one_row(self, slot: int) -> bool:
        """Whether all accesses of ``slot`` differ by constants and columns alone."""
        first, *others = (self._terms(index) for index in self.reached[slot])
        return all(other == first for other in others)

    def _is_of_row(self, terms: Counter[Known]) -> bool:
        """Whether what is the same in all rows leads to another row, not into one."""
        sizes = [size for known, size in terms.items() if known.shift is not None]
        alike = [size for known, size in terms.items() if known.shift is None]
        # Where several numbers differ from row to row, elements are reached one by one.
        return len(sizes) != 1 or all(size % sizes[0] == 0 for size in alike)

    def _terms(self, index: lir.Value) -> Counter[Known]:
        """What an index is the sum of, and how often, but for constants and where columns begin."""
        found, open_ = Counter[Known](), [(index, 1)]
        while open_:
            value, times = open_.pop()
            if isinstance(value, lir.Literal):
                continue
            match self.definitions.get(value.number):
                case lir.Binary("+", left, right) if value.type == int64:
                    open_ += [(left, times), (right, times)]
                case lir.Binary("-", left, right) if value.type == int64:
                    open_ += [(left, times), (right, -times)]
                case lir.Binary("*", part, lir.Literal(int(k))) | lir.Binary("*", lir.Literal(int(k)), part) if (
                    value.type == int64
                ):
                    open_.append((part, times * k))
                case lir.LoadArgument(argument) if isinstance(argument.binding, lir.ColumnStride):
                    pass
                case _:
                    found[self.names.of(value)] += times
        return Counter({known: times for known, times in found.items() if times})
