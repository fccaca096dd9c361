"""Which types operators take and give, and which types widen to which.

Every rule is a function of types alone. It returns what the operands must be converted to and the type of the result,
or a ``Mismatch`` that says what is wrong; nothing here raises. To convert a scalar operand to a vector or matrix is to
cast it to the element type and to repeat it in every component.
"""

from __future__ import annotations

from enum import Enum

from ebb.records import record
from ebb.types.types import (
    Element,
    KeyType,
    Kind,
    MatrixType,
    ScalarType,
    Type,
    VectorType,
    bool_,
    float64,
    int32,
    int64,
    shaped_type,
    with_scalar,
)


class Reason(Enum):
    """Why an operator does not take its operands."""

    SHAPES = "shapes"
    KEYS = "keys"
    RELATIONS = "relations"
    BOOLS = "bools"
    SIGNS = "signs"
    INTEGERS = "integers"
    BITS = "bits"
    ORDER = "order"
    CONDITION = "condition"
    PRODUCT = "product"


_TEXTS: dict[Reason, str] = {
    Reason.SHAPES: "'{op}' takes operands of one shape, or a scalar and any shape, not {left} and {right}",
    Reason.KEYS: "keys have no arithmetic: '{op}' does not take {operands}",
    Reason.RELATIONS: "'{op}' compares keys of one relation, not {left} and {right}",
    Reason.BOOLS: "'{op}' takes numbers, and a bool is none: {operands}",
    Reason.SIGNS: "'{op}' does not mix signed and unsigned integers: {left} and {right}",
    Reason.INTEGERS: "'{op}' takes integers, not {operands}",
    Reason.BITS: "'{op}' takes two integers or two bools, not {operands}",
    Reason.ORDER: "{operands} have no order: only '==' and '!=' compare them",
    Reason.CONDITION: "'{op}' takes a bool, not {operands}",
    Reason.PRODUCT: "the shapes of {left} '{op}' {right} do not fit: the inner extents differ",
}

_HINTS: dict[Reason, str] = {
    Reason.BOOLS: "convert the bool: ebb.int32(x), or ebb.select(x, a, b)",
    Reason.SIGNS: "convert one of them: ebb.int64(x)",
    Reason.INTEGERS: "convert to an integer: ebb.int32(x)",
    Reason.ORDER: "compare ebb.id(k), or convert bools: ebb.int32(b)",
    Reason.CONDITION: "compare (x != 0), or reduce a vector with ebb.all(v) or ebb.any(v)",
}


@record
class Mismatch:
    """Why ``op`` does not take ``left`` (and ``right``, None where it has one operand)."""

    reason: Reason
    op: str
    left: Type
    right: Type | None = None

    @property
    def text(self) -> str:
        """The fact in one clause, without a full stop."""
        operands = f"{self.left!r}" if self.right is None else f"{self.left!r} and {self.right!r}"
        return _TEXTS[self.reason].format(op=self.op, left=self.left, right=self.right, operands=operands)

    @property
    def hint(self) -> str | None:
        """What to do about it, where one thing helps in most cases."""
        return _HINTS.get(self.reason)


@record
class OperatorTypes:
    """The types to convert the operands to, and the type of the result.

    ``left`` and ``right`` are equal but for ``@``.
    """

    left: Type
    right: Type
    result: Type


ARITHMETIC = ("+", "-", "*", "/", "//", "%", "**", "min", "max")
BITWISE = ("&", "|", "^")
SHIFTS = ("<<", ">>")
EQUALITIES = ("==", "!=")
ORDERINGS = ("<", "<=", ">", ">=")


def is_number(shaped: Type) -> bool:
    """Whether the elements are integers or floats."""
    return isinstance(shaped.scalar, ScalarType) and shaped.scalar.kind is not Kind.BOOL


def is_integer(shaped: Type) -> bool:
    """Whether the elements are signed or unsigned integers."""
    return isinstance(shaped.scalar, ScalarType) and shaped.scalar.kind in (Kind.SIGNED, Kind.UNSIGNED)


def is_float(shaped: Type) -> bool:
    """Whether the elements are floats."""
    return isinstance(shaped.scalar, ScalarType) and shaped.scalar.kind is Kind.FLOAT


def is_bool(shaped: Type) -> bool:
    """Whether the elements are bools."""
    return shaped.scalar == bool_


def is_key(shaped: Type) -> bool:
    """Whether the elements are keys."""
    return isinstance(shaped.scalar, KeyType)


# ---- Coercion ----


def common_element(a: Element, b: Element) -> Element | None:
    """The element type to which both widen without a cast, or None."""
    if a == b:
        return a
    if not (isinstance(a, ScalarType) and isinstance(b, ScalarType)) or Kind.BOOL in (a.kind, b.kind):
        return None
    if a.kind is b.kind:
        return a if a.bits > b.bits else b
    if Kind.FLOAT in (a.kind, b.kind):
        return a if a.kind is Kind.FLOAT else b
    return None


def widens(source: Type, target: Type) -> bool:
    """Whether a value of ``source`` becomes one of ``target``, of the same shape, without a cast."""
    return source.shape == target.shape and common_element(source.scalar, target.scalar) == target.scalar


def broadcast_shape(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...] | None:
    """The shape of an elementwise operation: equal shapes, or a scalar with any; None if they do not fit."""
    if a == b or not b:
        return a
    return b if not a else None


def floating(element: ScalarType) -> ScalarType:
    """The type in which functions of real numbers compute: floats stay, integers become float64."""
    return element if element.kind is Kind.FLOAT else float64


def castable(source: Type, target: Type) -> bool:
    """Whether ``target(x)`` converts a ``source``: numbers and bools, of one shape or from a scalar."""
    if is_key(source) or is_key(target):
        return source == target
    return source.shape in ((), target.shape)


# ---- Weak Python numbers (NumPy's NEP 50) ----


def weak_element(number: bool | int | float, other: Element) -> ScalarType | None:
    """The type a Python number takes beside a value of ``other``, or None if it takes none (a bool, a key).

    An integer takes the number type beside it, a float the float type beside it and float64 beside integers.
    """
    if not isinstance(other, ScalarType):
        return None
    if isinstance(number, bool) or other.kind is Kind.BOOL:
        return bool_ if isinstance(number, bool) and other.kind is Kind.BOOL else None
    return floating(other) if isinstance(number, float) else other


def lone_type(number: bool | int | float) -> ScalarType:
    """The type of a Python number by itself: bool_, int32 (int64 if it does not fit), float64."""
    if isinstance(number, bool):
        return bool_
    if isinstance(number, float):
        return float64
    return int32 if fits(number, int32) else int64


def fits(number: int, target: ScalarType) -> bool:
    """Whether a Python integer is in the range of the number type ``target``."""
    match target.kind:
        case Kind.SIGNED:
            return -(2 ** (target.bits - 1)) <= number < 2 ** (target.bits - 1)
        case Kind.UNSIGNED:
            return 0 <= number < 2**target.bits
        case Kind.FLOAT:
            return True
        case Kind.BOOL:
            return False


# ---- Operators ----


def unary_type(op: str, operand: Type) -> Type | Mismatch:
    """The type of ``op operand`` for ``-``, ``+`` (numbers), ``~`` (integers), ``not`` (a bool)."""
    if op == "not":
        return bool_ if operand == bool_ else Mismatch(Reason.CONDITION, op, operand)
    if is_key(operand):
        return Mismatch(Reason.KEYS, op, operand)
    if op == "~":
        return operand if is_integer(operand) else Mismatch(Reason.INTEGERS, op, operand)
    return operand if is_number(operand) else Mismatch(Reason.BOOLS, op, operand)


def binary_type(op: str, left: Type, right: Type) -> OperatorTypes | Mismatch:
    """The types of ``left op right`` for ``+ - * / // % ** min max & | ^ << >> @``."""
    if is_key(left) or is_key(right):
        return Mismatch(Reason.KEYS, op, left, right)
    if op == "@":
        return matmul_type(left, right)
    if left == right and op in ARITHMETIC and is_number(left) and (op != "/" or is_float(left)):
        return OperatorTypes(left, left, left)  # which most are
    complaint = _element_mismatch(op, left, right)
    if complaint is not None:
        return Mismatch(complaint, op, left, right)
    element = common_element(left.scalar, right.scalar)
    if not isinstance(element, ScalarType):
        return Mismatch(Reason.SIGNS, op, left, right)
    return _elementwise(op, left, right, floating(element) if op == "/" else element)


def compare_type(op: str, left: Type, right: Type) -> OperatorTypes | Mismatch:
    """The types of ``left op right`` for ``== != < <= > >=``; the result has bools of the broadcast shape."""
    if is_key(left) and is_key(right) and left.scalar != right.scalar:
        return Mismatch(Reason.RELATIONS, op, left, right)
    if is_key(left) != is_key(right):
        return Mismatch(Reason.KEYS, op, left, right)
    if is_bool(left) != is_bool(right):
        return Mismatch(Reason.BOOLS, op, left, right)
    if op in ORDERINGS and not is_number(left):
        return Mismatch(Reason.ORDER, op, left, right)
    element = common_element(left.scalar, right.scalar)
    if element is None:
        return Mismatch(Reason.SIGNS, op, left, right)
    types = _elementwise(op, left, right, element)
    if isinstance(types, Mismatch):
        return types
    return OperatorTypes(types.left, types.right, with_scalar(types.result, bool_))


def matmul_type(left: Type, right: Type) -> OperatorTypes | Mismatch:
    """The types of ``left @ right`` for vectors and matrices of numbers; two vectors give their dot product."""
    if not (is_number(left) and is_number(right)):
        return Mismatch(Reason.KEYS if is_key(left) or is_key(right) else Reason.BOOLS, "@", left, right)
    if not left.shape or not right.shape or left.shape[-1] != right.shape[0]:
        return Mismatch(Reason.PRODUCT if left.shape and right.shape else Reason.SHAPES, "@", left, right)
    element = common_element(left.scalar, right.scalar)
    if element is None:
        return Mismatch(Reason.SIGNS, "@", left, right)
    result = shaped_type(element, left.shape[:-1] + right.shape[1:])
    return OperatorTypes(with_scalar(left, element), with_scalar(right, element), result)


def reduce_mismatch(op: str, place: Type, value: Type) -> Mismatch | None:
    """Why ``place op= value`` is no reduction (``+ * min max`` on numbers, ``& | ^`` on integers and bools), or None.

    That the value also has to widen to the place's type is left to the caller, who reports it as for an assignment.
    """
    if is_key(place) or is_key(value):
        return Mismatch(Reason.KEYS, op, place, value)
    complaint = _element_mismatch(op, place, value)
    return None if complaint is None else Mismatch(complaint, op, place, value)


def condition_mismatch(construct: str, condition: Type) -> Mismatch | None:
    """Why ``condition`` cannot decide ``if``, ``while``, ``and``, ``or``, ``assert``: it must be one bool."""
    return None if condition == bool_ else Mismatch(Reason.CONDITION, construct, condition)


def _element_mismatch(op: str, left: Type, right: Type) -> Reason | None:
    if op in BITWISE:
        both = (is_integer(left) and is_integer(right)) or (is_bool(left) and is_bool(right))
        return None if both else Reason.BITS
    if op in SHIFTS:
        return None if is_integer(left) and is_integer(right) else Reason.INTEGERS
    return None if is_number(left) and is_number(right) else Reason.BOOLS


def _elementwise(op: str, left: Type, right: Type, element: Element) -> OperatorTypes | Mismatch:
    shape = broadcast_shape(left.shape, right.shape)
    if shape is None:
        return Mismatch(Reason.SHAPES, op, left, right)
    operand = shaped_type(element, shape)
    return OperatorTypes(operand, operand, operand)


def is_square(shaped: Type) -> bool:
    """Whether the type is a matrix of as many rows as columns."""
    return isinstance(shaped, MatrixType) and shaped.rows == shaped.cols


def is_vector(shaped: Type) -> bool:
    """Whether the type is a vector."""
    return isinstance(shaped, VectorType)
