"""Solids of tetrahedra as relations: vertices, directed edges, tetrahedra, and the triangles of the boundary."""

from __future__ import annotations

from os import PathLike
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

import ebb
from ebb.domains import generators
from ebb.domains.checks import Solid, check_rows, check_tetrahedra, largest_of, mesh_data
from ebb.domains.embedding import embed_points
from ebb.domains.io.data import Floats, Integers, Material, MeshData, Region
from ebb.domains.io.errors import WrongArray
from ebb.domains.io.files import read_tetrahedra
from ebb.domains.lattice import fill_surface
from ebb.domains.refinement import refine_tetrahedra
from ebb.domains.savable import Savable
from ebb.domains.topology import directed_edges
from ebb.domains.trimesh import TriMesh, add_vertex_members, corner_relation
from ebb.errors import MeshFormatError


class TetMesh(Savable):
    """A solid of tetrahedra of positive volume, that is, whose corners 1, 2, 3 turn right as seen from corner 0.

    Make one by ``from_arrays``, ``load``, ``from_surface`` or a generator. In kernels, for a vertex ``v``: ``v.edges``
    are the edges that start there, ``v.neighbors`` the vertices at their other ends, ``v.tetrahedra`` the tetrahedra
    that have it as a corner. With ``self_edges=True`` each vertex has also an edge to itself, ``v.diag``, which is one
    of ``v.edges`` (and the vertex one of its neighbors): then edges are the entries of a sparse symmetric matrix.

    Attributes:
        vertices: ``pos`` (vec3f, or vec3d with ``precision=ebb.float64``), and with self edges ``diag`` (an edge).
        edges: each edge in both directions: ``tail`` and ``head`` (vertices); grouped by tail.
        tetrahedra: ``v`` (4 vertices), ``e`` (4 x 4 edges: from ``v[i]`` to ``v[j]``; the diagonal is unset without
            self edges) and ``volume`` (float64, of the mesh as it was made).
        triangles: the boundary: ``v`` (3 vertices), with the normal outwards.
        materials: those of a VEG file.
        regions: which tetrahedra are of which material, by a VEG file.
        turned: how many tetrahedra were given with a negative volume, and have been turned.
    """

    def __init__(
        self,
        mesh: MeshData,
        *,
        self_edges: bool = False,
        precision: Any = ebb.float32,
        fix_orientation: bool | None = False,
    ) -> None:
        """The relations of a mesh that has been read or generated.

        Raises:
            MeshFormatError: the arrays make no solid (E705 to E709, E719), or the precision is none (E712).
        """
        solid = check_tetrahedra(mesh, fix_orientation=fix_orientation, largest=largest_of(precision))
        self.turned = solid.turned
        self._points = solid.mesh.points
        self._self_edges, self._precision = self_edges, precision
        self.materials: tuple[Material, ...] = mesh.materials
        self.regions: tuple[Region, ...] = mesh.regions
        self._add_edges(solid)
        self.triangles = ebb.Relation("triangles", size=len(solid.boundary))
        self.triangles.new_field("v", ebb.vector(self.vertices, 3), init=solid.boundary)
        add_vertex_members(self.vertices, self.edges)
        self._corners: ebb.Relation | None = None
        mesh_of = self

        @self.vertices.member
        def tetrahedra(v: Any) -> Any:
            return ebb.where(mesh_of.corners.vertex, v).tetrahedron

    def _add_edges(self, solid: Solid) -> None:
        cells, n = solid.mesh.cells, len(self._points)
        found = directed_edges(cells, n, self._self_edges, solid.edges)
        self.vertices = ebb.Relation("vertices", size=n)
        self.edges = ebb.Relation("edges", size=len(found.tail))
        self.tetrahedra = ebb.Relation("tetrahedra", size=len(cells))
        self.vertices.new_field("pos", ebb.vector(self._precision, 3), init=self._points)
        self.edges.new_field("tail", self.vertices, init=found.tail)
        self.edges.new_field("head", self.vertices, init=found.head)
        self.edges.group_by("tail")
        if found.diagonal is not None:
            self.vertices.new_field("diag", self.edges, init=found.diagonal)
        self.tetrahedra.new_field("v", ebb.vector(self.vertices, 4), init=cells)
        # What is masked stays unset: following it in a kernel is an error.
        of_cell = found.of_cell if self._self_edges else np.ma.masked_less(found.of_cell, 0)
        self.tetrahedra.new_field("e", ebb.matrix(self.edges, 4, 4), init=of_cell)
        self.tetrahedra.new_field("volume", ebb.float64, init=solid.volume)

    @property
    def corners(self) -> ebb.Relation:
        """A row for each tetrahedron at each vertex: ``vertex``, ``tetrahedron``; grouped by vertex.

        It is what ``v.tetrahedra`` goes by, and made when it is first asked for.
        """
        if self._corners is None:
            cells = self.tetrahedra.v.to_numpy()
            self._corners = corner_relation(self.vertices, self.tetrahedra, "tetrahedron", cells)
        return self._corners

    @property
    def _mesh(self) -> MeshData:
        """The mesh as it was made."""
        cells = self.tetrahedra.v.to_numpy().astype(np.int64)
        return MeshData(self._points, cells, materials=self.materials, regions=self.regions)

    @classmethod
    def from_arrays(
        cls,
        positions: npt.ArrayLike,
        tetrahedra: npt.ArrayLike,
        *,
        self_edges: bool = False,
        precision: Any = ebb.float32,
        fix_orientation: bool | None = False,
    ) -> TetMesh:
        """A solid from points of the shape (n, 3) and corners of the shape (m, 4), numbered from 0.

        Args:
            positions: the coordinates, in any unit of length.
            tetrahedra: the corners of each.
            self_edges: whether each vertex gets an edge to itself.
            precision: the type of the coordinates in ``pos``, ``ebb.float32`` or ``ebb.float64``.
            fix_orientation: whether to exchange the corners 2 and 3 of tetrahedra of negative volume, rather than to
                raise. With None that is done if all are negative, since then they follow another convention.

        Raises:
            MeshFormatError: wrong shapes or kinds of numbers, an index that is no point, a coordinate that is not
                finite, a tetrahedron without volume or inverted, more than two tetrahedra at a face, or a tetrahedron
                given twice.
        """
        mesh = mesh_data(positions, tetrahedra, 4, "tetrahedra")
        return cls(mesh, self_edges=self_edges, precision=precision, fix_orientation=fix_orientation)

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        *,
        self_edges: bool = False,
        precision: Any = ebb.float32,
        fix_orientation: bool | None = None,
    ) -> TetMesh:
        """A solid from a VEG file, or from any format that meshio reads.

        Programs differ in which orientation they call positive, so by default the tetrahedra of a file all of which are
        negative are turned; ``turned`` has their count. Where only some are, that is an error, as in ``from_arrays``.

        Raises:
            MeshFormatError: the file cannot be read, is malformed, or makes no solid; it names the line.
            BackendError: the format is one of meshio's, and meshio is not installed.
        """
        mesh = read_tetrahedra(path)
        return cls(mesh, self_edges=self_edges, precision=precision, fix_orientation=fix_orientation)

    def _to_save(self) -> tuple[MeshData, ebb.Relation]:
        return self._mesh, self.tetrahedra

    @classmethod
    def box(
        cls,
        nx: int,
        ny: int,
        nz: int,
        size: tuple[float, float, float] = (1.0, 1.0, 1.0),
        *,
        self_edges: bool = False,
        precision: Any = ebb.float32,
    ) -> TetMesh:
        """A box with a corner at the origin, of nx * ny * nz cubes of six tetrahedra each."""
        return cls(MeshData(*generators.box((nx, ny, nz), size)), self_edges=self_edges, precision=precision)

    @classmethod
    def ball(
        cls, resolution: int = 6, radius: float = 1.0, *, self_edges: bool = False, precision: Any = ebb.float32
    ) -> TetMesh:
        """A ball about the origin of 20 * resolution**3 tetrahedra, on ``resolution`` concentric spheres."""
        return cls(MeshData(*generators.ball(resolution, radius)), self_edges=self_edges, precision=precision)

    @classmethod
    def from_surface(
        cls,
        surface: TriMesh | npt.ArrayLike,
        triangles: npt.ArrayLike | None = None,
        *,
        method: Literal["lattice", "conforming"] = "lattice",
        resolution: int = 32,
        self_edges: bool = False,
        precision: Any = ebb.float32,
    ) -> TetMesh:
        """A closed surface filled with tetrahedra.

        By ``"lattice"`` it is filled with cubes, each split into six tetrahedra (Kuhn). Kept are the cubes that have a
        corner or their centre inside, so the solid covers the surface but for slivers, and its own boundary has steps.
        Embed the surface in it (``embed``) to show the one by the other.

        By ``"conforming"`` its triangles become the boundary of the solid, some of them perhaps split, and the inside
        is filled by TetGen (Si, "TetGen, a Delaunay-based quality tetrahedral mesh generator", ACM TOMS 41, 2015),
        which needs the extra ``tetgen``. That package is under the AGPL.

        Args:
            surface: a ``TriMesh``, or its points of the shape (n, 3), and then
            triangles: the corners of the shape (m, 3), with normals outwards.
            method: ``"lattice"`` or ``"conforming"``.
            resolution: the number of cubes along the longest side of the bounding box; the tetrahedra of a conforming
                solid are hardly larger than a regular one with edges of the length of such a cube.
            self_edges: whether each vertex gets an edge to itself.
            precision: the type of the coordinates in ``pos``, ``ebb.float32`` or ``ebb.float64``.

        Raises:
            MeshFormatError: the surface is not closed, or its arrays are no surface's, or it cuts itself.
            BackendError: the package tetgen is not installed.
            ValueError: the resolution is no integer >= 1, there is no such method, or the surface has no extent.
        """
        if method not in ("lattice", "conforming"):
            raise ValueError(f"method is 'lattice' or 'conforming', not {method!r}")
        if isinstance(surface, TriMesh):
            points, cells = surface.vertices.pos.to_numpy(), surface.triangles.v.to_numpy()
        else:
            mesh = mesh_data(surface, () if triangles is None else triangles, 3, "triangles")
            check_rows(mesh, "triangle")
            points, cells = mesh.points, mesh.cells
        points, cells = points.astype(np.float64), cells.astype(np.int64)
        if method == "lattice":
            return cls(fill_surface(points, cells, resolution), self_edges=self_edges, precision=precision)
        from ebb.domains.conforming import tetrahedralise  # here: few programs ask for it

        return cls(tetrahedralise(points, cells, resolution), self_edges=self_edges, precision=precision)

    def refine(self) -> TetMesh:
        """The mesh with each tetrahedron split in eight, by the middles of its edges; options stay the same.

        It is of the mesh as it was made, whatever has become of ``pos``. Vertices keep their numbers, after them come
        the middles; the tetrahedra 8 i to 8 i + 7 are those of the tetrahedron i, and of its region.
        """
        return TetMesh(refine_tetrahedra(self._mesh), self_edges=self._self_edges, precision=self._precision)

    def embed(self, points: npt.ArrayLike) -> tuple[Integers, Floats]:
        """Place points in the mesh: the tetrahedron that holds each, or comes nearest, and barycentric weights there.

        The weights sum to 1 and, applied to the corners' ``pos`` as it was when the mesh was made, give the point back;
        for a point outside the mesh some are negative.

        Args:
            points: shape (n, 3).

        Returns:
            The rows of the tetrahedra, shape (n,), and the weights, shape (n, 4).

        Raises:
            MeshFormatError: the points are not finite numbers of the shape (n, 3), or the mesh has no tetrahedra.
        """
        given = mesh_data(points, (), 3, "triangles")
        check_rows(given, "triangle")
        if not self.tetrahedra.size:
            raise MeshFormatError(WrongArray("the mesh", "one with tetrahedra", "an empty one"))
        return embed_points(given.points, self._points, self._mesh.cells)

    def __repr__(self) -> str:
        return (
            f"<TetMesh: {self.vertices.size} vertices, {self.edges.size} directed edges, "
            f"{self.tetrahedra.size} tetrahedra, {self.triangles.size} boundary triangles>"
        )
