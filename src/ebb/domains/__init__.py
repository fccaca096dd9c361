"""Domain libraries: grids, meshes and particles as relations, written with the public API alone, as users can too."""

from __future__ import annotations

from ebb.domains.grid import Grid1D, Grid2D, Grid3D
from ebb.domains.hexgrid import HexGrid
from ebb.domains.hexmesh import HexMesh
from ebb.domains.particles import Particles
from ebb.domains.polymesh import PolyMesh
from ebb.domains.tetmesh import TetMesh
from ebb.domains.trimesh import TriMesh

__all__ = ["Grid1D", "Grid2D", "Grid3D", "HexGrid", "HexMesh", "Particles", "PolyMesh", "TetMesh", "TriMesh"]
