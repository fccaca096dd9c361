"""Signatures of builtins: from the types of the arguments to what they are converted to and what comes out."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import TypeAlias

from ebb.records import record
from ebb.types import small_matrix
from ebb.types.rules import (
    Mismatch,
    broadcast_shape,
    common_element,
    floating,
    is_bool,
    is_integer,
    is_key,
    is_number,
    is_square,
    is_vector,
    matmul_type,
)
from ebb.types.types import (
    Element,
    MatrixType,
    ScalarType,
    Type,
    VectorType,
    bool_,
    int64,
    shaped_type,
    with_scalar,
)


@record
class Signature:
    """The types to convert the arguments to, and the type of the result.

    An argument that is a scalar where its type here is not is repeated in every component.
    """

    arguments: tuple[Type, ...]
    result: Type


@record
class Complaint:
    """Why a builtin does not take its arguments; ``argument`` counts from 0, None where all are concerned."""

    text: str
    argument: int | None = None
    hint: str | None = None


Rule: TypeAlias = "Callable[[tuple[Type, ...]], Signature | Complaint]"


def numbers(types: tuple[Type, ...]) -> Signature | Complaint:
    """Elementwise on numbers of a common type, which is the result's: ``abs``, ``min``, ``clamp``."""
    complaint = _not_numbers(types)
    return complaint or _broadcast(types, lambda element: element)


def reals(types: tuple[Type, ...]) -> Signature | Complaint:
    """Elementwise on floats; integers become float64: ``sqrt``, ``atan2``."""
    complaint = _not_numbers(types)
    return complaint or _broadcast(types, floating)


def predicate(types: tuple[Type, ...]) -> Signature | Complaint:
    """Elementwise from a float to a bool: ``isnan``."""
    signature = reals(types)
    if isinstance(signature, Complaint):
        return signature
    return Signature(signature.arguments, with_scalar(signature.result, bool_))


def to_integer(types: tuple[Type, ...]) -> Signature | Complaint:
    """Elementwise from a float to int64, as Python's ``round`` and ``math.floor``; integers stay as they are."""
    complaint = _not_numbers(types)
    if complaint is not None:
        return complaint
    (x,) = types
    return Signature(types, x if is_integer(x) else with_scalar(x, int64))


def select(types: tuple[Type, ...]) -> Signature | Complaint:
    """A bool or a shape of bools, then two values of one type; the result has the shape of them all."""
    condition, then, other = types
    if not is_bool(condition):
        return Complaint(f"the condition is a bool or a vector of bools, not {condition!r}", 0, "compare: x != 0")
    element = common_element(then.scalar, other.scalar)
    if element is None:
        return Complaint(f"{then!r} and {other!r} have no common type", 2, "convert one of them to the other's type")
    shape = _common_shape(types)
    if shape is None:
        return _shapes(types)
    value = shaped_type(element, shape)
    return Signature((with_scalar(value, bool_) if condition.shape else bool_, value, value), value)


def dot(types: tuple[Type, ...]) -> Signature | Complaint:
    """Two vectors of numbers of one length to a scalar of their common type."""
    signature = _two_vectors(types)
    if isinstance(signature, Complaint):
        return signature
    return Signature(signature.arguments, signature.result.scalar)


def cross(types: tuple[Type, ...]) -> Signature | Complaint:
    """Two vectors of three numbers to a third."""
    for position, argument in enumerate(types):
        if argument.shape != (3,):
            return Complaint(f"takes vectors of 3 components, not {argument!r}", position)
    return _two_vectors(types)


def length(types: tuple[Type, ...]) -> Signature | Complaint:
    """A vector of numbers to a float."""
    signature = normalize(types)
    if isinstance(signature, Complaint):
        return signature
    return Signature(signature.arguments, signature.result.scalar)


def normalize(types: tuple[Type, ...]) -> Signature | Complaint:
    """A vector of numbers to a vector of floats."""
    (v,) = types
    return _not_vectors(types) or reals((v,))


def outer(types: tuple[Type, ...]) -> Signature | Complaint:
    """Two vectors of numbers, of any lengths, to a matrix."""
    complaint = _not_vectors(types)
    if complaint is not None:
        return complaint
    a, b = types
    element = common_element(a.scalar, b.scalar)
    if element is None:
        return _signs(types)
    return Signature((with_scalar(a, element), with_scalar(b, element)), MatrixType(element, a.size, b.size))


def transpose(types: tuple[Type, ...]) -> Signature | Complaint:
    """A matrix of anything with rows and columns exchanged."""
    (m,) = types
    if not isinstance(m, MatrixType):
        return Complaint(f"takes a matrix, not {m!r}", 0)
    return Signature(types, MatrixType(m.scalar, m.cols, m.rows))


def trace(types: tuple[Type, ...]) -> Signature | Complaint:
    """A square matrix of numbers to a scalar of its type."""
    (m,) = types
    if not is_square(m) or not is_number(m):
        return Complaint(f"takes a square matrix of numbers, not {m!r}", 0)
    return Signature(types, m.scalar)


def determinant(types: tuple[Type, ...]) -> Signature | Complaint:
    """A square matrix of numbers, up to 4 x 4, to a float."""
    signature = inverse(types)
    if isinstance(signature, Complaint):
        return signature
    return Signature(signature.arguments, signature.result.scalar)


def inverse(types: tuple[Type, ...]) -> Signature | Complaint:
    """A square matrix of numbers, up to 4 x 4, to one of floats."""
    (m,) = types
    if not is_square(m) or not is_number(m) or m.shape[0] > small_matrix.LARGEST:
        return Complaint(f"takes a square matrix of numbers, at most 4 x 4, not {m!r}", 0)
    return reals(types)


def matmul(types: tuple[Type, ...]) -> Signature | Complaint:
    """The operator ``@``."""
    left, right = types
    operator = matmul_type(left, right)
    if isinstance(operator, Mismatch):
        return Complaint(operator.text, None, operator.hint)
    return Signature((operator.left, operator.right), operator.result)


def bools(types: tuple[Type, ...]) -> Signature | Complaint:
    """A bool, or a vector or matrix of bools, to one bool."""
    (x,) = types
    if not is_bool(x):
        return Complaint(f"takes bools, not {x!r}", 0, "compare: v != 0")
    return Signature(types, bool_)


def constants_only(types: tuple[Type, ...]) -> Signature | Complaint:
    """For builtins whose arguments are types and sizes, never values."""
    del types
    return Complaint("takes types and sizes that are known when the kernel is compiled")


def _not_numbers(types: tuple[Type, ...]) -> Complaint | None:
    for position, argument in enumerate(types):
        if is_key(argument):
            return Complaint(f"takes numbers, and keys have no arithmetic: {argument!r}", position)
        if not is_number(argument):
            return Complaint(f"takes numbers, and a bool is none: {argument!r}", position, "convert it: ebb.int32(x)")
    return None


def _not_vectors(types: tuple[Type, ...]) -> Complaint | None:
    for position, argument in enumerate(types):
        if not is_vector(argument):
            return Complaint(f"takes a vector, not {argument!r}", position)
    return _not_numbers(types)


def _two_vectors(types: tuple[Type, ...]) -> Signature | Complaint:
    complaint = _not_vectors(types)
    if complaint is not None:
        return complaint
    a, b = types
    if a.shape != b.shape:
        return Complaint(f"takes two vectors of one length, not {a!r} and {b!r}")
    element = common_element(a.scalar, b.scalar)
    if element is None:
        return _signs(types)
    operand = VectorType(element, a.size)
    return Signature((operand, operand), operand)


def _broadcast(types: tuple[Type, ...], result: Callable[[ScalarType], ScalarType]) -> Signature | Complaint:
    element = _common(types)
    if not isinstance(element, ScalarType):
        return _signs(types)
    shape = _common_shape(types)
    if shape is None:
        return _shapes(types)
    operand = shaped_type(result(element), shape)
    return Signature((operand,) * len(types), operand)


def _common(types: tuple[Type, ...]) -> Element | None:
    def widen(a: Element | None, b: Element) -> Element | None:
        return None if a is None else common_element(a, b)

    return reduce(widen, (argument.scalar for argument in types[1:]), types[0].scalar)


def _common_shape(types: tuple[Type, ...]) -> tuple[int, ...] | None:
    def widen(a: tuple[int, ...] | None, b: tuple[int, ...]) -> tuple[int, ...] | None:
        return None if a is None else broadcast_shape(a, b)

    return reduce(widen, (argument.shape for argument in types[1:]), types[0].shape)


def _signs(types: tuple[Type, ...]) -> Complaint:
    return Complaint(f"does not mix signed and unsigned integers: {_listed(types)}", None, "convert one: ebb.int64(x)")


def _shapes(types: tuple[Type, ...]) -> Complaint:
    return Complaint(f"takes arguments of one shape, or scalars, not {_listed(types)}")


def _listed(types: tuple[Type, ...]) -> str:
    return " and ".join((", ".join(map(repr, types[:-1])), repr(types[-1])))
