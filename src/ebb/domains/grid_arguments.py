"""What a grid is made from: checked, and the same for each dimension."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

import ebb
from ebb.domains.errors_grid import BadGridArgument, BadGridExtent, BadGridShape, BoundaryTooDeep
from ebb.errors import RelationError
from ebb.records import record


@record(eq=False)
class Geometry:
    """Where a grid lies.

    Attributes:
        shape: the number of cells in each dimension.
        origin: the lower corner of the domain.
        extent: the lengths of its sides.
        periodic: for each dimension, whether it wraps.
        depth: of the boundary, in cells; 0 in periodic dimensions.
        precision: the type of positions, float32 or float64.
    """

    shape: tuple[int, ...]
    origin: tuple[float, ...]
    extent: tuple[float, ...]
    periodic: tuple[bool, ...]
    depth: tuple[int, ...]
    precision: Any

    @property
    def ndim(self) -> int:
        """The number of dimensions."""
        return len(self.shape)

    @property
    def spacing(self) -> tuple[float, ...]:
        """The lengths of the sides of a cell."""
        return tuple(length / count for length, count in zip(self.extent, self.shape, strict=True))


def check_geometry(
    grid: str, ndim: int, shape: Any, origin: Any, extent: Any, periodic: Any, depth: Any, precision: Any
) -> Geometry:
    """What the arguments of a ``grid`` of ``ndim`` dimensions mean.

    Raises:
        RelationError: they mean none (E530 to E533).
    """
    counts = _shape(grid, ndim, shape)
    if precision not in (ebb.float32, ebb.float64):
        expected = "ebb.float32 or ebb.float64"
        raise RelationError(BadGridArgument(grid, "precision", expected, repr(precision)))
    corner = _each(grid, "origin", "finite number", ndim, origin, _as_number)
    sides = _each(grid, "extent", "finite number", ndim, counts if extent is None else extent, _as_number)
    wraps = _each(grid, "periodic", "bool", ndim, periodic, _as_bool)
    geometry = Geometry(counts, corner, sides, wraps, _depth(grid, counts, wraps, depth), precision)
    _check_extent(grid, geometry)
    return geometry


def _shape(grid: str, ndim: int, shape: Any) -> tuple[int, ...]:
    found = tuple(_as_count(count) for count in _items(shape) or (shape,))
    good = tuple(count for count in found if count is not None and count >= 1)
    if len(good) < len(found) or len(found) != ndim:
        raise RelationError(BadGridShape(grid, ndim, repr(shape)))
    return good


def _depth(grid: str, shape: tuple[int, ...], periodic: tuple[bool, ...], depth: Any) -> tuple[int, ...]:
    found = _each(grid, "boundary_depth", "count of layers", len(shape), depth, _as_depth)
    for axis, (layers, cells) in enumerate(zip(found, shape, strict=True)):
        if layers > cells and not periodic[axis]:
            raise RelationError(BoundaryTooDeep(grid, axis, layers, cells))
    return tuple(0 if wraps else layers for layers, wraps in zip(found, periodic, strict=True))


def _check_extent(grid: str, geometry: Geometry) -> None:
    for axis, (start, length, cells) in enumerate(zip(geometry.origin, geometry.extent, geometry.shape, strict=True)):
        if length <= 0:
            raise RelationError(BadGridExtent(grid, axis, length, "it is not positive"))
        dtype = np.dtype(geometry.precision.dtype)
        with np.errstate(over="ignore"):
            ends = np.array([start, start + length], dtype)
        if not np.isfinite(ends).all():
            raise RelationError(BadGridExtent(grid, axis, length, f"it goes beyond the range of {dtype.name}"))
        if length / cells < np.spacing(np.abs(ends).max()):
            reason = f"its {cells} cells are too small to tell their corners apart in {dtype.name}"
            raise RelationError(BadGridExtent(grid, axis, length, reason))


def _each(grid: str, argument: str, what: str, ndim: int, value: Any, take: Callable[[Any], Any]) -> tuple[Any, ...]:
    """``value`` for each dimension, as ``take`` reads it; one value stands for all."""
    given = _items(value) or (value,) * ndim
    found = tuple(take(item) for item in given)
    if len(found) != ndim or None in found:
        expected = f"a {what}" if ndim == 1 else f"a {what}, or one for each of {ndim} dimensions"
        raise RelationError(BadGridArgument(grid, argument, expected, repr(value)))
    return found


def _items(value: Any) -> tuple[Any, ...]:
    """The items of a sequence or array, none of anything else."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(cast("Sequence[Any]", value))
    return tuple(value) if isinstance(value, np.ndarray) and value.ndim else ()  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]


def _as_count(value: Any) -> int | None:
    if isinstance(value, bool | np.bool_):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def _as_depth(value: Any) -> int | None:
    count = _as_count(value)
    return count if count is not None and count >= 0 else None


def _as_bool(value: Any) -> bool | None:
    return bool(value) if isinstance(value, bool | np.bool_) else None  # pyright: ignore[reportUnknownArgumentType]


def _as_number(value: Any) -> float | None:
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        return None
    try:
        number = float(cast("float", value))
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
