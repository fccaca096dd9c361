"""Domain libraries: meshes as relations, written with the public API alone, so that a user can write another."""

from __future__ import annotations

from ebb.domains.tetmesh import TetMesh
from ebb.domains.trimesh import TriMesh

__all__ = ["TetMesh", "TriMesh"]
