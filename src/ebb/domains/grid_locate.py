"""Which cell of a grid contains a point, in kernels and for whole fields."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import ebb
from ebb.domains.errors_grid import CannotLocate
from ebb.domains.grid_arguments import Geometry
from ebb.errors import RelationError

_FARTHEST = 2.0**62
"""How many cells from the origin a point may lie in a periodic dimension: its index is computed in 64 bits."""


class LocatedRelation(ebb.Relation):
    """The cells of a grid, or of its dual: the rows contain points.

    In kernels ``c.local(pos)`` is where a point lies in ``c``: in each dimension 0 at its lower end and 1 at its upper.

    Attributes:
        locate: a function for kernels: the cell that contains a point.
    """

    __slots__ = ("_place", "locate")

    def __init__(self, name: str, shape: tuple[int, ...], geometry: Geometry, first: tuple[float, ...]) -> None:
        """Cells of a grid whose first one begins ``first`` cells from the origin."""
        super().__init__(name, shape=shape, periodic=geometry.periodic)
        self.locate: Callable[[Any], Any] = _locator(self, geometry, first)
        self._place = _placer(self.locate)
        self.member("local")(_local(geometry, first))

    def point_locate(self, key_field: ebb.Field, pos_field: ebb.Field) -> None:
        """Sets each key to the cell that contains the position: periodic dimensions wrap, the others clamp.

        A point where cells meet belongs to the upper one. Points outside of a dimension that is not periodic belong to
        the outermost cells.

        Args:
            key_field: a field with keys of this relation.
            pos_field: a field of the same relation as the keys, with vectors of float32 or float64.

        Raises:
            RelationError: the fields are not such.
            KernelAssertionError: a position is not a number; the error names the row.
        """
        for name, field in (("key_field", key_field), ("pos_field", pos_field)):
            if not isinstance(field, ebb.Field):  # pyright: ignore[reportUnnecessaryIsInstance]
                raise RelationError(CannotLocate(self.name, f"takes a field as {name}, not {field!r}"))
        if key_field.relation is not pos_field.relation:
            complaint = f"takes two fields of one relation, not '{key_field.path}' and '{pos_field.path}'"
            raise RelationError(CannotLocate(self.name, complaint))
        if key_field.type != self.key_type:
            complaint = f"takes keys of '{self.name}', and '{key_field.path}' is of {key_field.type!r}"
            raise RelationError(CannotLocate(self.name, complaint))
        if pos_field.type not in (ebb.vector(ebb.float32, self.ndim), ebb.vector(ebb.float64, self.ndim)):
            complaint = f"takes vectors of {self.ndim} floats, and '{pos_field.path}' is of {pos_field.type!r}"
            raise RelationError(CannotLocate(self.name, complaint))
        self._place(key_field.relation, key_field.name, pos_field.name)


def _locator(target: ebb.Relation, geometry: Geometry, first: tuple[float, ...]) -> Callable[[Any], Any]:
    """The function that gives the row of ``target`` that contains a point."""
    indices = ebb.vector(ebb.int64, geometry.ndim)
    farthest = tuple(_FARTHEST if wraps else math.inf for wraps in geometry.periodic)

    # What is fixed comes as default values: they are constants, while captured numbers are read at each launch.
    @ebb.func
    def locate(
        pos: Any,
        origin: Any = geometry.origin,
        spacing: Any = geometry.spacing,
        first: Any = first,
        farthest: Any = farthest,
    ) -> Any:
        at = (pos - origin) / spacing - first
        assert ebb.all(ebb.abs(at) <= farthest), "the position to locate is not a number, or too far away to wrap"
        return ebb.row_at(target, indices(ebb.floor(at)), edge="clamp")

    return locate


def _local(geometry: Geometry, first: tuple[float, ...]) -> Callable[..., Any]:
    """The member that gives the place of a point in an element, whose first one begins ``first`` cells from the origin.

    It rounds as ``locate`` does: a point that is in the domain has a place from 0 on and below 1 in what contains it.
    """

    extents = _wraps(geometry, geometry.shape)

    def local(
        c: Any,
        pos: Any,
        origin: Any = geometry.origin,
        spacing: Any = geometry.spacing,
        first: Any = first,
        extents: Any = extents,
    ) -> Any:
        at = (pos - origin) / spacing - first - ebb.coords(c)
        for axis, count in extents:  # of its images, the one nearest to the element
            at[axis] -= count * ebb.floor((at[axis] - 0.5) / count + 0.5)
        return at

    return local


def wrapper(geometry: Geometry) -> Callable[[Any], Any]:
    """The function ``wrap`` of a grid: moves a point by whole lengths of periodic dimensions."""
    lengths = _wraps(geometry, geometry.extent)

    @ebb.func
    def wrap(pos: Any, origin: Any = geometry.origin, lengths: Any = lengths) -> Any:
        inside = pos
        for axis, length in lengths:
            inside[axis] -= length * ebb.floor((pos[axis] - origin[axis]) / length)
        return inside

    return wrap


def _wraps(geometry: Geometry, lengths: tuple[float, ...]) -> tuple[tuple[int, float], ...]:
    """The periodic dimensions, and what they are long."""
    return tuple((axis, length) for axis, length in enumerate(lengths) if geometry.periodic[axis])


def _placer(locate: Callable[[Any], Any]) -> Callable[..., None]:
    @ebb.kernel
    def point_locate(row: Any, key: str, position: str) -> None:
        row[key] = locate(row[position])

    return point_locate
