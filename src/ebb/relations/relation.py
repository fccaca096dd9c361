"""Relations: sets of rows, with fields, members and subsets as attributes."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from keyword import iskeyword
from math import prod
from types import MappingProxyType, MemberDescriptorType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast, overload

import numpy as np

from ebb.errors import RelationError
from ebb.relations.errors import (
    AttributeAssigned,
    BadExtent,
    BadName,
    ForeignField,
    NameTaken,
    NotABool,
    NotGroupable,
    TypeMismatch,
    UnknownName,
)
from ebb.relations.field import Field
from ebb.relations.grouping import Grouping
from ebb.relations.member import Function, Member
from ebb.relations.ordering import reorder
from ebb.relations.storage import Rows, Storage, inverse, is_permutation
from ebb.relations.subset import Box, Subset, select
from ebb.relations.table import table
from ebb.runtime.recording import recorder, refuse
from ebb.runtime.threads import launching
from ebb.types.types import KeyType, as_type

if TYPE_CHECKING:
    import numpy.typing as npt

Attribute: TypeAlias = Field | Member | Subset

CALL = "__call__"
"""The name of the member that is the call of the key itself."""


class MissingAttributeError(RelationError, AttributeError):
    """A relation has no attribute of that name. It is also an ``AttributeError``, as ``hasattr`` expects."""


class Relation:
    """A set of rows, as a table is: fields are its columns. With ``shape=`` the rows are the cells of a grid.

    Fields, members and subsets are attributes: ``vertices.pos``. Two relations are equal only if they are the same.
    A domain may derive from it, to give relations more methods; like its own slots, those of the derived class are set
    once, and their names are taken.

    Attributes:
        name: for messages.
        shape: the extents of a grid; ``(size,)`` for a relation that is none.
        periodic: for each dimension, whether affine indices wrap.
        is_grid: whether the relation was made with ``shape=``.
        storage: where the rows lie, and the storage order.
    """

    __slots__ = ("__weakref__", "_attributes", "_fields", "is_grid", "name", "periodic", "shape", "storage")

    def __init__(
        self,
        name: str,
        size: int | None = None,
        *,
        shape: int | Sequence[int] | None = None,
        periodic: bool | Sequence[bool] | None = None,
        reorder: bool = True,
    ) -> None:
        """A relation of ``size`` rows, or of the cells of a grid of one, two or three dimensions.

        Args:
            name: a Python identifier.
            size: the number of rows; or
            shape: the extents of a grid, and then
            periodic: for each dimension, whether it wraps; one bool stands for all. By default none does.
            reorder: whether the rows may be stored in another order so that kernels find them closer together. No
                program can tell but by ``view()``. Groupings sort the rows all the same.

        Raises:
            RelationError: the name is no identifier, there are no such rows, or ``reorder`` is no bool.
        """
        if not isinstance(reorder, bool):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise RelationError(NotABool(str(name), "reorder", repr(reorder)))
        self.name = _checked_name("relation", name)
        self.is_grid = shape is not None
        self.shape: tuple[int, ...] = _extents(name, size, shape)
        self.periodic: tuple[bool, ...] = _wraps(name, periodic, self.is_grid, len(self.shape))
        self.storage = Storage(prod(self.shape))
        self.storage.may_reorder = reorder
        self._attributes: dict[str, Attribute] = {}
        self._fields: dict[str, Field] = {}

    # What it is

    @property
    def relation(self) -> Relation:
        """The relation itself: as a set of rows to launch on, it is all of its own."""
        return self

    @property
    def size(self) -> int:
        """The number of rows."""
        return self.storage.size

    @property
    def ndim(self) -> int:
        """The number of dimensions, 1 for a relation that is no grid."""
        return len(self.shape)

    @property
    def fields(self) -> Mapping[str, Field]:
        """The fields by name, live and read-only."""
        return MappingProxyType(self._fields)

    @property
    def key_type(self) -> KeyType:
        """The type of references to the rows."""
        return KeyType(self)

    @property
    def key_dtype(self) -> np.dtype[Any]:
        """How keys are stored: int32 while all rows can be numbered in it, else int64."""
        return self.storage.key_dtype

    @property
    def boxes(self) -> tuple[Box, ...] | None:
        """All rows as one box, or None for a relation that is no grid."""
        return (Box((0,) * self.ndim, self.shape),) if self.is_grid else None

    def row_positions(self) -> None:
        """None: all rows, in storage order (see ``RowSet``)."""
        return None

    def attribute(self, name: str) -> Attribute | None:
        """The field, member or subset of that name, or None."""
        return self._attributes.get(name)

    # Fields

    def new_field(self, name: str, type: Any, init: Any = None) -> Field:
        """Adds a field, which is then also reachable as an attribute.

        Args:
            name: a Python identifier that the relation does not use yet.
            type: of each row's value; a relation stands for its key type.
            init: what to load (see ``Field.load``). By default numbers are 0, bools False and keys unset.

        Raises:
            TypeError: ``type`` is no type.
            RelationError: the name is bad or taken, or ``init`` cannot be loaded; no field is added then.
            BackendError: a step is being captured.
        """
        refuse(f"adding a field to {self.name}", "add it before the with statement")
        self._check_free(name, "field")
        field = Field(self, name, as_type(type))
        if init is not None:
            field.load(init)
        self._fields[name] = field
        self._attributes[name] = field
        if field.target is not None:
            field.target.storage.referrers[field] = None
        return field

    def swap(self, a: str | Field, b: str | Field) -> None:
        """Exchanges the values of two fields of one type, in constant time.

        Raises:
            RelationError: there is no such field, the types differ, or a writable view of one is open.
        """
        left, right = self._pair("swap", a, b)
        if left is right:
            return
        by = recorder()
        if by is None:
            with launching():  # while machine code replays a step, it keeps the account of what it swaps
                left.swap_with(right)
        else:
            by.record_swap(left, right)

    def copy(self, src: str | Field, dst: str | Field) -> None:
        """Copies the values of the field ``src`` to the field ``dst`` of the same type.

        Raises:
            RelationError: there is no such field, the types differ, or a writable view of one is open.
            BackendError: a step is being captured.
        """
        source, target = self._pair("copy", src, dst)
        copying = f"row.{target.name} = row.{source.name}"
        refuse(f"copying {source.path} to {target.path}", f"launch a kernel that copies it: {copying}")
        if source is not target:
            target.load(source)

    def group_by(self, key: str | Field) -> None:
        """Makes ``ebb.where(relation.key, row)`` legal in kernels: the rows whose ``key`` is that row.

        The first grouping sorts the storage of a relation that is no grid, which no program can tell but by ``view()``.
        Whatever is loaded or written later, the index is brought up to date before its next use.

        Raises:
            RelationError: there is no such field, it is not of one key, or a writable view of a field is open.
            BackendError: a step is being captured.
        """
        field = self._own(key)
        refuse(f"grouping {self.name} by {field.name}", "group it before the with statement")
        if not isinstance(field.type, KeyType):
            keys = tuple(name for name, other in self._fields.items() if isinstance(other.type, KeyType))
            raise RelationError(NotGroupable(self.name, field.name, repr(field.type), keys))
        with launching():
            if field.grouping is None:
                self._group(field)

    # Members and subsets

    @overload
    def member(self, function: Function, /) -> Member: ...

    @overload
    def member(self, name: str, /) -> Callable[[Function], Member]: ...

    def member(self, function: Function | str, /) -> Member | Callable[[Function], Member]:
        """Decorator: the function of a key stands in kernels as ``key.name``, the function's name or the one given.

        Raises:
            RelationError: the name is bad or taken, or no function is given.
        """
        if isinstance(function, str):
            name = function
            return lambda decorated: self._add_member(name, decorated)
        return self._add_member(getattr(function, "__name__", repr(function)), function)

    def new_subset(self, name: str, rows: Any) -> Subset:
        """Adds a subset, which is then also reachable as an attribute; a kernel can be launched on it.

        Args:
            name: a Python identifier that the relation does not use yet.
            rows: slices as ``np.s_[1:-1, ::2]``, which mean what they mean in Python; or a list of those, whose rows
                count once; or a boolean array of the relation's shape; or a list of row numbers, for a grid also one of
                index tuples, of the shape ``(n, ndim)``.

        Raises:
            RelationError: the name is bad or taken, ``rows`` is none of these, or a row does not exist.
        """
        self._check_free(name, "subset")
        subset = select(self, name, rows)
        self._attributes[name] = subset
        return subset

    # Storage

    def permute(self, order: npt.ArrayLike) -> None:
        """Stores the row that is now at position ``order[p]`` at position ``p``, in every field, and follows with keys.

        Row numbers do not change: no program can tell, but by ``Field.view``. If it fails, all is as it was.

        Raises:
            ValueError: ``order`` is no permutation of the rows, or the relation is a grid.
            RelationError: a writable view of a field is open.
            BackendError: a step is being captured.
        """
        refuse(f"permuting {self.name}", "permute it before the with statement, or when the step has run")
        moves: Rows = np.asarray(order, dtype=np.int64)
        if self.is_grid:
            raise ValueError(f"{self.name} is a grid, whose rows lie in the order of their indices")
        if not is_permutation(moves, self.size):
            raise ValueError(f"no permutation of the {self.size} rows of {self.name}")
        with launching():
            self._move(moves)

    def reorder(self) -> None:
        """Stores rows that refer to each other close together, which makes kernels that follow keys faster.

        Kernels have this done when they find rows far apart; this does it now, whatever there is to gain. The rows are
        ordered by what relates them (Cuthill and McKee): their keys to each other, and rows of other relations that
        have two keys into this one, as edges have. Where there is nothing of the kind, they are sorted by their own
        keys, or in the order in which others refer to them. If the relation is grouped, what it is grouped by is
        reordered, and its groups follow; so do relations that refer to it and have no order of their own.

        Row numbers do not change: no program can tell, but by ``Field.view``.

        Raises:
            RelationError: the relation is a grid, or a writable view is open of a field that has to move.
            BackendError: a step is being captured.
        """
        refuse(f"reordering {self.name}", "reorder it before the with statement, or when the step has run")
        with launching():
            reorder(self)

    # Python's own

    def __ebb_type__(self) -> KeyType:
        return self.key_type

    def __len__(self) -> int:
        return self.size

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or _is_slot(type(self), name):  # what Python asks of all objects; a slot not yet set
            raise AttributeError(f"relation has no attribute {name!r}")
        found = self._attributes.get(name)
        if found is None:
            raise MissingAttributeError(UnknownName(self.name, "attribute", name, tuple(self._attributes)))
        return found

    def __setattr__(self, name: str, value: Any) -> None:
        if not _is_slot(type(self), name) or hasattr(self, name):  # a slot is set once, when the relation is made
            raise RelationError(AttributeAssigned(self.name, name, self._kind_of(name)))
        object.__setattr__(self, name, value)

    def __dir__(self) -> Iterator[str]:
        yield from object.__dir__(self)
        yield from self._attributes

    def __repr__(self) -> str:
        return table(self.name, self.shape, self.periodic if self.is_grid else None, self._attributes)

    def _move(self, moves: Rows) -> None:
        """Permutes the rows by ``moves``, which is a permutation of them."""
        for field in self._fields.values():
            field.check_no_view()
        moved = inverse(moves)
        buffers = {field: field.buffer.permuted(moves) for field in self._fields.values()}
        for field in list(self.storage.referrers):
            buffers[field] = buffers.get(field, field.buffer).mapped(moved)
        order, rank = self.storage.moved(moves, moved)
        version = self.storage.version + 1

        def carry_out() -> None:
            self.storage.take_order(order, rank, version)
            for field, buffer in buffers.items():
                field.replace(buffer)

        try:
            carry_out()
        except BaseException:  # an interrupt: what has begun is brought to its end
            carry_out()
            raise

    def _group(self, field: Field) -> None:
        grouping = Grouping(field)
        primary = self.storage.primary
        field.grouping = grouping
        if grouping.orders_storage:
            self.storage.primary = grouping
        try:
            grouping.refresh()
        except BaseException:  # an open view, memory, an interrupt
            field.grouping = None
            self.storage.primary = primary
            raise

    def _pair(self, action: Literal["swap", "copy"], a: str | Field, b: str | Field) -> tuple[Field, Field]:
        left, right = self._own(a), self._own(b)
        left.check_no_view()
        right.check_no_view()
        if left.type != right.type:
            raise RelationError(TypeMismatch(action, left.path, repr(left.type), right.path, repr(right.type)))
        return left, right

    def _own(self, field: str | Field) -> Field:
        """The field of this relation that is meant."""
        if isinstance(field, Field):
            if field.relation is not self:
                raise RelationError(ForeignField(self.name, field.path))
            return field
        if not isinstance(field, str) or field not in self._fields:  # pyright: ignore[reportUnnecessaryIsInstance]
            raise RelationError(UnknownName(self.name, "field", str(field), tuple(self._fields)))
        return self._fields[field]

    def _add_member(self, name: str, function: Function) -> Member:
        member = Member(self, name, function)
        if name == CALL and CALL not in self._attributes:
            self._attributes[name] = member
            return member
        self._check_free(name, "member")
        self._attributes[name] = member
        return member

    def _check_free(self, name: str, what: str) -> None:
        """Raises unless a new thing may have the name."""
        taken_by = self._kind_of(name)
        if taken_by is not None:
            raise RelationError(NameTaken(self.name, name, taken_by))
        _checked_name(what, name)

    def _kind_of(self, name: str) -> str | None:
        """What has the name already, in words, or None."""
        match self._attributes.get(name):
            case None:
                return "built-in attribute" if any(name in vars(base) for base in type(self).__mro__) else None
            case found:
                return type(found).__name__.lower()


def _is_slot(kind: type[Relation], name: str) -> bool:
    """Whether ``name`` is a slot of ``kind``, one that it inherits too."""
    return isinstance(getattr(kind, name, None), MemberDescriptorType)


def _checked_name(what: str, name: Any) -> str:
    if not isinstance(name, str) or not name.isidentifier() or iskeyword(name) or name.startswith("__"):
        raise RelationError(BadName(what, repr(name)))
    return name


_MOST_ROWS = 2**48
"""Addresses have no more bits; beyond it, sizes in bytes would not fit into 64."""


def _extents(name: str, size: Any, shape: Any) -> tuple[int, ...]:
    if (size is None) == (shape is None):
        raise RelationError(BadExtent(name, "one of size= and shape= is needed"))
    extents = cast("Sequence[Any]", (size,) if shape is None else shape if np.ndim(shape) else (shape,))
    found = tuple(_extent(name, extent) for extent in extents)
    if not 1 <= len(found) <= 3:
        raise RelationError(BadExtent(name, f"a grid has one to three dimensions, not {len(found)}"))
    if prod(found) > _MOST_ROWS:
        raise RelationError(BadExtent(name, f"{prod(found)} rows are more than any memory holds"))
    return found


def _extent(name: str, extent: Any) -> int:
    try:
        count = operator.index(extent)
    except TypeError:
        count = -1
    if count < 0 or isinstance(extent, bool):
        raise RelationError(BadExtent(name, f"{extent!r} is no number of rows"))
    return count


def _wraps(name: str, periodic: Any, is_grid: bool, ndim: int) -> tuple[bool, ...]:
    if periodic is None:
        return (False,) * ndim
    if not is_grid:
        raise RelationError(BadExtent(name, "periodic= is for grids, which are made with shape="))
    given = (periodic,) * ndim if isinstance(periodic, bool) else tuple(periodic)
    if len(given) != ndim or not all(isinstance(wraps, bool | np.bool_) for wraps in given):
        raise RelationError(BadExtent(name, f"periodic={periodic!r} is not {ndim} bools"))
    return tuple(bool(wraps) for wraps in given)
