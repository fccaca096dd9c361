"""What can be wrong with grids: the kinds of ``RelationError`` from E530 on."""

from __future__ import annotations

from typing import ClassVar

from ebb.diagnostics.diagnostic import Diagnostic
from ebb.records import record


@record
class BadGridShape(Diagnostic):
    """The numbers of cells are no numbers of cells."""

    code: ClassVar[str] = "E530"
    grid: str
    ndim: int
    found: str

    @property
    def title(self) -> str:
        counts = "a number >= 1" if self.ndim == 1 else f"{self.ndim} numbers >= 1"
        return f"the shape of a {self.grid} is {counts}, of cells in each dimension, not {self.found}"


@record
class BadGridArgument(Diagnostic):
    """An argument of a grid has the wrong length, or is of the wrong kind."""

    code: ClassVar[str] = "E531"
    grid: str
    argument: str
    expected: str
    found: str

    @property
    def title(self) -> str:
        return f"{self.argument}= of a {self.grid} takes {self.expected}, not {self.found}"


@record
class BadGridExtent(Diagnostic):
    """The extent is not positive, or the cells are too small to have corners of their own."""

    code: ClassVar[str] = "E532"
    grid: str
    axis: int
    extent: float
    reason: str

    @property
    def title(self) -> str:
        return f"a {self.grid} cannot have the extent {self.extent} in dimension {self.axis}: {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("the extent is the length of a side of the domain; origin= is its lower corner",)


@record
class BoundaryTooDeep(Diagnostic):
    """The boundary has more layers of cells than the grid."""

    code: ClassVar[str] = "E533"
    grid: str
    axis: int
    depth: int
    cells: int

    @property
    def title(self) -> str:
        return (
            f"the boundary of a {self.grid} cannot be {self.depth} cells deep in dimension {self.axis}, "
            f"which has {self.cells}"
        )


@record
class OddGrid(Diagnostic):
    """A grid with an odd number of cells in some dimension is to be coarsened."""

    code: ClassVar[str] = "E534"
    shape: tuple[int, ...]
    axis: int

    @property
    def title(self) -> str:
        return f"a grid of the shape {self.shape} has no coarser one: dimension {self.axis} has an odd number of cells"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("for a hierarchy of n levels, take multiples of 2**(n - 1) cells in each dimension",)


@record
class CannotLocate(Diagnostic):
    """``point_locate`` is given fields that it cannot use."""

    code: ClassVar[str] = "E535"
    relation: str
    complaint: str

    @property
    def title(self) -> str:
        return f"{self.relation}.point_locate(key_field, pos_field) {self.complaint}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            f"give two fields of one relation: one with keys of '{self.relation}', and one with positions, "
            "vectors of floats",
        )
