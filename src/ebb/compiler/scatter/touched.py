"""Which rows a launch will reduce into, found ahead of it from keys alone: the kernel itself is not run.

A key can be followed where it is the kernel's own row, a key field (or a component of one) that the kernel only reads,
an affine map of such a key, the variable of a query loop, or a local that surely holds one of these. Conditions are not
looked at: what a row may touch counts as touched.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias, cast

import numpy as np

from ebb.compiler import kir
from ebb.compiler.kir_walk import statements
from ebb.compiler.lower.facts import target as relation_of
from ebb.compiler.phases.centered import Centered, find_centered, single_assignments
from ebb.compiler.phases.stencil import Coordinates, find_outside, map_coordinates, open_mesh, settled, target_of
from ebb.compiler.phases.table import PhaseKind, PhaseTable
from ebb.compiler.scatter.keys import certain_locals
from ebb.records import field, record, replace
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.relations.subset import Box, RowSet
from ebb.runtime.buffer import Array

MOST_TOUCHED = 1 << 26
"""More places than this are not listed."""

_MOST_TURNS = 64
"""Loops over more numbers than this are not followed turn by turn."""

_ALL = slice(None)

_Rows: TypeAlias = "Array | slice"
"""Positions, one an execution; ``_ALL`` where those are all rows of the kernel's relation in storage order."""


@record(eq=False)
class Touched:
    """Where one reduction goes.

    Attributes:
        stmt: the reduction.
        positions: of the rows that it may change, -1 where a key is unset; one an execution, in the order of the rows.
        owners: for each execution the number in the launch of the row that does it, ascending; None where each row does
            it once.
    """

    stmt: kir.ReduceField
    positions: Array
    owners: Array | None


@record(eq=False)
class Touches:
    """All that a launch touches by reductions into other rows.

    Attributes:
        places: one for each reduction, or one for each turn of a loop over numbers that it stands in.
        read: the key fields that were read.
    """

    places: tuple[Touched, ...]
    read: tuple[Field, ...]


@record
class NotStatic:
    """Why the places are not known before the launch.

    Attributes:
        why: what it depends on, for ``explain``.
    """

    why: str


def find_touched(kernel: kir.Kernel, phases: PhaseTable, rows: RowSet) -> Touches | NotStatic:
    """The rows that the reductions into other rows go to, when ``kernel`` runs on ``rows``.

    Args:
        kernel: a checked kernel whose stencil has been checked for ``rows``. The groupings that it queries are valid.
        phases: of its fields.
        rows: what it is launched on.
    """
    follower = _Follower(kernel, phases, rows)
    try:
        follower.body(kernel.body, _Scope(rows.size))
    except _UnknownError as unknown:
        return unknown.reason
    return Touches(tuple(follower.places), tuple(follower.read))


def own_positions(rows: RowSet) -> Array | None:
    """The positions of ``rows`` in the order of their blocks; None for all rows in storage order."""
    if rows.boxes is None or (len(rows.boxes) == 1 and rows.boxes[0].size == rows.relation.size):
        return rows.row_positions() if rows.boxes is None else None
    shape = rows.relation.shape
    parts = [_ravelled(open_mesh(box.slices), shape, _extents(box)) for box in rows.boxes if box.size]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


class _UnknownError(Exception):
    """A key cannot be followed."""

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.reason = NotStatic(why)


@record(eq=False)
class _Scope:
    """Where a statement stands: the executions of it, and the loop variables around it.

    Attributes:
        size: the number of executions.
        owners: the number in the launch of the row of each, or None where each row is there once.
        rows: the values of the variables of query loops, by ``uid``.
        numbers: those of the variables of loops over numbers.
    """

    size: int
    owners: Array | None = None
    rows: Mapping[int, _Rows] = field(default_factory=dict[int, "_Rows"])
    numbers: Mapping[int, int] = field(default_factory=dict[int, int])


class _Follower:
    """Follows the keys of one launch."""

    def __init__(self, kernel: kir.Kernel, phases: PhaseTable, rows: RowSet) -> None:
        self.phases = phases
        self.launched = rows
        self.centered: Centered = find_centered(kernel)
        certain = certain_locals(kernel)
        self.values = {uid: value for uid, value in single_assignments(kernel).items() if uid in certain}
        self.own = own_positions(rows)
        self.places: list[Touched] = []
        self.read: dict[Field, None] = {}
        self.unset = False
        self.total = 0

    # ---- Statements ----

    def body(self, body: kir.Body, scope: _Scope) -> None:
        for stmt in body:
            self.statement(stmt, scope)

    def statement(self, stmt: kir.Stmt, scope: _Scope) -> None:
        match stmt:
            case kir.ReduceField() if self.phases.fields[stmt.field].kind is PhaseKind.REDUCE:
                self.reduce(stmt, scope)
            case kir.If(_, then, orelse):
                self.body(then, scope)
                self.body(orelse, scope)
            case kir.Block(_, body) | kir.While(_, body):
                self.body(body, scope)
            case kir.ForRange():
                self.for_range(stmt, scope)
            case kir.ForQuery() if self.reduces(stmt.body):
                self.body(stmt.body, self.members(stmt, scope))
            case _:
                pass

    def reduces(self, body: kir.Body) -> bool:
        """Whether ``body`` has a reduction into other rows."""
        return any(
            isinstance(stmt, kir.ReduceField) and self.phases.fields[stmt.field].kind is PhaseKind.REDUCE
            for stmt in statements(body)
        )

    def reduce(self, stmt: kir.ReduceField, scope: _Scope) -> None:
        self.count(scope.size)
        rows = self.rows(stmt.key, scope)
        if isinstance(rows, slice):
            rows = np.arange(scope.size, dtype=stmt.field.relation.key_dtype)
        self.places.append(Touched(stmt, rows, scope.owners))

    def count(self, more: int) -> None:
        self.total += more
        if self.total > MOST_TOUCHED:
            raise _UnknownError("there are too many places to list")

    def for_range(self, stmt: kir.ForRange, scope: _Scope) -> None:
        if not self.reduces(stmt.body):
            return
        match stmt.start, stmt.stop, stmt.step:
            case kir.Const(start), kir.Const(stop), kir.Const(step) if (
                step and len(range(start, stop, step)) <= _MOST_TURNS and not _rebinds(stmt)
            ):
                for number in range(start, stop, step):
                    self.body(stmt.body, replace(scope, numbers={**scope.numbers, stmt.local.uid: number}))
            case _:
                self.body(stmt.body, scope)  # its variable has no value: keys that do not depend on it can be followed

    def members(self, stmt: kir.ForQuery, scope: _Scope) -> _Scope:
        """The executions of the body of a query loop."""
        grouping = stmt.index.grouping
        assert grouping is not None
        self.read[stmt.index] = None
        keys = self.rows(stmt.key, scope)
        if isinstance(keys, slice):
            starts, stops = grouping.offsets[:-1], grouping.offsets[1:]
        else:
            starts, stops = grouping.offsets[keys], grouping.offsets[keys + 1]
            if self.unset:
                stops = np.where(keys < 0, starts, stops)
        counts = stops - starts
        total = int(counts.sum())
        self.count(total)
        ends = np.cumsum(counts)
        members = np.arange(total) + np.repeat(starts - (ends - counts), counts)
        owners = np.arange(scope.size) if scope.owners is None else scope.owners
        outer = {uid: _repeated(rows, counts) for uid, rows in scope.rows.items()}
        if not _rebinds(stmt):
            outer[stmt.local.uid] = members if grouping.rows is None else grouping.rows[members]
        return _Scope(total, np.repeat(owners, counts), outer, scope.numbers)

    # ---- Keys ----

    def rows(self, key: kir.Expr, scope: _Scope) -> _Rows:
        """The positions of the rows that ``key`` is."""
        if self.centered.is_centered(key):
            return self.own_rows(scope)
        match key:
            case kir.ReadLocal(local) if local.uid in scope.rows:
                return scope.rows[local.uid]
            case kir.ReadLocal(local) if local.uid in self.values:
                return self.rows(self.values[local.uid], scope)
            case kir.Affine(_, base):
                return self.affine(key, base, scope)
            case kir.ReadField() | kir.Component():
                return self.keys(key, scope)
            case _:
                raise _UnknownError(_dependence(key))

    def own_rows(self, scope: _Scope) -> _Rows:
        if scope.owners is None:
            return _ALL if self.own is None else self.own
        return scope.owners if self.own is None else self.own[scope.owners]

    def keys(self, expr: kir.Expr, scope: _Scope, index: tuple[int, ...] = ()) -> Array:
        """The component ``index`` of ``expr``, a key or a vector or matrix of keys."""
        match expr:
            case kir.Component(operand, indices):
                numbers = tuple(self.number(part, scope) for part in indices)
                if all(0 <= part < extent for part, extent in zip(numbers, operand.type.shape, strict=False)):
                    return self.keys(operand, scope, (*numbers, *index))
                self.unset = True  # a turn that the kernel leaves out, or fails in
                return np.full(scope.size, -1)
            case kir.ReadLocal(local) if local.uid in self.values:
                return self.keys(self.values[local.uid], scope, index)
            case kir.ReadField(source, key):
                return self.read_keys(source, self.rows(key, scope), index)
            case kir.Build(elements) if len(index) == 1 and len(expr.type.shape) == 1:
                rows = self.rows(elements[index[0]], scope)
                return np.arange(scope.size) if isinstance(rows, slice) else rows
            case _:
                raise _UnknownError(_dependence(expr))

    def read_keys(self, source: Field, rows: _Rows, index: tuple[int, ...]) -> Array:
        phase = self.phases.fields.get(source)
        if phase is None or phase.kind is not PhaseKind.READ:
            raise _UnknownError(f"the kernel changes '{source.path}'")
        self.read[source] = None
        found: Array = source.data[(rows, *index)]
        if self.unset and not isinstance(rows, slice):
            found = np.where(rows < 0, -1, found)
        self.unset = self.unset or source.maybe_unset
        return found

    def number(self, expr: kir.Expr, scope: _Scope) -> int:
        """The value of an index that is the same for all rows."""
        match expr:
            case kir.Const(value):
                return int(value)
            case kir.ReadLocal(local) if local.uid in scope.numbers:
                return scope.numbers[local.uid]
            case kir.Cast(operand):
                return self.number(operand, scope)
            case _:
                raise _UnknownError(_dependence(expr))

    # ---- Grids ----

    def affine(self, node: kir.Affine, base: kir.Expr, scope: _Scope) -> Array:
        """The rows of a grid that an affine map of ``base`` gives, -1 where there is none."""
        target = target_of(node)
        if scope.owners is None and self.launched.boxes is not None and (steps := self.steps(node)) is not None:
            boxes = [box for box in self.launched.boxes if box.size]
            parts = [_along(steps, open_mesh(box.slices), target, _extents(box)) for box in boxes]
            return np.concatenate(parts) if len(parts) != 1 else parts[0]
        rows = self.rows(base, scope)
        source = relation_of(base.type)
        positions = np.arange(scope.size) if isinstance(rows, slice) else rows
        shape = tuple(max(extent, 1) for extent in source.shape)
        at = [np.asarray(axis) for axis in np.unravel_index(np.maximum(positions, 0), shape)]
        asked = map_coordinates(node.matrix, at)
        missing = positions < 0
        for dimension, index in enumerate(asked):
            beyond = find_outside(node, dimension, index) if node.edge is kir.Edge.CHECK else None
            if beyond is not None:
                missing = missing | beyond
        found = _ravelled(settled(node, asked), target.shape, positions.shape)
        self.unset = self.unset or bool(missing.any())
        return np.where(missing, -1, found)

    def steps(self, node: kir.Affine) -> tuple[kir.Affine, ...] | None:
        """The affine maps from the own row to ``node``, or None where its base is not the own row."""
        match node.key:
            case _ if self.centered.is_centered(node.key):
                return (node,)
            case kir.Affine() as inner:
                before = self.steps(inner)
                return None if before is None else (*before, node)
            case kir.ReadLocal(local) if isinstance(self.values.get(local.uid), kir.Affine):
                before = self.steps(cast("kir.Affine", self.values[local.uid]))
                return None if before is None else (*before, node)
            case _:
                return None


def _rebinds(loop: kir.ForRange | kir.ForQuery) -> bool:
    """Whether the body of ``loop`` gives its variable other values."""
    bindings = (kir.Assign, kir.ForRange, kir.ForQuery)
    return any(isinstance(stmt, bindings) and stmt.local.uid == loop.local.uid for stmt in statements(loop.body))


def _extents(box: Box) -> tuple[int, ...]:
    return tuple(stop - start for start, stop in zip(box.start, box.stop, strict=True))


def _along(steps: tuple[kir.Affine, ...], at: Coordinates, target: Relation, extents: tuple[int, ...]) -> Array:
    for step in steps:
        at = settled(step, map_coordinates(step.matrix, at))
    return _ravelled(at, target.shape, extents)


def _ravelled(at: Coordinates, shape: tuple[int, ...], extents: tuple[int, ...]) -> Array:
    """The positions in a grid of ``shape`` of rows by coordinates, whose axes are those of a box or one list."""
    dtype = np.int32 if np.prod(shape, dtype=np.float64) < 1 << 31 else np.int64
    total: Any = np.zeros((), dtype=dtype)
    for index, extent in zip(at, shape, strict=True):
        total = total * dtype(extent) + index.astype(dtype)
    return np.ascontiguousarray(np.broadcast_to(total, extents)).reshape(-1)


def _repeated(rows: _Rows, counts: Array) -> Array:
    return np.repeat(np.arange(counts.size) if isinstance(rows, slice) else rows, counts)


def _dependence(expr: kir.Expr) -> str:
    """What a key that cannot be followed depends on."""
    match expr:
        case kir.ReadLocal(local):
            return f"the value of '{local.name}'"
        case kir.ReadField(source):
            return f"the value of '{source.path}'"
        case kir.Choose():
            return "a condition"
        case _:
            return "what the kernel computes"
