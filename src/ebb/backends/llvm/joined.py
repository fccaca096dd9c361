"""Lines of a grid that follow one another in memory, computed as one: a register of rows at a time, across their ends.

What registers share is then made once for all lines of a block, not anew for each line, which on lines of 256 cells is
an eighth of the work. What lies between the lines is computed too, and not stored.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from ebb.backends.llvm import ops
from ebb.backends.llvm.registers import (
    REGISTER_BYTES,
    Parts,
    Registers,
    emit_registers,
    only_streams,
    plan_registers,
)
from ebb.backends.llvm.stream import emit_part
from ebb.backends.llvm.turns import FEW_TURNS, Emitter, choose, least, line_start, most, value_at
from ebb.compiler import lir
from ebb.compiler.lir_walk import values
from ebb.records import record

_MOST_BETWEEN = 32
"""The rows between two lines up to which it pays to compute them."""


@record
class Joined:
    """How the rows of a loop are computed across the ends of lines.

    Attributes:
        registers: how the rows of a line are.
        length: of the lines of the grid; None where each line is to be computed by itself.
    """

    registers: Registers
    length: lir.Value | None

    @property
    def dimensions(self) -> int:
        """How many dimensions of the loop, from the last one, are gone through as one."""
        return 1 if self.length is None else 2


def plan_joined(loop: lir.RowLoop) -> Joined | None:
    """How the rows of ``loop`` are computed as one, if all run the same straight code and do nothing but stream."""
    if loop.streaming is None or loop.inside is not None or not only_streams(loop.body, loop.streaming):
        return None
    registers = plan_registers(loop.body, loop.index[-1])
    return None if registers is None else Joined(registers, _length(loop))


def emit_joined(e: Emitter, loop: lir.RowLoop, joined: Joined) -> None:
    """The rows of ``loop`` in the last of its dimensions, or the last two."""
    w, index = e.w, loop.index
    low, high = e.bounds(len(index) - 1)
    width = w.emit(f"sub i64 {high}, {low}")
    if joined.length is None:
        _emit_lines(e, loop, joined, width, (low, high))
        return
    first, last = e.bounds(len(index) - 2)
    length = value_at(e, loop.body, index[-1], joined.length, low)
    are_close = w.emit(f"icmp sle i64 {w.emit(f'sub i64 {length}, {width}')}, {_MOST_BETWEEN}")
    count = choose(e, are_close, w.emit(f"sub i64 {last}, {first}"), "1")
    others = w.emit(f"sub i64 {count}, 1")
    end = w.emit(f"add i64 {high}, {w.emit(f'mul i64 {others}, {length}')}")
    with w.loop(first, last, count) as lines:
        e.temps[index[-2].number] = lines.counter
        _emit_lines(e, loop, joined, length, (low, end))


def _emit_lines(e: Emitter, loop: lir.RowLoop, joined: Joined, length: str, rows: tuple[str, str]) -> None:
    """The rows from the first of one line up to the end of another, of which those at ``e.bounds`` of each are stored.

    A line begins ``length`` rows behind the one before. Rows are counted from the coordinate 0 of the first line.
    """
    streaming, plan, w, index = loop.streaming, joined.registers, e.w, loop.index[-1]
    assert streaming is not None
    (start, stop), (low, high) = rows, e.bounds(len(loop.index) - 1)
    width = w.emit(f"sub i64 {high}, {low}")
    offset = w.emit(f"sub i64 {value_at(e, loop.body, index, streaming.written[0].row, start)}, {start}")
    # The first row of the line that is to be stored next, and up to where registers are whole lines of the cache.
    line, whole = w.allocate("i64"), w.allocate("i64")
    w.do(f"store i64 {start}, ptr {line}")
    begin = line_start(e, start, offset, plan.lanes)
    w.do(f"store i64 {begin}, ptr {whole}")

    def is_whole(row: str) -> str:
        bound = w.emit(f"load i64, ptr {whole}")
        return w.emit(f"icmp slt i64 {row}, {bound}")

    def store(row: str, results: Sequence[tuple[lir.Store, str]]) -> None:
        moved = [(_on_stack(e, plan, value), e.element(stmt.slot, e.value(stmt.index))) for stmt, value in results]
        behind = w.emit(f"add i64 {row}, {plan.lanes}")
        end = least(e, behind, rows[1])
        part, another, done = (w.fresh(stem) for stem in ("part", "another", "done"))
        w.branch(part)
        w.start(part)
        first = w.emit(f"load i64, ptr {line}")
        last = w.emit(f"add i64 {first}, {width}")
        low, high = most(e, row, first), least(e, end, last)
        words = plan.scalar.bits // 32
        start, stop = (w.emit(f"mul i64 {w.emit(f'sub i64 {at}, {row}')}, {words}") for at in (low, most(e, low, high)))
        for buffer, place in moved:
            emit_part(e, buffer, place, start, stop)
        following = w.emit(f"add i64 {first}, {length}")
        w.branch_if(w.emit(f"icmp slt i64 {following}, {end}"), another, done)
        w.start(another)
        w.do(f"store i64 {following}, ptr {line}")
        w.branch(part)
        w.start(done)
        first = choose(e, w.emit(f"icmp sle i64 {last}, {behind}"), following, first)
        w.do(f"store i64 {first}, ptr {line}")
        lines = line_start(e, w.emit(f"add i64 {first}, {width}"), offset, plan.lanes)
        begun = w.emit(f"icmp sle i64 {first}, {behind}")
        w.do(f"store i64 {choose(e, begun, lines, behind)}, ptr {whole}")

    notes = e.loop_notes(*FEW_TURNS)
    emit_registers(e, plan, index, (begin, stop), Parts(is_whole, store), streaming.ahead, notes)


def _on_stack(e: Emitter, plan: Registers, value: str) -> str:
    """Puts a register into memory, and returns its address. LLVM would keep pieces of it in registers, all of them
    made before it is known which are stored; so the access is volatile, as that of ``emit_part`` is."""
    type_ = f"<{plan.lanes} x {ops.llvm_type(plan.scalar)}>"
    place = e.w.allocate(f"{type_}, align {REGISTER_BYTES}")
    e.w.do(f"store volatile {type_} {value}, ptr {place}, align {REGISTER_BYTES}")
    return place


def _length(loop: lir.RowLoop) -> lir.Value | None:
    """The length of a line, where going on behind its end leads to the next one: where nothing but the position in
    memory, ``(... + line) * length + row``, is made of the coordinates."""
    if len(loop.index) == 1:
        return None
    users = defaultdict[int, list[lir.Stmt]](list)
    for stmt in loop.body:
        for value in values(stmt):
            if isinstance(value, lir.Temp):
                users[value.number].append(stmt)
    line, row = loop.index[-2:]
    step = _sum_with(users[line.number])
    if step is not None:
        line = step.temp
    match users[line.number]:
        case [lir.Let(start, lir.Binary("*", left, right))]:
            place = _sum_with(users[start.number])
            if place is not None and users[row.number] == [place]:
                return right if left == line else left
        case _:
            pass
    return None


def _sum_with(users: list[lir.Stmt]) -> lir.Let | None:
    """The only one of ``users``, if it is a sum."""
    match users:
        case [lir.Let(_, lir.Binary("+")) as stmt]:
            return stmt
        case _:
            return None
