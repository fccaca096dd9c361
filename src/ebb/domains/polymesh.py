"""Meshes of any polygons or polyhedra as relations: vertices, edges, faces, cells, and the tables that join them."""

from __future__ import annotations

from os import PathLike
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

import ebb
from ebb.domains import polyshapes
from ebb.domains.checks import as_points, largest_of
from ebb.domains.hexahedra import FACES
from ebb.domains.hexmesh import HexMesh
from ebb.domains.io.data import Integers, PolyData
from ebb.domains.io.polygons import read_polygons
from ebb.domains.polyhedra import (
    PolygonEdges,
    cell_faces,
    check_cells,
    check_polygons,
    check_surface,
    distinct_pairs,
    merged_faces,
    polygon_edges,
    ragged,
)
from ebb.domains.savable import Savable
from ebb.domains.tetmesh import TetMesh
from ebb.domains.topology import OUTWARD_FACES
from ebb.domains.trimesh import TriMesh


class PolyMesh(Savable):
    """A surface of any polygons, or a solid of any polyhedra.

    Make one by ``from_arrays``, ``from_mesh``, ``load`` or a generator. Each kind of element is a relation, and five
    tables of pairs join them, each grouped both ways (Bernstein et al. 2015, section 4.2: keys and query loops encode
    any incidence). So in kernels, for a vertex ``v``, an edge ``e``, a face ``f`` and a cell ``c``, one can loop over

    - ``v.edges v.faces v.cells``, and ``v.neighbors``, the vertices at the other ends of the edges;
    - ``e.vertices e.faces e.cells``;
    - ``f.vertices f.edges f.cells``: vertices and edges in their order around the face;
    - ``c.vertices c.edges c.faces``;

    and over the rows that join: ``v.ends e.ends``, ``v.corners e.corners f.corners``, ``f.sides c.sides``. ``f.center``
    is the mean of a face's corners, ``f.area`` its area as a vector along its normal, ``c.center`` the mean of a cell's
    vertices.

    Attributes:
        vertices: ``pos`` (vec3f, or vec3d with ``precision=ebb.float64``). Subsets ``boundary`` and ``interior``.
        edges: each once: ``tail`` and ``head`` (vertices). Subsets ``boundary`` and ``interior``.
        faces: polygons, of three vertices or more. Of a solid: subsets ``boundary`` and ``interior``.
        cells: polyhedra: ``volume`` (float64, of ``pos`` when the mesh was made). A surface has none.
        ends: the two ends of each edge: ``vertex``, ``edge``, and ``other``, the vertex at the other end.
        corners: the corners of each face: ``face``, ``vertex``, ``next``, the vertex after it around the face, and
            ``edge``, which leads there.
        sides: the faces of each cell: ``cell``, ``face``, and ``sign`` (int32): 1 if the normal leaves the cell, or -1.
        cell_vertices: the vertices of each cell: ``cell``, ``vertex``.
        cell_edges: the edges of each cell: ``cell``, ``edge``.
    """

    def __init__(self, mesh: PolyData, *, manifold: bool = True, precision: Any = ebb.float32) -> None:
        """The relations of a mesh that has been read or generated.

        Args:
            mesh: points, faces and cells.
            manifold: whether a surface is checked to be one: see ``from_arrays``.
            precision: the type of the coordinates, ``ebb.float32`` or ``ebb.float64``.

        Raises:
            MeshFormatError: the arrays make no surface or solid (E705 to E707, E709, E710, E712, E716 to E718).
        """
        shapes = check_polygons(mesh, largest_of(precision))
        edges = polygon_edges(mesh.faces, len(mesh.points))
        solid = len(mesh.cells) > 0
        if manifold and not solid:
            check_surface(mesh, edges)
        found = check_cells(mesh, edges, shapes)
        self._mesh = mesh
        self.vertices = ebb.Relation("vertices", size=len(mesh.points))
        self.edges = ebb.Relation("edges", size=len(edges.low))
        self.faces = ebb.Relation("faces", size=len(mesh.faces))
        self.cells = ebb.Relation("cells", size=len(mesh.cells))
        self.vertices.new_field("pos", ebb.vector(precision, 3), init=mesh.points)
        self.edges.new_field("tail", self.vertices, init=edges.low)
        self.edges.new_field("head", self.vertices, init=edges.high)
        self.cells.new_field("volume", ebb.float64, init=found.volumes)
        self._join_faces(edges)
        self._join_cells(edges, found.signs)
        _add_members(self)
        self._add_subsets(edges)

    def _join_faces(self, edges: PolygonEdges) -> None:
        faces = self._mesh.faces
        vertex = np.concatenate([edges.low, edges.high])
        order = np.argsort(vertex, kind="stable")
        other, number = np.concatenate([edges.high, edges.low]), np.tile(np.arange(len(edges.low)), 2)
        self.ends = ebb.Relation("ends", size=len(vertex))
        self.ends.new_field("vertex", self.vertices, init=vertex[order])
        self.ends.new_field("edge", self.edges, init=number[order])
        self.ends.new_field("other", self.vertices, init=other[order])
        self.corners = ebb.Relation("corners", size=len(faces.values))
        self.corners.new_field("face", self.faces, init=faces.rows)
        self.corners.new_field("vertex", self.vertices, init=faces.values)
        self.corners.new_field("next", self.vertices, init=faces.following)
        self.corners.new_field("edge", self.edges, init=edges.of_corner)
        _group(self.ends, "vertex", "edge")
        _group(self.corners, "face", "vertex", "edge")

    def _join_cells(self, edges: PolygonEdges, signs: Integers) -> None:
        cells = self._mesh.cells
        self.sides = ebb.Relation("sides", size=len(cells.values))
        self.sides.new_field("cell", self.cells, init=cells.rows)
        self.sides.new_field("face", self.faces, init=cells.values)
        self.sides.new_field("sign", ebb.int32, init=signs.astype(np.int32))
        _group(self.sides, "cell", "face")
        places = self._mesh.faces.places(cells.values)
        cell, at = cells.rows[places.rows], places.values
        self.cell_vertices = self._pairs("vertex", self.vertices, cell, self._mesh.faces.values[at])
        self.cell_edges = self._pairs("edge", self.edges, cell, edges.of_corner[at])

    def _pairs(self, name: str, target: ebb.Relation, cell: Integers, other: Integers) -> ebb.Relation:
        first, second = distinct_pairs(cell, other, target.size)
        relation = ebb.Relation(f"cell_{target.name}", size=len(first))
        relation.new_field("cell", self.cells, init=first)
        relation.new_field(name, target, init=second)
        _group(relation, "cell", name)
        return relation

    def _add_subsets(self, edges: PolygonEdges) -> None:
        """The boundary of a surface is made of edges with one face, that of a solid of faces with one cell."""
        faces = self._mesh.faces
        if len(self._mesh.cells):
            outer = np.bincount(self._mesh.cells.values, minlength=len(faces)) == 1
            self.faces.new_subset("boundary", outer)
            self.faces.new_subset("interior", ~outer)
            corner = outer[faces.rows]
            edge = np.bincount(edges.of_corner[corner], minlength=len(edges.low)) > 0
        else:
            edge = np.bincount(edges.of_corner, minlength=len(edges.low)) == 1
        vertex = np.zeros(self.vertices.size, dtype=bool)
        vertex[edges.low[edge]] = vertex[edges.high[edge]] = True
        used = np.zeros(self.vertices.size, dtype=bool)
        used[faces.values] = True
        for relation, boundary, interior in ((self.edges, edge, ~edge), (self.vertices, vertex, used & ~vertex)):
            relation.new_subset("boundary", boundary)
            relation.new_subset("interior", interior)

    @classmethod
    def from_arrays(
        cls,
        positions: npt.ArrayLike,
        faces: Any,
        cells: Any = None,
        *,
        face_offsets: npt.ArrayLike | None = None,
        cell_offsets: npt.ArrayLike | None = None,
        manifold: bool = True,
        precision: Any = ebb.float32,
    ) -> PolyMesh:
        """A surface, or with ``cells`` a solid, from points of the shape (n, 3), numbered from 0.

        Args:
            positions: the coordinates, in any unit of length.
            faces: the corners of each, in their order around it: lists of numbers of points, or an array of the shape
                (m, k), or with ``face_offsets`` all of them in one array.
            cells: the faces of each, in any order: lists of numbers of faces, or an array of the shape (m, k), or with
                ``cell_offsets`` all of them in one array. Faces need not turn outwards.
            face_offsets: where in ``faces`` each face begins, and at last where they end.
            cell_offsets: where in ``cells`` each cell begins, and at last where they end.
            manifold: whether to check, of a surface, that at most two faces meet at an edge and that neighbours turn
                the same way.
            precision: the type of the coordinates, ``ebb.float32`` or ``ebb.float64``.

        Raises:
            MeshFormatError: wrong shapes or kinds of numbers, an index that is no point or no face, a coordinate that
                is not finite, a face without area, a cell that is not closed or without volume, more than two cells at
                a face, and, if ``manifold``, more than two faces at an edge or neighbours that turn oppositely.
        """
        made = ragged("faces", faces, face_offsets)
        filled = ragged("cells", () if cells is None else cells, cell_offsets)
        return cls(PolyData(as_points(positions), made, filled), manifold=manifold, precision=precision)

    @classmethod
    def from_mesh(cls, mesh: TriMesh | TetMesh | HexMesh, *, precision: Any = ebb.float32) -> PolyMesh:
        """The same triangles, tetrahedra or hexahedra; vertices and elements keep their numbers."""
        points = mesh.vertices.pos.to_numpy().astype(np.float64)
        match mesh:
            case TriMesh():
                data = polyshapes.surface(points, ragged("faces", mesh.triangles.v.to_numpy(), None))
                return cls(data, manifold=False, precision=precision)
            case TetMesh():
                block = (mesh.tetrahedra.v.to_numpy().astype(np.int64), OUTWARD_FACES.tolist())
            case HexMesh():
                block = (mesh.elements.v.to_numpy().astype(np.int64), FACES.tolist())
        return cls(PolyData(points, *merged_faces(*cell_faces(*block))), precision=precision)

    @classmethod
    def load(cls, path: str | PathLike[str], *, manifold: bool = True, precision: Any = ebb.float32) -> PolyMesh:
        """The polyhedra of a file, or where it has none its polygons: from OFF, or from any format that meshio reads.

        Tetrahedra, hexahedra, wedges and pyramids are polyhedra, triangles and quadrangles polygons. ``manifold`` and
        ``precision`` are as in ``from_arrays``.

        Raises:
            MeshFormatError: the file cannot be read, is malformed, or makes no mesh; it names the line.
            BackendError: the format is one of meshio's, and meshio is not installed.
        """
        return cls(read_polygons(path), manifold=manifold, precision=precision)

    def _to_save(self) -> tuple[PolyData, ebb.Relation]:
        return self._mesh, self.cells if self.cells.size else self.faces

    @classmethod
    def grid(
        cls,
        nx: int,
        ny: int,
        size: tuple[float, float] = (1.0, 1.0),
        *,
        split: Literal["none", "checkered"] = "none",
        precision: Any = ebb.float32,
    ) -> PolyMesh:
        """A rectangle in the plane z = 0, with a corner at the origin, of nx * ny squares.

        With ``split="checkered"`` every second square is split into two triangles.
        """
        return cls(polyshapes.grid(nx, ny, size, split), precision=precision)

    @classmethod
    def globe(
        cls, n_around: int = 24, n_up: int = 12, radius: float = 1.0, *, precision: Any = ebb.float32
    ) -> PolyMesh:
        """A sphere about the origin of quadrangles between circles of latitude, with triangles at the poles."""
        return cls(polyshapes.globe(n_around, n_up, radius), precision=precision)

    @classmethod
    def goldberg(cls, subdivisions: int = 3, radius: float = 1.0, *, precision: Any = ebb.float32) -> PolyMesh:
        """A sphere about the origin of 12 pentagons and 10 * 4**subdivisions - 10 hexagons."""
        return cls(polyshapes.goldberg(subdivisions, radius), precision=precision)

    @classmethod
    def box(
        cls,
        nx: int,
        ny: int,
        nz: int,
        size: tuple[float, float, float] = (1.0, 1.0, 1.0),
        *,
        precision: Any = ebb.float32,
    ) -> PolyMesh:
        """A box with a corner at the origin, of nx * ny * nz bricks."""
        return cls(polyshapes.box((nx, ny, nz), size), precision=precision)

    @classmethod
    def dual(cls, solid: TetMesh, *, precision: Any = ebb.float32) -> PolyMesh:
        """A polyhedron about each vertex of a solid of tetrahedra, with a face across each of its edges.

        The tetrahedra of ``TetMesh.box`` give polyhedra of 14 faces, squeezed truncated octahedra, which fill space.

        Raises:
            ValueError: at an edge the tetrahedra are in several parts.
        """
        points, cells = solid.vertices.pos.to_numpy().astype(np.float64), solid.tetrahedra.v.to_numpy()
        return cls(polyshapes.dual(points, cells.astype(np.int64)), precision=precision)

    def __repr__(self) -> str:
        counts = ((r.name, r.size) for r in (self.vertices, self.edges, self.faces, self.cells) if r.size)
        return f"<PolyMesh: {', '.join(f'{size} {name}' for name, size in counts)}>"


def _group(relation: ebb.Relation, *fields: str) -> None:
    for field in fields:
        relation.group_by(field)


# A row of a table that joins, by the two kinds of element that it joins; and where it says so.
_TABLES = {
    "ends": ("vertex", "edge"),
    "corners": ("face", "vertex", "edge"),
    "sides": ("cell", "face"),
    "cell_vertices": ("cell", "vertex"),
    "cell_edges": ("cell", "edge"),
}
_PLURAL = {"vertex": "vertices", "edge": "edges", "face": "faces", "cell": "cells"}


def _add_members(mesh: PolyMesh) -> None:
    """Each table gives the members that find it from one side, and those that go through it to the other side."""
    relations = {"vertex": mesh.vertices, "edge": mesh.edges, "face": mesh.faces, "cell": mesh.cells}
    for table, kinds in _TABLES.items():
        rows: ebb.Relation = getattr(mesh, table)
        for kind in kinds:
            key = rows.fields[kind]
            if table in ("ends", "corners", "sides"):
                _add_rows(relations[kind], table, key)
            for other in kinds:
                # Vertices and edges of a face are joined by ``ends``.
                if other != kind and not (table == "corners" and "face" not in (kind, other)):
                    _add_others(relations[kind], _PLURAL[other], key, other)
    _add_others(mesh.vertices, "neighbors", mesh.ends.vertex, "other")
    _add_geometry(mesh)


def _add_rows(relation: ebb.Relation, name: str, key: Any) -> None:
    @relation.member(name)
    def rows(element: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return ebb.where(key, element)


def _add_others(relation: ebb.Relation, name: str, key: Any, other: str) -> None:
    @relation.member(name)
    def others(element: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return ebb.where(key, element)[other]


def _add_geometry(mesh: PolyMesh) -> None:
    place = mesh.vertices.pos.type

    def center(element: Any) -> Any:
        total, count = ebb.zeros(place), 0
        for v in element.vertices:
            total += v.pos
            count += 1
        return total / count

    for elements in (mesh.faces, mesh.cells):
        elements.member("center")(center)

    @mesh.faces.member("area")
    def face_area(f: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        total, middle = ebb.zeros(place), f.center
        for c in f.corners:
            total += ebb.cross(c.vertex.pos - middle, c.next.pos - middle)
        return total / 2
