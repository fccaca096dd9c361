"""Updates of a place that several threads may make at once: an instruction where the target has it, else a loop."""

from __future__ import annotations

from collections.abc import Mapping

from ebb.backends.llvm import ops
from ebb.backends.llvm.hooks import Hooks
from ebb.backends.llvm.writer import FunctionWriter
from ebb.types.types import Kind, ScalarType

_BITS = {"&": "and", "|": "or", "^": "xor"}
_SIGNED = {**_BITS, "+": "add", "min": "min", "max": "max"}

_INSTRUCTIONS: Mapping[Kind, Mapping[str, str]] = {
    Kind.BOOL: _BITS,
    Kind.SIGNED: _SIGNED,
    Kind.UNSIGNED: {**_SIGNED, "min": "umin", "max": "umax"},
    Kind.FLOAT: {"+": "fadd"},
}
"""Those of ``atomicrmw``. Its ``fmin`` and ``fmax`` lose NaN, which the language keeps."""

_WORD_BYTES = 4


def scope(w: FunctionWriter) -> str:
    """The scope of an atomic operation, before its order."""
    return w.hooks.groups.scope if w.hooks.groups else ""


def update(w: FunctionWriter, op: str, scalar: ScalarType, place: str, value: str) -> None:
    """``*place = *place op value`` at once; ``place`` is a pointer, with its type, to an element of a slot."""
    instruction = _instruction(w.hooks, op, scalar)
    if instruction is None:
        _exchange(w, op, scalar, place, value)
        return
    memory = ops.memory_type(scalar)
    if memory != ops.llvm_type(scalar):
        value = w.emit(f"zext i1 {value} to {memory}")
    if w.hooks.groups and w.hooks.groups.atomic_bits > scalar.bits:
        place, value = _widened(w, op, place, value)
        memory = f"i{8 * _WORD_BYTES}"
    w.do(f"atomicrmw {instruction} {place}, {memory} {value}{scope(w)} monotonic")


def _instruction(hooks: Hooks, op: str, scalar: ScalarType) -> str | None:
    lacks = hooks.groups and scalar.kind is Kind.FLOAT and scalar.bits not in hooks.groups.float_adds
    return None if lacks else _INSTRUCTIONS[scalar.kind].get(op)


def _widened(w: FunctionWriter, op: str, place: str, value: str) -> tuple[str, str]:
    """The aligned word around a byte, and what changes of the word that byte alone, by an operator of bits."""
    pointer = place.rpartition(" ")[0]
    number = w.emit(f"and i64 {w.emit(f'ptrtoint {place} to i64')}, {_WORD_BYTES - 1}")
    word = w.emit(f"getelementptr i8, {place}, i64 {w.emit(f'sub i64 0, {number}')}")
    shift = w.emit(f"trunc i64 {w.emit(f'shl i64 {number}, 3')} to i32")
    wide = w.emit(f"shl i32 {w.emit(f'zext i8 {value} to i32')}, {shift}")
    if op == "&":
        others = w.emit(f"xor i32 {w.emit(f'shl i32 255, {shift}')}, -1")
        wide = w.emit(f"or i32 {wide}, {others}")
    return f"{pointer} {word}", wide


def _exchange(w: FunctionWriter, op: str, scalar: ScalarType, place: str, value: str) -> None:
    """Computes the new value from the one that was seen, until nobody has changed it meanwhile."""
    t, bits, order = ops.llvm_type(scalar), f"i{scalar.bits}", f"{scope(w)} monotonic"
    before, turn, done = w.label, w.fresh("exchange"), w.fresh("exchanged")
    first = w.emit(f"load atomic {bits}, {place}{order}, align {scalar.bits // 8}")
    seen = f"%{w.fresh('seen')}"
    w.branch(turn)
    w.start(turn)
    old = w.emit(f"phi {bits} [ {first}, %{before} ], [ {seen}, %{turn} ]")
    present = old if t == bits else w.emit(f"bitcast {bits} {old} to {t}")
    new = ops.binary(w, op, scalar, present, value, "")
    stored = new if t == bits else w.emit(f"bitcast {t} {new} to {bits}")
    pair = w.emit(f"cmpxchg weak {place}, {bits} {old}, {bits} {stored}{order} monotonic")
    w.do(f"{seen} = extractvalue {{ {bits}, i1 }} {pair}, 0")
    w.branch_if(w.emit(f"extractvalue {{ {bits}, i1 }} {pair}, 1"), done, turn)
    w.start(done)
