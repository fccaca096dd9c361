"""OFF, the Object File Format of Geomview: a surface as points and polygons, in text.

Source: Geomview manual, section "OFF Files". Normals and colours (``NOFF``, ``COFF``, face colours) are skipped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ebb.domains.io.data import Floats, Integers, MeshData, Origin, PolyData, Ragged
from ebb.domains.io.saving import write_text
from ebb.domains.io.text import Lines

_HEADERS = ("OFF", "COFF", "NOFF", "CNOFF", "STOFF", "STCOFF", "STNOFF", "STCNOFF")
_Faces = TypeVar("_Faces")

_COUNTS = "the numbers of points, faces and edges"


def read_off(path: str | PathLike[str]) -> MeshData:
    """The points and triangles of an OFF file.

    Raises:
        MeshFormatError: the file cannot be read, is malformed, cut short, or has faces that are no triangles.
    """
    points, triangles, origin = _read(path, _take_triangles)
    return MeshData(points, triangles, origin)


def read_off_polygons(path: str | PathLike[str]) -> PolyData:
    """The points and faces of an OFF file, of any number of corners from three on.

    Raises:
        MeshFormatError: the file cannot be read, is malformed or cut short.
    """
    points, faces, origin = _read(path, lambda lines, count: lines.take_ragged(count, 3, "faces"))
    return PolyData(points, faces, Ragged(np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)), origin)


def write_off(path: str | PathLike[str], points: npt.NDArray[np.floating[Any]], faces: Iterable[Sequence[int]]) -> None:
    """Write a surface of polygons; coordinates keep all their digits.

    Raises:
        MeshFormatError: the file cannot be written (E701).
    """
    rows = [f"{len(face)} {' '.join(map(str, face))}" for face in faces]
    text = [f"OFF\n{len(points)} {len(rows)} 0"]
    text += [f"{x!s} {y!s} {z!s}" for x, y, z in points]
    write_text(path, text + rows)


def _read(path: str | PathLike[str], take_faces: Callable[[Lines, int], _Faces]) -> tuple[Floats, _Faces, Origin]:
    lines = Lines(path)
    keyword, rest = lines.take_keyword("the keyword OFF")
    if keyword not in _HEADERS:
        raise lines.malformed("the keyword OFF")
    n_points, n_faces, *_ = lines.take_counts(2, _COUNTS, rest or None)
    start = lines.position
    points = lines.take_floats(n_points, 3, "points")
    faces = take_faces(lines, n_faces)
    if not lines.at_end:
        raise lines.malformed(f"no more lines after the {n_faces} faces that are announced", lines.position)
    middle = start + n_points
    origin = Origin(lines.source, lines.numbers[start:middle], lines.numbers[middle : middle + n_faces])
    return points, faces, origin


def _take_triangles(lines: Lines, count: int) -> Integers:
    first = lines.position
    corners = lines.take_integers(count, 1, "faces")[:, 0]
    others = np.flatnonzero(corners != 3)
    if others.size:
        raise lines.malformed("a triangle, 3 and three point numbers", first + int(others[0]))
    lines.position = first
    return lines.take_integers(count, 4, "faces")[:, 1:]
