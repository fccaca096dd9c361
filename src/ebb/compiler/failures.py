"""What goes wrong while a kernel runs: one kind of error each, the same on every backend.

A backend that finds a failure calls the function here with the node at fault, the position of the row and the offending
values, and raises what comes back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ebb.compiler import kir
from ebb.diagnostics.diagnostic import Diagnostic, Label
from ebb.diagnostics.span import Span
from ebb.errors import BoundsError, KernelAssertionError, KernelTypeError, RelationError
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.types.types import KeyType, Type

_STOPPED = ("the launch stopped here; what it wrote for other rows stays",)


@record
class Failure(Diagnostic):
    """A kernel stopped in the middle of a launch.

    Attributes:
        kernel: the kernel's name.
        row: the row it ran for, as ``vertices[17]`` or ``cells[3, 4]``.
        span: where in the source.
    """

    kernel: str
    row: str
    span: Span

    @property
    def notes(self) -> tuple[str, ...]:
        return _STOPPED


@record
class AssertionFailed(Failure):
    """The condition of an ``assert`` is false."""

    code: ClassVar[str] = "E401"
    text: str

    @property
    def title(self) -> str:
        said = f": {self.text}" if self.text else ""
        return f"assertion failed in kernel '{self.kernel}', row {self.row}{said}"

    @property
    def primary(self) -> Label:
        return Label(self.span, f"false for row {self.row}")

    @property
    def hints(self) -> tuple[str, ...]:
        return ('run it under ebb.set_backend("reference") with breakpoint() before this line to look at the row',)


@record
class ComponentOutOfRange(Failure):
    """An index that is computed in the kernel selects no component."""

    code: ClassVar[str] = "E402"
    index: int
    extent: int
    type: Type

    @property
    def title(self) -> str:
        return f"index {self.index} is outside {self.type!r} in kernel '{self.kernel}', row {self.row}"

    @property
    def primary(self) -> Label:
        return Label(self.span, f"{self.index} is not in range({self.extent})")

    @property
    def notes(self) -> tuple[str, ...]:
        more = ("only indices known when the kernel is compiled count from the end",) if self.index < 0 else ()
        return (*more, *_STOPPED)


@record
class AffineOutside(Failure):
    """An access to a row of a grid, at a place that comes from data, falls outside it."""

    code: ClassVar[str] = "E403"
    grid: str
    shape: tuple[int, ...]
    periodic: tuple[bool, ...]
    coordinates: tuple[int, ...]

    @property
    def title(self) -> str:
        where = ", ".join(map(str, self.coordinates))
        return f"there is no cell {self.grid}[{where}], which kernel '{self.kernel}' accesses for row {self.row}"

    @property
    def primary(self) -> Label:
        axis = self._bad_axis
        return Label(self.span, f"{self.coordinates[axis]} is not in range({self.shape[axis]}), dimension {axis}")

    @property
    def _bad_axis(self) -> int:
        dimensions = enumerate(zip(self.coordinates, self.shape, self.periodic, strict=True))
        # Where a dimension has no index at all there is none to wrap to.
        return next(axis for axis, (at, extent, wraps) in dimensions if not (0 <= at < extent or (wraps and extent)))

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"the shape of '{self.grid}' is {self.shape}, periodic {self.periodic}", *_STOPPED)

    @property
    def hints(self) -> tuple[str, ...]:
        return ('clamp the access with edge="clamp"', "make the grid periodic in that dimension")


@record
class UnsetKey(Failure):
    """A key is read that was never set."""

    code: ClassVar[str] = "E404"
    field: str
    holder: str

    @property
    def title(self) -> str:
        return f"kernel '{self.kernel}', row {self.row}, reads '{self.field}' of {self.holder}, which is not set"

    @property
    def primary(self) -> Label:
        return Label(self.span, "refers to no row")

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"load '{self.field}' for every row before the launch, or launch on a subset of rows that have it",)


@record
class ZeroStep(Failure):
    """The step of a ``range`` is zero."""

    code: ClassVar[str] = "E405"

    @property
    def title(self) -> str:
        return f"the step of range() is zero in kernel '{self.kernel}', row {self.row}"

    @property
    def primary(self) -> Label:
        return Label(self.span, "this range would never end")


def identity(relation: Relation, position: int) -> int:
    """The number at its creation of the row stored at ``position``."""
    order = relation.storage.order
    return position if order is None else int(order[position])


def coordinates(relation: Relation, position: int) -> tuple[int, ...]:
    """The coordinates of the row at ``position``: indices on a grid, else the one number."""
    if not relation.is_grid:
        return (identity(relation, position),)
    return tuple(int(index) for index in np.unravel_index(position, relation.shape))


def row_name(relation: Relation, position: int) -> str:
    """The row stored at ``position`` as a user would write it: ``vertices[17]``, ``cells[3, 4]``."""
    if position < 0:
        return f"{relation.name}[unset]"
    return f"{relation.name}[{', '.join(map(str, coordinates(relation, position)))}]"


def assertion_failed(kernel: kir.Kernel, position: int, stmt: kir.Assert) -> KernelAssertionError:
    """``stmt`` does not hold for the row at ``position``."""
    row = row_name(kernel.relation, position)
    return KernelAssertionError(AssertionFailed(kernel.name, row, stmt.span, stmt.text))


def component_out_of_range(
    kernel: kir.Kernel, position: int, span: Span, index: int, axis: int, type: Type
) -> BoundsError:
    """``index`` along ``axis`` is outside a vector or matrix of ``type``."""
    row = row_name(kernel.relation, position)
    return BoundsError(ComponentOutOfRange(kernel.name, row, span, index, type.shape[axis], type))


def affine_outside(kernel: kir.Kernel, position: int, node: kir.Affine | kir.RowAt, at: Sequence[int]) -> BoundsError:
    """``node`` maps to the coordinates ``at``, before wrapping, which its target does not have."""
    assert isinstance(node.type, KeyType) and isinstance(node.type.target, Relation)
    grid = node.type.target
    row = row_name(kernel.relation, position)
    found = tuple(int(index) for index in at[: grid.ndim])
    return BoundsError(AffineOutside(kernel.name, row, node.span, grid.name, grid.shape, grid.periodic, found))


def unset_key(kernel: kir.Kernel, position: int, span: Span, field: Field, holder: int) -> RelationError:
    """The key (or a component) of ``field`` in the row at position ``holder`` is read and is unset."""
    row = row_name(kernel.relation, position)
    return RelationError(UnsetKey(kernel.name, row, span, field.path, row_name(field.relation, holder)))


def zero_step(kernel: kir.Kernel, position: int, stmt: kir.ForRange) -> KernelTypeError:
    """The step of ``stmt`` is zero."""
    return KernelTypeError(ZeroStep(kernel.name, row_name(kernel.relation, position), stmt.span))
