"""Surfaces of triangles as relations: vertices, directed edges, triangles."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy.typing as npt

import ebb
from ebb.domains import generators
from ebb.domains.checks import check_triangles, mesh_data
from ebb.domains.io.data import Integers, MeshData
from ebb.domains.io.files import read_triangles
from ebb.domains.savable import Savable
from ebb.domains.topology import corner_rows, directed_edges, faces_of_tetrahedra, used_points

_EDGES = {"e01": (0, 1), "e10": (1, 0), "e12": (1, 2), "e21": (2, 1), "e20": (2, 0), "e02": (0, 2)}


class TriMesh(Savable):
    """A surface of triangles that all turn the same way; it may have a boundary, and several parts.

    With ``manifold=False`` any number of triangles may meet at an edge, turning as they like.

    Make one by ``from_arrays``, ``load`` or a generator. In kernels, for a vertex ``v``: ``v.edges`` are the edges that
    start there, ``v.neighbors`` the vertices at their other ends, ``v.triangles`` the triangles that have it as a
    corner.

    Attributes:
        vertices: ``pos`` (vec3f).
        edges: each edge in both directions: ``tail`` and ``head`` (vertices); grouped by tail.
        triangles: ``v`` (3 vertices), and ``e01 e10 e12 e21 e20 e02`` (edges): from ``v[i]`` to ``v[j]``.
        corners: a row for each triangle at each vertex: ``vertex``, ``triangle``; grouped by vertex.
    """

    def __init__(self, mesh: MeshData, *, manifold: bool = True) -> None:
        """The relations of a mesh that has been read or generated.

        Raises:
            MeshFormatError: the arrays make no surface (E705 to E707, E709, E710).
        """
        check_triangles(mesh, manifold)
        self._mesh = mesh
        cells, n = mesh.cells, len(mesh.points)
        found = directed_edges(cells, n)
        self.vertices = ebb.Relation("vertices", size=n)
        self.edges = ebb.Relation("edges", size=len(found.tail))
        self.triangles = ebb.Relation("triangles", size=len(cells))
        self.vertices.new_field("pos", ebb.vec3f, init=mesh.points)
        self.edges.new_field("tail", self.vertices, init=found.tail)
        self.edges.new_field("head", self.vertices, init=found.head)
        self.edges.group_by("tail")
        self.triangles.new_field("v", ebb.vector(self.vertices, 3), init=cells)
        for name, (i, j) in _EDGES.items():
            self.triangles.new_field(name, self.edges, init=found.of_cell[:, i, j])
        self.corners = corner_relation(self.vertices, self.triangles, "triangle", cells)
        add_vertex_members(self.vertices, self.edges)

        corners = self.corners

        @self.vertices.member
        def triangles(v: Any) -> Any:
            return ebb.where(corners.vertex, v).triangle

    @classmethod
    def from_arrays(cls, positions: npt.ArrayLike, triangles: npt.ArrayLike, *, manifold: bool = True) -> TriMesh:
        """A surface from points of the shape (n, 3) and corners of the shape (m, 3), numbered from 0.

        Args:
            positions: the coordinates, in any unit of length.
            triangles: the corners of each.
            manifold: whether to check that at most two triangles meet at an edge and that neighbours turn the same way.

        Raises:
            MeshFormatError: wrong shapes or kinds of numbers, an index that is no point, a coordinate that is not
                finite, a triangle without area, or, if ``manifold``, more than two triangles at an edge or neighbours
                that turn oppositely.
        """
        return cls(mesh_data(positions, triangles, 3, "triangles"), manifold=manifold)

    @classmethod
    def load(cls, path: str | PathLike[str], *, manifold: bool = True) -> TriMesh:
        """A surface from an OFF file, or from any format that meshio reads; ``manifold`` as in ``from_arrays``.

        Raises:
            MeshFormatError: the file cannot be read, is malformed, or makes no surface; it names the line.
            BackendError: the format is one of meshio's, and meshio is not installed.
        """
        return cls(read_triangles(path), manifold=manifold)

    def _to_save(self) -> tuple[MeshData, ebb.Relation]:
        return self._mesh, self.triangles

    @classmethod
    def icosphere(cls, subdivisions: int = 3, radius: float = 1.0) -> TriMesh:
        """A sphere about the origin of 20 * 4**subdivisions triangles of similar size."""
        return cls(MeshData(*generators.icosphere(subdivisions, radius)))

    @classmethod
    def torus(cls, major: float = 1.0, minor: float = 0.4, n_major: int = 48, n_minor: int = 24) -> TriMesh:
        """A torus about the z axis: a tube of the radius ``minor`` along a circle of the radius ``major``."""
        return cls(MeshData(*generators.torus(major, minor, n_major, n_minor)))

    @classmethod
    def grid(cls, nx: int, ny: int, size: tuple[float, float] = (1.0, 1.0)) -> TriMesh:
        """A rectangle in the plane z = 0, with a corner at the origin, of nx * ny squares of two triangles each."""
        return cls(MeshData(*generators.grid(nx, ny, size)))

    @classmethod
    def box(cls, nx: int, ny: int, nz: int, size: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> TriMesh:
        """The surface of a box with a corner at the origin, of nx * ny * nz cubes."""
        points, cells = generators.box((nx, ny, nz), size)
        used, triangles = used_points(faces_of_tetrahedra(cells, len(points)).boundary)
        return cls(MeshData(points[used], triangles))

    def __repr__(self) -> str:
        return (
            f"<TriMesh: {self.vertices.size} vertices, {self.edges.size} directed edges, "
            f"{self.triangles.size} triangles>"
        )


def corner_relation(vertices: ebb.Relation, cells: ebb.Relation, cell: str, corners: Integers) -> ebb.Relation:
    """The incidence of vertices and cells: a row (``vertex``, ``cell``) for each corner, grouped by vertex."""
    vertex, row = corner_rows(corners)
    relation = ebb.Relation("corners", size=len(row))
    relation.new_field("vertex", vertices, init=vertex)
    relation.new_field(cell, cells, init=row)
    relation.group_by("vertex")
    return relation


def add_vertex_members(vertices: ebb.Relation, mesh_edges: ebb.Relation) -> None:
    """``v.edges``, the edges that start at ``v``, and ``v.neighbors``, the vertices where they end."""

    @vertices.member
    def edges(v: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return ebb.where(mesh_edges.tail, v)

    @vertices.member
    def neighbors(v: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return ebb.where(mesh_edges.tail, v).head
