"""VEG, the format of Vega FEM: a tetrahedral mesh with its materials, in text.

Source: Barbic, Sin and Schroeder, "Vega FEM library", 2012, user's manual, section on the .veg format. Points and
elements are numbered from 0 or from 1, as the first point has it.
"""

from __future__ import annotations

from collections.abc import Container
from math import isfinite
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt

from ebb.domains.io.data import Floats, Integers, Material, MeshData, Origin, Region
from ebb.domains.io.errors import IndexOutOfRange
from ebb.domains.io.saving import write_text
from ebb.domains.io.text import Lines, as_float
from ebb.errors import MeshFormatError
from ebb.records import field, record

# The set that every file has.
_ALL = "allElements"

# Elements of a set on one line: readers with a buffer of fixed size take lines of some thousand characters.
_SET_LINE = 16


@record(frozen=False)
class _Parts:
    """What has been read so far. ``base`` is the number of the first point, 0 or 1."""

    points: Floats = field(default_factory=lambda: np.empty((0, 3)))
    cells: Integers = field(default_factory=lambda: np.empty((0, 4), dtype=np.int64))
    base: int = 1
    point_lines: list[int] = field(default_factory=list[int])
    cell_lines: list[int] = field(default_factory=list[int])
    materials: dict[str, Material] = field(default_factory=dict[str, Material])
    sets: dict[str, Integers] = field(default_factory=dict[str, Integers])
    regions: list[Region] = field(default_factory=list[Region])
    seen: set[str] = field(default_factory=set[str])


def read_veg(path: str | PathLike[str]) -> MeshData:
    """The points, tetrahedra, materials and regions of a VEG file.

    Raises:
        MeshFormatError: the file cannot be read, is malformed, cut short, or has other elements than tetrahedra.
    """
    lines = Lines(path)
    parts = _Parts()
    while not lines.at_end:
        keyword, rest = lines.take_keyword("a section")
        section = _SECTIONS.get(keyword.upper())
        if section is None:
            raise lines.malformed(f"a section, one of {', '.join(_SECTIONS)}")
        section(lines, parts, rest)
        parts.seen.add(keyword.upper())
    for keyword in ("*VERTICES", "*ELEMENTS"):
        if keyword not in parts.seen:
            raise lines.malformed(f"a section {keyword}, which the file lacks", len(lines.texts) - 1)
    origin = Origin(lines.source, parts.point_lines, parts.cell_lines)
    _check_range(parts, origin)
    return MeshData(parts.points, parts.cells, origin, tuple(parts.materials.values()), tuple(parts.regions))


def write_veg(path: str | PathLike[str], points: npt.NDArray[np.floating[Any]], mesh: MeshData) -> None:
    """Write the tetrahedra of ``mesh`` at ``points``, with materials and regions; coordinates keep all their digits.

    Raises:
        MeshFormatError: the file cannot be written (E701).
    """
    text = ["*VERTICES", f"{len(points)} 3 0 0"]
    text += [f"{i} {x!s} {y!s} {z!s}" for i, (x, y, z) in enumerate(points, start=1)]
    text += ["", "*ELEMENTS", "TET", f"{len(mesh.cells)} 4 0"]
    text += [f"{i} {a} {b} {c} {d}" for i, (a, b, c, d) in enumerate((mesh.cells + 1).tolist(), start=1)]
    for material in mesh.materials:
        numbers = ", ".join(map(repr, material.parameters))
        text += ["", f"*MATERIAL {material.name}", f"{material.model}, {numbers}"]
    for name, rows in {region.name: region.rows + 1 for region in mesh.regions if region.name != _ALL}.items():
        text += ["", f"*SET {name}"]
        text += [", ".join(map(str, rows[i : i + _SET_LINE].tolist())) for i in range(0, len(rows), _SET_LINE)]
    for region in mesh.regions:
        text += ["", "*REGION", f"{region.name}, {region.material.name}"]
    write_text(path, text)


def _take_vertices(lines: Lines, parts: _Parts, rest: str) -> None:
    _once(lines, parts, "*VERTICES")
    expected = "the number of points and their dimension, 3"
    count, dimension, *_ = lines.take_counts(2, expected)
    if dimension != 3:
        raise lines.malformed(expected)
    first = lines.position
    table = lines.take_floats(count, 4, "points")
    parts.points = np.ascontiguousarray(table[:, 1:])
    parts.point_lines = lines.numbers[first : first + count]
    parts.base = 0 if count and table[0, 0] == 0 else 1
    _check_numbers(lines, table[:, 0], parts.base, first)


def _take_elements(lines: Lines, parts: _Parts, rest: str) -> None:
    _once(lines, parts, "*ELEMENTS")
    if "*VERTICES" not in parts.seen:
        raise lines.malformed("the section *VERTICES before *ELEMENTS")
    kind = lines.take("the kind of element, TET")
    if kind.upper() not in ("TET", "TETS"):
        raise lines.malformed("the kind of element TET, the only one that a tetrahedral mesh takes")
    expected = "the number of elements and of their corners, 4"
    count, corners, *_ = lines.take_counts(2, expected)
    if corners != 4:
        raise lines.malformed(expected)
    first = lines.position
    table = lines.take_integers(count, 5, "elements")
    parts.cells = np.ascontiguousarray(table[:, 1:]) - parts.base
    parts.cell_lines = lines.numbers[first : first + count]
    _check_numbers(lines, table[:, 0], parts.base, first)


def _take_material(lines: Lines, parts: _Parts, rest: str) -> None:
    _new_name(lines, "material", rest, parts.materials)
    expected = "a model and its numbers, such as ENU, 1000, 1e7, 0.4"
    model, *numbers = (word.strip() for word in lines.take(expected).split(","))
    parameters = tuple(number for number in map(as_float, numbers) if number is not None and isfinite(number))
    if not rest or not model.isidentifier() or len(parameters) < len(numbers):
        raise lines.malformed(expected)
    parts.materials[rest] = Material(rest, model, parameters)


def _take_set(lines: Lines, parts: _Parts, rest: str) -> None:
    _new_name(lines, "set", rest, (_ALL, *parts.sets))
    rows: list[int] = []
    while not lines.at_end and not lines.peek.startswith("*"):
        numbers = lines.take_counts(0, "element numbers", lines.take("element numbers").replace(",", " "))
        last = len(parts.cells) - 1 + parts.base
        if any(not parts.base <= number <= last for number in numbers):
            raise lines.malformed(f"element numbers from {parts.base} to {last}")
        rows += [number - parts.base for number in numbers]
    parts.sets[rest] = np.array(rows, dtype=np.int64)


def _take_region(lines: Lines, parts: _Parts, rest: str) -> None:
    expected = "the names of a set and of a material"
    names = [word.strip() for word in lines.take(expected).split(",")]
    if len(names) != 2:
        raise lines.malformed(expected)
    name, material = names
    known = {_ALL: np.arange(len(parts.cells), dtype=np.int64), **parts.sets}
    if name not in known or material not in parts.materials:
        raise lines.malformed(f"{expected} that the file defines before")
    parts.regions.append(Region(name, parts.materials[material], known[name]))


_SECTIONS = {
    "*VERTICES": _take_vertices,
    "*ELEMENTS": _take_elements,
    "*MATERIAL": _take_material,
    "*SET": _take_set,
    "*REGION": _take_region,
}


def _once(lines: Lines, parts: _Parts, keyword: str) -> None:
    if keyword in parts.seen:
        raise lines.malformed(f"one section {keyword} in the file")


def _new_name(lines: Lines, what: str, name: str, taken: Container[str]) -> None:
    if name in taken:
        raise lines.malformed(f"the name of a {what} that the file does not have yet, {name!r} it has")


def _check_numbers(lines: Lines, numbers: Floats | Integers, base: int, first: int) -> None:
    wrong = np.flatnonzero(numbers != np.arange(base, base + len(numbers)))
    if wrong.size:
        row = int(wrong[0])
        raise lines.malformed(f"a line that begins with the number {base + row}", first + row)


def _check_range(parts: _Parts, origin: Origin) -> None:
    rows, columns = np.nonzero((parts.cells < 0) | (parts.cells >= len(parts.points)))
    if rows.size:
        index = int(parts.cells[rows[0], columns[0]]) + parts.base
        raise MeshFormatError(
            IndexOutOfRange("tetrahedron", int(rows[0]), origin, index, len(parts.points), parts.base)
        )
