"""LLVM IR of each LIR operation: tables for the regular ones, a short function for each irregular one.

Every sequence here is total: no operand makes it undefined, so no kernel can trap (``lir`` says what comes out).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from ebb.backends.llvm.hooks import PURE, Hooks
from ebb.backends.llvm.vector_math import VectorForm
from ebb.types.types import Kind, ScalarType


class Writer(Protocol):
    """Where instructions go: a function under construction."""

    @property
    def hooks(self) -> Hooks:
        """What the target wants."""
        ...

    def emit(self, instruction: str) -> str:
        """Appends ``instruction`` and returns the name of its result."""
        ...

    def declare(self, signature: str) -> None:
        """Makes the module declare an external function."""
        ...

    def keep(self, signature: str, name: str) -> None:
        """Makes the module declare an external function that LLVM may come to call."""
        ...

    def define(self, name: str, text: str) -> None:
        """Makes the module define a function of its own."""
        ...


def llvm_type(scalar: ScalarType) -> str:
    """The type of a value: a bool is one bit."""
    if scalar.kind is Kind.BOOL:
        return "i1"
    if scalar.kind is Kind.FLOAT:
        return "float" if scalar.bits == 32 else "double"
    return f"i{scalar.bits}"


def memory_type(scalar: ScalarType) -> str:
    """The type of an element of a slot: a bool is a byte."""
    return "i8" if scalar.kind is Kind.BOOL else llvm_type(scalar)


def literal(value: Any, scalar: ScalarType) -> str:
    """The constant ``value``."""
    if scalar.kind is Kind.BOOL:
        return "true" if value else "false"
    if scalar.kind is Kind.FLOAT:
        number = float(value)
        if scalar.bits == 32:
            number = _round_to_float(number)
        return f"0x{struct.unpack('<Q', struct.pack('<d', number))[0]:016X}"
    bits = int(value) & ((1 << scalar.bits) - 1)
    signed = bits - (1 << scalar.bits) if bits >> (scalar.bits - 1) else bits
    return str(signed)


def _round_to_float(number: float) -> float:
    try:
        return struct.unpack("<f", struct.pack("<f", number))[0]
    except OverflowError:
        return float("inf") if number > 0 else float("-inf")


# ---- Regular operators: operator and kind to instruction. ----

_FLOAT = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
_INTEGER = {"+": "add", "-": "sub", "*": "mul", "&": "and", "|": "or", "^": "xor"}
_MINMAX = {
    Kind.FLOAT: {"min": "llvm.minimum", "max": "llvm.maximum"},
    Kind.SIGNED: {"min": "llvm.smin", "max": "llvm.smax"},
    Kind.UNSIGNED: {"min": "llvm.umin", "max": "llvm.umax"},
}
_COMPARE = {
    Kind.FLOAT: {"==": "oeq", "!=": "une", "<": "olt", "<=": "ole", ">": "ogt", ">=": "oge"},
    Kind.SIGNED: {"==": "eq", "!=": "ne", "<": "slt", "<=": "sle", ">": "sgt", ">=": "sge"},
    Kind.UNSIGNED: {"==": "eq", "!=": "ne", "<": "ult", "<=": "ule", ">": "ugt", ">=": "uge"},
    Kind.BOOL: {"==": "eq", "!=": "ne", "<": "ult", "<=": "ule", ">": "ugt", ">=": "uge"},
}


def unary(w: Writer, op: str, scalar: ScalarType, x: str, flags: str) -> str:
    """``op x``."""
    t = llvm_type(scalar)
    match op:
        case "-" if scalar.kind is Kind.FLOAT:
            return w.emit(f"fneg{flags} {t} {x}")
        case "-":
            return w.emit(f"sub {t} 0, {x}")
        case "not":
            return w.emit(f"xor {t} {x}, true")
        case _:
            return w.emit(f"xor {t} {x}, {'true' if scalar.kind is Kind.BOOL else '-1'}")


def binary(w: Writer, op: str, scalar: ScalarType, a: str, b: str, flags: str) -> str:
    """``a op b``."""
    t = llvm_type(scalar)
    if scalar.kind is Kind.FLOAT and op in _FLOAT:
        return w.emit(f"{_FLOAT[op]}{flags} {t} {a}, {b}")
    if op in ("min", "max"):
        return _min_max(w, op, scalar, a, b, flags)
    if scalar.kind is not Kind.FLOAT and op in _INTEGER:
        return w.emit(f"{_INTEGER[op]} {t} {a}, {b}")
    return _IRREGULAR[op, scalar.kind](w, scalar, a, b)


def regular(op: str, scalar: ScalarType) -> str:
    """The instruction of an arithmetic operator."""
    return (_FLOAT if scalar.kind is Kind.FLOAT else _INTEGER)[op]


def comparison(op: str, scalar: ScalarType) -> str:
    """The instruction of a comparison."""
    return f"{'fcmp' if scalar.kind is Kind.FLOAT else 'icmp'} {_COMPARE[scalar.kind][op]}"


def min_max(op: str, scalar: ScalarType) -> str:
    """The intrinsic of ``min`` or ``max``, without the suffix of the type."""
    return _MINMAX[scalar.kind][op]


def conversion(source: ScalarType, target: ScalarType) -> str:
    """The instruction that converts between numbers, but for floats to integers, which takes an intrinsic."""
    signed = source.kind is Kind.SIGNED
    if target.kind is Kind.FLOAT:
        if source.kind is Kind.FLOAT:
            return "fptrunc" if target.bits < source.bits else "fpext"
        return "sitofp" if signed else "uitofp"
    if source.kind is not Kind.BOOL and target.bits < source.bits:
        return "trunc"
    return "sext" if signed else "zext"


def compare(w: Writer, op: str, scalar: ScalarType, a: str, b: str) -> str:
    """``a op b``, one bit."""
    return w.emit(f"{comparison(op, scalar)} {llvm_type(scalar)} {a}, {b}")


def _min_max(w: Writer, op: str, scalar: ScalarType, a: str, b: str, flags: str) -> str:
    t, intrinsic = llvm_type(scalar), min_max(op, scalar)
    if intrinsic in w.hooks.missing:
        return _ordered_min_max(w, op, t, a, b)
    name = f"{intrinsic}.{_suffix(scalar)}"
    w.declare(f"{t} @{name}({t}, {t})")
    # Which of -0.0 and 0.0 comes out is not fixed, as in NumPy; without nsz that costs instructions.
    extra = f"{flags}{'' if 'nsz' in flags else ' nsz'}" if scalar.kind is Kind.FLOAT else ""
    return w.emit(f"call{extra} {t} @{name}({t} {a}, {t} {b})")


def _ordered_min_max(w: Writer, op: str, t: str, a: str, b: str) -> str:
    """The one of two floats that is less or greater, or the NaN."""
    first = w.emit(f"fcmp {'olt' if op == 'min' else 'ogt'} {t} {a}, {b}")
    not_a_number = w.emit(f"fcmp uno {t} {a}, {a}")
    return w.emit(f"select i1 {w.emit(f'or i1 {first}, {not_a_number}')}, {t} {a}, {t} {b}")


def _suffix(scalar: ScalarType) -> str:
    return f"{'f' if scalar.kind is Kind.FLOAT else 'i'}{scalar.bits}"


# ---- Irregular operators. ----


def _divisor(w: Writer, scalar: ScalarType, b: str) -> tuple[str, str, str]:
    """Whether ``b`` is 0, whether it is -1, and a divisor that cannot trap in its place."""
    t = llvm_type(scalar)
    zero = w.emit(f"icmp eq {t} {b}, 0")
    minus = w.emit(f"icmp eq {t} {b}, -1") if scalar.kind is Kind.SIGNED else "false"
    either = w.emit(f"or i1 {zero}, {minus}")
    return zero, minus, w.emit(f"select i1 {either}, {t} 1, {t} {b}")


def _signs_differ(w: Writer, t: str, remainder: str, divisor: str) -> str:
    mixed = w.emit(f"xor {t} {remainder}, {divisor}")
    negative = w.emit(f"icmp slt {t} {mixed}, 0")
    some = w.emit(f"icmp ne {t} {remainder}, 0")
    return w.emit(f"and i1 {negative}, {some}")


def _signed_floordiv(w: Writer, scalar: ScalarType, a: str, b: str) -> str:
    t = llvm_type(scalar)
    zero, minus, safe = _divisor(w, scalar, b)
    quotient = w.emit(f"sdiv {t} {a}, {safe}")
    remainder = w.emit(f"srem {t} {a}, {safe}")
    down = w.emit(f"sext i1 {_signs_differ(w, t, remainder, safe)} to {t}")
    floored = w.emit(f"add {t} {quotient}, {down}")
    negated = w.emit(f"sub {t} 0, {a}")
    result = w.emit(f"select i1 {minus}, {t} {negated}, {t} {floored}")
    return w.emit(f"select i1 {zero}, {t} 0, {t} {result}")


def _signed_mod(w: Writer, scalar: ScalarType, a: str, b: str) -> str:
    t = llvm_type(scalar)
    _, _, safe = _divisor(w, scalar, b)  # by 0 and by -1 the remainder is that by 1, which is 0
    remainder = w.emit(f"srem {t} {a}, {safe}")
    wrapped = w.emit(f"add {t} {remainder}, {safe}")
    return w.emit(f"select i1 {_signs_differ(w, t, remainder, safe)}, {t} {wrapped}, {t} {remainder}")


def _unsigned_floordiv(w: Writer, scalar: ScalarType, a: str, b: str) -> str:
    t = llvm_type(scalar)
    zero, _, safe = _divisor(w, scalar, b)
    return w.emit(f"select i1 {zero}, {t} 0, {t} {w.emit(f'udiv {t} {a}, {safe}')}")


def _unsigned_mod(w: Writer, scalar: ScalarType, a: str, b: str) -> str:
    t = llvm_type(scalar)
    _, _, safe = _divisor(w, scalar, b)
    return w.emit(f"urem {t} {a}, {safe}")


def _shift(instruction: str, beyond: str | None) -> Callable[[Writer, ScalarType, str, str], str]:
    """A shift; one by the width or more gives ``beyond``, or the shift by the width less one where that is None."""

    def emit(w: Writer, scalar: ScalarType, a: str, b: str) -> str:
        t = llvm_type(scalar)
        much = w.emit(f"icmp uge {t} {b}, {scalar.bits}")
        amount = w.emit(f"select i1 {much}, {t} {scalar.bits - 1}, {t} {b}")
        shifted = w.emit(f"{instruction} {t} {a}, {amount}")
        return shifted if beyond is None else w.emit(f"select i1 {much}, {t} {beyond}, {t} {shifted}")

    return emit


def _float_divmod(w: Writer, scalar: ScalarType, a: str, b: str) -> tuple[str, str]:
    """The floored quotient before it is made whole, and the remainder, as NumPy's ``divmod``; ``b`` is not 0."""
    t = llvm_type(scalar)
    remainder = math(w, "fmod", scalar, (a, b), "")
    quotient = w.emit(f"fdiv {t} {w.emit(f'fsub {t} {a}, {remainder}')}, {b}")
    some = w.emit(f"fcmp une {t} {remainder}, 0.0")
    b_negative, r_negative = (w.emit(f"fcmp olt {t} {x}, 0.0") for x in (b, remainder))
    differ = w.emit(f"and i1 {some}, {w.emit(f'xor i1 {b_negative}, {r_negative}')}")
    moved = w.emit(f"fadd {t} {remainder}, {b}")
    lowered = w.emit(f"fsub {t} {quotient}, 1.0")
    signed_zero = math(w, "copysign", scalar, ("0.0", b), "")
    whole = w.emit(f"select i1 {some}, {t} {remainder}, {t} {signed_zero}")
    return (
        w.emit(f"select i1 {differ}, {t} {lowered}, {t} {quotient}"),
        w.emit(f"select i1 {differ}, {t} {moved}, {t} {whole}"),
    )


def _float_floordiv(w: Writer, scalar: ScalarType, a: str, b: str) -> str:
    t = llvm_type(scalar)
    quotient, _ = _float_divmod(w, scalar, a, b)
    ratio = w.emit(f"fdiv {t} {a}, {b}")
    floored = math(w, "floor", scalar, (quotient,), "")
    far = w.emit(f"fcmp ogt {t} {w.emit(f'fsub {t} {quotient}, {floored}')}, {literal(0.5, scalar)}")
    nearest = w.emit(f"select i1 {far}, {t} {w.emit(f'fadd {t} {floored}, 1.0')}, {t} {floored}")
    some = w.emit(f"fcmp une {t} {quotient}, 0.0")
    signed_zero = math(w, "copysign", scalar, ("0.0", ratio), "")
    result = w.emit(f"select i1 {some}, {t} {nearest}, {t} {signed_zero}")
    by_zero = w.emit(f"fcmp oeq {t} {b}, 0.0")
    return w.emit(f"select i1 {by_zero}, {t} {ratio}, {t} {result}")


def _float_mod(w: Writer, scalar: ScalarType, a: str, b: str) -> str:
    t = llvm_type(scalar)
    _, remainder = _float_divmod(w, scalar, a, b)
    by_zero = w.emit(f"fcmp oeq {t} {b}, 0.0")
    not_a_number = literal(float("nan"), scalar)
    return w.emit(f"select i1 {by_zero}, {t} {not_a_number}, {t} {remainder}")


_IRREGULAR: Mapping[tuple[str, Kind], Callable[[Writer, ScalarType, str, str], str]] = {
    ("//", Kind.SIGNED): _signed_floordiv,
    ("//", Kind.UNSIGNED): _unsigned_floordiv,
    ("//", Kind.FLOAT): _float_floordiv,
    ("%", Kind.SIGNED): _signed_mod,
    ("%", Kind.UNSIGNED): _unsigned_mod,
    ("%", Kind.FLOAT): _float_mod,
    ("<<", Kind.SIGNED): _shift("shl", "0"),
    ("<<", Kind.UNSIGNED): _shift("shl", "0"),
    (">>", Kind.SIGNED): _shift("ashr", None),
    (">>", Kind.UNSIGNED): _shift("lshr", "0"),
}


# ---- Conversions. ----


def convert(w: Writer, source: ScalarType, target: ScalarType, x: str) -> str:
    """``x`` as ``target``: integers wrap, floats to integers truncate and saturate, to bool is ``!= 0``."""
    if source == target:
        return x
    s, t = llvm_type(source), llvm_type(target)
    if target.kind is Kind.BOOL:
        return w.emit(f"fcmp une {s} {x}, 0.0" if source.kind is Kind.FLOAT else f"icmp ne {s} {x}, 0")
    if source.kind is Kind.FLOAT:
        return _from_float(w, source, target, x)
    return x if s == t else w.emit(f"{conversion(source, target)} {s} {x} to {t}")


def _from_float(w: Writer, source: ScalarType, target: ScalarType, x: str) -> str:
    s, t = llvm_type(source), llvm_type(target)
    if target.kind is Kind.FLOAT:
        return w.emit(f"{conversion(source, target)} {s} {x} to {t}")
    instruction = f"fpto{'s' if target.kind is Kind.SIGNED else 'u'}i"
    if f"llvm.{instruction}.sat" in w.hooks.missing:
        return _saturated(w, instruction, source, target, x)
    name = f"llvm.{instruction}.sat.{t}.{_suffix(source)}"
    w.declare(f"{t} @{name}({s})")
    return w.emit(f"call {t} @{name}({s} {x})")


def _saturated(w: Writer, instruction: str, source: ScalarType, target: ScalarType, x: str) -> str:
    """``x``, a float, by an ``instruction`` that is right only for what ``target`` can hold."""
    s, t = llvm_type(source), llvm_type(target)
    signed = target.kind is Kind.SIGNED
    least, beyond = (-(1 << target.bits - 1), 1 << target.bits - 1) if signed else (0, 1 << target.bits)
    above = w.emit(f"fcmp oge {s} {x}, {literal(beyond, source)}")
    below = w.emit(f"fcmp olt {s} {x}, {literal(least, source)}")
    outside = w.emit(f"or i1 {w.emit(f'or i1 {above}, {below}')}, {w.emit(f'fcmp uno {s} {x}, {x}')}")
    inside = w.emit(f"select i1 {outside}, {s} {literal(0.0, source)}, {s} {x}")
    number = w.emit(f"{instruction} {s} {inside} to {t}")
    number = w.emit(f"select i1 {above}, {t} {literal(beyond - 1, target)}, {t} {number}")
    return w.emit(f"select i1 {below}, {t} {literal(least, target)}, {t} {number}")


def to_word(w: Writer, scalar: ScalarType, x: str) -> str:
    """The bits of ``x`` in the low end of 64 bits."""
    t = llvm_type(scalar)
    if scalar.kind is Kind.FLOAT:
        x = w.emit(f"bitcast {t} {x} to i{scalar.bits}")
        t = f"i{scalar.bits}"
    return x if t == "i64" else w.emit(f"zext {t} {x} to i64")


# ---- Functions. ----


def math(
    w: Writer,
    function: str,
    scalar: ScalarType,
    operands: tuple[str, ...],
    flags: str,
    forms: Sequence[VectorForm] = (),
) -> str:
    """A function of ``lir.MATH``, which LLVM may call in one of ``forms`` for several values at once."""
    t = llvm_type(scalar)
    if function not in w.hooks.math and function == "fmod":
        return w.emit(f"frem{flags} {t} {operands[0]}, {operands[1]}")
    if function == "ipow":
        return _integer_power(w, scalar, operands)
    letter = "f" if scalar.bits == 32 else "d"
    name = w.hooks.math[function].format(
        type=_suffix(scalar), suffix=letter.replace("d", ""), operands=letter * len(operands)
    )
    convention, pure = ("", "") if name.startswith("llvm.") else (w.hooks.convention, PURE)
    w.declare(f"{convention}{t} @{name}({', '.join([t] * len(operands))}){pure}")
    for form in forms:
        wide = f"<{form.lanes} x {t}>"
        w.keep(f"{wide} @{form.symbol}({', '.join([wide] * form.operands)}){PURE}", form.symbol)
    variants = ",".join(form.variant(name) for form in forms)
    attribute = f' "vector-function-abi-variant"="{variants}"' if forms else ""
    return w.emit(f"call{flags} {convention}{t} @{name}({', '.join(f'{t} {x}' for x in operands)}){attribute}")


def _integer_power(w: Writer, scalar: ScalarType, operands: tuple[str, ...]) -> str:
    t = llvm_type(scalar)
    name = f"ebb.ipow.{scalar.name}"
    template = _SIGNED_POWER if scalar.kind is Kind.SIGNED else ""
    negative = template.format(t=t) or "  br label %start\n"
    w.define(name, _POWER.format(name=name, t=t, negative=negative, convention=w.hooks.convention))
    return w.emit(f"call {w.hooks.convention}{t} @{name}({t} {operands[0]}, {t} {operands[1]})")


_SIGNED_POWER = """\
  %below = icmp slt {t} %e, 0
  br i1 %below, label %truncated, label %start
truncated:
  %is1 = icmp eq {t} %b, 1
  %is-1 = icmp eq {t} %b, -1
  %low = and {t} %e, 1
  %odd = icmp ne {t} %low, 0
  %alternating = select i1 %odd, {t} -1, {t} 1
  %other = select i1 %is-1, {t} %alternating, {t} 0
  %inverse = select i1 %is1, {t} 1, {t} %other
  ret {t} %inverse
"""

_POWER = """\
define internal {convention}{t} @{name}({t} %b, {t} %e) alwaysinline nounwind willreturn memory(none) {{
entry:
{negative}\
start:
  br label %head
head:
  %square = phi {t} [ %b, %start ], [ %nextsquare, %turn ]
  %rest = phi {t} [ %e, %start ], [ %nextrest, %turn ]
  %product = phi {t} [ 1, %start ], [ %nextproduct, %turn ]
  %done = icmp eq {t} %rest, 0
  br i1 %done, label %end, label %turn
turn:
  %bit = and {t} %rest, 1
  %take = icmp ne {t} %bit, 0
  %multiplied = mul {t} %product, %square
  %nextproduct = select i1 %take, {t} %multiplied, {t} %product
  %nextsquare = mul {t} %square, %square
  %nextrest = lshr {t} %rest, 1
  br label %head
end:
  ret {t} %product
}}
"""
