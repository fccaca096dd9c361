"""What a mesh file says, before it becomes relations: plain arrays, and where in the file each row stood."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from ebb.diagnostics.span import Source, Span
from ebb.records import record

Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]

_Number = TypeVar("_Number", np.int64, np.float64)


@record(eq=False)
class Origin:
    """The file that a mesh was read from. The line numbers count from 1, and are empty where the format has none."""

    source: Source
    point_lines: Sequence[int] = ()
    cell_lines: Sequence[int] = ()

    def point(self, row: int) -> Span | None:
        """The line of the point ``row``, if the format has lines."""
        return line_span(self.source, self.point_lines[row]) if row < len(self.point_lines) else None

    def cell(self, row: int) -> Span | None:
        """The line of the cell ``row``, if the format has lines."""
        return line_span(self.source, self.cell_lines[row]) if row < len(self.cell_lines) else None


@record
class Material:
    """A ``*MATERIAL`` of a VEG file: its name, its model (``ENU``, ``ORTHOTROPIC``, ``MOONEYRIVLIN``) and the numbers.

    For ``ENU`` the numbers are the mass density, Young's modulus and Poisson's ratio.
    """

    name: str
    model: str
    parameters: tuple[float, ...]


@record(eq=False)
class Region:
    """The elements that are of one material: a ``*REGION`` of a VEG file. ``rows`` are row numbers from 0."""

    name: str
    material: Material
    rows: Integers


@record(eq=False)
class MeshData:
    """Points of shape (n, 3), cells of shape (m, corners) that index them from 0, and what else the file holds."""

    points: Floats
    cells: Integers
    origin: Origin | None = None
    materials: tuple[Material, ...] = ()
    regions: tuple[Region, ...] = ()


@record(eq=False)
class Ragged:
    """Rows of different lengths: row i is ``values[offsets[i] : offsets[i + 1]]``."""

    offsets: Integers
    values: Integers

    @staticmethod
    def of_lengths(lengths: Integers, values: Integers) -> Ragged:
        """Rows of the given lengths, which take their values in turn."""
        return Ragged(np.concatenate([[0], np.cumsum(lengths)]), values.ravel())

    @staticmethod
    def joined(parts: Sequence[Ragged]) -> Ragged:
        """The rows of all parts, one part after the other."""
        return Ragged.of_lengths(
            np.concatenate([part.lengths for part in parts]), np.concatenate([part.values for part in parts])
        )

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def lengths(self) -> Integers:
        """How many values each row has."""
        return np.diff(self.offsets)

    @property
    def rows(self) -> Integers:
        """The row of each value."""
        return np.repeat(np.arange(len(self)), self.lengths)

    @property
    def following(self) -> Integers:
        """For each value the one after it in its row; the first follows the last. No row is empty."""
        return self.after(self.values)

    def after(self, values: npt.NDArray[_Number]) -> npt.NDArray[_Number]:
        """For each value of a row what ``values`` has for the one after it; the first follows the last."""
        following = np.roll(values, -1, axis=0)
        following[self.offsets[1:] - 1] = values[self.offsets[:-1]]
        return following

    def row(self, row: int) -> tuple[int, ...]:
        """The values of one row."""
        return tuple(self.values[self.offsets[row] : self.offsets[row + 1]].tolist())

    def places(self, rows: Integers) -> Ragged:
        """For each of ``rows``, where in ``values`` its values are."""
        lengths = self.lengths[rows]
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        shift = np.repeat(self.offsets[:-1][rows] - offsets[:-1], lengths)
        return Ragged(offsets, shift + np.arange(len(shift)))

    def take(self, rows: Integers) -> Ragged:
        """The rows with the numbers ``rows``, in that order."""
        places = self.places(rows)
        return Ragged(places.offsets, self.values[places.values])

    def sums(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """For each row the sum of what ``values`` has for its values. No row is empty."""
        if not len(self):
            return np.zeros((0, *values.shape[1:]), dtype=values.dtype)
        return np.add.reduceat(values, self.offsets[:-1])


@record(eq=False)
class PolyData:
    """Points of shape (n, 3), faces as lists of points, cells as lists of faces; the cells of a surface are none."""

    points: Floats
    faces: Ragged
    cells: Ragged
    origin: Origin | None = None


def line_span(source: Source, line: int) -> Span:
    """The whole of one line."""
    text = source.line(line)
    indent = len(text) - len(text.lstrip())
    return Span(source, line, indent, line, max(len(text.rstrip()), indent + 1))
