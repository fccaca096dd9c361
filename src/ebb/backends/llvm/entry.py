"""The entries of a kernel's module: the loop over some of its blocks, and what finishes a launch.

They know the argument block (``layout``) and nothing of what the kernel computes. The driver calls them (``driver``).
"""

from __future__ import annotations

from ebb.backends.llvm import ops
from ebb.backends.llvm.layout import layout_of
from ebb.backends.llvm.writer import FunctionWriter, ModuleWriter
from ebb.compiler import lir
from ebb.runtime.cpu import BLOCK_ENTRY, BOXES, FAILURES, FINISH_ENTRY, ROWS

BLOCK_FUNCTION, FINISH_FUNCTION = "ebb.block", "ebb.finish"

AS_WRITTEN = "nounwind noinline optnone"
"""Attributes of the entries and of the driver. They run once a block, or a launch: to optimise them takes several times
as long as to compile them, and saves nothing that can be measured."""


def write_entries(program: lir.Program, module: ModuleWriter) -> None:
    """Adds the entries of ``program`` to ``module``."""
    _write_blocks(program, module)
    _write_finish(program, module)


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


def _write_blocks(program: lir.Program, module: ModuleWriter) -> None:
    """A thread runs the blocks from one on, up to another; once a row has failed none of those that are left."""
    w = FunctionWriter(module)
    w.branch("head")
    w.start("head")
    block = w.emit("phi i64 [ %first, %entry ], [ %next, %turn ]")
    w.branch_if(w.emit(f"icmp ult i64 {block}, %end"), "turn", "done")
    w.start("turn")
    failed = _call(w, program, BLOCK_FUNCTION, "%failure", block, _box(w, program, block))
    w.do(f"%next = add i64 {block}, 1")
    w.branch_if(w.emit(f"icmp eq i64 {failed}, 0"), "head", "done")
    w.start("done")
    result = w.emit("phi i64 [ 0, %head ], [ 1, %turn ]")
    w.do(f"ret i64 {result}")
    w.finish(f"define i64 @{BLOCK_ENTRY}(ptr %args, ptr %failure, i64 %first, i64 %end) {AS_WRITTEN}")


def _write_finish(program: lir.Program, module: ModuleWriter) -> None:
    w = FunctionWriter(module)
    if program.finish:
        bounds = ["0"] * (2 * program.dimensions)
        _call(w, program, FINISH_FUNCTION, _word(w, FAILURES, "ptr"), "0", bounds)
    w.do("ret void")
    w.finish(f"define void @{FINISH_ENTRY}(ptr %args) {AS_WRITTEN}")
