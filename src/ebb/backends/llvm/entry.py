"""The entries of a module: loops over blocks, and the fork into threads.

They know the argument block (``layout``) and nothing of what the kernel computes.
"""

from __future__ import annotations

from ebb.backends.llvm import ops
from ebb.backends.llvm.layout import layout_of
from ebb.backends.llvm.writer import FunctionWriter, ModuleWriter
from ebb.compiler import lir
from ebb.runtime.cpu import (
    BOXES,
    FAILURE_WORDS,
    FAILURES,
    FINISH,
    FORK,
    ITEMS,
    LAUNCH,
    ROWS,
    SHARE,
    STARTS,
    THREAD_COUNT,
    THREAD_NUMBER,
    THREADS,
    WAVE,
    WAVES,
)

BLOCK_FUNCTION, FINISH_FUNCTION = "ebb.block", "ebb.finish"

_AS_WRITTEN = "nounwind noinline optnone"
"""Attributes of the entries. They run once a block, and to optimise them took two thirds of the time in which a small
kernel is compiled."""


def write_entries(program: lir.Program, module: ModuleWriter) -> None:
    """Adds the entries of ``program`` to ``module``."""
    _write_share(program, module)
    _write_worker(module)
    _write_finish(program, module)
    _write_launch(module)


def _word(w: FunctionWriter, number: int, type_: str = "i64") -> str:
    place = w.emit(f"getelementptr inbounds i64, ptr %args, i64 {number}")
    return w.emit(f"load {type_}, ptr {place}")


def _call(w: FunctionWriter, program: lir.Program, function: str, failure: str, block: str, box: list[str]) -> str:
    layout = layout_of(program)
    operands = [f"ptr {failure}", f"i64 {block}", *(f"i64 {bound}" for bound in box)]
    operands += [f"ptr {_word(w, layout.slots + slot.number, 'ptr')}" for slot in program.slots]
    for argument in program.arguments:
        t = ops.memory_type(argument.type)
        operands.append(f"{t} {_word(w, layout.arguments + argument.number, t)}")
    return w.emit(f"call i64 @{function}({', '.join(operands)})")


def _box(w: FunctionWriter, program: lir.Program, block: str) -> list[str]:
    """The bounds of the block's rows: low and high of each dimension."""
    if program.space is lir.Space.LINE:
        low = w.emit(f"mul i64 {block}, {lir.BLOCK_ROWS}")
        end = w.emit(f"add i64 {low}, {lir.BLOCK_ROWS}")
        w.declare("i64 @llvm.smin.i64(i64, i64)")
        return [low, w.emit(f"call i64 @llvm.smin.i64(i64 {end}, i64 {_word(w, ROWS)})")]
    bounds = 2 * program.dimensions
    boxes = _word(w, BOXES, "ptr")
    first = w.emit(f"mul i64 {block}, {bounds}")
    result: list[str] = []
    for number in range(bounds):
        index = w.emit(f"add i64 {first}, {number}")
        result.append(w.emit(f"load i64, ptr {w.emit(f'getelementptr inbounds i64, ptr {boxes}, i64 {index}')}"))
    return result


def _record(w: FunctionWriter, thread: str) -> str:
    offset = w.emit(f"mul i64 {thread}, {FAILURE_WORDS}")
    return w.emit(f"getelementptr inbounds i64, ptr {_word(w, FAILURES, 'ptr')}, i64 {offset}")


def _write_share(program: lir.Program, module: ModuleWriter) -> None:
    """A thread takes a stretch of the items of the wave. Once it has failed, items behind its failure are not run."""
    w = FunctionWriter(module)
    first, last = _wave_items(w, _word(w, WAVE))
    count = w.emit(f"sub i64 {last}, {first}")
    low, high = (_share_start(w, first, count, thread) for thread in ("%thread", w.emit("add i64 %thread, 1")))
    failure, items = _record(w, "%thread"), _word(w, ITEMS, "ptr")
    listed = w.emit(f"icmp ne ptr {items}, null")
    # Where each block is an item, the stretch itself is the one item.
    item_low = w.emit(f"select i1 {listed}, i64 {low}, i64 0")
    item_high = w.emit(f"select i1 {listed}, i64 {high}, i64 1")
    w.branch("items")
    w.start("items")
    item = w.emit(f"phi i64 [ {item_low}, %entry ], [ %next.item, %item.done ]")
    w.branch_if(w.emit(f"icmp ult i64 {item}, {item_high}"), "item", "done")
    w.start("item")
    w.branch_if(listed, "look.up", "bounds")
    w.start("look.up")
    place = w.emit(f"getelementptr inbounds i64, ptr {items}, i64 {w.emit(f'mul i64 {item}, 2')}")
    given = [w.emit(f"load i64, ptr {_next_word(w, place, number)}") for number in range(2)]
    w.branch("bounds")
    w.start("bounds")
    start, stop = (
        w.emit(f"phi i64 [ {whole}, %item ], [ {listed_bound}, %look.up ]")
        for whole, listed_bound in zip((low, high), given, strict=True)
    )
    site = w.emit(f"load i64, ptr {failure}")
    failed_block = w.emit(f"load i64, ptr {_next_word(w, failure, 1)}")
    behind = w.emit(f"icmp uge i64 {start}, {failed_block}")
    over = w.emit(f"and i1 {w.emit(f'icmp ne i64 {site}, 0')}, {behind}")
    w.branch_if(over, "done", "head")
    w.start("head")
    block = w.emit(f"phi i64 [ {start}, %bounds ], [ %next, %turn ]")
    w.branch_if(w.emit(f"icmp ult i64 {block}, {stop}"), "turn", "item.done")
    w.start("turn")
    failed = _call(w, program, BLOCK_FUNCTION, failure, block, _box(w, program, block))
    w.do(f"%next = add i64 {block}, 1")
    w.branch_if(w.emit(f"icmp eq i64 {failed}, 0"), "head", "done")
    w.start("item.done")
    w.do(f"%next.item = add i64 {item}, 1")
    w.branch("items")
    w.start("done")
    _leave(w, program)
    w.finish(f"define void @{SHARE}(ptr %args, i64 %thread, i64 %threads) {_AS_WRITTEN}")


def _leave(w: FunctionWriter, program: lir.Program) -> None:
    """Returns. What has been stored past the cache is there before other threads go on."""
    if program.streams is not None:
        w.do("fence seq_cst")
    w.do("ret void")


def _wave_items(w: FunctionWriter, wave: str) -> tuple[str, str]:
    """The first item of a wave, and the first of the next."""
    starts = w.emit(f"getelementptr inbounds i64, ptr {_word(w, STARTS, 'ptr')}, i64 {wave}")
    first = w.emit(f"load i64, ptr {starts}")
    return first, w.emit(f"load i64, ptr {_next_word(w, starts, 1)}")


def _next_word(w: FunctionWriter, place: str, number: int) -> str:
    return w.emit(f"getelementptr inbounds i64, ptr {place}, i64 {number}")


def _share_start(w: FunctionWriter, first: str, count: str, thread: str) -> str:
    share = w.emit(f"udiv i64 {w.emit(f'mul i64 {count}, {thread}')}, %threads")
    return w.emit(f"add i64 {first}, {share}")


def _write_worker(module: ModuleWriter) -> None:
    w = FunctionWriter(module)
    thread = w.emit(f"call i32 {_word(w, THREAD_NUMBER, 'ptr')}()")
    threads = w.emit(f"call i32 {_word(w, THREAD_COUNT, 'ptr')}()")
    wide = [w.emit(f"zext i32 {number} to i64") for number in (thread, threads)]
    w.do(f"call void @{SHARE}(ptr %args, i64 {wide[0]}, i64 {wide[1]})")
    w.do("ret void")
    w.finish(f"define internal void @ebb.worker(ptr %args) {_AS_WRITTEN}")


def _write_finish(program: lir.Program, module: ModuleWriter) -> None:
    w = FunctionWriter(module)
    _call(w, program, FINISH_FUNCTION, _record(w, "0"), "0", ["0"] * (2 * program.dimensions))
    w.do("ret void")
    w.finish(f"define void @{FINISH}(ptr %args) {_AS_WRITTEN}")


def _write_launch(module: ModuleWriter) -> None:
    """All waves run even after a failure: a later one may hold a row that comes before it."""
    w = FunctionWriter(module)
    threads, waves = _word(w, THREADS), _word(w, WAVES)
    present = w.emit(f"getelementptr inbounds i64, ptr %args, i64 {WAVE}")
    w.declare("i64 @llvm.umin.i64(i64, i64)")
    w.branch("waves")
    w.start("waves")
    wave = w.emit("phi i64 [ 0, %entry ], [ %next.wave, %joined ]")
    w.branch_if(w.emit(f"icmp ult i64 {wave}, {waves}"), "wave", "check")
    w.start("wave")
    w.do(f"store i64 {wave}, ptr {present}")
    first, last = _wave_items(w, wave)
    count = w.emit(f"call i64 @llvm.umin.i64(i64 {threads}, i64 {w.emit(f'sub i64 {last}, {first}')})")
    w.branch_if(w.emit(f"icmp ugt i64 {count}, 1"), "fork", "serial")
    w.start("fork")
    team = w.emit(f"trunc i64 {count} to i32")
    w.do(f"call void {_word(w, FORK, 'ptr')}(ptr @ebb.worker, ptr %args, i32 {team}, i32 0)")
    w.branch("joined")
    w.start("serial")
    w.do(f"call void @{SHARE}(ptr %args, i64 0, i64 1)")
    w.branch("joined")
    w.start("joined")
    w.do(f"%next.wave = add i64 {wave}, 1")
    w.branch("waves")
    w.start("check")
    w.branch("head")
    w.start("head")
    thread = w.emit("phi i64 [ 0, %check ], [ %next, %turn ]")
    w.branch_if(w.emit(f"icmp ult i64 {thread}, {threads}"), "turn", "finish")
    w.start("turn")
    site = w.emit(f"load i64, ptr {_record(w, thread)}")
    w.do(f"%next = add i64 {thread}, 1")
    w.branch_if(w.emit(f"icmp eq i64 {site}, 0"), "head", "failed")
    w.start("finish")
    w.do(f"call void @{FINISH}(ptr %args)")
    w.do("ret i64 0")
    w.start("failed")
    w.do("ret i64 1")
    w.finish(f"define i64 @{LAUNCH}(ptr %args) {_AS_WRITTEN}")
