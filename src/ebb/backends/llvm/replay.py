"""The function that replays captured steps, the same for all: it goes through the table of one."""

from __future__ import annotations

from ebb.backends.llvm.entry import AS_WRITTEN
from ebb.runtime.cpu import BLOCK_CODE, FAILURES, LAUNCH
from ebb.runtime.replay import (
    BEHIND,
    BLOCK,
    BUFFERS,
    BYTES,
    COUNT,
    DRAWN,
    FAILED,
    FIRST,
    FORK_BY,
    KIND,
    LAUNCHES,
    LEFT,
    NUMBER,
    OPERATION_WORDS,
    OPERATIONS,
    PLACE_COUNT,
    PLACES,
    RANDOM_WORD,
    REPLAY,
    RIGHT,
    RUNS,
    SOURCE,
    TABLE,
    TARGET,
    TEAM,
    TURN,
    TURN_WORDS,
    TURNS,
    WHAT,
    Kind,
)


def word(name: str, base: str, number: int | str, type_: str = "i64") -> str:
    """Loads a word of the array ``base`` as ``name``; ``%name.at`` is where it lies."""
    place = f"%{name}.at = getelementptr inbounds i64, ptr %{base}, i64 {number}"
    return f"{place}\n  %{name} = load {type_}, ptr %{name}.at"


REPLAY_FUNCTION = f"""
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)

define internal void @ebb.turns(ptr %what) {AS_WRITTEN} {{
entry:
  {word("turns", "what", TURNS)}
  {word("table", "what", TABLE, "ptr")}
  {word("launches", "what", LAUNCHES, "ptr")}
  %turn.at = getelementptr inbounds i64, ptr %what, i64 {TURN}
  br label %take

take:
  %turn = atomicrmw add ptr %turn.at, i64 1 monotonic
  %left = icmp ult i64 %turn, %turns
  br i1 %left, label %begin, label %done

begin:
  %offset = mul i64 %turn, {TURN_WORDS}
  %words = getelementptr inbounds i64, ptr %table, i64 %offset
  {word("first", "words", FIRST)}
  {word("behind", "words", BEHIND)}
  {word("number", "words", NUMBER)}
  %behind.it = add i64 %number, 1
  br label %launch

launch:
  %this = phi i64 [ %first, %begin ], [ %following, %launch ]
  {word("block", "launches", "%this", "ptr")}
  {word("code", "block", BLOCK_CODE, "ptr")}
  {word("failures", "block", FAILURES, "ptr")}
  %failed = call i64 %code(ptr %block, ptr %failures, i64 %number, i64 %behind.it)
  %following = add i64 %this, 1
  %more = icmp ult i64 %following, %behind
  br i1 %more, label %launch, label %take

done:
  fence seq_cst
  ret void
}}

define i64 @{REPLAY}(ptr %state) {AS_WRITTEN} {{
entry:
  {word("operations", "state", OPERATIONS, "ptr")}
  {word("count", "state", COUNT)}
  {word("buffers", "state", BUFFERS, "ptr")}
  %drawn.at = getelementptr inbounds i64, ptr %state, i64 {DRAWN}
  br label %run

run:
  {word("runs", "state", RUNS)}
  %over = icmp eq i64 %runs, 0
  br i1 %over, label %done, label %operation

operation:
  %number = phi i64 [ 0, %run ], [ %number.next, %next ]
  %first = mul i64 %number, {OPERATION_WORDS}
  %words = getelementptr inbounds i64, ptr %operations, i64 %first
  {word("kind", "words", KIND)}
  switch i64 %kind, label %launch [
    i64 {Kind.SWAP:d}, label %swap
    i64 {Kind.COPY:d}, label %copy
    i64 {Kind.DRAW:d}, label %draw
    i64 {Kind.TOGETHER:d}, label %together
  ]

launch:
  {word("block", "words", BLOCK, "ptr")}
  {word("places", "words", PLACES, "ptr")}
  {word("place.count", "words", PLACE_COUNT)}
  br label %place

place:
  %place.number = phi i64 [ 0, %launch ], [ %place.next, %put ]
  %placed = icmp uge i64 %place.number, %place.count
  br i1 %placed, label %random, label %put

put:
  %pair = shl i64 %place.number, 1
  {word("word", "places", "%pair")}
  %second = or disjoint i64 %pair, 1
  {word("field", "places", "%second")}
  {word("buffer", "buffers", "%field")}
  %put.at = getelementptr inbounds i64, ptr %block, i64 %word
  store i64 %buffer, ptr %put.at
  %place.next = add i64 %place.number, 1
  br label %place

random:
  {word("random.word", "words", RANDOM_WORD)}
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
  %runs.later = icmp eq i64 %kind, {Kind.PLACE:d}
  br i1 %runs.later, label %next, label %run.code

run.code:
  %result = call i64 @{LAUNCH}(ptr %block)
  %bad = icmp ne i64 %result, 0
  br i1 %bad, label %failed, label %next

failed:
  %failed.at = getelementptr inbounds i64, ptr %state, i64 {FAILED}
  store i64 %number, ptr %failed.at
  ret i64 1

swap:
  {word("left", "words", LEFT)}
  {word("right", "words", RIGHT)}
  {word("left.buffer", "buffers", "%left")}
  {word("right.buffer", "buffers", "%right")}
  store i64 %left.buffer, ptr %right.buffer.at
  store i64 %right.buffer, ptr %left.buffer.at
  br label %next

copy:
  {word("target", "words", TARGET, "ptr")}
  {word("source", "words", SOURCE, "ptr")}
  {word("bytes", "words", BYTES)}
  call void @llvm.memcpy.p0.p0.i64(ptr %target, ptr %source, i64 %bytes, i1 false)
  br label %next

draw:
  %drawn = load i64, ptr %drawn.at
  %drawn.more = add i64 %drawn, 1
  store i64 %drawn.more, ptr %drawn.at
  br label %next

together:
  {word("what", "words", WHAT, "ptr")}
  {word("fork", "words", FORK_BY, "ptr")}
  {word("team", "words", TEAM)}
  %first.turn.at = getelementptr inbounds i64, ptr %what, i64 {TURN}
  store i64 0, ptr %first.turn.at
  %alone = icmp ule i64 %team, 1
  br i1 %alone, label %serial, label %parallel

serial:
  call void @ebb.turns(ptr %what)
  br label %next

parallel:
  %threads = trunc i64 %team to i32
  call void %fork(ptr @ebb.turns, ptr %what, i32 %threads, i32 0)
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
