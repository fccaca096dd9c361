"""LLVM IR of operations on all lanes of a strip at once; the scalar forms are in ``ops``."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ebb.backends.llvm import ops
from ebb.backends.llvm.hooks import PURE
from ebb.backends.llvm.transpose import LANES
from ebb.backends.llvm.writer import FunctionWriter
from ebb.compiler import lir
from ebb.records import record
from ebb.types.arithmetic import identity_of
from ebb.types.types import Kind, ScalarType, bool_

MASK = f"<{LANES} x i1>"
NUMBERS = f"<{', '.join(f'i32 {k}' for k in range(LANES))}>"
"""The lanes' own numbers."""

NUMBERS_64 = f"<{', '.join(f'i64 {k}' for k in range(LANES))}>"
"""The same as int64."""

_BITWISE = {"&": "and", "|": "or", "^": "xor"}
_REDUCTIONS = {
    Kind.FLOAT: {"+": "fadd", "*": "fmul", "min": "fminimum", "max": "fmaximum"},
    Kind.SIGNED: {"+": "add", "*": "mul", "min": "smin", "max": "smax"} | _BITWISE,
    Kind.UNSIGNED: {"+": "add", "*": "mul", "min": "umin", "max": "umax"} | _BITWISE,
    Kind.BOOL: _BITWISE,
}


def wide(element: str) -> str:
    """The type of a vector of ``element``."""
    return f"<{LANES} x {element}>"


def wide_type(scalar: ScalarType) -> str:
    """The type of the lanes of ``scalar``."""
    return wide(ops.llvm_type(scalar))


def suffix(scalar: ScalarType) -> str:
    """How intrinsics name the lanes of ``scalar``."""
    match scalar.kind:
        case Kind.FLOAT:
            return f"v{LANES}f{scalar.bits}"
        case Kind.BOOL:
            return f"v{LANES}i1"
        case _:
            return f"v{LANES}i{scalar.bits}"


def identity(op: str, scalar: ScalarType) -> str:
    """Lanes that change nothing under ``op``."""
    # -0.0, for 0.0 would make 0.0 of a sum that is -0.0.
    plus = op == "+" and scalar.kind is Kind.FLOAT
    neutral = -0.0 if plus else identity_of("+" if op == "-" else op, scalar.dtype).item()
    return f"splat ({ops.llvm_type(scalar)} {ops.literal(neutral, scalar)})"


@record
class LaneWriter:
    """Emits vector instructions into a function.

    Attributes:
        w: the function.
        flags: the fast-math flags of arithmetic.
    """

    w: FunctionWriter
    flags: str

    def broadcast(self, element: str, x: str) -> str:
        """``x`` in every lane."""
        one = self.w.emit(f"insertelement {wide(element)} poison, {element} {x}, i64 0")
        return self.w.emit(
            f"shufflevector {wide(element)} {one}, {wide(element)} poison, <{LANES} x i32> zeroinitializer"
        )

    def extract(self, element: str, x: str, k: int) -> str:
        """Lane ``k``."""
        return self.w.emit(f"extractelement {wide(element)} {x}, i64 {k}")

    def select(self, mask: str, scalar: ScalarType, then: str, other: str) -> str:
        """Lane by lane ``then`` or ``other``."""
        t = wide_type(scalar)
        return self.w.emit(f"select {MASK} {mask}, {t} {then}, {t} {other}")

    def inverted(self, mask: str) -> str:
        """The other lanes."""
        return self.w.emit(f"xor {MASK} {mask}, splat (i1 true)")

    def both(self, left: str, right: str) -> str:
        """The lanes in both masks."""
        return self.w.emit(f"and {MASK} {left}, {right}")

    def any(self, mask: str) -> str:
        """Whether the mask has some lane."""
        return self.reduce("|", bool_, mask)

    def operation(self, operation: lir.Operation, scalar: ScalarType, value: Callable[[lir.Value], str]) -> str:
        """What a calculation gives in each lane; ``value`` names the vectors of its operands."""
        match operation:
            case lir.Unary(op, operand):
                return self.unary(op, scalar, value(operand))
            case lir.Binary(op, left, right):
                return self.binary(op, scalar, value(left), value(right))
            case lir.Compare(op, left, right):
                return self.compare(op, left.type, value(left), value(right))
            case lir.Select(condition, then, other):
                return self.select(value(condition), scalar, value(then), value(other))
            case lir.Convert(operand):
                return self.convert(operand.type, scalar, value(operand))
            case lir.Math(function, operands):
                return self.math(function, scalar, [value(operand) for operand in operands])
            case _:
                raise AssertionError(operation)

    def unary(self, op: str, scalar: ScalarType, x: str) -> str:
        """``op x``."""
        t = wide_type(scalar)
        match op:
            case "-" if scalar.kind is Kind.FLOAT:
                return self.w.emit(f"fneg{self.flags} {t} {x}")
            case "-":
                return self.w.emit(f"sub {t} zeroinitializer, {x}")
            case _:
                ones = "true" if scalar.kind is Kind.BOOL else "-1"
                return self.w.emit(f"xor {t} {x}, splat ({ops.llvm_type(scalar)} {ones})")

    def binary(self, op: str, scalar: ScalarType, a: str, b: str, flags: str | None = None) -> str:
        """``a op b``, under other flags where they are given."""
        t, flags = wide_type(scalar), self.flags if flags is None else flags
        if op in ("min", "max"):
            return self.call(ops.min_max(op, scalar), scalar, (a, b), f"{flags}{'' if 'nsz' in flags else ' nsz'}")
        return self.w.emit(f"{ops.regular(op, scalar)}{flags if scalar.kind is Kind.FLOAT else ''} {t} {a}, {b}")

    def compare(self, op: str, scalar: ScalarType, a: str, b: str) -> str:
        """``a op b``, a mask."""
        return self.w.emit(f"{ops.comparison(op, scalar)} {wide_type(scalar)} {a}, {b}")

    def convert(self, source: ScalarType, target: ScalarType, x: str) -> str:
        """``x`` as ``target``; see ``ops.convert``."""
        s, t = wide_type(source), wide_type(target)
        if source == target or (s == t and target.kind is not Kind.FLOAT):
            return x
        if target.kind is Kind.BOOL:
            return self.w.emit(f"{'fcmp une' if source.kind is Kind.FLOAT else 'icmp ne'} {s} {x}, zeroinitializer")
        if source.kind is Kind.FLOAT and target.kind is not Kind.FLOAT:
            name = f"llvm.fpto{'s' if target.kind is Kind.SIGNED else 'u'}i.sat.{suffix(target)}.{suffix(source)}"
            self.w.declare(f"{t} @{name}({s})")
            return self.w.emit(f"call {t} @{name}({s} {x})")
        return self.w.emit(f"{ops.conversion(source, target)} {s} {x} to {t}")

    def math(self, function: str, scalar: ScalarType, operands: Sequence[str]) -> str:
        """A function of ``lir.MATH``: an intrinsic, or one that the target has for all lanes."""
        for form in self.w.hooks.vector_math.get((function, scalar.bits), ()):
            if form.lanes == LANES:
                t = wide_type(scalar)
                self.w.declare(f"{t} @{form.symbol}({', '.join([t] * len(operands))}){PURE}")
                return self.w.emit(f"call{self.flags} {t} @{form.symbol}({', '.join(f'{t} {x}' for x in operands)})")
        return self.call(self.w.hooks.math[function].removesuffix(".{type}"), scalar, operands, self.flags)

    def call(self, intrinsic: str, scalar: ScalarType, operands: Sequence[str], flags: str) -> str:
        """An intrinsic without the suffix of its type, of ``operands``."""
        t, name = wide_type(scalar), f"{intrinsic}.{suffix(scalar)}"
        self.w.declare(f"{t} @{name}({', '.join([t] * len(operands))})")
        extra = flags if scalar.kind is Kind.FLOAT else ""
        return self.w.emit(f"call{extra} {t} @{name}({', '.join(f'{t} {x}' for x in operands)})")

    def reduce(self, op: str, scalar: ScalarType, lanes: str) -> str:
        """All lanes under ``op``: a scalar."""
        t, lane_type = ops.llvm_type(scalar), wide_type(scalar)
        name = f"llvm.vector.reduce.{_REDUCTIONS[scalar.kind][op]}.{suffix(scalar)}"
        if scalar.kind is Kind.FLOAT and op in ("+", "*"):
            first = ops.literal(-0.0 if op == "+" else 1.0, scalar)
            self.w.declare(f"{t} @{name}({t}, {lane_type})")
            return self.w.emit(f"call reassoc {t} @{name}({t} {first}, {lane_type} {lanes})")
        self.w.declare(f"{t} @{name}({lane_type})")
        return self.w.emit(f"call {t} @{name}({lane_type} {lanes})")
