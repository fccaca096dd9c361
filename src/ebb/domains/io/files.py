"""Reading and writing a mesh in the format that the suffix of its file names."""

from __future__ import annotations

from collections.abc import Iterable
from math import prod
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import ebb
from ebb.diagnostics.nearest import nearest
from ebb.domains.io.data import MeshData
from ebb.domains.io.errors import UnknownFormat, Unsavable
from ebb.domains.io.meshio import read_meshio, write_meshio
from ebb.domains.io.off import read_off, write_off
from ebb.domains.io.veg import read_veg, write_veg
from ebb.errors import MeshFormatError
from ebb.records import record


def read_triangles(path: str | PathLike[str]) -> MeshData:
    """The triangles of an OFF file, or of any format of meshio's.

    Raises:
        MeshFormatError: the file cannot be read, is malformed, or holds no triangles.
        BackendError: the format is one of meshio's, and meshio is not installed.
    """
    match Path(path).suffix.lower():
        case ".off":
            return read_off(path)
        case ".veg":
            raise MeshFormatError(UnknownFormat(str(path), "VEG files hold tetrahedra: load it with TetMesh.load"))
        case _:
            return read_meshio(path, "triangle")


def read_tetrahedra(path: str | PathLike[str]) -> MeshData:
    """The tetrahedra of a VEG file, or of any format of meshio's.

    Raises:
        MeshFormatError: the file cannot be read, is malformed, or holds no tetrahedra.
        BackendError: the format is one of meshio's, and meshio is not installed.
    """
    match Path(path).suffix.lower():
        case ".veg":
            return read_veg(path)
        case ".off":
            reason = "OFF files hold surfaces: load it with TriMesh.load, and fill it with TetMesh.from_surface"
            raise MeshFormatError(UnknownFormat(str(path), reason))
        case _:
            return read_meshio(path, "tetra")


def read_hexahedra(path: str | PathLike[str]) -> MeshData:
    """The hexahedra of any format of meshio's.

    Raises:
        MeshFormatError: the file cannot be read, or holds no hexahedra.
        BackendError: meshio is not installed.
    """
    if Path(path).suffix.lower() in (".off", ".veg"):
        raise MeshFormatError(UnknownFormat(str(path), "OFF and VEG files hold no hexahedra; .vtu and .msh files do"))
    return read_meshio(path, "hexahedron")


@record(eq=False)
class Saved:
    """What is saved of a mesh: where its points are, and values at points and cells by name."""

    points: npt.NDArray[np.floating[Any]]
    point_data: dict[str, Any]
    cell_data: dict[str, Any]


def values_to_save(
    path: str,
    vertices: ebb.Relation,
    cells: ebb.Relation,
    positions: str | ebb.Field | None,
    fields: Iterable[str | ebb.Field],
) -> Saved:
    """The values of ``positions``, a field of the vertices, by default ``pos``, and of ``fields``.

    Raises:
        MeshFormatError: a field is none of the vertices or cells, or ``positions`` says no places (E714).
    """
    place = _own_field(path, vertices, cells, "pos" if positions is None else positions)
    if place.relation is not vertices or place.type.shape != (3,) or place.target is not None:
        raise MeshFormatError(Unsavable(path, f"{place.path} is no vector of 3 numbers at each vertex"))
    points = place.to_numpy().reshape(vertices.size, 3)
    if points.dtype.kind != "f":
        points = points.astype(np.float64)
    chosen = [_own_field(path, vertices, cells, field) for field in fields]
    of_vertices, of_cells = (
        {field.name: plain_values(field) for field in chosen if field.relation is relation}
        for relation in (vertices, cells)
    )
    return Saved(points, of_vertices, of_cells)


def write_mesh(path: str | PathLike[str], mesh: MeshData, saved: Saved) -> None:
    """Write the cells of ``mesh``, and the places of its points and the values that ``saved`` has.

    OFF (triangles) and VEG (tetrahedra) are written natively and hold no fields; the others are meshio's.

    Raises:
        MeshFormatError: the file cannot be written, or its format has no place for the cells or a field.
        BackendError: the format is one of meshio's, and meshio is not installed.
    """
    name = str(path)
    kind = {3: "triangle", 4: "tetra", 8: "hexahedron"}[mesh.cells.shape[1]]
    suffix = Path(name).suffix.lower()
    if suffix not in (".off", ".veg"):
        data = {key: [values] for key, values in saved.cell_data.items()}
        return write_meshio(name, saved.points, [(kind, mesh.cells)], saved.point_data, data)
    if saved.point_data or saved.cell_data:
        raise MeshFormatError(Unsavable(name, f"{suffix} files hold no fields; .vtu files do"))
    match suffix, kind:
        case ".off", "triangle":
            return write_off(name, saved.points, mesh.cells.tolist())
        case ".veg", "tetra":
            return write_veg(name, saved.points, mesh)
        case _:
            raise MeshFormatError(Unsavable(name, f"{suffix} files do not hold cells of the type {kind!r}"))


def _own_field(path: str, vertices: ebb.Relation, cells: ebb.Relation, field: str | ebb.Field) -> ebb.Field:
    """The field of the vertices or cells that is meant; a name is one of the vertices' fields."""
    if isinstance(field, str):
        found = vertices.fields.get(field)
        if found is not None:
            return found
        close = nearest(field, vertices.fields)
        meant = f"; did you mean {close!r}?" if close else ""
        raise MeshFormatError(Unsavable(path, f"{vertices.name} has no field {field!r}{meant}"))
    if field.relation is vertices or field.relation is cells:
        return field
    reason = f"the field {field.path} is none of {vertices.name} or {cells.name} of this mesh"
    raise MeshFormatError(Unsavable(path, reason))


def plain_values(field: ebb.Field) -> Any:
    """The values as the formats take them, row by row: bools as bytes, matrices as long vectors."""
    values = field.to_numpy()
    if values.dtype == np.bool_:
        values = values.astype(np.uint8)
    size, shape = field.relation.size, values.shape[len(field.relation.shape) :]
    return values.reshape((size, prod(shape)) if shape else size)
