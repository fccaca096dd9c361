"""What a mesh file says, before it becomes relations: plain arrays, and where in the file each row stood."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from ebb.diagnostics.span import Source, Span
from ebb.records import record

Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]


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


def line_span(source: Source, line: int) -> Span:
    """The whole of one line."""
    text = source.line(line)
    indent = len(text) - len(text.lstrip())
    return Span(source, line, indent, line, max(len(text.rstrip()), indent + 1))
