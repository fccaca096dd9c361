"""Domain libraries: grids and meshes as relations, written with the public API alone, as users can write others."""

from __future__ import annotations

from ebb.domains.grid import Grid1D, Grid2D, Grid3D
from ebb.domains.tetmesh import TetMesh
from ebb.domains.trimesh import TriMesh

__all__ = ["Grid1D", "Grid2D", "Grid3D", "TetMesh", "TriMesh"]
