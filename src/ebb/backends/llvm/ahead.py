"""Rows of other relations are asked for before they are needed, where a row takes so long that the processor would not.

A processor runs some hundred instructions ahead, so in short rows it finds by itself which memory the next rows want.
Where a row is longer than that, as the stiffness of an element is, it waits for what the keys of each row lead to. So
the keys of a row further on are loaded too, and what they lead to is prefetched. Only rows that run one after the other
are treated so: of others LLVM makes vectors, which it does not where there are prefetches.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from ebb.backends.llvm import ops
from ebb.backends.llvm.unroll import length
from ebb.backends.llvm.writer import FunctionWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import statements
from ebb.records import field, record

LONG_ROW = 300
"""The statements from which on a row is too long to see beyond it."""

ROWS_AHEAD = 4
"""How far the row is that is asked for. Of rows of 0.1 us the first is soon enough for memory that is not busy; the
fourth was as quick where it is."""

_LINE = 64
"""The bytes of a line of the cache."""


@record(eq=False)
class Ahead:
    """A key of the own row, and what is reached through it.

    Attributes:
        keys: where it is loaded from.
        index: of which element.
        row: the own row.
        step: how far the element lies from that of the next row.
        reached: for each slot, the elements of a row of it, and whether rows are changed.
    """

    keys: lir.Slot
    index: lir.Value
    row: lir.Temp
    step: int
    reached: dict[int, tuple[lir.Slot, int, bool]] = field(default_factory=dict[int, "tuple[lir.Slot, int, bool]"])


def plan_ahead(loop: lir.RowLoop) -> Mapping[int, Ahead]:
    """What to ask for where a key is loaded, by the number of the temporary that holds it."""
    size = length(loop)
    if loop.rows is lir.Rows.INDEPENDENT or len(loop.index) != 1 or size is None or size < LONG_ROW:
        return {}
    planner = _Planner(loop)
    return {number: ahead for number, ahead in planner.keys.items() if ahead.reached}


class _Planner:
    def __init__(self, loop: lir.RowLoop) -> None:
        self.definitions = {stmt.temp.number: stmt.operation for stmt in _lets(loop)}
        self.row = loop.index[0]
        self.steps = {self.row.number: 1}
        self.keys: dict[int, Ahead] = {}
        for stmt in statements(loop.body):
            match stmt:
                case lir.Let(temp, lir.Load(slot, index)):
                    self.reach(slot, index, changed=False)
                    self.note_key(temp, slot, index)
                case lir.Store(slot, index, _):
                    self.reach(slot, index, changed=True)
                case _:
                    pass

    def note_key(self, temp: lir.Temp, slot: lir.Slot, index: lir.Value) -> None:
        binding, step = slot.binding, self.step(index)
        if step and isinstance(binding, lir.FieldData) and binding.field.target is not None:
            self.keys[temp.number] = Ahead(slot, index, self.row, step)

    def step(self, value: lir.Value) -> int | None:
        """How much ``value`` grows from row to row; None where that is not known."""
        if isinstance(value, lir.Literal):
            return 0
        if value.number not in self.steps:
            found = self.step_of(self.definitions.get(value.number))
            if found is None:
                return None
            self.steps[value.number] = found
        return self.steps[value.number]

    def step_of(self, operation: lir.Operation | None) -> int | None:
        match operation:
            case None:
                return 0  # the counter of a loop within the row
            case lir.Convert(operand):
                return self.step(operand)
            case lir.Binary("+", left, right):
                steps = self.step(left), self.step(right)
                return None if None in steps else sum(step for step in steps if step)
            case lir.Binary("*", left, lir.Literal(factor)):
                step = self.step(left)
                return None if step is None else factor * step
            case _:
                return None

    def reach(self, slot: lir.Slot, index: lir.Value, *, changed: bool) -> None:
        """Notes the access if it is to a row that a noted key refers to."""
        size, value = 1, index
        while isinstance(value, lir.Temp):
            match self.definitions.get(value.number):
                case lir.Binary("+", left, lir.Literal()) | lir.Convert(left):
                    value = left
                case lir.Binary("*", left, lir.Literal(factor)):
                    value, size = left, size * factor
                case _:
                    break
        ahead = self.keys.get(value.number) if isinstance(value, lir.Temp) else None
        if ahead is not None:
            _, _, before = ahead.reached.get(slot.number, (slot, size, False))
            ahead.reached[slot.number] = (slot, size, before or changed)


def _lets(loop: lir.RowLoop) -> Iterator[lir.Let]:
    for stmt in statements(loop.body):
        if isinstance(stmt, lir.Let):
            yield stmt


class Emitter(Protocol):
    """What emits the loop."""

    w: FunctionWriter

    def value(self, value: lir.Value) -> str:
        """The name or literal of ``value``."""
        ...


def emit_ahead(e: Emitter, ahead: Ahead, stop: str) -> None:
    """Asks for what the key will lead to in a later row, if there is one before ``stop``."""
    w = e.w
    later = w.emit(f"add nsw i64 {e.value(ahead.row)}, {ROWS_AHEAD}")
    rows = w.emit(f"select i1 {w.emit(f'icmp slt i64 {later}, {stop}')}, i64 {ROWS_AHEAD}, i64 0")
    index = w.emit(f"add i64 {e.value(ahead.index)}, {w.emit(f'mul i64 {rows}, {ahead.step}')}")
    key_type = ops.memory_type(ahead.keys.type)
    place = w.emit(f"getelementptr inbounds {key_type}, ptr %slot{ahead.keys.number}, i64 {index}")
    key = w.emit(f"load {key_type}, ptr {place}")
    if key_type != "i64":
        key = w.emit(f"sext {key_type} {key} to i64")
    w.declare("void @llvm.prefetch.p0(ptr, i32, i32, i32)")
    for slot, size, changed in ahead.reached.values():
        width = size * slot.type.dtype.itemsize
        first = w.emit(f"mul i64 {key}, {width}")
        for offset in range(0, width, _LINE):
            # Not inbounds: an unset key leads nowhere, and what is asked for there is nothing.
            place = w.emit(f"getelementptr i8, ptr %slot{slot.number}, i64 {w.emit(f'add i64 {first}, {offset}')}")
            w.do(f"call void @llvm.prefetch.p0(ptr {place}, i32 {int(changed)}, i32 3, i32 1)")
