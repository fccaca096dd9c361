"""The driver: what takes launches through the code of any kernel, the same for all, so that it is compiled once.

It knows the argument block (``ebb.runtime.cpu``) and nothing of what the kernels compute.
"""

from __future__ import annotations

from ebb.backends.llvm.entry import AS_WRITTEN
from ebb.backends.llvm.replay import REPLAY_FUNCTION, word
from ebb.runtime.cpu import (
    BLOCK_CODE,
    FAILURE_WORDS,
    FAILURES,
    FINISH_CODE,
    FORK,
    ITEMS,
    LAUNCH,
    SHARE,
    STARTS,
    THREAD_COUNT,
    THREAD_NUMBER,
    THREADS,
    WAVE,
    WAVES,
)

_SHARE_FUNCTION = f"""
define void @{SHARE}(ptr %args, i64 %thread, i64 %threads) {AS_WRITTEN} {{
entry:
  {word("wave", "args", WAVE)}
  {word("starts", "args", STARTS, "ptr")}
  {word("items", "args", ITEMS, "ptr")}
  {word("failures", "args", FAILURES, "ptr")}
  {word("code", "args", BLOCK_CODE, "ptr")}
  {word("first", "starts", "%wave")}
  %wave.next = add i64 %wave, 1
  {word("last", "starts", "%wave.next")}
  %count = sub i64 %last, %first
  %low.part = mul i64 %count, %thread
  %low.share = udiv i64 %low.part, %threads
  %low = add i64 %first, %low.share
  %thread.next = add i64 %thread, 1
  %high.part = mul i64 %count, %thread.next
  %high.share = udiv i64 %high.part, %threads
  %high = add i64 %first, %high.share
  %record = mul i64 %thread, {FAILURE_WORDS}
  %failure = getelementptr inbounds i64, ptr %failures, i64 %record
  %listed = icmp ne ptr %items, null
  %item.low = select i1 %listed, i64 %low, i64 0
  %item.high = select i1 %listed, i64 %high, i64 1
  br label %next

next:
  %item = phi i64 [ %item.low, %entry ], [ %item.next, %run ]
  %more = icmp ult i64 %item, %item.high
  br i1 %more, label %bounds, label %done

bounds:
  br i1 %listed, label %look.up, label %check

look.up:
  %pair = shl i64 %item, 1
  {word("item.start", "items", "%pair")}
  %second = or disjoint i64 %pair, 1
  {word("item.stop", "items", "%second")}
  br label %check

check:
  %start = phi i64 [ %low, %bounds ], [ %item.start, %look.up ]
  %stop = phi i64 [ %high, %bounds ], [ %item.stop, %look.up ]
  {word("site", "failure", 0)}
  {word("failed.block", "failure", 1)}
  %sound = icmp eq i64 %site, 0
  %before = icmp ult i64 %start, %failed.block
  %goes.on = or i1 %sound, %before
  br i1 %goes.on, label %run, label %done

run:
  %item.next = add i64 %item, 1
  %failed = call i64 %code(ptr %args, ptr %failure, i64 %start, i64 %stop)
  %sound.still = icmp eq i64 %failed, 0
  br i1 %sound.still, label %next, label %done

done:
  ret void
}}
"""
"""A thread takes a stretch of the items of the wave; where each block is an item, the stretch itself is the one item.
Once it has failed, items behind its failure are not run."""

_WORKER_FUNCTION = f"""
define internal void @worker(ptr %args) {AS_WRITTEN} {{
entry:
  {word("number", "args", THREAD_NUMBER, "ptr")}
  {word("count", "args", THREAD_COUNT, "ptr")}
  %thread = call i32 %number()
  %threads = call i32 %count()
  %thread.wide = zext i32 %thread to i64
  %threads.wide = zext i32 %threads to i64
  call void @{SHARE}(ptr %args, i64 %thread.wide, i64 %threads.wide)
  ret void
}}
"""

_LAUNCH_FUNCTION = f"""
declare i64 @llvm.umin.i64(i64, i64)

define i64 @{LAUNCH}(ptr %args) {AS_WRITTEN} {{
entry:
  {word("threads", "args", THREADS)}
  {word("waves", "args", WAVES)}
  {word("starts", "args", STARTS, "ptr")}
  {word("fork.code", "args", FORK, "ptr")}
  %present = getelementptr inbounds i64, ptr %args, i64 {WAVE}
  br label %wave.head

wave.head:
  %wave = phi i64 [ 0, %entry ], [ %wave.next, %joined ]
  %more = icmp ult i64 %wave, %waves
  br i1 %more, label %wave.turn, label %check.head

wave.turn:
  store i64 %wave, ptr %present
  %wave.next = add i64 %wave, 1
  {word("first", "starts", "%wave")}
  {word("last", "starts", "%wave.next")}
  %items = sub i64 %last, %first
  %team = call i64 @llvm.umin.i64(i64 %threads, i64 %items)
  %several = icmp ugt i64 %team, 1
  br i1 %several, label %fork, label %alone

fork:
  %team.size = trunc i64 %team to i32
  call void %fork.code(ptr @worker, ptr %args, i32 %team.size, i32 0)
  br label %joined

alone:
  call void @{SHARE}(ptr %args, i64 0, i64 1)
  br label %joined

joined:
  br label %wave.head

check.head:
  %thread = phi i64 [ 0, %wave.head ], [ %thread.next, %check.turn ]
  %unchecked = icmp ult i64 %thread, %threads
  br i1 %unchecked, label %check.turn, label %finish

check.turn:
  {word("failures", "args", FAILURES, "ptr")}
  %record = mul i64 %thread, {FAILURE_WORDS}
  {word("site", "failures", "%record")}
  %thread.next = add i64 %thread, 1
  %sound = icmp eq i64 %site, 0
  br i1 %sound, label %check.head, label %failed

finish:
  {word("finish.code", "args", FINISH_CODE, "ptr")}
  call void %finish.code(ptr %args)
  ret i64 0

failed:
  ret i64 1
}}
"""
"""All waves run even after a failure: a later one may hold a row that comes before it."""

DRIVER_MODULE = _SHARE_FUNCTION + _WORKER_FUNCTION + _LAUNCH_FUNCTION + REPLAY_FUNCTION
