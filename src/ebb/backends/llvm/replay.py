"""The machine code that replays captured steps: one function, the same for every step, that goes through its table."""

from __future__ import annotations

from ebb.runtime.replay import (
    BLOCK,
    BUFFERS,
    BYTES,
    CODE,
    COUNT,
    DRAWN,
    FAILED,
    KIND,
    LEFT,
    OPERATION_WORDS,
    OPERATIONS,
    PLACE_COUNT,
    PLACES,
    RANDOM_WORD,
    REPLAY,
    RIGHT,
    RUNS,
    SOURCE,
    TARGET,
    Kind,
)


def _word(name: str, base: str, number: int | str, type_: str = "i64") -> str:
    """Loads a word of the array ``base`` as ``name``; ``%name.at`` is where it lies."""
    place = f"%{name}.at = getelementptr inbounds i64, ptr %{base}, i64 {number}"
    return f"{place}\n  %{name} = load {type_}, ptr %{name}.at"


REPLAY_MODULE = f"""
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)

define i64 @{REPLAY}(ptr %state) nounwind {{
entry:
  {_word("operations", "state", OPERATIONS, "ptr")}
  {_word("count", "state", COUNT)}
  {_word("buffers", "state", BUFFERS, "ptr")}
  %drawn.at = getelementptr inbounds i64, ptr %state, i64 {DRAWN}
  br label %run

run:
  {_word("runs", "state", RUNS)}
  %over = icmp eq i64 %runs, 0
  br i1 %over, label %done, label %operation

operation:
  %number = phi i64 [ 0, %run ], [ %number.next, %next ]
  %first = mul i64 %number, {OPERATION_WORDS}
  %words = getelementptr inbounds i64, ptr %operations, i64 %first
  {_word("kind", "words", KIND)}
  switch i64 %kind, label %launch [
    i64 {Kind.SWAP:d}, label %swap
    i64 {Kind.COPY:d}, label %copy
    i64 {Kind.DRAW:d}, label %draw
  ]

launch:
  {_word("code", "words", CODE, "ptr")}
  {_word("block", "words", BLOCK, "ptr")}
  {_word("places", "words", PLACES, "ptr")}
  {_word("place.count", "words", PLACE_COUNT)}
  br label %place

place:
  %place.number = phi i64 [ 0, %launch ], [ %place.next, %put ]
  %placed = icmp uge i64 %place.number, %place.count
  br i1 %placed, label %random, label %put

put:
  %pair = shl i64 %place.number, 1
  {_word("word", "places", "%pair")}
  %second = or disjoint i64 %pair, 1
  {_word("field", "places", "%second")}
  {_word("buffer", "buffers", "%field")}
  %put.at = getelementptr inbounds i64, ptr %block, i64 %word
  store i64 %buffer, ptr %put.at
  %place.next = add i64 %place.number, 1
  br label %place

random:
  {_word("random.word", "words", RANDOM_WORD)}
  %draws = icmp sge i64 %random.word, 0
  br i1 %draws, label %key, label %call

key:
  %launch.number = load i64, ptr %drawn.at
  %launch.low = and i64 %launch.number, 4294967295
  %key.at = getelementptr inbounds i64, ptr %block, i64 %random.word
  store i64 %launch.low, ptr %key.at
  %launch.more = add i64 %launch.number, 1
  store i64 %launch.more, ptr %drawn.at
  br label %call

call:
  %result = call i64 %code(ptr %block)
  %bad = icmp ne i64 %result, 0
  br i1 %bad, label %failed, label %next

failed:
  %failed.at = getelementptr inbounds i64, ptr %state, i64 {FAILED}
  store i64 %number, ptr %failed.at
  ret i64 1

swap:
  {_word("left", "words", LEFT)}
  {_word("right", "words", RIGHT)}
  {_word("left.buffer", "buffers", "%left")}
  {_word("right.buffer", "buffers", "%right")}
  store i64 %left.buffer, ptr %right.buffer.at
  store i64 %right.buffer, ptr %left.buffer.at
  br label %next

copy:
  {_word("target", "words", TARGET, "ptr")}
  {_word("source", "words", SOURCE, "ptr")}
  {_word("bytes", "words", BYTES)}
  call void @llvm.memcpy.p0.p0.i64(ptr %target, ptr %source, i64 %bytes, i1 false)
  br label %next

draw:
  %drawn = load i64, ptr %drawn.at
  %drawn.more = add i64 %drawn, 1
  store i64 %drawn.more, ptr %drawn.at
  br label %next

next:
  %number.next = add i64 %number, 1
  %more = icmp ult i64 %number.next, %count
  br i1 %more, label %operation, label %run.done

run.done:
  %runs.left = sub i64 %runs, 1
  store i64 %runs.left, ptr %runs.at
  br label %run

done:
  ret i64 0
}}
"""
