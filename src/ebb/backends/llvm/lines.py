"""The innermost turns of a loop over rows where those of a line differ, or go through more than caches hold.

Near the ends of a line of a grid coordinates wrap or are held; all other rows run code that knows of no ends.

Rows that stream are computed stretch by stretch into a buffer on the stack, from where whole lines of the cache are
stored past it: what is overwritten is never read into the cache. Meanwhile what other rows will read is fetched ahead:
processors foresee that within a line of a grid, but not from line to line. Measured on Zen 4, a 7-point stencil on
256^3 cells takes 9 ms on one thread with neither of the two, 8.5 with the first, 5 with both.
"""

from __future__ import annotations

from collections.abc import Sequence

from ebb.backends.llvm import ops
from ebb.backends.llvm.registers import Parts, emit_registers, plan_registers
from ebb.backends.llvm.stream import STREAM, STREAM_FUNCTION
from ebb.backends.llvm.strides import is_even
from ebb.backends.llvm.turns import FETCHED_AHEAD, Emitter, value_at
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
    part, head, turn, latch, done = (e.w.fresh(stem) for stem in ("part", "head", "turn", "latch", "done"))
    before = e.w.label
    e.w.branch(head)
    e.w.start(head)
    following = f"%{e.w.fresh('next')}"
    number = e.w.emit(f"phi i64 [ 0, %{before} ], [ {following}, %{latch} ]")
    e.w.branch_if(e.w.emit(f"icmp ult i64 {number}, 3"), turn, done)
    e.w.start(turn)
    is_first, inner = (e.w.emit(f"icmp eq i64 {number}, {k}") for k in (0, 1))
    start = _choose(e, is_first, low, _choose(e, inner, first, last))
    stop = _choose(e, is_first, first, _choose(e, inner, last, high))
    near = e.w.fresh("near")
    e.w.branch_if(inner, part, near)
    e.w.start(part)
    e.count(loop.index[-1], start, stop, loop.inside.body, metadata)
    e.w.branch(latch)
    e.w.start(near)
    e.count(loop.index[-1], start, stop, loop.body, e.loop_notes(*_FEW_TURNS))
    e.w.branch(latch)
    e.w.start(latch)
    e.w.do(f"{following} = add nuw i64 {number}, 1")
    e.w.branch(head)
    e.w.start(done)


_FEW_TURNS = ('!"llvm.loop.vectorize.enable", i1 false', '!"llvm.loop.unroll.disable"')


def emit_streaming(e: Emitter, loop: lir.RowLoop, metadata: str) -> None:
    """The rows of ``loop`` along a line, stretch by stretch."""
    streaming = loop.streaming
    assert streaming is not None
    w, index = e.w, loop.index[-1]
    low, high = e.bounds(len(loop.index) - 1)
    buffers = _buffers(e, streaming)
    offset = w.emit(f"sub i64 {value_at(e, _body(loop), index, streaming.written[0].row, low)}, {low}")
    head, turn, done = (w.fresh(stem) for stem in ("head", "stretch", "done"))
    before, following, latch = w.label, f"%{w.fresh('next')}", w.fresh("latch")
    w.branch(head)
    w.start(head)
    start = w.emit(f"phi i64 [ {low}, %{before} ], [ {following}, %{latch} ]")
    w.branch_if(w.emit(f"icmp slt i64 {start}, {high}"), turn, done)
    w.start(turn)
    aligned = _aligned(e, start, offset)
    stop = _least(e, w.emit(f"add nsw i64 {aligned}, {STRETCH}"), high)
    _compute(e, loop, buffers, (start, stop), aligned, offset, metadata)
    w.branch(latch)
    w.start(latch)
    w.do(f"{following} = add nsw i64 {stop}, 0")
    w.branch(head)
    w.start(done)


# ---- Parts of a line ----


def _body(loop: lir.RowLoop) -> lir.Body:
    """What most rows run."""
    return loop.body if loop.inside is None else loop.inside.body


def _inner(e: Emitter, loop: lir.RowLoop, low: str, high: str) -> tuple[str, str]:
    """The first of the rows from ``low`` to ``high`` that is not near the ends of the line, and the one behind them."""
    if loop.inside is None:
        return low, high
    before, after = loop.inside.ends
    first = _least(e, high, _most(e, low, str(before)))
    behind = e.w.emit(f"sub nsw i64 %argument{loop.inside.length.number}, {after}")
    return first, _most(e, first, _least(e, high, behind))


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
    if _only_streams(body, streaming):
        begin = _aligned(e, first, offset)
        taken = w.emit(f"add i64 {w.emit(f'sub i64 {last}, {begin}')}, {TOGETHER - 1}")
        count = _choose(e, w.emit(f"icmp slt i64 {first}, {last}"), w.emit(f"and i64 {taken}, {-TOGETHER}"), "0")
        end = w.emit(f"add i64 {begin}, {count}")
        plan = plan_registers(body, index)

    def store(low: str, high: str) -> None:
        low, high = _most(e, low, rows[0]), _least(e, high, rows[1])
        _store(e, streaming, buffers, (low, _most(e, low, high)), aligned, offset)

    if plan is None:
        for ahead in streaming.ahead:
            _fetch(e, loop, ahead, *rows)
        e.count(index, begin, end, body, metadata)
        if loop.inside is not None:
            _near_ends(e, loop, rows, first, last)
        store(*rows)
    else:
        if loop.inside is not None:
            _near_ends(e, loop, rows, first, last)
            store(rows[0], begin)
        whole = _whole(e, first, last, begin, rows[1], offset)
        parts = Parts(whole, None if loop.inside is None else (first, last), store)
        emit_registers(e, plan, index, (begin, end), parts, streaming.ahead, e.loop_notes(*_FEW_TURNS))
        if loop.inside is not None:
            store(end, rows[1])
    e.buffers.clear()


def _whole(e: Emitter, first: str, last: str, begin: str, stop: str, offset: str) -> tuple[str, str]:
    """The rows of those from ``first`` to ``last`` that are whole lines of the cache; ``stop`` twice if none are."""
    after = e.w.emit(f"add i64 {begin}, {TOGETHER}")
    low = _choose(e, e.w.emit(f"icmp eq i64 {begin}, {first}"), begin, after)
    high = _aligned(e, last, offset)
    some = e.w.emit(f"icmp slt i64 {low}, {high}")
    return _choose(e, some, low, stop), _choose(e, some, high, stop)


def _near_ends(e: Emitter, loop: lir.RowLoop, rows: tuple[str, str], first: str, last: str) -> None:
    """The rows of a stretch before ``first`` and from ``last`` on, in one loop."""
    w, (start, stop) = e.w, rows
    head, turn, latch, done = (w.fresh(stem) for stem in ("head", "turn", "latch", "done"))
    before, following = w.label, f"%{w.fresh('next')}"
    w.branch(head)
    w.start(head)
    reached = w.emit(f"phi i64 [ {start}, %{before} ], [ {following}, %{latch} ]")
    inner = w.emit(f"icmp eq i64 {reached}, {first}")
    row = e.temps[loop.index[-1].number] = _choose(e, inner, last, reached)
    w.branch_if(w.emit(f"icmp slt i64 {row}, {stop}"), turn, done)
    w.start(turn)
    group, e.access_group = e.access_group, None
    e.body(loop.body)
    e.access_group = group
    w.branch(latch)
    w.start(latch)
    w.do(f"{following} = add nsw i64 {row}, 1")
    w.do(f"br label %{head}{e.loop_notes(*_FEW_TURNS)}")
    w.start(done)


def _only_streams(body: lir.Body, streaming: lir.Streaming) -> bool:
    """Whether ``body`` leaves nothing but in slots that stream, and reads what has room around it."""
    slots = {place.slot.number for place in streaming.written}
    for stmt in body:
        match stmt:
            case lir.Accumulate():
                return False
            case lir.Store(slot) if slot.number not in slots:
                return False
            case lir.Let(_, lir.Load(slot)) if not isinstance(slot.binding, lir.FieldData | lir.GlobalData):
                return False
            case _:
                pass
    return True


# ---- Buffers ----


def _buffers(e: Emitter, streaming: lir.Streaming) -> list[str]:
    """Memory on the stack for a stretch of each slot, with room for whole registers."""
    rows = STRETCH + 3 * TOGETHER
    return [
        e.w.allocate(f"[{rows * place.size} x {ops.memory_type(place.slot.type)}], align {_LINE_BYTES}")
        for place in streaming.written
    ]


def _store(
    e: Emitter, streaming: lir.Streaming, buffers: Sequence[str], rows: tuple[str, str], aligned: str, offset: str
) -> None:
    """Moves a stretch from the buffers to the slots."""
    w, (start, stop) = e.w, rows
    w.declare("i64 @llvm.umin.i64(i64, i64)")
    if STREAM_FUNCTION not in e.module.definitions:
        w.define(STREAM_FUNCTION, STREAM.replace("!NOTE", e.module.note("!{{i32 1}}")))
    skipped = w.emit(f"sub i64 {start}, {w.emit(f'add i64 {aligned}, {-TOGETHER}')}")
    count = w.emit(f"sub i64 {stop}, {start}")
    first = w.emit(f"add i64 {start}, {offset}")
    for place, buffer in zip(streaming.written, buffers, strict=True):
        size = place.size * place.slot.type.bits // 8
        to, source, length = (w.emit(f"mul i64 {number}, {size}") for number in (first, skipped, count))
        target = w.emit(f"getelementptr inbounds i8, ptr %slot{place.slot.number}, i64 {to}")
        moved = w.emit(f"getelementptr inbounds i8, ptr {buffer}, i64 {source}")
        w.do(f"call void @{STREAM_FUNCTION}(ptr {target}, ptr {moved}, i64 {length})")


def _fetch(e: Emitter, loop: lir.RowLoop, ahead: lir.RowPlace, start: str, stop: str) -> None:
    """Asks for the memory that rows some way behind a stretch will be the first to read, into the second cache."""
    w = e.w
    w.declare("void @llvm.prefetch.p0(ptr, i32, i32, i32)")
    element = ahead.size * ahead.slot.type.bits // 8
    first = w.emit(f"mul i64 {value_at(e, _body(loop), loop.index[-1], ahead.row, start)}, {element}")
    place = w.emit(f"getelementptr i8, ptr %slot{ahead.slot.number}, i64 {first}")
    place = w.emit(f"getelementptr i8, ptr {place}, i64 {FETCHED_AHEAD}")
    length = w.emit(f"mul i64 {w.emit(f'sub i64 {stop}, {start}')}, {element}")
    head, turn, done = (w.fresh(stem) for stem in ("head", "fetch", "done"))
    before, following = w.label, f"%{w.fresh('next')}"
    w.branch(head)
    w.start(head)
    at = w.emit(f"phi i64 [ 0, %{before} ], [ {following}, %{turn} ]")
    w.branch_if(w.emit(f"icmp slt i64 {at}, {length}"), turn, done)
    w.start(turn)
    line = w.emit(f"getelementptr i8, ptr {place}, i64 {at}")
    w.do(f"call void @llvm.prefetch.p0(ptr {line}, i32 0, i32 2, i32 1)")
    w.do(f"{following} = add nsw i64 {at}, {_LINE_BYTES}")
    w.branch(head)
    w.start(done)


# ---- Numbers ----


def _aligned(e: Emitter, row: str, offset: str) -> str:
    """The last row up to ``row`` that begins a line of the cache in every field; its position is ``offset`` more."""
    position = e.w.emit(f"add i64 {row}, {offset}")
    return e.w.emit(f"sub i64 {row}, {e.w.emit(f'and i64 {position}, {TOGETHER - 1}')}")


def _least(e: Emitter, a: str, b: str) -> str:
    e.w.declare("i64 @llvm.smin.i64(i64, i64)")
    return e.w.emit(f"call i64 @llvm.smin.i64(i64 {a}, i64 {b})")


def _most(e: Emitter, a: str, b: str) -> str:
    e.w.declare("i64 @llvm.smax.i64(i64, i64)")
    return e.w.emit(f"call i64 @llvm.smax.i64(i64 {a}, i64 {b})")


def _choose(e: Emitter, condition: str, then: str, other: str) -> str:
    return e.w.emit(f"select i1 {condition}, i64 {then}, i64 {other}")
