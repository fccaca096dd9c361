"""Subsets: some rows of a relation, each once, on which a kernel can run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import prod
from typing import TYPE_CHECKING, Any, Protocol, TypeGuard, cast, runtime_checkable

import numpy as np

from ebb.errors import RelationError
from ebb.records import record
from ebb.relations.errors import BadSubset, SubsetOutOfRange
from ebb.relations.storage import Rows, Storage
from ebb.runtime.buffer import Array
from ebb.runtime.living import Living

if TYPE_CHECKING:
    from ebb.relations.relation import Relation

MAX_BOXES = 64
"""Where overlapping boxes fall into more disjoint ones than this, the subset lists its rows instead."""


@record
class Box:
    """The rows of a grid from ``start`` up to ``stop``, exclusive, in each dimension."""

    start: tuple[int, ...]
    stop: tuple[int, ...]

    @property
    def size(self) -> int:
        """The number of rows."""
        return prod(max(0, stop - start) for start, stop in zip(self.start, self.stop, strict=True))

    @property
    def slices(self) -> tuple[slice, ...]:
        """The box as an index into arrays of the grid's shape."""
        return tuple(slice(start, stop) for start, stop in zip(self.start, self.stop, strict=True))

    def without(self, other: Box) -> tuple[Box, ...]:
        """The rows of this box that are not in ``other``, as disjoint boxes, at most two a dimension."""
        common = Box(
            tuple(max(a, b) for a, b in zip(self.start, other.start, strict=True)),
            tuple(min(a, b) for a, b in zip(self.stop, other.stop, strict=True)),
        )
        if not common.size:
            return (self,)
        pieces: list[Box] = []
        start, stop = list(self.start), list(self.stop)
        for axis in range(len(start)):
            below, above = list(stop), list(start)
            below[axis], above[axis] = common.start[axis], common.stop[axis]
            pieces += [Box(tuple(start), tuple(below)), Box(tuple(above), tuple(stop))]
            start[axis], stop[axis] = common.start[axis], common.stop[axis]
        return tuple(piece for piece in pieces if piece.size)


@runtime_checkable
class RowSet(Protocol):
    """What a kernel is launched on: a relation or a subset."""

    @property
    def relation(self) -> Relation:
        """The relation whose rows they are."""
        ...

    @property
    def storage(self) -> Storage:
        """Where the rows of that relation lie."""
        ...

    @property
    def size(self) -> int:
        """The number of rows."""
        ...

    @property
    def boxes(self) -> tuple[Box, ...] | None:
        """The rows as disjoint boxes of a grid, or None where they are no boxes."""
        ...

    def row_positions(self) -> Rows | None:
        """The positions of the rows, ascending, or None for all rows."""
        ...


class Subset:
    """Some rows of a relation. ``Relation.new_subset`` makes them.

    Attributes:
        relation: whose rows they are.
        storage: where the rows of that relation lie.
        name: unique in the relation.
        size: the number of rows.
        boxes: the rows as disjoint boxes, or None where the relation is no grid or they are no boxes.
    """

    __slots__ = ("__weakref__", "_identities", "_positions", "_version", "boxes", "name", "relation", "size", "storage")

    def __init__(self, relation: Relation, name: str, rows: tuple[Box, ...] | Rows) -> None:
        self.relation = relation
        self.storage = relation.storage
        self.name = name
        self.boxes = rows if isinstance(rows, tuple) else None
        self._identities = None if isinstance(rows, tuple) else rows
        self._positions: Rows | None = None
        self._version = -1
        self.size = sum(box.size for box in rows) if isinstance(rows, tuple) else int(rows.size)
        all_subsets.add(self)

    def row_positions(self) -> Rows:
        """The positions of the rows, ascending; they follow the relation when its storage is permuted."""
        storage = self.relation.storage
        if self._positions is None or self._version != storage.version:
            identities = self.identities()
            self._positions = identities if storage.rank is None else np.sort(storage.rank[identities]).astype(np.int64)
            self._version = storage.version
        return self._positions

    def identities(self) -> Rows:
        """The numbers of the rows, ascending."""
        if self._identities is None:
            mask = np.zeros(self.relation.shape, dtype=np.bool_)
            for box in self.boxes or ():
                mask[box.slices] = True
            self._identities = np.flatnonzero(mask)
        return self._identities

    def kept_arrays(self) -> list[Rows]:
        """The arrays that it keeps to find its rows by: their numbers, and their positions where these are others."""
        found = [self._identities, None if self._positions is self._identities else self._positions]
        return [array for array in found if array is not None]

    def __len__(self) -> int:
        return self.size

    def __repr__(self) -> str:
        return f"<subset {self.relation.name}.{self.name}: {self.size} of {self.relation.size} rows>"


all_subsets: Living[Subset] = Living()
"""All subsets that there are."""


def select(relation: Relation, name: str, selection: Any) -> Subset:
    """The subset of ``relation`` that ``selection`` describes; ``Relation.new_subset`` says how.

    Raises:
        RelationError: the selection is none of these, or names a row that does not exist.
    """
    return Subset(relation, name, _rows(relation, f"{relation.name}.{name}", selection))


def _rows(relation: Relation, path: str, selection: Any) -> tuple[Box, ...] | Rows:
    if _is_slices(selection):
        return _boxes_or_rows(relation, path, [selection])
    if isinstance(selection, Sequence) and len(cast("Sequence[Any]", selection)):
        parts = cast("Sequence[Any]", selection)
        if all(_is_slices(part) for part in parts):
            return _boxes_or_rows(relation, path, parts)
    try:
        array: Array = np.asarray(cast("Any", selection))
    except ValueError:
        raise RelationError(BadSubset(path, "the list is ragged")) from None
    if array.dtype == np.bool_:
        if array.shape != relation.shape:
            problem = f"the boolean array has the shape {array.shape}, the relation {relation.shape}"
            raise RelationError(BadSubset(path, problem))
        return np.flatnonzero(array)
    if array.size == 0 and array.ndim in (1, 2):
        return np.zeros(0, dtype=np.int64)
    return _listed(relation, path, array)


def _listed(relation: Relation, path: str, array: Array) -> Rows:
    """The rows of an array of row numbers, or for a grid of index tuples."""
    tuples = relation.is_grid and array.ndim == 2 and array.shape[1] == relation.ndim
    if array.dtype.kind not in "iu" or not (array.ndim == 1 or tuples):
        problem = f"an array of the dtype {array.dtype} and the shape {array.shape} is no list of rows"
        raise RelationError(BadSubset(path, problem))
    bad = (array < 0) | (array >= (np.array(relation.shape) if tuples else relation.size))
    bad = bad.any(axis=1) if tuples else bad
    if bad.any():
        entry = int(bad.argmax())
        shape = relation.shape if tuples else (relation.size,)
        raise RelationError(SubsetOutOfRange(path, f"entry {entry}", f"row {_listed_row(array[entry])}", shape))
    if tuples:
        array = np.asarray(np.ravel_multi_index(tuple(array.astype(np.int64).T), relation.shape))
    return np.unique(array.astype(np.int64))


def _listed_row(entry: Any) -> Any:
    return tuple(entry.tolist()) if np.ndim(entry) else int(entry)


def _boxes_or_rows(relation: Relation, path: str, parts: Iterable[Any]) -> tuple[Box, ...] | Rows:
    ranges = [_ranges(relation, path, part) for part in parts]
    if relation.is_grid and all(r.step == 1 for part in ranges for r in part):
        boxes = _disjoint(
            Box(tuple(r.start for r in part), tuple(max(r.start, r.stop) for r in part)) for part in ranges
        )
        if len(boxes) <= MAX_BOXES:
            return boxes
    mask = np.zeros(relation.shape, dtype=np.bool_)
    for part in ranges:
        mask[np.ix_(*(np.arange(r.start, r.stop, r.step) for r in part))] = True
    return np.flatnonzero(mask)


def _disjoint(boxes: Iterable[Box]) -> tuple[Box, ...]:
    """Disjoint boxes with the rows of all of ``boxes``."""
    found: list[Box] = []
    for box in boxes:
        pieces = [box] if box.size else []
        for other in found:
            pieces = [part for piece in pieces for part in piece.without(other)]
        found += pieces
        if len(found) > MAX_BOXES:
            break
    return tuple(found)


def _is_slices(value: Any) -> TypeGuard[slice | tuple[Any, ...]]:
    """Whether ``value`` is what ``np.s_`` makes of an index with a slice or ``...`` in it."""
    if isinstance(value, tuple):
        parts = cast("tuple[Any, ...]", value)
        return any(isinstance(part, slice) or part is ... for part in parts) and all(
            isinstance(part, slice | int | np.integer) or part is ... for part in parts
        )
    return isinstance(value, slice)


def _ranges(relation: Relation, path: str, part: slice | tuple[Any, ...]) -> tuple[range, ...]:
    """For each dimension the indices that ``part`` selects, ascending, as a range."""
    items: list[Any] = list(part) if isinstance(part, tuple) else [part]
    if items.count(...) > 1:
        raise RelationError(BadSubset(path, "'...' stands twice in one index"))
    if ... not in items:
        items.append(...)
    missing = relation.ndim - len(items) + 1
    if missing < 0:
        raise RelationError(BadSubset(path, f"{len(items) - 1} indices for {relation.ndim} dimensions"))
    at = items.index(...)
    items[at : at + 1] = [slice(None)] * missing
    pairs = zip(items, relation.shape, strict=True)
    return tuple(_range(path, item, extent, axis, relation.shape) for axis, (item, extent) in enumerate(pairs))


def _range(path: str, item: slice | int, extent: int, axis: int, shape: tuple[int, ...]) -> range:
    if not isinstance(item, slice):
        index = int(item) + (extent if item < 0 else 0)
        if not 0 <= index < extent:
            raise RelationError(SubsetOutOfRange(path, f"dimension {axis}", f"index {item}", shape))
        return range(index, index + 1)
    try:
        found = range(extent)[item]
    except (TypeError, ValueError) as error:
        raise RelationError(BadSubset(path, str(error))) from None
    return found[::-1] if found.step < 0 else found
