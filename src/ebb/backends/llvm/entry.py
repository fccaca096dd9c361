"""The entries of a module: loops over blocks, and the fork into threads.

They know the argument block (``layout``) and nothing of what the kernel computes.
"""

from __future__ import annotations

from ebb.backends.llvm import ops
from ebb.backends.llvm.layout import layout_of
from ebb.backends.llvm.writer import FunctionWriter, ModuleWriter
from ebb.compiler import lir
from ebb.runtime.cpu import (
    BLOCKS,
    BOXES,
    FAILURE_WORDS,
    FAILURES,
    FINISH,
    FORK,
    LAUNCH,
    ROWS,
    SHARE,
    THREAD_COUNT,
    THREAD_NUMBER,
    THREADS,
)

BLOCK_FUNCTION, FINISH_FUNCTION = "ebb.block", "ebb.finish"


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
    """A thread's blocks are a stretch of all blocks, so its first failure is its first in the order of rows."""
    w = FunctionWriter(module)
    blocks = _word(w, BLOCKS)
    first = w.emit(f"udiv i64 {w.emit(f'mul i64 {blocks}, %thread')}, %threads")
    following = w.emit("add i64 %thread, 1")
    last = w.emit(f"udiv i64 {w.emit(f'mul i64 {blocks}, {following}')}, %threads")
    failure = _record(w, "%thread")
    w.branch("head")
    w.start("head")
    block = w.emit(f"phi i64 [ {first}, %entry ], [ %next, %turn ]")
    w.branch_if(w.emit(f"icmp ult i64 {block}, {last}"), "turn", "done")
    w.start("turn")
    failed = _call(w, program, BLOCK_FUNCTION, failure, block, _box(w, program, block))
    w.do(f"%next = add i64 {block}, 1")
    w.branch_if(w.emit(f"icmp eq i64 {failed}, 0"), "head", "done")
    w.start("done")
    w.do("ret void")
    w.finish(f"define void @{SHARE}(ptr %args, i64 %thread, i64 %threads) nounwind")


def _write_worker(module: ModuleWriter) -> None:
    w = FunctionWriter(module)
    thread = w.emit(f"call i32 {_word(w, THREAD_NUMBER, 'ptr')}()")
    threads = w.emit(f"call i32 {_word(w, THREAD_COUNT, 'ptr')}()")
    wide = [w.emit(f"zext i32 {number} to i64") for number in (thread, threads)]
    w.do(f"call void @{SHARE}(ptr %args, i64 {wide[0]}, i64 {wide[1]})")
    w.do("ret void")
    w.finish("define internal void @ebb.worker(ptr %args) nounwind")


def _write_finish(program: lir.Program, module: ModuleWriter) -> None:
    w = FunctionWriter(module)
    _call(w, program, FINISH_FUNCTION, _record(w, "0"), "0", ["0"] * (2 * program.dimensions))
    w.do("ret void")
    w.finish(f"define void @{FINISH}(ptr %args) nounwind")


def _write_launch(module: ModuleWriter) -> None:
    w = FunctionWriter(module)
    threads = _word(w, THREADS)
    w.branch_if(w.emit(f"icmp ugt i64 {threads}, 1"), "fork", "serial")
    w.start("fork")
    count = w.emit(f"trunc i64 {threads} to i32")
    w.do(f"call void {_word(w, FORK, 'ptr')}(ptr @ebb.worker, ptr %args, i32 {count}, i32 0)")
    w.branch("check")
    w.start("serial")
    w.do(f"call void @{SHARE}(ptr %args, i64 0, i64 1)")
    w.branch("check")
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
    w.finish(f"define i64 @{LAUNCH}(ptr %args) nounwind")
