"""Meshes that can be written into files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from os import PathLike

import ebb
from ebb.domains.io.data import MeshData, PolyData
from ebb.domains.io.files import values_to_save, write_mesh
from ebb.domains.io.polygons import write_polygons


class Savable(ABC):
    """A mesh of cells at vertices: ``save`` writes it."""

    vertices: ebb.Relation

    @abstractmethod
    def _to_save(self) -> tuple[MeshData | PolyData, ebb.Relation]:
        """The cells that are written, and their relation; where the points are does not count."""

    def save(
        self,
        path: str | PathLike[str],
        fields: Iterable[str | ebb.Field] = (),
        positions: str | ebb.Field | None = None,
    ) -> None:
        """Write the mesh in the format that the suffix names.

        Surfaces are written as OFF and solids of tetrahedra as VEG by Ebb itself, everything else by meshio: surfaces
        as vtu, vtk, ply, obj and more, tetrahedra and hexahedra as vtu, vtk, msh and more, polyhedra as vtu. But for
        OFF the polygons or polyhedra of a ``PolyMesh`` are sorted by their number of vertices; the elements of a
        ``HexGrid`` are written with the last axis fastest.

        Args:
            path: where to.
            fields: to save with it: names of fields of the vertices, or fields of the vertices or of the cells: the
                triangles, tetrahedra or elements, of a ``PolyMesh`` the cells of a solid, the faces of a surface.
            positions: the field of the vertices that says where they are, by default ``pos``.

        Raises:
            MeshFormatError: the file cannot be written, or has no place for the mesh or a field.
            BackendError: the format is one of meshio's, and meshio is not installed.
        """
        mesh, cells = self._to_save()
        saved = values_to_save(str(path), self.vertices, cells, positions, fields)
        match mesh:
            case MeshData():
                write_mesh(path, mesh, saved)
            case PolyData():
                write_polygons(path, mesh, saved)
