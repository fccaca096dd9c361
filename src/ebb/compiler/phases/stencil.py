"""The stencil of a kernel: its affine accesses from the own row, checked against the launched rows before a launch.

Every access is followed exactly, with floors, wraps and clamps, on arrays that hold one axis for each dimension of the
launched box. A coordinate that depends on one dimension alone stays a one-dimensional array, so that the check of an
ordinary stencil costs the sum of the extents of the grid, not their product.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np

from ebb.compiler import kir
from ebb.compiler.kir_walk import expressions
from ebb.compiler.phases.centered import Centered, find_centered, single_assignments
from ebb.compiler.phases.errors import StencilOutOfBounds
from ebb.diagnostics.span import Span
from ebb.errors import BoundsError
from ebb.records import record
from ebb.relations.relation import Relation
from ebb.relations.subset import RowSet, Subset
from ebb.types.types import KeyType, Type

if TYPE_CHECKING:
    import numpy.typing as npt

Coordinates: TypeAlias = "list[npt.NDArray[Any]]"
Matrix: TypeAlias = "tuple[tuple[kir.Entry, ...], ...]"

_Map: TypeAlias = "kir.Affine | Move"

_MOST_ROWS = 1 << 22
"""How many rows are followed at once, which bounds the memory of a check."""


@record
class Move:
    """What an affine access does to coordinates: that of ``kir.Affine`` without its place in the kernel."""

    matrix: Matrix
    edge: kir.Edge
    type: Type


@record
class Access:
    """An affine access of a kernel whose base is the kernel's own row.

    Attributes:
        node: the access. It needs no check in the kernel.
        steps: the affine maps from the own row to it, in the order in which they apply; the last is ``node``.
    """

    node: kir.Affine
    steps: tuple[kir.Affine, ...]


@record
class _Overrun:
    """The dimension in which an access leaves its grid, the indices that it asks for there, and a row that does."""

    dimension: int
    reach: tuple[int, int]
    row: tuple[int, ...]


def collect_stencil(kernel: kir.Kernel) -> tuple[Access, ...]:
    """The affine accesses of ``kernel`` whose base is its own row, each once, in source order."""
    maps = [expr for expr in expressions(kernel.body) if isinstance(expr, kir.Affine)]
    if not maps:
        return ()
    centered = find_centered(kernel)
    values = single_assignments(kernel)
    accesses: dict[kir.Affine, Access] = {}
    for expr in maps:
        if expr not in accesses:
            steps = _steps_to(expr, centered, values)
            if steps is not None:
                accesses[expr] = Access(expr, steps)
    return tuple(accesses.values())


def moves_of(accesses: Sequence[Access]) -> tuple[tuple[Move, ...], ...]:
    """The steps of the accesses that have to stay within their grids."""
    checked = [access for access in accesses if access.node.edge is kir.Edge.CHECK]
    return tuple(tuple(Move(step.matrix, step.edge, step.type) for step in access.steps) for access in checked)


def stays_inside(moves: Sequence[Sequence[Move]], rows: RowSet) -> bool:
    """Whether no access leaves its grid when the kernel runs on ``rows``, whatever the branches."""
    return all([_find_overrun(steps, rows) is None for steps in moves])


def check_stencil(kernel: kir.Kernel, accesses: Sequence[Access], rows: RowSet) -> None:
    """Checks that no access leaves its grid when ``kernel`` runs on ``rows``, whatever the branches.

    Raises:
        BoundsError: some do; all of them are reported, with subsets that would do.
    """
    checked = [access for access in accesses if access.node.edge is kir.Edge.CHECK]
    overruns = [(access, overrun) for access in checked if (overrun := _find_overrun(access.steps, rows)) is not None]
    if not overruns:
        return
    fitting, subset = _suggest_subsets(kernel.relation, checked)
    raise BoundsError(*(_diagnostic(kernel, access, overrun, fitting, subset) for access, overrun in overruns))


def target_of(node: _Map) -> Relation:
    """The grid whose row an affine access gives."""
    return cast(Relation, cast(KeyType, node.type).target)


def _steps_to(key: kir.Expr, centered: Centered, values: Mapping[int, kir.Expr]) -> tuple[kir.Affine, ...] | None:
    """The affine maps from the own row to ``key``, or None where its base is not the own row."""
    steps: list[kir.Affine] = []
    seen: set[int] = set()
    while True:
        match key:
            case kir.Affine():
                steps.append(key)
                key = key.key
            case kir.ReadLocal(local) if local.uid in centered.locals:
                return tuple(reversed(steps))
            case kir.ReadLocal(local) if local.uid in values and local.uid not in seen:
                seen.add(local.uid)
                key = values[local.uid]
            case _:
                return None


# ---- Following an access ----


def _find_overrun(steps: Sequence[_Map], rows: RowSet) -> _Overrun | None:
    """Where the last of ``steps`` leaves its grid; the others are accesses of their own."""
    for coordinates in _coordinates(rows):
        asked = _ask(steps, coordinates)
        for dimension, index in enumerate(asked):
            outside = find_outside(steps[-1], dimension, index)
            if outside is not None and outside.any():
                first = np.unravel_index(int(np.argmax(outside)), outside.shape)
                row = tuple(int(_at(axis, first)) for axis in coordinates)
                return _Overrun(dimension, _reach(steps, dimension, rows), row)
    return None


def _reach(steps: Sequence[_Map], dimension: int, rows: RowSet) -> tuple[int, int]:
    asked = [_ask(steps, coordinates)[dimension] for coordinates in _coordinates(rows)]
    return min(int(index.min()) for index in asked), max(int(index.max()) for index in asked)


def _ask(steps: Sequence[_Map], coordinates: Coordinates) -> Coordinates:
    """The indices that the last of ``steps`` asks for, before they wrap."""
    for step in steps[:-1]:
        coordinates = settled(step, map_coordinates(step.matrix, coordinates))
    return map_coordinates(steps[-1].matrix, coordinates)


def map_coordinates(matrix: Matrix, coordinates: Coordinates) -> Coordinates:
    """``floor(matrix @ [*coordinates, 1])``, exactly; a result has the axes of the coordinates it depends on."""
    return [_map_row(entries, coordinates) for entries in matrix]


def _map_row(entries: tuple[kir.Entry, ...], coordinates: Coordinates) -> npt.NDArray[Any]:
    scale = math.lcm(*(entry.denominator for entry in entries))
    factors = [int(entry * scale) for entry in entries]
    wide = sum(map(abs, factors)) > 1 << 30  # a product may not fit in 64 bits: follow it in Python's integers
    index = np.full((1,) * coordinates[0].ndim, factors[-1], dtype=object if wide else np.int64)
    for factor, coordinate in zip(factors, coordinates, strict=False):
        if factor:
            index = index + factor * coordinate.astype(index.dtype)
    return index // scale


def settled(step: _Map, asked: Coordinates) -> Coordinates:
    """The coordinates that a step gives: wrapped, or held within the grid."""
    target = target_of(step)
    return [
        index % max(extent, 1) if wraps else np.clip(index, 0, extent - 1)
        for index, extent, wraps in zip(asked, target.shape, target.periodic, strict=True)
    ]


def find_outside(step: _Map, dimension: int, index: npt.NDArray[Any]) -> npt.NDArray[np.bool_] | None:
    """Which indices lie outside the grid in a dimension, or None where it wraps."""
    target = target_of(step)
    extent = target.shape[dimension]
    if target.periodic[dimension] and extent:
        return None
    return np.asarray((index < 0) | (index >= extent), dtype=np.bool_)


def _at(axis: npt.NDArray[Any], place: Sequence[Any]) -> Any:
    """The entry of a coordinate at ``place``, which counts an axis of length 1 as any length."""
    return axis[tuple(min(int(index), extent - 1) for index, extent in zip(place, axis.shape, strict=True))]


# ---- The coordinates of the launched rows ----


def _coordinates(rows: RowSet) -> Iterator[Coordinates]:
    """The coordinates of ``rows`` in parts: of a box as an open mesh, of single rows as lists."""
    shape = rows.relation.shape
    if rows.boxes is not None:
        for box in rows.boxes:
            yield from _box_coordinates(box.start, box.stop)
        return
    positions = rows.row_positions()
    if positions is None:
        yield from _box_coordinates((0,) * len(shape), shape)
        return
    for first in range(0, len(positions), _MOST_ROWS):
        yield [axis.astype(np.int64) for axis in np.unravel_index(positions[first : first + _MOST_ROWS], shape)]


def _box_coordinates(start: Sequence[int], stop: Sequence[int]) -> Iterator[Coordinates]:
    extents = [last - first for first, last in zip(start, stop, strict=True)]
    if min(extents) <= 0:
        return
    thickness = max(1, _MOST_ROWS // max(1, math.prod(extents[1:])))
    for first in range(start[0], stop[0], thickness):
        slices = [slice(first, min(first + thickness, stop[0]))]
        slices += [slice(low, high) for low, high in zip(start[1:], stop[1:], strict=True)]
        yield open_mesh(slices)


def open_mesh(slices: Sequence[slice]) -> Coordinates:
    """The indices of each slice, along an axis of its own."""
    return [np.asarray(axis, dtype=np.int64) for axis in np.ogrid[tuple(slices)]]


# ---- The error ----


def _diagnostic(
    kernel: kir.Kernel, access: Access, overrun: _Overrun, fitting: str | None, subset: str | None
) -> StencilOutOfBounds:
    target = target_of(access.node)
    return StencilOutOfBounds(
        kernel=kernel.name,
        span=written_at(access.node.span),
        move=describe_move(access),
        source=kernel.relation.name,
        target=target.name,
        dimension=overrun.dimension,
        extent=target.shape[overrun.dimension],
        reach=overrun.reach,
        row=overrun.row,
        fitting=fitting,
        subset=subset,
    )


def written_at(span: Span) -> Span:
    """Where the access is written: ``c(1, 0)`` rather than the ``ebb.affine`` of the member that it calls."""
    return span if span.caller is None else span.caller


def describe_move(access: Access) -> str:
    """What an access does to the coordinates of the row: ``offset (1, 0)``, or ``map [[2, 0, 1], [0, 2, 0]]``."""
    matrix = access.steps[0].matrix
    for step in access.steps[1:]:
        matrix = _compose(step.matrix, matrix)
    linear = [[int(row == column) for column in range(len(matrix[0]) - 1)] for row in range(len(matrix))]
    if [list(entries[:-1]) for entries in matrix] == linear:
        offset = tuple(entries[-1] for entries in matrix)
        return f"offset {_tuple_text(offset)}"
    return f"map [{', '.join(f'[{_entries_text(entries)}]' for entries in matrix)}]"


def _compose(outer: Matrix, inner: Matrix) -> Matrix:
    """The map that applies ``inner``, then ``outer``, without the floors between."""
    rows: list[tuple[kir.Entry, ...]] = []
    for entries in outer:
        row = [
            sum(factor * inner[k][column] for k, factor in enumerate(entries[:-1])) for column in range(len(inner[0]))
        ]
        row[-1] += entries[-1]
        rows.append(tuple(row))
    return tuple(rows)


def _tuple_text(values: tuple[kir.Entry, ...]) -> str:
    return str(values[0]) if len(values) == 1 else f"({_entries_text(values)})"


def _entries_text(values: Sequence[kir.Entry]) -> str:
    return ", ".join(map(str, values))


def _suggest_subsets(relation: Relation, accesses: Sequence[Access]) -> tuple[str | None, str | None]:
    """The largest subset for which no access leaves its grid, and code that makes one that has more rows than it."""
    subsets = (found for found in relation._attributes.values() if isinstance(found, Subset) and found.size)  # pyright: ignore[reportPrivateUsage]
    good = [each for each in subsets if all(_find_overrun(access.steps, each) is None for access in accesses)]
    fitting = max(good, key=lambda each: each.size, default=None)
    name = None if fitting is None else f"{relation.name}.{fitting.name}"
    box = _largest_box(relation, accesses)
    if box is None or (fitting is not None and fitting.size >= math.prod(last - first for first, last in box)):
        return name, None
    slices = ", ".join(_slice_text(run, extent) for run, extent in zip(box, relation.shape, strict=True))
    return name, f'{relation.name}.new_subset("{_free_name(relation)}", np.s_[{slices}])'


def _largest_box(relation: Relation, accesses: Sequence[Access]) -> list[tuple[int, int]] | None:
    """The largest box of rows that can be found for which no access leaves its grid: start and stop by dimension."""
    good = [np.ones(extent, dtype=np.bool_) for extent in relation.shape]
    whole = open_mesh([slice(0, extent) for extent in relation.shape])
    for access in accesses:
        for dimension, index in enumerate(_ask(access.steps, whole)):
            outside = find_outside(access.node, dimension, index)
            if outside is None or not outside.any():
                continue
            axes = [axis for axis, extent in enumerate(outside.shape) if extent > 1]
            if len(axes) > 1 or outside.all():
                return None
            good[axes[0]] &= ~outside.reshape(-1)
    runs = [_longest_run(mask) for mask in good]
    return None if any(first == last for first, last in runs) else runs


def _longest_run(mask: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """The longest stretch of True in ``mask``, as start and stop."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    if not len(edges):
        return 0, 0
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * longest]), int(edges[2 * longest + 1])


def _slice_text(run: tuple[int, int], extent: int) -> str:
    first, last = run
    return f"{first or ''}:{last - extent if last < extent else ''}"


def _free_name(relation: Relation) -> str:
    names = ("interior", "inside", "within", *(f"within_{number}" for number in range(2, 1000)))
    return next(name for name in names if relation.attribute(name) is None)
