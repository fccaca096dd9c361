"""The bodies and surfaces that the examples use: generated, from a file, or the bunny scan that pymeshfix ships."""

from __future__ import annotations

import importlib.util
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from ebb.domains import TetMesh, TriMesh
from ebb.errors import MeshFormatError

SURFACES = (".off", ".stl", ".ply", ".obj")


@dataclass(frozen=True)
class Body:
    """A solid, and the finer surface that shows it, if there is one. ``note`` says what the user should know."""

    name: str
    solid: TetMesh
    skin: TriMesh | None = None
    note: str = ""


def load_body(name: str, resolution: int) -> Body:
    """A ball, the bunny, or the body of a file, 1 m along its longest side, with z up.

    Args:
        name: ``ball``, ``bunny``, or the path of a mesh: of a solid, or of a closed surface, which is filled.
        resolution: how many tetrahedra lie along the longest side, where they are made here.
    """
    if name == "ball":
        return Body("ball", TetMesh.ball(max(2, resolution // 3), 0.5))
    if name == "bunny":
        lacking = what_bunny_lacks()
        if lacking is not None:
            note = f'The bunny needs {lacking} (pip install "ebblang[viz]"): a ball falls instead.'
            return Body("ball", TetMesh.ball(max(2, resolution // 3), 0.5), note=note)
        return _fill("bunny", *bunny_scan(), resolution)
    if Path(name).suffix.lower() in SURFACES:
        surface = TriMesh.load(name)
        return _fill(Path(name).stem, surface.vertices.pos.to_numpy(), surface.triangles.v.to_numpy(), resolution)
    # Springs ask for no orientation, so that none can be wrong.
    solid = TetMesh.load(name, fix_orientation=True)
    points = fitted(solid.vertices.pos.to_numpy())
    return Body(Path(name).stem, TetMesh.from_arrays(points, solid.tetrahedra.v.to_numpy()))


def load_solid(name: str, fix_orientation: bool, console: Console, **options: Any) -> TetMesh:
    """The solid of a file: .veg, .npz with ``V``, shape (n, 3), and ``T``, shape (m, 4), or any that meshio reads.

    If all tetrahedra are negative, they follow another convention than ours: they are turned, and that is said. If some
    are, that is an error, unless ``fix_orientation``. The other options are those of `TetMesh.load`.
    """
    turn = True if fix_orientation else None
    try:
        if Path(name).suffix.lower() == ".npz":
            solid = TetMesh.from_arrays(*_read_npz(name), fix_orientation=turn, **options)
        else:
            solid = TetMesh.load(name, fix_orientation=turn, **options)
    except MeshFormatError as error:
        if "E708" not in error.codes:
            raise
        raise ValueError(f"{error}\n--fix-orientation turns them, and leaves the others as they are") from None
    if solid.turned == solid.tetrahedra.size > 0:
        console.print(
            f"all {solid.turned} tetrahedra are negative, so of the other convention: they have been turned",
            soft_wrap=True,
        )
    elif solid.turned:
        console.print(
            f"{solid.turned} of the {solid.tetrahedra.size} tetrahedra were inverted, and have been turned",
            soft_wrap=True,
        )
    return solid


def _read_npz(name: str) -> tuple[np.ndarray, np.ndarray]:
    try:
        with np.load(name) as arrays:
            return arrays["V"], arrays["T"]
    except KeyError as error:
        raise ValueError(f"{name}: a mesh has the arrays V (points) and T (corners): {error.args[0]}") from None
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{name} cannot be read: {error}") from None


def what_bunny_lacks() -> str | None:
    """The package that is missing for the bunny, or None."""
    return next((name for name in ("pymeshfix", "pyvista") if importlib.util.find_spec(name) is None), None)


def bunny_scan() -> tuple[np.ndarray, np.ndarray]:
    """The Stanford bunny, a scan of 50,000 points that comes with pymeshfix, which also closes its holes here."""
    import pymeshfix
    import pyvista
    from pymeshfix.examples import bunny_scan as path

    scan = pyvista.read(path)
    closed = pymeshfix.MeshFix(np.asarray(scan.points), np.asarray(scan.regular_faces))
    closed.repair()
    return np.asarray(closed.points, dtype=np.float64), np.asarray(closed.faces, dtype=np.int64)


def bunny_surface(console: Console, otherwise: str) -> TriMesh | None:
    """The bunny, 1 m along its longest side; None where a package is missing for it, and ``otherwise`` happens."""
    lacking = what_bunny_lacks()
    if lacking is None:
        points, triangles = bunny_scan()
        return TriMesh.from_arrays(fitted(points), triangles)
    console.print(f'The bunny needs {lacking} (pip install "ebblang[viz]"): {otherwise}.', markup=False)
    return None


def fitted(points: np.ndarray) -> np.ndarray:
    """The points scaled to 1 m along their longest side, with their lowest above the origin."""
    low, high = points.min(axis=0), points.max(axis=0)
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return (points - foot) / np.ptp(points, axis=0).max()


def _fill(name: str, points: np.ndarray, triangles: np.ndarray, resolution: int) -> Body:
    skin = TriMesh.from_arrays(fitted(points), triangles)
    return Body(name, TetMesh.from_surface(skin, resolution=resolution), skin)
