"""Solids of hexahedra as relations: vertices, elements with their six neighbours, quadrangles of the boundary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

import ebb
from ebb.domains.checks import largest_of, mesh_data
from ebb.domains.grid import Grid3D
from ebb.domains.hexahedra import (
    FACES,
    SIDES,
    brick_points,
    brick_sides,
    bricks,
    check_hexahedra,
    face_neighbors,
    grid_points,
    named_sides,
)
from ebb.domains.io.data import Integers, MeshData
from ebb.domains.io.errors import WrongArray
from ebb.domains.io.files import read_hexahedra
from ebb.domains.savable import Savable
from ebb.errors import MeshFormatError


class HexMesh(Savable):
    """A solid of hexahedra, at each corner of which the three edges are right-handed.

    Make one by ``from_arrays``, ``from_grid``, ``box`` or ``load``. The corners of an element are numbered as in VTK
    and LULESH: (0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0) in its own frame, and the same four with z = 1. Its sides are
    called ``xneg xpos yneg ypos zneg zpos`` in that frame.

    In kernels ``e.xneg`` is the element beyond that side, or ``e`` itself where there is none, so that it can always be
    followed; ``e.boundary(side)``, with a side from 0 to 5, is ``HexMesh.INTERIOR``, ``SYMMETRY`` or ``FREE`` (0, 1, 2)
    accordingly. ``e.corner(i)`` is ``e.v[i]``, and ``e.beyond(side)`` the neighbour there: so programs are written that
    run on a ``HexGrid`` too. For a vertex ``v``, ``v.elements`` are the elements that have it as a corner, and
    ``v.corners`` the rows of ``corners`` that say so.

    Attributes:
        vertices: ``pos`` (vec3f, or vec3d with ``precision=ebb.float64``). Subsets: each entry of ``symmetry``, and of
            a box or a grid each of the six sides, by its name.
        elements: ``v`` (8 vertices), ``xneg xpos yneg ypos zneg zpos`` (elements) and ``sides`` (int32: the kinds of
            the sides, two bits each).
        quads: the boundary: ``v`` (4 vertices), with the normal outwards, and ``element``.
        turned: how many elements were given inverted, and have been turned.
    """

    INTERIOR: ClassVar[int] = 0
    SYMMETRY: ClassVar[int] = 1
    FREE: ClassVar[int] = 2

    def __init__(
        self,
        mesh: MeshData,
        *,
        symmetry: Mapping[str, npt.ArrayLike] | None = None,
        precision: Any = ebb.float32,
        fix_orientation: bool | None = False,
        neighbors: Integers | None = None,
    ) -> None:
        """The relations of a mesh that has been read or generated.

        Args:
            mesh: the points and the corners of the elements.
            symmetry: as in ``from_arrays``.
            precision: the type of the coordinates, ``ebb.float32`` or ``ebb.float64``.
            fix_orientation: as in ``from_arrays``.
            neighbors: the element beyond each side, where it is known, of shape (n, 6).

        Raises:
            MeshFormatError: the arrays make no solid (E705 to E709, E712, E715, E719).
        """
        mesh, self.turned = check_hexahedra(mesh, fix_orientation=fix_orientation, largest=largest_of(precision))
        if neighbors is None:
            neighbors = face_neighbors(mesh)
        self.vertices = ebb.Relation("vertices", size=len(mesh.points))
        self.elements = ebb.Relation("elements", size=len(mesh.cells))
        self.vertices.new_field("pos", ebb.vector(precision, 3), init=mesh.points)
        self.elements.new_field("v", ebb.vector(self.vertices, 8), init=mesh.cells)
        for side, name in enumerate(SIDES):
            self.elements.new_field(name, self.elements, init=neighbors[:, side])
        sets = {} if symmetry is None else {name: _node_mask(mesh, name, rows) for name, rows in symmetry.items()}
        for name, mask in sets.items():
            self.vertices.new_subset(name, mask)
        self._add_boundary(mesh.cells, neighbors, sets.values())
        self._corners: ebb.Relation | None = None
        self._add_members()

    def _add_boundary(self, cells: Integers, neighbors: Integers, symmetry: Iterable[npt.NDArray[np.bool_]]) -> None:
        rows, sides = np.nonzero(neighbors == np.arange(len(cells))[:, None])
        quads = cells[rows[:, None], FACES[sides]]
        kinds = np.full(len(rows), self.FREE)
        for mask in symmetry:
            kinds[mask[quads].all(axis=1)] = self.SYMMETRY
        packed = np.zeros(len(cells), dtype=np.int32)
        np.bitwise_or.at(packed, rows, (kinds << (2 * sides)).astype(np.int32))
        self.elements.new_field("sides", ebb.int32, init=packed)
        self.quads = ebb.Relation("quads", size=len(rows))
        self.quads.new_field("v", ebb.vector(self.vertices, 4), init=quads)
        self.quads.new_field("element", self.elements, init=rows)

    def _add_members(self) -> None:
        mesh = self

        @self.elements.member
        def corner(e: Any, i: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return e.v[i]

        @self.elements.member
        def beyond(e: Any, side: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return e[SIDES[side]]

        @self.elements.member
        def boundary(e: Any, side: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return (e.sides >> (2 * side)) & 3

        @self.vertices.member
        def corners(v: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return ebb.where(mesh.corners.vertex, v)

        @self.vertices.member
        def elements(v: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return ebb.where(mesh.corners.vertex, v).element

    @property
    def corners(self) -> ebb.Relation:
        """A row for each element at each vertex: ``vertex``, ``element`` and ``number``, so that ``element.v[number]``
        is ``vertex``; grouped by vertex. It is made when it is first used: it takes 96 bytes an element.
        """
        if self._corners is None:
            vertex = self.elements.v.to_numpy().ravel()
            order = np.argsort(vertex, kind="stable")
            self._corners = ebb.Relation("corners", size=len(vertex))
            self._corners.new_field("vertex", self.vertices, init=vertex[order])
            self._corners.new_field("element", self.elements, init=order // 8)
            self._corners.new_field("number", ebb.int32, init=(order % 8).astype(np.int32))
            self._corners.group_by("vertex")
        return self._corners

    @classmethod
    def from_arrays(
        cls,
        positions: npt.ArrayLike,
        elements: npt.ArrayLike,
        *,
        symmetry: Mapping[str, npt.ArrayLike] | None = None,
        precision: Any = ebb.float32,
        fix_orientation: bool | None = False,
    ) -> HexMesh:
        """A solid from points of the shape (n, 3) and corners of the shape (m, 8), numbered from 0.

        Args:
            positions: the coordinates, in any unit of length.
            elements: the corners of each, in the order of VTK.
            symmetry: sets of points by name, each as bools of the shape (n,) or as numbers of points. They become
                subsets of the vertices; boundary faces all of whose corners are in one are planes of symmetry, the
                others are free.
            precision: the type of the coordinates, ``ebb.float32`` or ``ebb.float64``.
            fix_orientation: whether to exchange the lower and the upper face of inverted elements, rather than to
                raise. With None that is done if all are inverted, since then they follow another convention.

        Raises:
            MeshFormatError: wrong shapes or kinds of numbers, an index that is no point, a coordinate that is not
                finite, an element without volume, inverted or folded, more than two elements at a face, or an element
                given twice.
        """
        mesh = mesh_data(positions, elements, 8, "elements")
        return cls(mesh, symmetry=symmetry, precision=precision, fix_orientation=fix_orientation)

    @classmethod
    def from_grid(
        cls,
        grid: Grid3D | npt.ArrayLike,
        *,
        symmetry: Iterable[str] = (),
        precision: Any = ebb.float32,
    ) -> HexMesh:
        """The cells of a grid as elements; elements and vertices are numbered with the last axis fastest, as there.

        Args:
            grid: a ``Grid3D``, or points of the shape (nx + 1, ny + 1, nz + 1, 3), for a body that is a bent box.
            symmetry: those sides that are planes of symmetry, of ``xneg xpos yneg ypos zneg zpos``.
            precision: the type of the coordinates, ``ebb.float32`` or ``ebb.float64``.

        Raises:
            MeshFormatError: the array is of another shape, or an element without volume, inverted or folded.
            ValueError: the grid is periodic, or ``symmetry`` names no side.
        """
        points = grid_points(grid)
        made = bricks(points)
        x, y, z = points.shape[:3]
        sides, chosen = brick_sides((x, y, z)), named_sides(symmetry)
        mesh = cls(
            MeshData(made.points, made.cells),
            symmetry={name: rows for name, rows in sides.items() if name in chosen},
            precision=precision,
            neighbors=made.neighbors,
        )
        for name in sides:
            if name not in chosen:
                mesh.vertices.new_subset(name, sides[name])
        return mesh

    @classmethod
    def box(
        cls,
        nx: int,
        ny: int,
        nz: int,
        size: tuple[float, float, float] = (1.0, 1.0, 1.0),
        *,
        symmetry: Iterable[str] = (),
        precision: Any = ebb.float32,
    ) -> HexMesh:
        """A box with a corner at the origin, of nx * ny * nz bricks; the rest is as in ``from_grid``."""
        return cls.from_grid(brick_points((nx, ny, nz), size), symmetry=symmetry, precision=precision)

    @classmethod
    def load(
        cls,
        path: str | PathLike[str],
        *,
        symmetry: Mapping[str, npt.ArrayLike] | None = None,
        precision: Any = ebb.float32,
        fix_orientation: bool | None = None,
    ) -> HexMesh:
        """A solid from any format that meshio reads (vtu, vtk, msh, inp, ...).

        Inverted elements are by default turned if all are inverted, as in ``from_arrays``; ``turned`` has their count.

        Raises:
            MeshFormatError: the file cannot be read or makes no solid.
            BackendError: meshio is not installed.
        """
        return cls(read_hexahedra(path), symmetry=symmetry, precision=precision, fix_orientation=fix_orientation)

    def _to_save(self) -> tuple[MeshData, ebb.Relation]:
        return MeshData(np.empty((0, 3)), self.elements.v.to_numpy().astype(np.int64)), self.elements

    def __repr__(self) -> str:
        return (
            f"<HexMesh: {self.vertices.size} vertices, {self.elements.size} elements, "
            f"{self.quads.size} boundary quadrangles>"
        )


def _node_mask(mesh: MeshData, name: str, given: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Which points a set has: given as bools, or as numbers of points."""
    array, n = np.asarray(given), len(mesh.points)
    if array.dtype == np.bool_ and array.shape == (n,):
        return array
    if array.shape == (0,):
        return np.zeros(n, dtype=bool)
    rows = array.dtype.kind in "iu" and array.ndim == 1
    if not rows or (array.size and (array.min() < 0 or array.max() >= n)):
        found = f"{array.dtype} of the shape {array.shape}"
        raise MeshFormatError(WrongArray(f"symmetry[{name!r}]", f"{n} bools, or numbers of points below {n}", found))
    mask = np.zeros(n, dtype=bool)
    mask[array] = True
    return mask
