"""A function that stores words past the cache, in LLVM IR."""

from __future__ import annotations

STREAM_FUNCTION = "ebb.stream"

STREAM = """
define internal void @ebb.stream(ptr noalias %to, ptr noalias %from, i64 %bytes) alwaysinline nounwind {
entry:
  %address = ptrtoint ptr %to to i64
  %word.end = add nuw i64 0, 4
  %word.some = icmp ule i64 %word.end, %bytes
  %word.place = add i64 %address, 0
  %word.bit = and i64 %word.place, 4
  %word.odd = icmp ne i64 %word.bit, 0
  %word.wanted = and i1 %word.some, %word.odd
  br i1 %word.wanted, label %word, label %words
word:
  %word.from = getelementptr inbounds i8, ptr %from, i64 0
  %word.to = getelementptr inbounds i8, ptr %to, i64 0
  %word.moved = load i32, ptr %word.from, align 4
  store i32 %word.moved, ptr %word.to, align 4, !nontemporal !NOTE
  br label %words
words:
  %a = phi i64 [ 0, %entry ], [ 4, %word ]
  %pair.end = add nuw i64 %a, 8
  %pair.some = icmp ule i64 %pair.end, %bytes
  %pair.place = add i64 %address, %a
  %pair.bit = and i64 %pair.place, 8
  %pair.odd = icmp ne i64 %pair.bit, 0
  %pair.wanted = and i1 %pair.some, %pair.odd
  br i1 %pair.wanted, label %pair, label %pairs
pair:
  %pair.from = getelementptr inbounds i8, ptr %from, i64 %a
  %pair.to = getelementptr inbounds i8, ptr %to, i64 %a
  %pair.moved = load i64, ptr %pair.from, align 8
  store i64 %pair.moved, ptr %pair.to, align 8, !nontemporal !NOTE
  br label %pairs
pairs:
  %b = phi i64 [ %a, %words ], [ %pair.end, %pair ]
  br label %first
first:
  %first.at = phi i64 [ %b, %pairs ], [ %first.next, %first.turn ]
  %first.next = add nuw i64 %first.at, 16
  %first.some = icmp ule i64 %first.next, %bytes
  %first.place = add i64 %address, %first.at
  %first.beyond = and i64 %first.place, 63
  %first.inner = icmp ne i64 %first.beyond, 0
  %first.wanted = and i1 %first.some, %first.inner
  br i1 %first.wanted, label %first.turn, label %lines
first.turn:
  %first.from = getelementptr inbounds i8, ptr %from, i64 %first.at
  %first.to = getelementptr inbounds i8, ptr %to, i64 %first.at
  %first.moved = load <4 x i32>, ptr %first.from, align 16
  store <4 x i32> %first.moved, ptr %first.to, align 16, !nontemporal !NOTE
  br label %first
lines:
  br label %line
line:
  %line.at = phi i64 [ %first.at, %lines ], [ %line.next, %line.turn ]
  %line.next = add nuw i64 %line.at, 64
  %line.some = icmp ule i64 %line.next, %bytes
  br i1 %line.some, label %line.turn, label %rest
line.turn:
  %line.from = getelementptr inbounds i8, ptr %from, i64 %line.at
  %line.to = getelementptr inbounds i8, ptr %to, i64 %line.at
  %line.moved = load <16 x i32>, ptr %line.from, align 64
  store <16 x i32> %line.moved, ptr %line.to, align 64, !nontemporal !NOTE
  br label %line
rest:
  br label %last
last:
  %last.at = phi i64 [ %line.at, %rest ], [ %last.next, %last.turn ]
  %last.next = add nuw i64 %last.at, 16
  %last.some = icmp ule i64 %last.next, %bytes
  br i1 %last.some, label %last.turn, label %odd
last.turn:
  %last.from = getelementptr inbounds i8, ptr %from, i64 %last.at
  %last.to = getelementptr inbounds i8, ptr %to, i64 %last.at
  %last.moved = load <4 x i32>, ptr %last.from, align 16
  store <4 x i32> %last.moved, ptr %last.to, align 16, !nontemporal !NOTE
  br label %last
odd:
  %two.end = add nuw i64 %last.at, 8
  %two.some = icmp ule i64 %two.end, %bytes
  br i1 %two.some, label %two, label %twos
two:
  %two.from = getelementptr inbounds i8, ptr %from, i64 %last.at
  %two.to = getelementptr inbounds i8, ptr %to, i64 %last.at
  %two.moved = load i64, ptr %two.from, align 8
  store i64 %two.moved, ptr %two.to, align 8, !nontemporal !NOTE
  br label %twos
twos:
  %c = phi i64 [ %last.at, %odd ], [ %two.end, %two ]
  %one.end = add nuw i64 %c, 4
  %one.some = icmp ule i64 %one.end, %bytes
  br i1 %one.some, label %one, label %done
one:
  %one.from = getelementptr inbounds i8, ptr %from, i64 %c
  %one.to = getelementptr inbounds i8, ptr %to, i64 %c
  %one.moved = load i32, ptr %one.from, align 4
  store i32 %one.moved, ptr %one.to, align 4, !nontemporal !NOTE
  br label %done
done:
  ret void
}
"""
"""Moves words to where they lie as in ``from``, with respect to lines of the cache: whole lines where there are any,
and before and behind them the widest pieces that are aligned. ``!NOTE`` is the number of a note that says 1. It is
always inlined: around a call in a loop over registers all of them would be put on the stack and back."""
