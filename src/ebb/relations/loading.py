"""From what users load to what fields hold: shapes, kinds and ranges are checked here, before anything is changed.

The shape of a value decides what it is, never a guess: ``Place.shapes`` lists what fits. What would lose data is
refused: numbers as bools and bools as numbers, floats as integers, numbers out of range. Floats may lose precision, as
NumPy users expect of a float64 array that goes into a float32 one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import product
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np

from ebb.errors import RelationError
from ebb.records import record
from ebb.relations.errors import KeyOutOfRange, Row, ValueOutOfRange, WrongKind, WrongShape
from ebb.runtime.buffer import Array
from ebb.types.types import KeyType, Kind, ScalarType, Type

if TYPE_CHECKING:
    import numpy.typing as npt

    from ebb.relations.relation import Relation

Masked: TypeAlias = "np.ma.MaskedArray[Any, np.dtype[Any]]"


@record
class Place:
    """What a value is loaded into: its name for messages, its type, and the shape of its rows (() for a global)."""

    name: str
    type: Type
    rows: tuple[int, ...]

    @property
    def component_shape(self) -> tuple[int, ...]:
        """The shape of one scalar or key: keys of a grid are index tuples."""
        target = target_of(self.type)
        return (target.ndim,) if target is not None and target.is_grid else ()

    @property
    def value_shape(self) -> tuple[int, ...]:
        """The shape of the value of one row."""
        return self.type.shape + self.component_shape

    @property
    def full_shape(self) -> tuple[int, ...]:
        """The shape of the values of all rows."""
        return self.rows + self.value_shape

    def shapes(self) -> tuple[tuple[str, tuple[int, ...]], ...]:
        """The shapes that the place takes, each with what a value of that shape is."""
        found = [("for its value" if not self.rows else "for one value in every row", self.value_shape)]
        if self.type.shape:
            found.insert(0, ("for one number in every component", self.component_shape))
        if self.rows:
            found.append(("for a value a row", self.full_shape))
        return tuple(found)

    def misfit(self, shape: tuple[int, ...] | None, row: Row | None = None) -> RelationError:
        """The error of a value of this shape, None for a ragged one."""
        return RelationError(WrongShape(self.name, repr(self.type), shape, self.shapes(), row))


def target_of(type_: Type) -> Relation | None:
    """The relation that keys of ``type_`` refer to, None where it is no type of keys."""
    return cast("Relation", type_.scalar.target) if isinstance(type_.scalar, KeyType) else None


def converted(value: Any, place: Place) -> Array:
    """``value`` as what ``place`` holds: its dtype, keys as positions.

    Returns:
        An array of the shape ``place.rows + place.type.shape`` in the order of identities, or a constant of the shape
        ``place.type.shape`` or ``()``. Keys that are masked, as ``numpy.ma`` has it, are unset: -1.

    Raises:
        RelationError: the shape or the kind of the value does not fit, or a number or key is out of range.
    """
    # NumPy imports its masked arrays when they are first asked for, which takes longer than a launch may take.
    if "numpy.ma" in sys.modules and isinstance(value, np.ma.MaskedArray):
        return _masked_keys(cast("Masked", value), place)
    array = _as_array(value, place)
    if all(array.shape != shape for _, shape in place.shapes()):
        raise place.misfit(array.shape)
    scalar = place.type.scalar
    if isinstance(scalar, KeyType):
        return _keys(array, place, cast("Relation", scalar.target))
    return _numbers(array, place, scalar)


def called_by_row(function: Callable[..., Any], place: Place) -> Any:
    """The values of ``function`` at the indices of each row, as an array of ``place.full_shape``.

    Where the value of a row is one number, it fills every component.

    Raises:
        RelationError: a value is of a shape that does not fit.
    """
    values: list[Array] = []
    for index in product(*map(range, place.rows)):
        value = _as_array(function(*index), place, index)
        if value.shape == place.component_shape and place.type.shape:
            value = np.broadcast_to(value, place.value_shape)
        if value.shape != place.value_shape:
            raise place.misfit(value.shape, index)
        values.append(value)
    return np.array(values).reshape(place.full_shape) if values else np.zeros(place.full_shape, place.type.dtype)


def _as_array(value: Any, place: Place, row: Row | None = None) -> Array:
    try:
        return np.asarray(value)
    except ValueError:  # a ragged sequence
        raise place.misfit(None, row) from None


def _numbers(array: Array, place: Place, scalar: ScalarType) -> Array:
    kind = _kind(array)
    if array.size == 0:
        return array.astype(scalar.dtype)
    if scalar.kind is Kind.BOOL or kind == "b":
        if scalar.kind is not Kind.BOOL or kind != "b":
            raise _wrong_kind(array, place, kind)
        return array
    if scalar.kind is Kind.FLOAT and kind in "if":
        return _floats(array, place, scalar)
    if kind == "i":
        return _integers(array, place, scalar)
    raise _wrong_kind(array, place, kind)


def _floats(array: Array, place: Place, scalar: ScalarType) -> Array:
    with np.errstate(over="ignore"):
        result = array.astype(scalar.dtype, copy=False)
    if result is not array and not np.isfinite(result).all():
        lost = np.isinf(result) & ~np.isinf(array.astype(np.longdouble))
        if lost.any():
            index = _first(lost)
            raise RelationError(ValueOutOfRange(place.name, repr(scalar), _row(index, array, place), str(array[index])))
    return result


def _integers(array: Array, place: Place, scalar: ScalarType) -> Array:
    limits = np.iinfo(scalar.dtype)
    if array.dtype != scalar.dtype and (array.min() < limits.min or array.max() > limits.max):
        index = _first(np.asarray((array < limits.min) | (array > limits.max)))
        raise RelationError(ValueOutOfRange(place.name, repr(scalar), _row(index, array, place), str(array[index])))
    return array.astype(scalar.dtype, copy=False)


def _keys(array: Array, place: Place, target: Relation) -> Array:
    if array.size == 0:
        shape = array.shape[:-1] if target.is_grid else array.shape
        return np.zeros(shape, place.type.dtype)
    kind = _kind(array)
    if kind != "i":
        raise _wrong_kind(array, place, kind)
    if not target.is_grid and array.dtype != object and array.min() >= 0 and array.max() < target.size:
        # What is nearly always so, and then there may be many: no arrays besides.
        return target.storage.positions_of(array).astype(place.type.dtype, copy=False)
    extents = np.array(target.shape) if target.is_grid else target.size
    bad = np.asarray((array < 0) | (array >= extents))
    if bad.any():
        index = _first(np.asarray(bad.any(axis=-1)) if target.is_grid else bad)
        shown = str(tuple(array[index].tolist()) if target.is_grid else array[index])
        raise RelationError(KeyOutOfRange(place.name, _row(index, array, place), shown, target.name, target.shape))
    if target.is_grid:
        rows = np.ravel_multi_index(tuple(np.moveaxis(array.astype(np.int64, copy=False), -1, 0)), target.shape)
        return np.asarray(rows).astype(place.type.dtype)
    return target.storage.positions_of(array.astype(np.int64, copy=False)).astype(place.type.dtype, copy=False)


def _masked_keys(array: Masked, place: Place) -> Array:
    target = target_of(place.type)
    if target is None:
        raise RelationError(WrongKind(place.name, repr(place.type), "masked values, which only keys have", None, None))
    mask = np.ma.getmaskarray(array)
    if target.size == 0 and mask.all() and any(array.shape == shape for _, shape in place.shapes()):
        return np.full_like(mask[..., 0] if target.is_grid else mask, -1, dtype=place.type.dtype)
    keys = converted(array.filled(0), place).copy()
    keys[mask.any(axis=-1) if target.is_grid else mask] = -1
    return keys


_KINDS = {"b": "bools", "i": "integers", "f": "floats", "c": "complex numbers", "U": "strings", "S": "bytes"}
_KIND_OF = {"b": "b", "i": "i", "u": "i", "f": "f", "c": "c", "U": "U", "S": "S"}


def _kind(array: Array) -> str:
    """The letter in ``_KINDS`` of the array's kind, "?" for what has none."""
    if array.dtype == object and all(isinstance(item, int) for item in array.flat):
        return "i"  # Python integers that NumPy has no type for
    return _KIND_OF.get(array.dtype.kind, "?")


def _wrong_kind(array: Array, place: Place, kind: str) -> RelationError:
    row, shown, hint = None, None, None
    scalar = place.type.scalar
    if kind == "f" and array.size:
        hint = "convert them, and say how: np.rint(x).astype(int)"
        misfits = ~(np.isfinite(array) & (array == np.rint(array)))
        if misfits.any():
            index = _first(misfits)
            row, shown = _row(index, array, place), str(array[index])
    elif kind == "b":
        hint = "convert them: x.astype(int)"
    elif isinstance(scalar, ScalarType) and scalar.kind is Kind.BOOL and kind in "if":
        hint = "compare them: x != 0"
    described = _KINDS.get(kind, f"values of the dtype {array.dtype}")
    return RelationError(WrongKind(place.name, repr(place.type), described, row, shown, hint))


def _first(mask: npt.NDArray[np.bool_]) -> tuple[int, ...]:
    """The index of the first entry that holds, in row-major order."""
    return tuple(int(i) for i in np.unravel_index(int(mask.argmax()), mask.shape))


def _row(index: tuple[int, ...], array: Array, place: Place) -> Row | None:
    """The row in which ``index`` lies, None in a constant."""
    return index[: len(place.rows)] if place.rows and array.ndim == len(place.full_shape) else None
