"""The parameters of a launch: their types, and their values as uniforms."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from ebb.compiler.host import HostValue, describe, evaluate
from ebb.compiler.launch_errors import ArgumentType, UniformFailed
from ebb.errors import KernelTypeError
from ebb.types.types import (
    KeyType,
    Kind,
    ScalarType,
    Type,
    bool_,
    float32,
    float64,
    from_dtype,
    int32,
    int64,
    shaped_type,
)

_INT32 = range(-(2**31), 2**31)
_INT64 = range(-(2**63), 2**63)


def argument_type(value: Any) -> Type | None:
    """The type of a bare parameter's value: Python numbers as NumPy would take them, arrays by their dtype.

    Returns:
        None where the language has no type for the value.
    """
    match value:
        case bool():
            return bool_
        case int():
            return int32 if value in _INT32 else int64 if value in _INT64 else None
        case float():
            return float64
        case np.generic() | np.ndarray() | list() | tuple():
            return _array_type(_as_array(cast("Any", value)), narrow=isinstance(value, list | tuple))
        case _:
            return None


def check_argument(kernel: str, name: str, value: Any, declared: Type) -> None:
    """Checks that ``value`` may stand for a parameter of the type ``declared``.

    Raises:
        KernelTypeError: it is of another shape, or of a kind that does not widen to the declared one.
    """
    array = _as_array(value)
    scalar = declared.scalar
    fits = (
        array is not None
        and isinstance(scalar, ScalarType)
        and array.dtype.kind in _ACCEPTED[scalar.kind]
        and array.shape in ((), declared.shape)
        and (array.dtype.kind not in "iuO" or scalar.kind is Kind.FLOAT or _in_range(array, scalar))
    )
    if not fits:
        raise KernelTypeError(ArgumentType(kernel, name, value, declared))


def uniform_values(kernel: str, uniforms: tuple[HostValue, ...], parameters: tuple[Any, ...]) -> tuple[Any, ...]:
    """Evaluates the uniforms of a kernel for one launch, each a NumPy scalar or array of its type.

    Raises:
        KernelTypeError: a value does not fit its type.
    """
    return tuple([uniform_value(kernel, uniform, parameters) for uniform in uniforms])


def uniform_value(kernel: str, uniform: HostValue, parameters: tuple[Any, ...]) -> Any:
    """Evaluates one uniform of a kernel: a NumPy scalar or array of its type.

    Raises:
        KernelTypeError: the value does not fit its type.
    """
    target = uniform.type
    assert not isinstance(target.scalar, KeyType), "a uniform is no key"
    try:
        value = evaluate(uniform.expr, parameters)
    except (ArithmeticError, AttributeError, LookupError, NameError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise KernelTypeError(UniformFailed(kernel, describe(uniform.expr), reason)) from error
    try:
        if not target.shape and (target != float32 or abs(value) <= _LARGEST_FLOAT32):
            return target.dtype.type(value)
        with np.errstate(over="ignore"):  # beyond its range float32 is infinite, as it is for literals
            array = np.asarray(value, dtype=target.dtype)
        return np.broadcast_to(array, target.shape)[()]
    except (OverflowError, ValueError, TypeError) as error:
        reason = f"{value!r} is no {target!r}"
        raise KernelTypeError(UniformFailed(kernel, describe(uniform.expr), reason)) from error


_ACCEPTED = {Kind.BOOL: "b", Kind.SIGNED: "iuO", Kind.UNSIGNED: "iuO", Kind.FLOAT: "iufO"}
"""The kinds of arrays that each kind of type takes. ``_as_array`` makes object arrays of Python integers alone."""

_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def _as_array(value: Any) -> np.ndarray[Any, Any] | None:
    """``value`` as an array, None where it is none. Python integers that share no NumPy type are kept as they are."""
    try:
        array = np.asarray(value)
        if array.dtype.kind in "iub" or not isinstance(value, int | list | tuple):
            return array if array.dtype != object else None
        exact = np.asarray(cast("Any", value), dtype=object)
    except ValueError:  # a ragged list
        return None
    if all(type(item) is int for item in exact.flat):
        return exact
    return array if array.dtype != object else None


def _array_type(array: np.ndarray[Any, Any] | None, narrow: bool) -> Type | None:
    """The type of an array; ``narrow`` gives the Python integers of a list int32 where they fit."""
    scalar = None if array is None else from_dtype(array.dtype)
    if array is None or scalar is None:
        return None
    if narrow and scalar == int64 and _in_range(array, int32):
        scalar = int32
    return shaped_type(scalar, array.shape) if array.ndim <= 2 and array.size else None


def _in_range(array: np.ndarray[Any, Any], scalar: ScalarType) -> bool:
    limits = np.iinfo(scalar.dtype)
    return array.size == 0 or (int(array.min()) >= limits.min and int(array.max()) <= limits.max)
