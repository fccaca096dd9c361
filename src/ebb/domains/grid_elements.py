"""The elements of a grid, cells to vertices, and the affine maps from one to another: no key is stored.

Along each axis an element either stands at a point, as vertices do, or spans from one point to the next, as cells do.
The index of a span is that of its lower point. So all that lies around an element has its indices, plus constants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import ebb
from ebb.domains.grid_arguments import Geometry
from ebb.domains.grid_locate import LocatedRelation
from ebb.records import record

AXES = "xyz"


@record
class Kind:
    """A kind of elements.

    Attributes:
        points: for each axis, whether the elements stand at points of it rather than span from one to the next.
        dual: whether these points are the centres of cells, rather than their corners.
    """

    points: tuple[bool, ...]
    dual: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """What an element is called; in two dimensions the sides of cells are edges, and faces too."""
        ndim, spans = len(self.points), self.points.count(False)
        if self.dual:
            return ("dual_cell" if spans else "dual_vertex",)
        names: list[str] = []
        if spans in (0, ndim):
            names.append("cell" if spans else "vertex")
        if spans == 1:
            names.append(f"{AXES[self.points.index(False)]}edge")
        if spans == ndim - 1:
            names.append(f"{AXES[self.points.index(True)]}face")
        return tuple(names)

    @property
    def short_names(self) -> tuple[str, ...]:
        """The names without their axes."""
        return tuple(dict.fromkeys(name if name[0] not in AXES else name[1:] for name in self.names))

    def toggled(self, axis: int) -> Kind:
        """The kind that spans where this one stands, or stands where this one spans."""
        return Kind(tuple(point != (d == axis) for d, point in enumerate(self.points)), self.dual)

    def count(self, cells: int, axis: int, periodic: bool) -> int:
        """How many there are along an axis that has ``cells`` cells."""
        points = cells if periodic else cells - 1 if self.dual else cells + 1
        if self.dual:
            return cells if self.points[axis] else points
        return points if self.points[axis] else cells

    def place(self, axis: int) -> float:
        """Where the centre of the first lies along an axis, in cells from the origin."""
        if self.dual:
            return 0.5 if self.points[axis] else 1.0
        return 0.0 if self.points[axis] else 0.5


def kinds_of(ndim: int) -> tuple[Kind, ...]:
    """All kinds of elements of a grid: from cells to vertices, and the duals of these."""
    primal = [Kind(tuple(bool(bits >> axis & 1) for axis in range(ndim))) for bits in range(1 << ndim)]
    return (*primal, Kind((False,) * ndim, dual=True), Kind((True,) * ndim, dual=True))


def plural(name: str) -> str:
    """The name of the relation of the elements ``name``."""
    return name.removesuffix("ex") + "ices" if name.endswith("vertex") else f"{name}s"


def make_relations(geometry: Geometry) -> Mapping[Kind, ebb.Relation]:
    """A relation for each kind of elements, with the members that lead from each to all others."""
    relations = {kind: _relation(kind, geometry) for kind in kinds_of(geometry.ndim)}
    for kind, relation in relations.items():
        _add_center(relation, kind, geometry)
        _add_boundary(relation, geometry)
        _add_walls(relation, kind, geometry)
        _add_offset(relation, "__call__", relation)
        _add_offset(relation, "clamped", relation, edge="clamp")
        for other, target in relations.items():
            for name in other.names:
                _add_offset(relation, name, target)
        for axis in range(geometry.ndim):
            _add_pair(relation, axis, "", relation, (-1, 1))
            _add_incidence(relations, kind, axis)
    return relations


def _relation(kind: Kind, geometry: Geometry) -> ebb.Relation:
    sizes = zip(geometry.shape, geometry.periodic, strict=True)
    shape = tuple(kind.count(cells, axis, wraps) for axis, (cells, wraps) in enumerate(sizes))
    name = plural(kind.names[0])
    if any(kind.points):
        return ebb.Relation(name, shape=shape, periodic=geometry.periodic)
    first = tuple(kind.place(axis) - 0.5 for axis in range(geometry.ndim))
    return LocatedRelation(name, shape, geometry, first)


# ---- Where they lie ----


def _add_center(relation: ebb.Relation, kind: Kind, geometry: Geometry) -> None:
    vector = ebb.vector(geometry.precision, geometry.ndim)
    origin, spacing = ebb.constant(geometry.origin, vector), ebb.constant(geometry.spacing, vector)
    place = ebb.constant([kind.place(axis) for axis in range(geometry.ndim)], vector)

    @relation.member
    def center(c: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return origin + (vector(ebb.coords(c)) + place) * spacing

    relation.member("pos")(center.function)


def _add_boundary(relation: ebb.Relation, geometry: Geometry) -> None:
    """``in_boundary`` and ``in_interior``, and the subsets ``boundary`` and ``interior``: the outermost layers."""
    depths = geometry.depth
    inside = [(min(d, n), max(n - d, min(d, n))) for d, n in zip(depths, relation.shape, strict=True)]
    indices = ebb.vector(ebb.int32, geometry.ndim)
    low, high = (ebb.constant(list(ends), indices) for ends in zip(*inside, strict=True))

    @relation.member
    def in_interior(c: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return ebb.all(ebb.coords(c) >= low) and ebb.all(ebb.coords(c) < high)

    @relation.member
    def in_boundary(c: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return ebb.any(ebb.coords(c) < low) or ebb.any(ebb.coords(c) >= high)

    _add_subsets(relation, "interior", "boundary", inside)


def _add_walls(relation: ebb.Relation, kind: Kind, geometry: Geometry) -> None:
    """The subsets ``walls``, what lies where the domain ends, and ``inside``, what has cells on all sides."""
    walls = [int(p and not w and not kind.dual) for p, w in zip(kind.points, geometry.periodic, strict=True)]
    _add_subsets(relation, "inside", "walls", [(d, n - d) for d, n in zip(walls, relation.shape, strict=True)])


def _add_subsets(relation: ebb.Relation, inner: str, outer: str, box: Sequence[tuple[int, int]]) -> None:
    """The subset ``inner`` of a box, from the first to the last index along each axis, and ``outer`` of the rest."""
    whole = tuple(slice(0, n) for n in relation.shape)
    layers: list[tuple[slice, ...]] = [(slice(0, 0), *whole[1:])]
    for axis, (first, last) in enumerate(box):
        for layer in (slice(0, first), slice(last, relation.shape[axis])):
            layers.append((*whole[:axis], layer, *whole[axis + 1 :]))
    relation.new_subset(inner, tuple(slice(first, last) for first, last in box))
    relation.new_subset(outer, layers)


# ---- What lies around them ----


def _add_offset(source: ebb.Relation, name: str, target: ebb.Relation, edge: str = "check") -> None:
    """``c.name(di, dj)``: the element of ``target`` with the indices of ``c`` and these added.

    With ``edge`` ``"clamp"`` it is held within the grid.
    """
    if source.ndim == 1:

        @source.member(name)
        def move_1d(c: Any, di: Any = 0) -> Any:  # pyright: ignore[reportUnusedFunction]
            return ebb.affine(target, [[1, di]], c, edge=edge)

    elif source.ndim == 2:

        @source.member(name)
        def move_2d(c: Any, di: Any = 0, dj: Any = 0) -> Any:  # pyright: ignore[reportUnusedFunction]
            return ebb.affine(target, [[1, 0, di], [0, 1, dj]], c, edge=edge)

    else:

        @source.member(name)
        def move_3d(c: Any, di: Any = 0, dj: Any = 0, dk: Any = 0) -> Any:  # pyright: ignore[reportUnusedFunction]
            return ebb.affine(target, [[1, 0, 0, di], [0, 1, 0, dj], [0, 0, 1, dk]], c, edge=edge)


def _add_incidence(relations: Mapping[Kind, ebb.Relation], kind: Kind, axis: int) -> None:
    """What an element ends at along an axis that it spans, or what ends at it: a face of a cell, a cell of a face."""
    other = kind.toggled(axis)
    if other not in relations:
        return
    relation, target = relations[kind], relations[other]
    offsets = (-1, 0) if kind.points[axis] else (0, 1)
    for name in other.short_names:
        _add_pair(relation, axis, f"_{name}", target, offsets)
    if "edge" in kind.short_names and not kind.points[axis]:
        add_map(relation, "tail", target, _moved(relation.ndim, axis, 0))
        add_map(relation, "head", target, _moved(relation.ndim, axis, 1))


def _add_pair(relation: ebb.Relation, axis: int, suffix: str, target: ebb.Relation, offsets: tuple[int, int]) -> None:
    """``c.xneg_face`` and ``c.xpos_face``, or without a suffix the neighbours ``c.xneg`` and ``c.xpos``."""
    for sign, offset in zip(("neg", "pos"), offsets, strict=True):
        add_map(relation, f"{AXES[axis]}{sign}{suffix}", target, _moved(relation.ndim, axis, offset))


def add_map(source: ebb.Relation, name: str, target: ebb.Relation, matrix: Sequence[Sequence[Any]]) -> None:
    """``c.name``: the element of ``target`` at an affine map of the indices of ``c``."""

    @source.member(name)
    def mapped(c: Any) -> Any:  # pyright: ignore[reportUnusedFunction]
        return ebb.affine(target, matrix, c)


def _moved(ndim: int, axis: int, offset: int) -> tuple[tuple[int, ...], ...]:
    """The matrix that adds ``offset`` to one index."""
    rows = range(ndim)
    return tuple((*(int(row == column) for column in rows), offset if row == axis else 0) for row in rows)
