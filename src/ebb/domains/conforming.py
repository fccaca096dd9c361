"""A closed surface filled with tetrahedra of which its own triangles are the boundary, by TetGen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ebb.domains.errors_solid import MissingTetgen, NotTetrahedralised
from ebb.domains.generators import require_count
from ebb.domains.io.data import Floats, Integers, MeshData
from ebb.domains.lattice import check_closed
from ebb.errors import BackendError, MeshFormatError

_LEFT = ("_skipped.node", "_skipped.face")
"""What TetGen writes into the current folder when it fails."""

_REGULAR = 2**0.5 / 12
"""The volume of a regular tetrahedron with edges of length 1."""


def tetrahedralise(points: Floats, triangles: Integers, resolution: int) -> MeshData:
    """Tetrahedra inside a surface.

    Args:
        points: shape (n, 3).
        triangles: shape (m, 3), outward, and closed.
        resolution: of how many regular tetrahedra as large as is wanted the edges would span the longest side
            of the surface's bounding box.

    Raises:
        MeshFormatError: the surface is not closed (E711), or TetGen finds no solid in it, say since it cuts itself.
        BackendError: the package tetgen is not installed.
        ValueError: the resolution is no integer >= 1.
    """
    resolution = require_count("resolution", resolution, 1)
    check_closed(triangles, len(points))
    try:
        import tetgen  # pyright: ignore[reportMissingTypeStubs]
    except ModuleNotFoundError:
        raise BackendError(MissingTetgen()) from None
    used = points[triangles]
    size = float(np.ptp(used.reshape(-1, 3), axis=0).max()) / resolution
    left = [path for path in map(Path, _LEFT) if not path.exists()]
    surface: Any = tetgen.TetGen(points, triangles.astype(np.int32))
    try:
        found = surface.tetrahedralize(
            quality=True,
            minratio=1.4,
            mindihedral=10,
            maxvolume=_REGULAR * size**3,
            fixedvolume=True,
            steinerleft=-1,
        )
    except RuntimeError as error:
        for path in left:
            path.unlink(missing_ok=True)
        raise MeshFormatError(NotTetrahedralised(str(error))) from None
    return MeshData(np.array(found[0], dtype=np.float64), np.array(found[1], dtype=np.int64))
