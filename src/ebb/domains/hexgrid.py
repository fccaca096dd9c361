"""Solids of hexahedra that lie as the cells of a grid do: what ``HexMesh`` has in keys, affine maps find here."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

import ebb
from ebb.domains.checks import largest_of
from ebb.domains.grid import Grid3D
from ebb.domains.hexahedra import PLACES, SIDES, brick_points, bricks, check_hexahedra, grid_points, named_sides
from ebb.domains.hexmesh import HexMesh
from ebb.domains.io.data import MeshData
from ebb.domains.savable import Savable


def _shifted(place: Iterable[int]) -> tuple[tuple[int, ...], ...]:
    """The affine map that adds ``place`` to the indices of an element."""
    x, y, z = place
    return (1, 0, 0, x), (0, 1, 0, y), (0, 0, 1, z)


# The maps from an element to its corners, and to what is beyond its sides.
_CORNERS = tuple(map(_shifted, PLACES.tolist()))
_ELEMENTS = tuple(map(_shifted, (-PLACES).tolist()))
_SIDES = tuple(_shifted(way if axis == other else 0 for other in range(3)) for axis in range(3) for way in (-1, 1))


class HexGrid(Savable):
    """A box of hexahedra, straight or bent, whose elements and vertices are grid relations, so that no key is stored.

    In kernels elements have the members that those of a ``HexMesh`` have: ``e.corner(i)``, a vertex; ``e.xneg`` and so
    on and ``e.beyond(side)``, an element, which is ``e`` itself where there is none; ``e.boundary(side)``, which is
    ``HexMesh.INTERIOR``, ``SYMMETRY`` or ``FREE``; ``e.v[i]`` is ``e.corner(i)``. So one kernel without annotation runs
    on both. Here ``i`` and ``side`` are numbers known when the kernel is compiled (``for side in (0, 1, 2):``).

    ``v.elements`` of a ``HexMesh`` has no counterpart, since at the boundary there are fewer than eight. Instead
    ``v.element(i)`` is the element whose corner ``i`` the vertex is, where ``v.has_element(i)``, and else one nearby.

    Attributes:
        vertices: ``pos`` (vec3f, or vec3d with ``precision=ebb.float64``). Subsets: the six sides, by name.
        elements: one less than vertices along each axis.
        shape: how many elements lie along each axis.
    """

    def __init__(self, points: npt.NDArray[Any], *, symmetry: Iterable[str] = (), precision: Any = ebb.float32) -> None:
        """The relations of points of the shape (nx + 1, ny + 1, nz + 1, 3), which are not checked."""
        largest_of(precision)
        nx, ny, nz = (count - 1 for count in points.shape[:3])
        self.shape: tuple[int, int, int] = (nx, ny, nz)
        self.vertices = ebb.Relation("vertices", shape=(nx + 1, ny + 1, nz + 1))
        self.elements = ebb.Relation("elements", shape=self.shape)
        self.vertices.new_field("pos", ebb.vector(precision, 3), init=points)
        for number, name in enumerate(SIDES):
            axis, upper = divmod(number, 2)
            end = slice(-1, None) if upper else slice(0, 1)
            self.vertices.new_subset(name, tuple(end if other == axis else slice(None) for other in range(3)))
        self._add_members(named_sides(symmetry))

    def _add_members(self, symmetry: set[str]) -> None:
        elements, vertices = self.elements, self.vertices
        kinds = tuple(HexMesh.SYMMETRY if name in symmetry else HexMesh.FREE for name in SIDES)
        last = tuple(count - 1 if upper else 0 for count in self.shape for upper in range(2))
        axes = (0, 0, 1, 1, 2, 2)

        @elements.member
        def corner(e: Any, i: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return ebb.affine(vertices, _CORNERS[i], e)

        @elements.member
        def beyond(e: Any, side: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return ebb.affine(elements, _SIDES[side], e, edge="clamp")

        @elements.member
        def boundary(e: Any, side: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return kinds[side] * ebb.int32(ebb.coords(e)[axes[side]] == last[side])

        @elements.member
        def v(e: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            c = e.corner
            return [c(0), c(1), c(2), c(3), c(4), c(5), c(6), c(7)]

        for number, name in enumerate(SIDES):
            _add_neighbor(elements, name, number)
        self._add_elements_of_vertices()

    def _add_elements_of_vertices(self) -> None:
        elements, vertices = self.elements, self.vertices
        nx, ny, nz = self.shape
        places: tuple[tuple[int, int, int], ...] = tuple((x, y, z) for x, y, z in PLACES.tolist())

        @vertices.member
        def element(v: Any, i: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            return ebb.affine(elements, _ELEMENTS[i], v, edge="clamp")

        @vertices.member
        def has_element(v: Any, i: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
            at = ebb.coords(v) - [places[i][0], places[i][1], places[i][2]]
            return ebb.all(at >= 0) and at.x < nx and at.y < ny and at.z < nz

    @classmethod
    def from_grid(
        cls, grid: Grid3D | npt.ArrayLike, *, symmetry: Iterable[str] = (), precision: Any = ebb.float32
    ) -> HexGrid:
        """The cells of a grid as elements.

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
        check_hexahedra(MeshData(made.points, made.cells), fix_orientation=False, largest=largest_of(precision))
        return cls(points, symmetry=symmetry, precision=precision)

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
    ) -> HexGrid:
        """A box with a corner at the origin, of nx * ny * nz bricks; the rest is as in ``from_grid``."""
        return cls(brick_points((nx, ny, nz), size), symmetry=symmetry, precision=precision)

    def _to_save(self) -> tuple[MeshData, ebb.Relation]:
        made = bricks(np.empty((*self.vertices.shape, 3)))
        return MeshData(made.points, made.cells), self.elements

    def __repr__(self) -> str:
        return f"<HexGrid: {' x '.join(map(str, self.shape))} elements>"


def _add_neighbor(elements: ebb.Relation, name: str, side: int) -> None:
    @elements.member(name)
    def neighbor(e: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return ebb.affine(elements, _SIDES[side], e, edge="clamp")
