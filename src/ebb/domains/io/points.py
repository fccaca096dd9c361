"""Reading and writing points with values: NumPy's archives natively, other formats by meshio."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import ebb
from ebb.diagnostics.nearest import nearest
from ebb.diagnostics.span import Source
from ebb.domains.io.data import Origin
from ebb.domains.io.errors import NotFinite, UnknownFormat, UnreadableFile, Unsavable
from ebb.domains.io.files import plain_values
from ebb.domains.io.meshio import read_meshio_points, write_meshio
from ebb.domains.io.saving import replacing
from ebb.errors import MeshFormatError
from ebb.records import record

_POINTS = "numbers of the shape (n, d) with d from 1 to 3"


@record(eq=False)
class PointData:
    """Points of the shape (n, d), and arrays of a value for each, by name."""

    points: npt.NDArray[Any]
    values: dict[str, npt.NDArray[Any]]


def read_points(path: str | PathLike[str], dimension: int | None, precision: Any) -> PointData:
    """The points of a file, which ``precision``, an Ebb type, can hold.

    Args:
        path: an archive of NumPy's (.npz) with an array ``pos``, or any file that meshio reads.
        dimension: how many coordinates to take; those left out must be 0. None for all.
        precision: ``ebb.float32`` or ``ebb.float64``.

    Raises:
        MeshFormatError: the file cannot be read (E701), holds no such points or values (E702), or a coordinate is not
            finite (E706).
        BackendError: the format is one of meshio's, and meshio is not installed.
    """
    name = str(path)
    if Path(path).suffix.lower() == ".npz":
        values = _read_archive(path)
        if "pos" not in values:
            found = ", ".join(map(repr, values)) or "nothing"
            raise MeshFormatError(UnknownFormat(name, f"it has {found}, and no array 'pos'", "points"))
        points = values.pop("pos")
    else:
        points, values = read_meshio_points(path)
    if points.ndim != 2 or not 1 <= points.shape[1] <= 3 or points.dtype.kind not in "iuf":
        reason = f"its points are {points.dtype} of the shape {points.shape}, and no {_POINTS}"
        raise MeshFormatError(UnknownFormat(name, reason, "points"))
    for field, each in values.items():
        if each.shape[:1] != points.shape[:1]:
            reason = f"{field!r} has the shape {each.shape}, and there are {len(points)} points"
            raise MeshFormatError(UnknownFormat(name, reason, "points"))
    with np.errstate(over="ignore"):
        finite = np.isfinite(points.astype(precision.dtype)).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise MeshFormatError(NotFinite("point", row, Origin(Source(name, "")), tuple(map(float, points[row]))))
    return PointData(_of_dimension(name, points, dimension), values)


def write_points(path: str | PathLike[str], particles: ebb.Relation, fields: Iterable[str | ebb.Field] | None) -> None:
    """Write ``pos`` and other fields of particles.

    Raises:
        MeshFormatError: the file cannot be written, or has no place for a field.
        BackendError: the format is one of meshio's, and meshio is not installed.
    """
    name = str(path)
    points = particles.fields["pos"].to_numpy()
    if fields is None:
        chosen = [field for field in particles.fields.values() if field.target is None]
    else:
        chosen = [_own_field(name, particles, field) for field in fields]
    chosen = [field for field in chosen if field.name != "pos"]
    if Path(path).suffix.lower() == ".npz":
        values = {"pos": points, **{field.name: field.to_numpy() for field in chosen}}
        with replacing(path) as file, file.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **values)  # pyright: ignore[reportArgumentType]
        return
    padded = np.zeros((len(points), 3), points.dtype)
    padded[:, : points.shape[1]] = points
    vertices = [("vertex", np.arange(len(points))[:, None])]
    write_meshio(path, padded, vertices, {field.name: plain_values(field) for field in chosen}, {})


def _read_archive(path: str | PathLike[str]) -> dict[str, npt.NDArray[Any]]:
    from zipfile import BadZipFile

    try:
        archive: Any = np.load(path, allow_pickle=False)
        if isinstance(archive, np.ndarray):
            raise MeshFormatError(UnknownFormat(str(path), "it holds one array, and is no archive", "points"))
        with archive:
            return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise MeshFormatError(UnreadableFile(str(path), error.strerror or str(error))) from None
    except (ValueError, EOFError, KeyError, NotImplementedError, BadZipFile) as error:
        raise MeshFormatError(UnknownFormat(str(path), f"NumPy says {str(error)!r}", "points")) from None


def _of_dimension(name: str, points: npt.NDArray[Any], dimension: int | None) -> npt.NDArray[Any]:
    if dimension is None or dimension == points.shape[1]:
        return points
    if dimension > points.shape[1] or points[:, dimension:].any():
        reason = f"its points have {points.shape[1]} coordinates, and {dimension} are asked for"
        raise MeshFormatError(UnknownFormat(name, reason, "points"))
    return points[:, :dimension]


def _own_field(path: str, particles: ebb.Relation, field: str | ebb.Field) -> ebb.Field:
    if isinstance(field, str):
        found = particles.fields.get(field)
        if found is None:
            close = nearest(field, particles.fields)
            meant = f"; did you mean {close!r}?" if close else ""
            raise MeshFormatError(Unsavable(path, f"{particles.name} has no field {field!r}{meant}"))
        field = found
    if field.relation is not particles:
        raise MeshFormatError(Unsavable(path, f"the field {field.path} is none of these particles"))
    if field.target is not None:
        raise MeshFormatError(Unsavable(path, f"the field {field.path} holds keys, which mean nothing in a file"))
    return field
