"""Regular grids as relations: cells, vertices, edges and faces, and their duals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import ebb
from ebb.domains.errors_grid import OddGrid
from ebb.domains.grid_arguments import check_geometry
from ebb.domains.grid_elements import Kind, add_map, make_relations, plural
from ebb.domains.grid_locate import LocatedRelation, wrapper
from ebb.errors import RelationError


class Grid:
    """What grids of all dimensions have in common. Make a ``Grid1D``, ``Grid2D`` or ``Grid3D``.

    The cell with the indices ``(i, j)`` has its centre at ``origin + (i + 0.5, j + 0.5) * spacing``, and its lower
    corner is the vertex ``(i, j)``. In kernels the element of any kind whose indices are those of ``c`` plus constants
    is ``c.vertex(1, 1)``, ``c.xface(1, 0)``, ``v.cell(-1, -1)`` and so on; ``c(1, 0)`` is another of the same kind, and
    ``c.clamped(1, 0)`` is too, held within the grid. On either side of ``c`` lie the neighbours ``c.xneg`` and
    ``c.xpos``, and what it ends at or what ends at it: ``c.xneg_face``, ``f.xpos_cell``, ``v.yneg_edge``.

    Attributes:
        shape: the number of cells in each dimension.
        origin: the lower corner of the domain.
        extent: the lengths of its sides.
        spacing: the lengths of the sides of a cell.
        periodic: for each dimension, whether it wraps.
        boundary_depth: how many layers of elements the boundary has, in each dimension; 0 in periodic ones.
        precision: the type of the numbers of ``center``.
        wrap: ``grid.wrap(pos)`` in kernels: the point in the domain that stands for ``pos``: periodic dimensions wrap.
        cells: between vertices. They, like all elements, have ``center`` (also called ``pos``), ``in_boundary`` and
            ``in_interior``, and the subsets ``interior`` and ``boundary``, ``inside`` and ``walls``.
        vertices: the corners of cells: one more than cells in each dimension, or as many where it is periodic.
        dual_cells: between the centres of neighbouring cells: one less than cells in each dimension, or as many where
            it is periodic.
        dual_vertices: the centres of cells.
        edges: by the axis along which they lie: from a vertex, ``tail``, to the next, ``head``.
        faces: by the axis that they are normal to. In two dimensions faces are edges: ``xfaces`` is ``yedges``.
        coarse: what ``coarsen`` gave, or None.
        fine: the grid that this one is the coarser of, or None.
    """

    _ndim: ClassVar[int]

    cells: LocatedRelation
    vertices: ebb.Relation
    dual_cells: LocatedRelation
    dual_vertices: ebb.Relation
    xedges: ebb.Relation
    xfaces: ebb.Relation

    def __init__(
        self,
        shape: Any,
        origin: Any = 0.0,
        extent: Any = None,
        periodic: Any = False,
        boundary_depth: Any = 1,
        *,
        precision: Any = ebb.float32,
    ) -> None:
        """A grid of ``shape`` cells. Where an argument is one number or bool, it stands for all dimensions.

        Args:
            shape: the number of cells in each dimension.
            origin: the lower corner of the domain.
            extent: the lengths of its sides; by default those of cells are 1.
            periodic: for each dimension, whether it wraps.
            boundary_depth: how many layers of elements the boundary has in each dimension that does not wrap.
            precision: the type of the numbers of ``center``, ``ebb.float32`` or ``ebb.float64``.

        Raises:
            RelationError: a count is not positive, an extent neither, an argument is of the wrong length or kind, or
                the boundary is deeper than the grid (E530 to E533).
        """
        name = type(self).__name__
        geometry = check_geometry(name, self._ndim, shape, origin, extent, periodic, boundary_depth, precision)
        self.shape = geometry.shape
        self.origin = geometry.origin
        self.extent = geometry.extent
        self.spacing = geometry.spacing
        self.periodic = geometry.periodic
        self.boundary_depth = geometry.depth
        self.wrap: Callable[[Any], Any] = wrapper(geometry)
        self.coarse: Any = None
        self.fine: Any = None
        self.precision = precision
        self._relations = make_relations(geometry)
        for kind, relation in self._relations.items():
            for element in kind.names:
                setattr(self, plural(element), relation)

    @property
    def edges(self) -> tuple[ebb.Relation, ...]:
        """The edges along each axis."""
        return tuple(
            self._relations[Kind(tuple(other != axis for other in range(self._ndim)))] for axis in range(self._ndim)
        )

    @property
    def faces(self) -> tuple[ebb.Relation, ...]:
        """The faces normal to each axis."""
        return tuple(
            self._relations[Kind(tuple(other == axis for other in range(self._ndim)))] for axis in range(self._ndim)
        )

    @property
    def locate(self) -> Any:
        """``grid.locate(pos)`` in kernels: the cell that contains a point; it wraps, or is clamped.

        A point where cells meet belongs to the upper one. The rows of a field are located by
        ``grid.cells.point_locate(key_field, pos_field)``.
        """
        return self.cells.locate

    @property
    def dual_locate(self) -> Any:
        """``grid.dual_locate(pos)`` in kernels: the dual cell that contains a point, as ``locate`` for cells."""
        return self.dual_cells.locate

    def coarsen(self) -> Any:
        """The grid of the same domain with half as many cells in each dimension; always the same one.

        In kernels ``c.up`` is the coarser cell that contains ``c``, and ``C.down`` the first of the finer cells in
        ``C``: the others are ``C.down(1, 0)`` and so on. ``V.down`` is the finer vertex at the same place as ``V``, and
        ``v.up`` the coarser vertex at the same place as ``v`` or next below it. Edges, faces and dual vertices have
        these members too: ``down`` doubles the indices, ``up`` halves them.

        Raises:
            RelationError: the number of cells is odd in some dimension (E534).
        """
        if self.coarse is None:
            odd = next((axis for axis, count in enumerate(self.shape) if count % 2), None)
            if odd is not None:
                raise RelationError(OddGrid(self.shape, odd))
            shape = tuple(count // 2 for count in self.shape)
            depth = tuple(map(min, self.boundary_depth, shape))
            coarse = type(self)(shape, self.origin, self.extent, self.periodic, depth, precision=self.precision)
            self._link(coarse)
            self.coarse, coarse.fine = coarse, self
        return self.coarse

    def _link(self, coarse: Grid) -> None:
        for kind, relation in self._relations.items():
            if kind.dual and not any(kind.points):
                continue  # a dual cell lies in one of the coarser grid, or across two
            coarser = coarse._relations[kind]
            add_map(relation, "up", coarser, _scaled(self._ndim, 0.5))
            add_map(coarser, "down", relation, _scaled(self._ndim, 2))

    def __repr__(self) -> str:
        shape = " x ".join(map(str, self.shape))
        extent = " x ".join(f"{length:g}" for length in self.extent)
        wraps = [axis for axis, periodic in zip("xyz", self.periodic, strict=False) if periodic]
        periodic = f", periodic in {' and '.join(wraps)}" if wraps else ""
        return f"<{type(self).__name__}: {shape} cells, {extent} from {self.origin}{periodic}>"


class Grid1D(Grid):
    """A line of cells: vertices are their faces too, and cells are edges."""

    _ndim = 1


class Grid2D(Grid):
    """A rectangle of cells: their sides are edges, ``xedges`` and ``yedges``, and faces, ``yfaces`` and ``xfaces``."""

    _ndim = 2

    yedges: ebb.Relation
    yfaces: ebb.Relation


class Grid3D(Grid):
    """A box of cells, with faces normal to each axis and edges along each."""

    _ndim = 3

    yedges: ebb.Relation
    zedges: ebb.Relation
    yfaces: ebb.Relation
    zfaces: ebb.Relation


def _scaled(ndim: int, factor: float) -> tuple[tuple[Any, ...], ...]:
    """The matrix that multiplies all indices by ``factor``."""
    rows = range(ndim)
    return tuple((*(factor if row == column else 0 for column in rows), 0) for row in rows)
