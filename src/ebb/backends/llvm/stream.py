"""A function that stores words past the cache, in LLVM IR."""

from __future__ import annotations

STREAM_FUNCTION = "ebb.stream"


def _move(name: str, at: str, type_: str, nbytes: int) -> str:
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
{_move(name, at, type_, nbytes)}  br label %{name}.out
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
{_move(name, f"%{name}.at", type_, nbytes)}  br label %{name}
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
