"""All the formats that the package meshio reads and writes; it is imported when the first of them is met."""

from __future__ import annotations

import contextlib
import importlib
import io
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ebb.diagnostics.span import Source
from ebb.domains.io.data import Integers, MeshData, Origin
from ebb.domains.io.errors import MissingMeshio, UnknownFormat, UnreadableFile, Unsavable
from ebb.errors import BackendError, MeshFormatError


def read_meshio(path: str | PathLike[str], cell_type: str) -> MeshData:
    """The points of the file and its cells of ``cell_type`` (meshio's ``triangle`` or ``tetra``).

    Points in the plane get the third coordinate 0.

    Raises:
        MeshFormatError: the file cannot be read, is of no known format, or has no such cells.
        BackendError: meshio is not installed.
    """
    name = str(path)
    try:
        with Path(path).open("rb"):
            pass
    except (OSError, ValueError) as error:
        raise MeshFormatError(UnreadableFile(name, getattr(error, "strerror", None) or str(error))) from None
    mesh = _read(name)
    blocks = [block.data for block in mesh.cells if block.type == cell_type]
    if not blocks:
        found = ", ".join(sorted({block.type for block in mesh.cells})) or "no cells"
        raise MeshFormatError(UnknownFormat(name, f"it has {found}, and no cells of the type {cell_type!r}"))
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    cells = np.concatenate(blocks).astype(np.int64)
    return MeshData(points, cells, Origin(Source(name, "")))


def write_meshio(
    path: str | PathLike[str],
    points: npt.NDArray[np.floating[Any]],
    cell_type: str,
    cells: Integers,
    point_data: Mapping[str, Any],
    cell_data: Mapping[str, Any],
) -> None:
    """Write the mesh and its data in the format that the suffix of ``path`` names.

    Raises:
        MeshFormatError: the file cannot be written, or the format is not known or has no place for the data.
        BackendError: meshio is not installed.
    """
    meshio = _import(str(path))
    data = {name: [values] for name, values in cell_data.items()}
    mesh = meshio.Mesh(points, [(cell_type, cells)], point_data=dict(point_data), cell_data=data)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            mesh.write(str(path))
    except OSError as error:
        raise MeshFormatError(UnreadableFile(str(path), error.strerror or str(error))) from None
    # Writers complain in many ways (WriteError, ReadError for the suffix, KeyError, sys.exit): all mean the same here.
    except (Exception, SystemExit) as error:
        raise MeshFormatError(Unsavable(str(path), _reason(error))) from None


def _read(name: str) -> Any:
    meshio = _import(name)
    said = io.StringIO()
    try:
        # meshio prints what its readers say, and leaves by sys.exit when none of them takes the file.
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
            return meshio.read(name)
    except SystemExit:
        raise MeshFormatError(UnknownFormat(name, said.getvalue().strip() or "meshio cannot read it")) from None
    # A reader that meets a damaged file fails with whatever its code runs into: an index, a key, a Unicode error.
    except Exception as error:
        raise MeshFormatError(UnknownFormat(name, _reason(error))) from None


def _reason(error: BaseException) -> str:
    text = str(error).strip()
    return f"meshio says {text!r}" if text else f"meshio fails with {type(error).__name__}"


def _import(path: str) -> Any:
    try:
        return importlib.import_module("meshio")
    except ImportError:
        raise BackendError(MissingMeshio(path)) from None
