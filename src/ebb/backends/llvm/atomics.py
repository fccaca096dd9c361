"""Updates of a place that several threads may make at once: an instruction where LLVM has it, else a loop."""

from __future__ import annotations

from collections.abc import Mapping

from ebb.backends.llvm import ops
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


def update(w: FunctionWriter, op: str, scalar: ScalarType, place: str, value: str) -> None:
    """``*place = *place op value`` at once; ``place`` points to an element of a slot."""
    instruction = _INSTRUCTIONS[scalar.kind].get(op)
    if instruction is None:
        _exchange(w, op, scalar, place, value)
        return
    memory = ops.memory_type(scalar)
    if memory != ops.llvm_type(scalar):
        value = w.emit(f"zext i1 {value} to {memory}")
    w.do(f"atomicrmw {instruction} ptr {place}, {memory} {value} monotonic")


def _exchange(w: FunctionWriter, op: str, scalar: ScalarType, place: str, value: str) -> None:
    """Computes the new value from the one that was seen, until nobody has changed it meanwhile."""
    t, bits = ops.llvm_type(scalar), f"i{scalar.bits}"
    before, turn, done = w.label, w.fresh("exchange"), w.fresh("exchanged")
    first = w.emit(f"load atomic {bits}, ptr {place} monotonic, align {scalar.bits // 8}")
    seen = f"%{w.fresh('seen')}"
    w.branch(turn)
    w.start(turn)
    old = w.emit(f"phi {bits} [ {first}, %{before} ], [ {seen}, %{turn} ]")
    present = old if t == bits else w.emit(f"bitcast {bits} {old} to {t}")
    new = ops.binary(w, op, scalar, present, value, "")
    stored = new if t == bits else w.emit(f"bitcast {t} {new} to {bits}")
    pair = w.emit(f"cmpxchg weak ptr {place}, {bits} {old}, {bits} {stored} monotonic monotonic")
    w.do(f"{seen} = extractvalue {{ {bits}, i1 }} {pair}, 0")
    w.branch_if(w.emit(f"extractvalue {{ {bits}, i1 }} {pair}, 1"), done, turn)
    w.start(done)
