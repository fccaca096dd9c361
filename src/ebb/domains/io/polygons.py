"""Polygons and polyhedra in files: OFF natively, everything else through meshio."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ebb.diagnostics.span import Source
from ebb.domains.hexahedra import FACES
from ebb.domains.io.data import Floats, Integers, Origin, PolyData, Ragged
from ebb.domains.io.errors import UnknownFormat, Unsavable
from ebb.domains.io.files import Saved
from ebb.domains.io.meshio import read_blocks, write_meshio
from ebb.domains.io.off import read_off_polygons, write_off
from ebb.domains.polyhedra import cell_faces, distinct_pairs, merged_faces, ragged
from ebb.domains.topology import OUTWARD_FACES
from ebb.errors import MeshFormatError

# The faces of the cells that meshio names, in the numbering of VTK.
SCHEMES: dict[str, Sequence[Sequence[int]]] = {
    "tetra": OUTWARD_FACES.tolist(),
    "hexahedron": FACES.tolist(),
    "wedge": [(0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)],
    "pyramid": [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
}

_POLYGONS = {3: "triangle", 4: "quad"}


def read_polygons(path: str | PathLike[str]) -> PolyData:
    """The polyhedra of a file, or where it has none its polygons.

    Raises:
        MeshFormatError: the file cannot be read, is malformed, or holds neither.
        BackendError: the format is one of meshio's, and meshio is not installed.
    """
    match Path(path).suffix.lower():
        case ".off":
            return read_off_polygons(path)
        case ".veg":
            raise MeshFormatError(UnknownFormat(str(path), "load VEG files with TetMesh.load, then PolyMesh.from_mesh"))
        case _:
            return _polygons_of(str(path), *read_blocks(path))


def write_polygons(path: str | PathLike[str], mesh: PolyData, saved: Saved) -> None:
    """Write a surface as OFF or in a format of meshio's, or polyhedra as VTU.

    But for OFF the rows are sorted by their number of corners, as the formats demand; rows of equal number keep their
    order.

    Raises:
        MeshFormatError: the file cannot be written, or the format has no place for the mesh or a field.
        BackendError: the format is one of meshio's, and meshio is not installed.
    """
    name, suffix = str(path), Path(path).suffix.lower()
    solid = len(mesh.cells) > 0
    if suffix == ".veg" or (suffix in (".off", ".vtk") and solid):
        raise MeshFormatError(Unsavable(name, f"{suffix} files hold no polyhedra; .vtu files do"))
    if suffix == ".off":
        if saved.point_data or saved.cell_data:
            raise MeshFormatError(Unsavable(name, ".off files hold no fields; .vtu files do"))
        return write_off(name, saved.points, _lists(mesh.faces))
    blocks = _cell_blocks(mesh) if solid else _face_blocks(mesh.faces)
    data = {key: [values[rows] for _, rows, _ in blocks] for key, values in saved.cell_data.items()}
    return write_meshio(name, saved.points, [(kind, cells) for kind, _, cells in blocks], saved.point_data, data)


def _polygons_of(name: str, points: Floats, blocks: list[tuple[str, Any]]) -> PolyData:
    origin = Origin(Source(name, ""))
    solid = [(kind, data) for kind, data in blocks if kind.startswith("polyhedron") or kind in SCHEMES]
    if any(len(data) for _, data in solid):
        parts, counts = zip(*(_faces_of(kind, data) for kind, data in solid), strict=True)
        return PolyData(points, *merged_faces(Ragged.joined(parts), np.concatenate(counts)), origin)
    polygons = ("triangle", "quad", "polygon")
    faces = [face for kind, data in blocks if kind in polygons for face in np.asarray(data).tolist()]
    if not faces:
        found = ", ".join(sorted({kind for kind, _ in blocks})) or "no cells"
        raise MeshFormatError(UnknownFormat(name, f"it has {found}, and no polygons or polyhedra"))
    return PolyData(points, ragged("faces", faces, None), ragged("cells", [], None), origin)


def _faces_of(kind: str, data: Any) -> tuple[Ragged, Integers]:
    """The faces of the cells of a block, cell by cell, and how many each has."""
    if kind in SCHEMES:
        return cell_faces(np.asarray(data, dtype=np.int64), SCHEMES[kind])
    faces = [np.asarray(face, dtype=np.int64) for cell in data for face in cell]
    lengths, values = [len(face) for face in faces], np.concatenate(faces or [np.zeros(0, np.int64)])
    return Ragged.of_lengths(np.array(lengths, np.int64), values), np.array([len(cell) for cell in data], np.int64)


def _face_blocks(faces: Ragged) -> list[tuple[str, Integers, Any]]:
    lengths = faces.lengths
    blocks: list[tuple[str, Integers, Any]] = []
    for length in sorted(set(lengths.tolist())):
        rows = np.flatnonzero(lengths == length)
        blocks.append((_POLYGONS.get(length, "polygon"), rows, faces.take(rows).values.reshape(-1, length)))
    return blocks


def _cell_blocks(mesh: PolyData) -> list[tuple[str, Integers, Any]]:
    faces = [np.array(face) for face in _lists(mesh.faces)]
    cells = [[faces[face] for face in cell] for cell in _lists(mesh.cells)]
    places = mesh.faces.places(mesh.cells.values)
    cell, _ = distinct_pairs(mesh.cells.rows[places.rows], mesh.faces.values[places.values], len(mesh.points))
    sizes = np.bincount(cell)
    blocks: list[tuple[str, Integers, Any]] = []
    for size in sorted(set(sizes.tolist())):
        rows = np.flatnonzero(sizes == size)
        blocks.append((f"polyhedron{size}", rows, [cells[row] for row in rows.tolist()]))
    return blocks


def _lists(rows: Ragged) -> list[list[int]]:
    values, offsets = rows.values.tolist(), rows.offsets.tolist()
    return [values[start:stop] for start, stop in pairwise(offsets)]
