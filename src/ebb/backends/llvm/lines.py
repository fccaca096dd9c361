"""The innermost turns of a loop over rows where those of a line differ, or go through more than caches hold.

Near the ends of a line of a grid coordinates wrap or are held; all other rows run code that knows of no ends.

Rows that stream are computed stretch by stretch into a buffer on the stack, from where whole lines of the cache are
stored past it: what is overwritten is never read into the cache. Meanwhile what other rows will read is fetched ahead:
processors foresee that within a line of a grid, but not from line to line. Measured on Zen 4, a 7-point stencil on
256^3 cells takes 9 ms on one thread with neither of the two, 8.5 with the first, 5 with both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ebb.backends.llvm import ops
from ebb.backends.llvm.registers import Registers, RowRegisters, only_streams, plan_registers, put_rows
from ebb.backends.llvm.stream import emit_stream
from ebb.backends.llvm.strides import is_even
from ebb.backends.llvm.turns import (
    FETCHED_AHEAD,
    FEW_TURNS,
    Emitter,
    branch_often,
    choose,
    least,
    line_start,
    most,
    value_at,
)
from ebb.compiler import lir

STRETCH = 256
"""The rows that are computed before they are stored: few enough for the nearest cache, enough for long bursts."""

TOGETHER = 16
"""The rows of whole registers and lines of the cache: of the narrowest elements that stream, 4 bytes."""

_LINE_BYTES = 64


def streams(loop: lir.RowLoop) -> bool:
    """Whether the rows of ``loop`` are computed stretch by stretch: straight-line code, all of it row by row."""
    if loop.streaming is None:
        return False
    body = _body(loop)
    plain = all(isinstance(stmt, lir.Let | lir.Store | lir.Declare | lir.StoreVar | lir.Accumulate) for stmt in body)
    places = (*loop.streaming.written, *loop.streaming.ahead)
    sizes = {place.slot.number: place.size for place in places}
    return plain and is_even(body, loop.index[-1], sizes)


def emit_line(e: Emitter, loop: lir.RowLoop, metadata: str) -> None:
    """The rows of ``loop`` along a line, where some are near its ends."""
    assert loop.inside is not None
    low, high = e.bounds(len(loop.index) - 1)
    first, last = _inner(e, loop, low, high)
    with e.w.loop("0", "3") as part:
        is_first, is_inner = (e.w.emit(f"icmp eq i64 {part.counter}, {k}") for k in (0, 1))
        start = choose(e, is_first, low, choose(e, is_inner, first, last))
        stop = choose(e, is_first, first, choose(e, is_inner, last, high))
        inner, near, end = (e.w.fresh(stem) for stem in ("inner", "near", "end"))
        e.w.branch_if(is_inner, inner, near)
        e.w.start(inner)
        e.count(loop.index[-1], start, stop, loop.inside.body, metadata)
        e.w.branch(end)
        e.w.start(near)
        e.count(loop.index[-1], start, stop, loop.body, e.loop_notes(*FEW_TURNS))
        e.w.branch(end)
        e.w.start(end)


def emit_streaming(e: Emitter, loop: lir.RowLoop, metadata: str) -> None:
    """The rows of ``loop`` along a line, stretch by stretch."""
    streaming = loop.streaming
    assert streaming is not None
    w, index = e.w, loop.index[-1]
    low, high = e.bounds(len(loop.index) - 1)
    buffers = _buffers(e, streaming)
    offset = w.emit(f"sub i64 {value_at(e, _body(loop), index, streaming.written[0].row, low)}, {low}")
    with w.loop(low, high) as stretch:
        start, aligned = stretch.counter, line_start(e, stretch.counter, offset, TOGETHER)
        stop = least(e, w.emit(f"add nsw i64 {aligned}, {STRETCH}"), high)
        _compute(e, loop, buffers, (start, stop), aligned, offset, metadata)
        stretch.step = w.emit(f"sub nsw i64 {stop}, {start}")


# ---- Parts of a line ----


def _body(loop: lir.RowLoop) -> lir.Body:
    """What most rows run."""
    return loop.body if loop.inside is None else loop.inside.body


def _inner(e: Emitter, loop: lir.RowLoop, low: str, high: str) -> tuple[str, str]:
    """The first of the rows from ``low`` to ``high`` that is not near the ends of the line, and the one behind them."""
    if loop.inside is None:
        return low, high
    before, after = loop.inside.ends
    first = least(e, high, most(e, low, str(before)))
    behind = e.w.emit(f"sub nsw i64 %argument{loop.inside.length.number}, {after}")
    return first, most(e, first, least(e, high, behind))


def _compute(
    e: Emitter, loop: lir.RowLoop, buffers: Sequence[str], rows: tuple[str, str], aligned: str, offset: str,
    metadata: str,
) -> None:  # fmt: skip
    """The rows of a stretch: computed into the buffers, and stored from there, but for whole lines of the cache.

    Where nothing else is written, registers begin where lines of the cache do, and hold what will not be stored of rows
    before and behind. Such rows may not exist; memory that may be read does.
    """
    streaming, w, index = loop.streaming, e.w, loop.index[-1]
    assert streaming is not None
    for place, buffer in zip(streaming.written, buffers, strict=True):
        begin = w.emit(f"add i64 {w.emit(f'add i64 {aligned}, {offset}')}, {-TOGETHER}")
        e.buffers[place.slot.number] = buffer, w.emit(f"mul i64 {begin}, {place.size}")
    first, last = _inner(e, loop, *rows)
    body = _body(loop)
    begin, end = first, last
    plan = None
    if only_streams(body, streaming):
        begin = line_start(e, first, offset, TOGETHER)
        taken = w.emit(f"add i64 {w.emit(f'sub i64 {last}, {begin}')}, {TOGETHER - 1}")
        count = choose(e, w.emit(f"icmp slt i64 {first}, {last}"), w.emit(f"and i64 {taken}, {-TOGETHER}"), "0")
        end = w.emit(f"add i64 {begin}, {count}")
        plan = None if loop.inside is None else plan_registers(body, index)  # those without ends are joined

    def store(low: str, high: str) -> None:
        low, high = most(e, low, rows[0]), least(e, high, rows[1])
        begin = w.emit(f"add i64 {aligned}, {-TOGETHER}")
        emit_stream(e, streaming.written, buffers, (low, most(e, low, high)), begin, offset)

    if plan is None:
        for ahead in streaming.ahead:
            _fetch(e, loop, ahead, *rows)
        e.count(index, begin, end, body, metadata)
        if loop.inside is not None:
            _near_ends(e, loop, rows, first, last)
        store(*rows)
    else:
        _near_ends(e, loop, rows, first, last)
        store(rows[0], begin)
        whole = _whole(e, first, last, begin, rows[1], offset)
        _in_registers(e, loop, plan, (begin, end), whole, (first, last), store)
        store(end, rows[1])
    e.buffers.clear()


def _in_registers(
    e: Emitter, loop: lir.RowLoop, plan: Registers, rows: tuple[str, str], whole: tuple[str, str],
    inner: tuple[str, str], store: Callable[[str, str], None],
) -> None:  # fmt: skip
    """The rows from the first of ``rows``, where a line of the cache begins, up to the second, in whole registers.

    All are stored in their order, be they whole lines of the cache or not: what is written past the cache to and fro
    takes longer. Of the latter those that are ``inner`` go into the buffers.
    """
    assert loop.streaming is not None
    w, (start, stop) = e.w, rows
    registers = RowRegisters(e, plan, loop.index[-1], loop.streaming.ahead)
    some, past, part, stored, none = (w.fresh(stem) for stem in ("some", "past", "part", "stored", "none"))
    w.branch_if(w.emit(f"icmp slt i64 {start}, {stop}"), some, none)
    w.start(some)  # where there are no rows inside, what the first of them would read may lie anywhere
    registers.start(start)
    with w.loop(start, stop, plan.lanes, e.loop_notes(*FEW_TURNS)) as turn:
        row = turn.counter
        results = registers.turn(row)
        from_, to = (w.emit(f"icmp {how} i64 {row}, {at}") for how, at in zip(("sge", "slt"), whole, strict=True))
        branch_often(e, w.emit(f"and i1 {from_}, {to}"), past, part)
        w.start(past)
        registers.stream(results)
        w.branch(stored)
        w.start(part)
        for stmt, value in results:
            put_rows(e, plan, value, e.element(stmt.slot, e.value(stmt.index)), row, inner)
        store(row, w.emit(f"add i64 {row}, {plan.lanes}"))
        w.branch(stored)
        w.start(stored)
    w.branch(none)
    w.start(none)


def _whole(e: Emitter, first: str, last: str, begin: str, stop: str, offset: str) -> tuple[str, str]:
    """The rows of those from ``first`` to ``last`` that are whole lines of the cache; ``stop`` twice if none are."""
    after = e.w.emit(f"add i64 {begin}, {TOGETHER}")
    low = choose(e, e.w.emit(f"icmp eq i64 {begin}, {first}"), begin, after)
    high = line_start(e, last, offset, TOGETHER)
    some = e.w.emit(f"icmp slt i64 {low}, {high}")
    return choose(e, some, low, stop), choose(e, some, high, stop)


def _near_ends(e: Emitter, loop: lir.RowLoop, rows: tuple[str, str], first: str, last: str) -> None:
    """The rows of a stretch before ``first`` and from ``last`` on, in one loop."""
    w, (start, stop) = e.w, rows
    inner = w.emit(f"sub nsw i64 {last}, {first}")
    with w.loop(start, w.emit(f"sub nsw i64 {stop}, {inner}"), metadata=e.loop_notes(*FEW_TURNS)) as turn:
        before = w.emit(f"icmp slt i64 {turn.counter}, {first}")
        behind = w.emit(f"add nsw i64 {turn.counter}, {inner}")
        e.temps[loop.index[-1].number] = choose(e, before, turn.counter, behind)
        group, e.access_group = e.access_group, None
        e.body(loop.body)
        e.access_group = group


# ---- Buffers ----


def _buffers(e: Emitter, streaming: lir.Streaming) -> list[str]:
    """Memory on the stack for a stretch of each slot, with room for whole registers."""
    rows = STRETCH + 3 * TOGETHER
    return [
        e.w.allocate(f"[{rows * place.size} x {ops.memory_type(place.slot.type)}], align {_LINE_BYTES}")
        for place in streaming.written
    ]


def _fetch(e: Emitter, loop: lir.RowLoop, ahead: lir.RowPlace, start: str, stop: str) -> None:
    """Asks for the memory that rows some way behind a stretch will be the first to read, into the second cache."""
    w = e.w
    w.declare("void @llvm.prefetch.p0(ptr, i32, i32, i32)")
    element = ahead.size * ahead.slot.type.bits // 8
    first = w.emit(f"mul i64 {value_at(e, _body(loop), loop.index[-1], ahead.row, start)}, {element}")
    place = w.emit(f"getelementptr i8, ptr %slot{ahead.slot.number}, i64 {first}")
    place = w.emit(f"getelementptr i8, ptr {place}, i64 {FETCHED_AHEAD}")
    length = w.emit(f"mul i64 {w.emit(f'sub i64 {stop}, {start}')}, {element}")
    with w.loop("0", length, _LINE_BYTES) as turn:
        line = w.emit(f"getelementptr i8, ptr {place}, i64 {turn.counter}")
        w.do(f"call void @llvm.prefetch.p0(ptr {line}, i32 0, i32 2, i32 1)")
