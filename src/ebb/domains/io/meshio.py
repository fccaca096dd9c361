"""All the formats that the package meshio reads and writes; it is imported when the first of them is met."""

from __future__ import annotations

import importlib
import io
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ebb.diagnostics.span import Source
from ebb.domains.io.data import Floats, MeshData, Origin
from ebb.domains.io.errors import MissingMeshio, UnknownFormat, UnreadableFile, Unsavable
from ebb.domains.io.saving import replacing
from ebb.errors import BackendError, MeshFormatError

# The format of a suffix that several share, where meshio would take one that loses the cells.
_FORMATS = {".msh": "gmsh"}

# The two files of a mesh of TetGen.
_TETGEN = (".node", ".ele")


def read_meshio(path: str | PathLike[str], cell_type: str) -> MeshData:
    """The points of the file and its cells of ``cell_type`` (meshio's ``triangle``, ``tetra`` or ``hexahedron``).

    Points in the plane get the third coordinate 0.

    Raises:
        MeshFormatError: the file cannot be read, is of no known format, or has no such cells.
        BackendError: meshio is not installed.
    """
    points, blocks = read_blocks(path)
    cells = [data for kind, data in blocks if kind == cell_type]
    if not cells:
        found = ", ".join(sorted({kind for kind, _ in blocks})) or "no cells"
        raise MeshFormatError(UnknownFormat(str(path), f"it has {found}, and no cells of the type {cell_type!r}"))
    return MeshData(points, np.concatenate(cells).astype(np.int64), Origin(Source(str(path), "")))


def read_blocks(path: str | PathLike[str]) -> tuple[Floats, list[tuple[str, Any]]]:
    """The points of the file, and its blocks of cells: meshio's name of their type, and what it has for each cell.

    Raises:
        MeshFormatError: the file cannot be read, or is of no known format.
        BackendError: meshio is not installed.
    """
    name = str(path)
    mesh = _read_file(path)
    points = np.asarray(mesh.points, dtype=np.float64)
    match points.shape:
        case (_, 3):
            pass
        case (n, 2):
            points = np.column_stack([points, np.zeros(n)])
        case shape:
            raise MeshFormatError(UnknownFormat(name, f"its points are an array of the shape {shape}"))
    return points, [(block.type, block.data) for block in mesh.cells]


def read_meshio_points(path: str | PathLike[str]) -> tuple[npt.NDArray[Any], dict[str, npt.NDArray[Any]]]:
    """The points of the file, of as many coordinates as it has, and its values for all points, by name.

    Raises:
        MeshFormatError: the file cannot be read, or is of no known format.
        BackendError: meshio is not installed.
    """
    mesh = _read_file(path)
    return np.asarray(mesh.points), {name: np.asarray(values) for name, values in mesh.point_data.items()}


def write_meshio(
    path: str | PathLike[str],
    points: npt.NDArray[np.floating[Any]],
    blocks: Sequence[tuple[str, Any]],
    point_data: Mapping[str, Any],
    cell_data: Mapping[str, list[Any]],
) -> None:
    """Write the mesh and its data in the format that the suffix of ``path`` names.

    Args:
        path: where to.
        points: shape (n, 3).
        blocks: meshio's name of a type of cells, and the cells.
        point_data: values for all points, by name.
        cell_data: values for the cells of each block, by name.

    Raises:
        MeshFormatError: the file cannot be written, or the format is not known or has no place for the data.
        BackendError: meshio is not installed.
    """
    name = str(path)
    meshio = _import(name)
    mesh = meshio.Mesh(points, list(blocks), point_data=dict(point_data), cell_data=dict(cell_data))
    with replacing(path) as file:
        try:
            with _quiet(io.StringIO()):
                mesh.write(str(file), file_format=_FORMATS.get(file.suffix.lower()))
        except OSError:
            raise
        # Writers complain in many ways (WriteError, ReadError for the suffix, KeyError, sys.exit): all mean the same.
        except (Exception, SystemExit) as error:
            raise MeshFormatError(Unsavable(name, _reason(error).replace(str(file), name))) from None
        _check_written(name, str(file), mesh)


def _check_written(name: str, file: str, mesh: Any) -> None:
    """Check that all of the mesh is in the file: many writers leave out, without an error, what their format lacks."""
    try:
        found = _read(file)
    except MeshFormatError:
        raise MeshFormatError(Unsavable(name, "meshio cannot read again what it wrote")) from None
    written, kept = _counts(mesh), _counts(found)
    gone = sorted(kind for kind, count in written.items() if kept.get(kind) != count)
    if gone:
        raise MeshFormatError(Unsavable(name, f"the format does not hold cells of the type {gone[0]!r}"))
    lost = sorted([*(mesh.point_data.keys() - found.point_data), *(mesh.cell_data.keys() - found.cell_data)])
    if lost:
        fields = ", ".join(map(repr, lost))
        raise MeshFormatError(Unsavable(name, f"the format does not hold the fields {fields}; .vtu files do"))


def _counts(mesh: Any) -> dict[str, int]:
    """How many cells of each type there are."""
    counts: dict[str, int] = {}
    for block in mesh.cells:
        counts[block.type] = counts.get(block.type, 0) + len(block.data)
    return counts


def _read_file(path: str | PathLike[str]) -> Any:
    try:
        with Path(path).open("rb"):
            pass
    except (OSError, ValueError) as error:
        raise MeshFormatError(UnreadableFile(str(path), getattr(error, "strerror", None) or str(error))) from None
    return _read(str(path))


def _read(name: str) -> Any:
    meshio = _import(name)
    if Path(name).suffix.lower() in _TETGEN:
        _check_tetgen(name)
    said = io.StringIO()
    try:
        # meshio prints what its readers say, and leaves by sys.exit when none of them takes the file.
        with _quiet(said):
            return meshio.read(name)
    except SystemExit:
        raise MeshFormatError(UnknownFormat(name, said.getvalue().strip() or "meshio cannot read it")) from None
    # A reader that meets a damaged file fails with whatever its code runs into: an index, a key, a Unicode error.
    except Exception as error:
        raise MeshFormatError(UnknownFormat(name, _reason(error))) from None


def _check_tetgen(name: str) -> None:
    """Refuse files of TetGen without a first line of numbers: meshio would read on at their end for ever."""
    for part in map(Path(name).with_suffix, _TETGEN):
        lines = part.read_text(encoding="utf-8", errors="replace").split("\n") if part.exists() else ()
        if not any(line.strip() and not line.strip().startswith("#") for line in lines):
            raise MeshFormatError(UnknownFormat(name, f"{part.name!r} is missing or empty"))


@contextmanager
def _quiet(said: io.StringIO) -> Generator[None, None, None]:
    """Keeps what meshio prints from the user: ``said`` gets stdout, its warnings go nowhere."""
    with redirect_stdout(said), redirect_stderr(io.StringIO()):
        yield


def _reason(error: BaseException) -> str:
    text = str(error).strip()
    return f"meshio says {text!r}" if text else f"meshio fails with {type(error).__name__}"


def _import(path: str) -> Any:
    try:
        return importlib.import_module("meshio")
    except ImportError:
        raise BackendError(MissingMeshio(path)) from None
