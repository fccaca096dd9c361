"""A function that stores words past the cache, in LLVM IR, and calls of it."""

from __future__ import annotations

from collections.abc import Sequence

from ebb.backends.llvm.turns import FEW_TURNS, Emitter
from ebb.compiler import lir

_LINE_BYTES = 64
_WORD = 4
STREAM_FUNCTION = "ebb.stream"


def _moved(name: str, at: str, type_: str, nbytes: int) -> str:
    """A piece from one place to the other."""
    return f"""  %{name}.from = getelementptr inbounds i8, ptr %from, i64 {at}
  %{name}.to = getelementptr inbounds i8, ptr %to, i64 {at}
  %{name}.moved = load {type_}, ptr %{name}.from, align {nbytes}
  store {type_} %{name}.moved, ptr %{name}.to, align {nbytes}, !nontemporal !NOTE
"""


def _fits(name: str, at: str, nbytes: int) -> str:
    """Whether a piece is left, ``some``, and where it ends."""
    return f"""  %{name}.end = add nuw i64 {at}, {nbytes}
  %{name}.some = icmp ule i64 %{name}.end, %bytes
"""


def _leads_to(name: str, at: str, mask: int) -> str:
    """Whether it is left, and would lie where wider pieces are not aligned: ``wanted``."""
    return f"""  %{name}.place = add i64 %address, {at}
  %{name}.beyond = and i64 %{name}.place, {mask}
  %{name}.odd = icmp ne i64 %{name}.beyond, 0
  %{name}.wanted = and i1 %{name}.some, %{name}.odd
"""


def _once(name: str, at: str, type_: str, nbytes: int, leads: bool) -> str:
    """At most one piece, at ``at`` in block ``NAME.in``; it goes on at ``NAME.next`` in ``NAME.out``."""
    wanted = "wanted" if leads else "some"
    return f"""  br label %{name}.in
{name}.in:
{_fits(name, at, nbytes)}{_leads_to(name, at, nbytes) if leads else ""}\
  br i1 %{name}.{wanted}, label %{name}, label %{name}.out
{name}:
{_moved(name, at, type_, nbytes)}  br label %{name}.out
{name}.out:
  %{name}.next = phi i64 [ {at}, %{name}.in ], [ %{name}.end, %{name} ]
"""


def _many(name: str, before: str, at: str, type_: str, nbytes: int, leads: bool) -> str:
    """As many pieces as there are, from ``at`` on, behind block ``before``; goes on at ``NAME.at`` in ``NAME.out``."""
    wanted = "wanted" if leads else "some"
    return f"""  br label %{name}
{name}:
  %{name}.at = phi i64 [ {at}, %{before} ], [ %{name}.end, %{name}.turn ]
{_fits(name, f"%{name}.at", nbytes)}{_leads_to(name, f"%{name}.at", 63) if leads else ""}\
  br i1 %{name}.{wanted}, label %{name}.turn, label %{name}.out
{name}.turn:
{_moved(name, f"%{name}.at", type_, nbytes)}  br label %{name}
{name}.out:
"""


STREAM = f"""
define internal void @{STREAM_FUNCTION}(ptr noalias %to, ptr noalias %from, i64 %bytes) alwaysinline nounwind {{
entry:
  %address = ptrtoint ptr %to to i64
{_once("word", "0", "i32", 4, leads=True)}\
{_once("pair", "%word.next", "i64", 8, leads=True)}\
{_many("first", "pair.out", "%pair.next", "<4 x i32>", 16, leads=True)}\
{_many("line", "first.out", "%first.at", "<16 x i32>", 64, leads=False)}\
{_many("last", "line.out", "%line.at", "<4 x i32>", 16, leads=False)}\
{_once("two", "%last.at", "i64", 8, leads=False)}\
{_once("one", "%two.next", "i32", 4, leads=False)}\
  ret void
}}
"""
"""Moves words to where they lie as in ``from``, with respect to lines of the cache: whole lines where there are any,
and before and behind them the widest pieces that are aligned. ``!NOTE`` is the number of a note that says 1. It is
always inlined: around a call in a loop over registers all of them would be put on the stack and back."""


def emit_stream(
    e: Emitter, places: Sequence[lir.RowPlace], buffers: Sequence[str], rows: tuple[str, str], first: str, offset: str
) -> None:
    """Moves ``rows`` from the buffers, which begin with the row ``first``, to where they belong, ``offset`` further."""
    w, (start, stop) = e.w, rows
    if STREAM_FUNCTION not in e.module.definitions:
        w.define(STREAM_FUNCTION, STREAM.replace("!NOTE", e.module.note("!{{i32 1}}")))
    skipped, count = (w.emit(f"sub i64 {a}, {b}") for a, b in ((start, first), (stop, start)))
    position = w.emit(f"add i64 {start}, {offset}")
    for place, buffer in zip(places, buffers, strict=True):
        size = place.size * place.slot.type.bits // 8
        to, source, length = (w.emit(f"mul i64 {number}, {size}") for number in (position, skipped, count))
        target = w.emit(f"getelementptr inbounds i8, ptr %slot{place.slot.number}, i64 {to}")
        moved = w.emit(f"getelementptr inbounds i8, ptr {buffer}, i64 {source}")
        w.do(f"call void @{STREAM_FUNCTION}(ptr {target}, ptr {moved}, i64 {length})")


def emit_beginning(e: Emitter, value: str, place: str, stop: str) -> None:
    """Stores the words up to ``stop`` of a line of the cache past it, from memory."""
    at = "0"
    for piece in (8, 4, 2, 1):
        at = _emit_piece(e, value, place, stop, piece, at)


def emit_end(e: Emitter, value: str, place: str, start: str) -> None:
    """Stores the words from ``start`` on."""
    count, at = e.w.emit(f"sub i64 {_LINE_BYTES // _WORD}, {start}"), start
    for piece in (1, 2, 4, 8, 16):
        at = _emit_piece(e, value, place, count, piece, at)


def emit_words(e: Emitter, value: str, place: str, start: str, stop: str) -> None:
    """Stores the words from ``start`` up to ``stop``, one by one."""
    with e.w.loop(start, stop, metadata=e.loop_notes(*FEW_TURNS)) as word:
        _move(e, value, place, 1, word.counter)


def _emit_piece(e: Emitter, value: str, place: str, count: str, piece: int, at: str) -> str:
    """Stores so many words at ``at`` if the bit of ``count`` says so, and returns where the next begin."""
    w = e.w
    some, done = w.fresh("some"), w.fresh("done")
    bit = w.emit(f"and i64 {count}, {piece}")
    following = w.emit(f"add i64 {at}, {bit}")
    w.branch_if(w.emit(f"icmp ne i64 {bit}, 0"), some, done)
    w.start(some)
    _move(e, value, place, piece, at)
    w.branch(done)
    w.start(done)
    return following


def _move(e: Emitter, value: str, place: str, words: int, at: str) -> None:
    """Stores so many words at ``at``."""
    w = e.w
    at = w.emit(f"mul i64 {at}, {_WORD}")
    from_, to = (w.emit(f"getelementptr i8, ptr {base}, i64 {at}") for base in (value, place))
    nbytes = words * _WORD
    type_ = f"i{nbytes * 8}" if words < 4 else f"<{words} x i32>"
    piece = w.emit(f"load volatile {type_}, ptr {from_}, align {nbytes}")
    w.do(f"store {type_} {piece}, ptr {to}, align {nbytes}, !nontemporal {e.module.note('!{{i32 1}}')}")
