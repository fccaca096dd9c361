"""What operators and conversions compute, on NumPy scalars and small arrays of exactly the types of ``rules``.

This is the one definition of the language's arithmetic: the reference interpreter runs it, constants are folded by it,
and compiled code is tested against it. float32 stays float32, integers wrap. NumPy's floating-point warnings are the
caller's to silence (``np.errstate(all="ignore")``): in a kernel a division by zero is a value, not an event.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import numpy as np

from ebb.types.types import Kind, ScalarType, Type

_python: Any = operator  # the stubs of both leave most results unknown
_where: Any = np.where


def power(base: Any, exponent: Any) -> Any:
    """``base ** exponent``. An integer to a negative power is the exact value truncated: 1, -1 or 0."""
    if base.dtype.kind == "f":
        # NumPy takes the square root for an exponent of 0.5 that is a scalar, which differs at -0 and -infinity.
        return np.power(np.atleast_1d(base), np.atleast_1d(exponent)).reshape(np.shape(base))[()]
    if base.dtype.kind != "i" or not np.any(exponent < 0):
        return np.power(base, exponent)
    one = base.dtype.type(1)
    alternating = _where(exponent & one, -one, one)
    truncated = _where(base == 1, one, _where(base == -1, alternating, 0 * one))
    result = _where(exponent < 0, truncated, np.power(base, np.maximum(exponent, 0 * one)))
    return result[()]


UNARY: Mapping[str, Callable[[Any], Any]] = {
    "-": _python.neg,
    "~": _python.invert,
    "not": np.logical_not,
}

BINARY: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": _python.add,
    "-": _python.sub,
    "*": _python.mul,
    "/": _python.truediv,
    "//": _python.floordiv,
    "%": _python.mod,
    "**": power,
    "&": _python.and_,
    "|": _python.or_,
    "^": _python.xor,
    "<<": _python.lshift,
    ">>": _python.rshift,
    "min": np.minimum,
    "max": np.maximum,
}

COMPARE: Mapping[str, Callable[[Any, Any], Any]] = {
    "==": _python.eq,
    "!=": _python.ne,
    "<": _python.lt,
    "<=": _python.le,
    ">": _python.gt,
    ">=": _python.ge,
}


def convert(value: Any, target: Type) -> Any:
    """``value`` with elements of ``target``, repeated where ``value`` is a scalar and ``target`` is not.

    Floats to integers truncate and saturate, NaN gives 0. Integers to narrower ones wrap. Numbers to bool are ``!= 0``.
    """
    dtype = target.dtype
    array = np.asarray(value)
    if isinstance(target.scalar, ScalarType) and array.dtype != dtype:
        if target.scalar.kind is Kind.BOOL:
            array = np.not_equal(array, 0)
        elif array.dtype.kind == "f" and target.scalar.kind is not Kind.FLOAT:
            array = _saturate(array, dtype)
        else:
            array = array.astype(dtype)
    return array[()] if array.shape == target.shape else np.full(target.shape, array, dtype)


def dot(left: Any, right: Any) -> Any:
    """The sum of the products of the components, added from the first to the last."""
    return reduce(operator.add, left * right)


def matmul(left: Any, right: Any) -> Any:
    """``left @ right`` of vectors and matrices, each component a ``dot``."""
    match left.ndim, right.ndim:
        case 1, 1:
            return dot(left, right)
        case 2, 1:
            return np.array([dot(row, right) for row in left])
        case 1, _:
            return np.array([dot(left, column) for column in right.T])
        case _:
            return np.array([[dot(row, column) for column in right.T] for row in left])


def identity_of(op: str, dtype: np.dtype[Any]) -> Any:
    """The value that changes nothing under the reduction ``op`` (``+ * min max & | ^``) of elements of ``dtype``."""
    match op:
        case "+" | "|" | "^":
            return dtype.type(0)
        case "*":
            return dtype.type(1)
        case "&":
            return np.bool_(True) if dtype.kind == "b" else ~dtype.type(0)
        case _:
            info = np.iinfo(dtype) if dtype.kind in "iu" else None
            lowest, highest = (info.min, info.max) if info is not None else (-np.inf, np.inf)
            return dtype.type(highest if op == "min" else lowest)


def _saturate(array: Any, dtype: np.dtype[Any]) -> Any:
    info = np.iinfo(dtype)
    whole = np.trunc(np.nan_to_num(array, nan=0.0, posinf=np.inf, neginf=-np.inf))
    low, high = whole <= float(info.min), whole >= float(info.max)
    inside = _where(low | high, 0, whole).astype(dtype)
    return _where(low, dtype.type(info.min), _where(high, dtype.type(info.max), inside))
