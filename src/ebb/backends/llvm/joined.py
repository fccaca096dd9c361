"""Lines of a grid that follow one another in memory, computed as one: a register of rows at a time, across their ends.

What registers share is then made once for all lines of a block, not anew for each line, which on lines of 256 cells is
an eighth of the work. What lies between the lines is computed too, and not stored.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from ebb.backends.llvm.registers import REGISTER_BYTES, Registers, RowRegisters, only_streams, plan_registers
from ebb.backends.llvm.stream import emit_beginning, emit_end, emit_words
from ebb.backends.llvm.turns import FEW_TURNS, Emitter, branch_often, choose, least, line_start, value_at
from ebb.compiler import lir
from ebb.compiler.lir_walk import values
from ebb.records import record


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
    lanes = joined.registers.lanes
    near = w.emit(f"icmp sle i64 {w.emit(f'sub i64 {length}, {width}')}, {lanes}")
    long = w.emit(f"icmp sge i64 {width}, {2 * lanes}")
    are_close = w.emit(f"and i1 {near}, {long}")
    count = choose(e, are_close, w.emit(f"sub i64 {last}, {first}"), "1")
    others = w.emit(f"sub i64 {count}, 1")
    end = w.emit(f"add i64 {high}, {w.emit(f'mul i64 {others}, {length}')}")
    with w.loop(first, last, count) as lines:
        e.temps[index[-2].number] = lines.counter
        _emit_lines(e, loop, joined, length, (low, end))


def _emit_lines(e: Emitter, loop: lir.RowLoop, joined: Joined, length: str, rows: tuple[str, str]) -> None:
    """The rows from the first of one line up to the end of another, of which those at ``e.bounds`` of each are stored.

    A line begins ``length`` rows behind the one before. Rows are counted from the coordinate 0 of the first line. The
    loop over registers that are whole lines of the cache is left once a line, where it ends, and the next line begins
    in code of its own: so the same branches are taken in line after line, and processors foresee them. On Zen 4 a
    27-point stencil on 256^3 cells takes 6.7 ms if the two ends are stored by the same code, and 4.7 so.
    """
    streaming, w = loop.streaming, e.w
    assert streaming is not None
    (start, stop), (low, high) = rows, e.bounds(len(loop.index) - 1)
    width = w.emit(f"sub i64 {high}, {low}")
    position = value_at(e, loop.body, loop.index[-1], streaming.written[0].row, start)
    offset = w.emit(f"sub i64 {position}, {start}")
    lines = _Lines(e, RowRegisters(e, joined.registers, loop.index[-1], streaming.ahead), stop)
    begin = line_start(e, start, offset, lines.lanes)
    lines.registers.start(begin)
    head, part, inner, whole, past, end, done = (
        w.fresh(stem) for stem in ("line", "part", "inner", "whole", "past", "end", "done")
    )
    lines.go_to(begin)
    w.do(f"store i64 {start}, ptr {lines.first}")
    w.branch(head)
    w.start(head)
    first = w.emit(f"load i64, ptr {lines.first}")
    last = w.emit(f"add i64 {first}, {width}")
    w.branch_if(w.emit(f"icmp sgt i64 {first}, {lines.at()}"), part, inner)
    w.start(part)
    lines.emit_first(first)
    w.branch(inner)
    w.start(inner)
    bound = line_start(e, last, offset, lines.lanes)
    w.branch_if(lines.is_left(), whole, done)
    w.start(whole)
    row = lines.at()
    results = lines.registers.turn(row)
    branch_often(e, w.emit(f"icmp slt i64 {row}, {bound}"), past, end)
    w.start(past)
    lines.registers.stream(results)
    lines.go_to(w.emit(f"add i64 {row}, {lines.lanes}"))
    w.do(f"br i1 {lines.is_left()}, label %{whole}, label %{done}{e.loop_notes(*FEW_TURNS)}")
    w.start(end)
    lines.emit_last(results, last, w.emit(f"add i64 {first}, {length}"))
    w.branch_if(lines.is_left(), head, done)
    w.start(done)


class _Lines:
    """Emits what is done where lines begin and end.

    Attributes:
        first: the address of the first row of the line.
    """

    def __init__(self, e: Emitter, registers: RowRegisters, stop: str) -> None:
        self.e, self.w, self.registers, self.stop = e, e.w, registers, stop
        self.lanes = registers.plan.lanes
        self.words = registers.plan.scalar.bits // 32
        self.first, self.row = e.w.allocate("i64"), e.w.allocate("i64")

    def at(self) -> str:
        """The row with which the next register begins."""
        return self.w.emit(f"load i64, ptr {self.row}")

    def go_to(self, row: str) -> None:
        self.w.do(f"store i64 {row}, ptr {self.row}")

    def is_left(self) -> str:
        """Whether any row is."""
        return self.w.emit(f"icmp slt i64 {self.at()}, {self.stop}")

    def words_from(self, row: str, other: str) -> str:
        return self.w.emit(f"mul i64 {self.w.emit(f'sub i64 {other}, {row}')}, {self.words}")

    def emit_first(self, first: str) -> None:
        """The register in which a line begins, but not with the register."""
        e, w, row = self.e, self.w, self.at()
        moved = self.on_stack(self.registers.turn(row))
        following = w.emit(f"add i64 {row}, {self.lanes}")
        start, stop = (self.words_from(row, at) for at in (first, least(e, following, self.stop)))
        to_end, others, done = (w.fresh(stem) for stem in ("toend", "others", "done"))
        w.branch_if(w.emit(f"icmp sle i64 {following}, {self.stop}"), to_end, others)
        w.start(to_end)
        for value, place in moved:
            emit_end(e, value, place, start)
        w.branch(done)
        w.start(others)
        for value, place in moved:
            emit_words(e, value, place, start, stop)
        w.branch(done)
        w.start(done)
        self.go_to(following)

    def emit_last(self, results: Sequence[tuple[lir.Store, str]], last: str, next_: str) -> None:
        """The register in which a line ends, and in which perhaps the one begins whose first row is ``next_``."""
        e, w = self.e, self.w
        row = self.opaque(self.at())
        self.go_to(row)
        self.registers.begin(row)
        moved = self.on_stack(results)
        for value, place in moved:
            emit_beginning(e, value, place, self.words_from(row, last))
        following = w.emit(f"add i64 {row}, {self.lanes}")
        another, done = w.fresh("another"), w.fresh("done")
        w.branch_if(w.emit(f"icmp slt i64 {next_}, {least(e, following, self.stop)}"), another, done)
        w.start(another)
        for value, place in moved:
            emit_end(e, value, place, self.words_from(row, next_))
        w.branch(done)
        w.start(done)
        w.do(f"store i64 {next_}, ptr {self.first}")
        self.go_to(following)

    def opaque(self, number: str) -> str:
        """The same number, of which LLVM knows nothing: it would count the addresses of each piece in the loop."""
        place = self.w.allocate("i64")
        self.w.do(f"store volatile i64 {number}, ptr {place}")
        return self.w.emit(f"load volatile i64, ptr {place}")

    def on_stack(self, results: Sequence[tuple[lir.Store, str]]) -> list[tuple[str, str]]:
        """Puts registers into memory; the addresses of each and of where it belongs.

        LLVM would keep pieces of it in registers, all of them made before it is known which are stored; so the access
        is volatile, as that of the pieces is.
        """
        moved, type_ = list[tuple[str, str]](), self.registers.type
        for stmt, value in results:
            place = self.w.allocate(f"{type_}, align {REGISTER_BYTES}")
            self.w.do(f"store volatile {type_} {value}, ptr {place}, align {REGISTER_BYTES}")
            moved.append((place, self.e.element(stmt.slot, self.e.value(stmt.index))))
        return moved


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
