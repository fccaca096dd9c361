"""The driver: what takes launches through the code of any kernel, the same for all, so that it is compiled once.

It knows the argument block (``ebb.runtime.cpu``) and nothing of what the kernels compute.
"""

from __future__ import annotations

from ebb.backends.llvm.entry import AS_WRITTEN
from ebb.backends.llvm.replay import REPLAY_FUNCTION, word
from ebb.runtime.cpu import (
    BLOCK_CODE,
    CHUNK,
    DEAL,
    FAILURE_WORDS,
    FAILURES,
    FINISH_CODE,
    FORK,
    ITEMS,
    LAUNCH,
    SHARE,
    SHARE_WORDS,
    SHARES,
    STARTS,
    TEAM,
    THREAD_NUMBER,
    THREADS,
    WAVE,
    WAVES,
)

_CHUNKS = 64
"""In how many chunks a thread takes its share: so a thread that comes to a stop holds up little, and a launch of little
work, whose blocks are few, takes its blocks one by one. A chunk costs some 10 ns."""

_DEAL_FUNCTION = f"""
declare i64 @llvm.umin.i64(i64, i64)
declare i64 @llvm.umax.i64(i64, i64)

define void @{DEAL}(ptr %args, i64 %team) {AS_WRITTEN} {{
entry:
  {word("wave", "args", WAVE)}
  {word("starts", "args", STARTS, "ptr")}
  {word("shares", "args", SHARES, "ptr")}
  {word("first", "starts", "%wave")}
  %wave.next = add i64 %wave, 1
  {word("last", "starts", "%wave.next")}
  %items = sub i64 %last, %first
  %team.at = getelementptr inbounds i64, ptr %args, i64 {TEAM}
  store i64 %team, ptr %team.at
  %alone = icmp eq i64 %team, 1
  %several = mul i64 %team, {_CHUNKS}
  %chunks = select i1 %alone, i64 1, i64 %several
  %chunk.part = udiv i64 %items, %chunks
  %chunk = call i64 @llvm.umax.i64(i64 %chunk.part, i64 1)
  %chunk.at = getelementptr inbounds i64, ptr %args, i64 {CHUNK}
  store i64 %chunk, ptr %chunk.at
  br label %deal

deal:
  %thread = phi i64 [ 0, %entry ], [ %thread.next, %deal ]
  %low = phi i64 [ 0, %entry ], [ %high, %deal ]
  %thread.next = add i64 %thread, 1
  %high.part = mul i64 %items, %thread.next
  %high = udiv i64 %high.part, %team
  %high.half = shl i64 %high, 32
  %share = or disjoint i64 %high.half, %low
  %share.word = mul i64 %thread, {SHARE_WORDS}
  %share.at = getelementptr inbounds i64, ptr %shares, i64 %share.word
  store i64 %share, ptr %share.at
  %more = icmp ult i64 %thread.next, %team
  br i1 %more, label %deal, label %done

done:
  ret void
}}
"""
"""Each thread gets a stretch of the items of the wave, which follow one another in memory."""

_SHARE_FUNCTION = f"""
define void @{SHARE}(ptr %args, i64 %thread) {AS_WRITTEN} {{
entry:
  {word("wave", "args", WAVE)}
  {word("starts", "args", STARTS, "ptr")}
  {word("items", "args", ITEMS, "ptr")}
  {word("failures", "args", FAILURES, "ptr")}
  {word("code", "args", BLOCK_CODE, "ptr")}
  {word("shares", "args", SHARES, "ptr")}
  {word("team", "args", TEAM)}
  {word("chunk", "args", CHUNK)}
  {word("first", "starts", "%wave")}
  %record = mul i64 %thread, {FAILURE_WORDS}
  %failure = getelementptr inbounds i64, ptr %failures, i64 %record
  %site.at = getelementptr inbounds i64, ptr %failure, i64 0
  %failed.at = getelementptr inbounds i64, ptr %failure, i64 1
  %listed = icmp ne ptr %items, null
  br label %share

share:
  %offset = phi i64 [ 0, %entry ], [ %offset.next, %look ]
  %some.left = icmp ult i64 %offset, %team
  br i1 %some.left, label %begin, label %done

begin:
  %offset.next = add i64 %offset, 1
  %own = icmp eq i64 %offset, 0
  %behind = add i64 %thread, %offset
  %whose = urem i64 %behind, %team
  %share.word = mul i64 %whose, {SHARE_WORDS}
  %share.at = getelementptr inbounds i64, ptr %shares, i64 %share.word
  br label %look

look:
  %present = load atomic i64, ptr %share.at monotonic, align 8
  %low = and i64 %present, 4294967295
  %high = lshr i64 %present, 32
  %left = sub i64 %high, %low
  %none = icmp eq i64 %left, 0
  br i1 %none, label %share, label %take

take:
  %count = call i64 @llvm.umin.i64(i64 %left, i64 %chunk)
  %count.high = shl i64 %count, 32
  %without.first = add i64 %present, %count
  %without.last = sub i64 %present, %count.high
  %rest = select i1 %own, i64 %without.first, i64 %without.last
  %exchange = cmpxchg ptr %share.at, i64 %present, i64 %rest monotonic monotonic
  %taken = extractvalue {{ i64, i1 }} %exchange, 1
  br i1 %taken, label %chunk.begin, label %look

chunk.begin:
  %high.first = sub i64 %high, %count
  %offset.first = select i1 %own, i64 %low, i64 %high.first
  %chunk.first = add i64 %first, %offset.first
  %chunk.behind = add i64 %chunk.first, %count
  %item.first = select i1 %listed, i64 %chunk.first, i64 0
  %item.behind = select i1 %listed, i64 %chunk.behind, i64 1
  br label %next

next:
  %item = phi i64 [ %item.first, %chunk.begin ], [ %item.next, %check ], [ %item.next, %run ]
  %more = icmp ult i64 %item, %item.behind
  br i1 %more, label %bounds, label %look

bounds:
  %item.next = add i64 %item, 1
  br i1 %listed, label %look.up, label %check

look.up:
  %pair = shl i64 %item, 1
  {word("item.start", "items", "%pair")}
  %second = or disjoint i64 %pair, 1
  {word("item.stop", "items", "%second")}
  br label %check

check:
  %start = phi i64 [ %chunk.first, %bounds ], [ %item.start, %look.up ]
  %stop = phi i64 [ %chunk.behind, %bounds ], [ %item.stop, %look.up ]
  %site = load i64, ptr %site.at
  %failed.block = load i64, ptr %failed.at
  %sound = icmp eq i64 %site, 0
  %before = icmp ult i64 %start, %failed.block
  %goes.on = or i1 %sound, %before
  br i1 %goes.on, label %run, label %next

run:
  %failed = call i64 %code(ptr %args, ptr %failure, i64 %start, i64 %stop)
  br label %next

done:
  fence seq_cst
  ret void
}}
"""
"""A thread takes chunks of its share from the front, then of the others' from the end, so that none waits while there
are items that nobody has begun. Where each block is an item, a chunk is one stretch of blocks. Once the thread has
failed, items behind its failure are not run. The fence is for what has been stored past the cache."""

_WORKER_FUNCTION = f"""
define internal void @worker(ptr %args) {AS_WRITTEN} {{
entry:
  {word("number", "args", THREAD_NUMBER, "ptr")}
  %thread = call i32 %number()
  %thread.wide = zext i32 %thread to i64
  call void @{SHARE}(ptr %args, i64 %thread.wide)
  ret void
}}
"""

_LAUNCH_FUNCTION = f"""
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
  %most = call i64 @llvm.umin.i64(i64 %threads, i64 %items)
  %team = call i64 @llvm.umax.i64(i64 %most, i64 1)
  %several = icmp ugt i64 %team, 1
  call void @{DEAL}(ptr %args, i64 %team)
  br i1 %several, label %fork, label %alone

fork:
  %team.size = trunc i64 %team to i32
  call void %fork.code(ptr @worker, ptr %args, i32 %team.size, i32 0)
  br label %joined

alone:
  call void @{SHARE}(ptr %args, i64 0)
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

DRIVER_MODULE = _DEAL_FUNCTION + _SHARE_FUNCTION + _WORKER_FUNCTION + _LAUNCH_FUNCTION + REPLAY_FUNCTION
