"""What emits the function around loops over rows, and values of a turn outside of its loop."""

from __future__ import annotations

from typing import Protocol

from ebb.backends.llvm.writer import FunctionWriter, ModuleWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import operands

FETCHED_AHEAD = 5 << 10
"""How far ahead memory is fetched. Half of it is too late, twice as much no better."""


FEW_TURNS = ('!"llvm.loop.vectorize.enable", i1 false', '!"llvm.loop.unroll.disable"')
"""What makes LLVM leave a loop as it is."""


class Emitter(Protocol):
    """What emits the function around the rows.

    Attributes:
        buffers: where elements of slots are stored for now, by number, and the index of the first of them.
    """

    module: ModuleWriter
    w: FunctionWriter
    temps: dict[int, str]
    buffers: dict[int, tuple[str, str]]
    access_group: str | None
    flags: str

    def element(self, slot: lir.Slot, index: str) -> str:
        """The address of an element of a slot, or of where it is stored for now."""
        ...

    def value(self, value: lir.Value) -> str:
        """The name or literal of a scalar."""
        ...

    def statement(self, stmt: lir.Stmt) -> None:
        """Emits a statement."""
        ...

    def body(self, body: lir.Body) -> None:
        """Emits the statements of a body."""
        ...

    def bounds(self, d: int) -> tuple[str, str]:
        """The first index of a dimension of the block, and the one behind the last."""
        ...

    def loop_notes(self, *notes: str) -> str:
        """What says so of a loop, at its end."""
        ...

    def count(self, counter: lir.Temp, start: str, stop: str, body: lir.Body, metadata: str = "") -> None:
        """Emits a loop whose turns are counted."""
        ...


def value_at(e: Emitter, body: lir.Body, counter: lir.Temp, value: lir.Value, turn: str) -> str:
    """What ``value`` of the straight-line ``body`` of a loop is in the turn whose number is ``turn``."""
    defined = {stmt.temp.number: stmt for stmt in body if isinstance(stmt, lir.Let)}
    e.temps[counter.number] = turn
    wanted, open_ = set[int](), [value]
    while open_:
        found = open_.pop()
        if isinstance(found, lir.Temp) and found.number in defined and found.number not in wanted:
            wanted.add(found.number)
            open_ += operands(defined[found.number].operation)
    group, e.access_group = e.access_group, None
    for number, stmt in defined.items():
        if number in wanted:
            e.statement(stmt)
    e.access_group = group
    return e.value(value)


def branch_often(e: Emitter, condition: str, often: str, seldom: str) -> None:
    """Ends the basic block with a jump to ``often`` or ``seldom``: what is put on the stack is so for the latter."""
    weights = e.module.note('!{{!"branch_weights", i32 4000, i32 1}}')
    e.w.do(f"br i1 {condition}, label %{often}, label %{seldom}, !prof {weights}")


# ---- Numbers ----


def line_start(e: Emitter, row: str, offset: str, rows: int) -> str:
    """The last row up to ``row`` that begins ``rows`` that lie together; its position is ``offset`` more."""
    position = e.w.emit(f"add i64 {row}, {offset}")
    return e.w.emit(f"sub i64 {row}, {e.w.emit(f'and i64 {position}, {rows - 1}')}")


def least(e: Emitter, a: str, b: str) -> str:
    """The lesser of two numbers."""
    e.w.declare("i64 @llvm.smin.i64(i64, i64)")
    return e.w.emit(f"call i64 @llvm.smin.i64(i64 {a}, i64 {b})")


def most(e: Emitter, a: str, b: str) -> str:
    """The greater of two numbers."""
    e.w.declare("i64 @llvm.smax.i64(i64, i64)")
    return e.w.emit(f"call i64 @llvm.smax.i64(i64 {a}, i64 {b})")


def choose(e: Emitter, condition: str, then: str, other: str) -> str:
    """One of two numbers."""
    return e.w.emit(f"select i1 {condition}, i64 {then}, i64 {other}")
