"""Fields: one value of one type for each row of a relation."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from ebb.errors import RelationError
from ebb.relations.errors import ForeignField, KeysNotWritable, TypeMismatch, ViewOpen
from ebb.relations.family import Family, join
from ebb.relations.loading import Place, called_by_row, converted, target_of
from ebb.runtime.buffer import Array, Buffer
from ebb.runtime.copies import tell_host_code
from ebb.runtime.device import Device, current_device
from ebb.runtime.epoch import structure_changed
from ebb.runtime.living import Living
from ebb.runtime.recording import refuse
from ebb.runtime.threads import launching
from ebb.types.types import Type

if TYPE_CHECKING:
    from ebb.relations.grouping import Grouping
    from ebb.relations.relation import Relation

_ON_HOST = (1, 0)
"""What DLPack calls the memory of the processor."""

UNSET = -1
"""What is stored for a key that has never been loaded or written."""


class Field:
    """A column of a relation. ``Relation.new_field`` makes them.

    Two fields are equal only if they are the same field.

    Attributes:
        name: unique in the relation.
        type: of each row's value.
        relation: whose rows have the values.
        grouping: the index that ``group_by`` made, or None.
        version: counts the changes of the values; what is derived from them compares it.
        buffer: the memory that ``data`` lies in now.
        holds_keys: whether the values are keys.
        family: the fields that it has been swapped with, once that matters.
        followed: of keys: whether something that launches rely on has come from their values since it was last cleared:
            a plan of reductions, or a look at where they lead. Who takes it from them sets this, under ``launching()``.
    """

    __slots__ = (
        "__weakref__",
        "_open_views",
        "_unset",
        "buffer",
        "family",
        "followed",
        "grouping",
        "holds_keys",
        "name",
        "relation",
        "type",
        "version",
    )

    def __init__(self, relation: Relation, name: str, type_: Type, buffer: Buffer | None = None) -> None:
        """``buffer`` is memory that is there already, with its values; a new field is 0, and its keys unset."""
        self.relation = relation
        self.name = name
        self.type = type_
        self.grouping: Grouping | None = None
        self.family: Family | None = None
        self.followed = False
        self.version = 0
        self._open_views = 0
        self.buffer = Buffer((relation.size, *type_.shape), type_.dtype) if buffer is None else buffer
        self.holds_keys = target_of(type_) is not None
        self._unset: bool | None = None if self.holds_keys else False
        if self.holds_keys and buffer is None:
            self.data.fill(UNSET)
            self._unset = relation.size > 0
        all_fields.add(self)

    @property
    def path(self) -> str:
        """The name that messages use: ``vertices.pos``."""
        return f"{self.relation.name}.{self.name}"

    @property
    def data(self) -> Array:
        """The values in storage order, shape ``(relation.size, *type.shape)``; keys are positions, -1 where unset.

        The array is aligned to 64 bytes; its strides are those of the layout (see ``Buffer``). Swapping, grouping and
        a change of the layout replace it, and what runs on a device does not write to it, so nobody keeps it. Taking it
        waits for a device that has newer values. Who writes to it calls ``changed`` afterwards.
        """
        return self.buffer.host

    @property
    def address(self) -> int:
        """Where ``data`` begins. It changes when ``data`` is replaced."""
        return self.buffer.address

    @property
    def target(self) -> Relation | None:
        """The relation that the field's keys refer to, None where it holds no keys."""
        return target_of(self.type)

    @property
    def maybe_unset(self) -> bool:
        """Whether some key of the field may be unset: True while only a device could tell. False where it has none."""
        if self._unset is None:
            if not self.buffer.is_current:
                return True
            self._unset = self.data.size > 0 and int(self.data.min()) < 0
        return self._unset

    def changed(self) -> None:
        """Says that ``data`` has been written on the host, so that it holds the only valid values."""
        self.buffer.changed_on_host()
        self.version += 1
        if self.holds_keys:
            self._unset = None
            structure_changed()

    def rewritten(self) -> None:
        """Says that a kernel has written values, wherever it ran. Keys that kernels write are set.

        That is a change of the structure only where something depends on the keys: so particles may find their cells
        after each step, and launches stay as they are. The caller holds ``launching()``.
        """
        self.version += 1
        if self.holds_keys and (self.followed or self.grouping is not None or self._unset is not False):
            if self._unset:
                self._unset = None
            self.followed = False  # who still depends on them settles in the new epoch, and says so
            structure_changed()

    def all_set(self) -> None:
        """Says that a kernel has written every key, so that nobody has to look for some that are unset."""
        self._unset = False

    def load(self, value: Any) -> None:
        """Sets the values of all rows. A load that fails changes nothing.

        Args:
            value: a constant of the type, where one number fills every component; or an array of the shape
                ``relation.shape + type.shape``; or another field of the relation; or a function that is called once a
                row with its index, on a grid with its indices. Keys are row numbers, and for a grid index tuples: one
                more trailing axis of the length ``ndim``. Keys that are masked (``numpy.ma``) are unset.

        Raises:
            RelationError: the value does not fit in shape or kind, a number or key is out of range, or a writable view
                of the field is open.
            BackendError: a step is being captured.
        """
        refuse(f"loading {self.path}", "load it before the with statement, or set it in a kernel")
        self.check_no_view()
        match value:
            case Field():
                self._load_field(value)
            case _ if _is_function(value):
                self._store(converted(called_by_row(value, self._place()), self._place()))
            case _:
                self._store(converted(value, self._place()))

    def fill(self, value: Any) -> None:
        """Sets the values of all rows to the constant ``value``; one number fills every component.

        Raises:
            EbbError: as ``load``.
        """
        refuse(f"filling {self.path}", f"launch a kernel that sets it: row.{self.name} = ...")
        self.check_no_view()
        self._store(converted(value, Place(self.path, self.type, ())))

    def to_numpy(self) -> Array:
        """A copy of the values in the order of row numbers, shape ``relation.shape + type.shape``.

        Keys are row numbers, and for a grid index tuples on one more trailing axis; unset keys are -1.

        Raises:
            BackendError: a step is being captured.
        """
        refuse(f"reading {self.path}", "read it when the step has run")
        rank = self.relation.storage.rank
        values = self.data.copy() if rank is None else np.take(self.data, rank, axis=0)
        target = target_of(self.type)
        if target is not None:
            values = target.storage.identities_of(values)
            if target.is_grid:
                values = _index_tuples(values, target.shape)
        return values.reshape(self.relation.shape + values.shape[1:])

    @overload
    def view(self, write: Literal[False] = False) -> Array: ...

    @overload
    def view(self, write: Literal[True]) -> AbstractContextManager[Array]: ...

    def view(self, write: bool = False) -> Array | AbstractContextManager[Array]:
        """The runtime's own memory as a NumPy array of the shape ``relation.shape + type.shape``, without a copy.

        Rows lie in storage order, which grouping the relation changes, and keys are the places of rows in that order.
        The strides tell the layout: the components of a row together, or a column for each. While nobody has taken a
        view of a field of the relation, launches may choose order and layout; from the first view on they stay, those
        of the relation that keys refer to as well.
        A view shows the memory that the field had when it was taken: take a new one after a swap or a grouping, and on
        a device after a launch: what runs there leaves the host's memory as it is until somebody looks again.

        Args:
            write: returns a context manager instead, whose value is a writable array. Until it is left, launches that
                touch the field raise.

        Raises:
            RelationError: ``write`` on a field of keys.
            BackendError: a step is being captured.
        """
        refuse(f"taking a view of {self.path}", "take it before the with statement, or when the step has run")
        if write:
            if self.target is not None:
                raise RelationError(KeysNotWritable(self.path))
            return self._writable_view()
        array = self._shaped()
        array.flags.writeable = False
        return array

    def check_no_view(self) -> None:
        """Raises while a writable view is open; what uses the field calls this first.

        Raises:
            RelationError: a writable view of the field is open.
        """
        if self._open_views:
            raise RelationError(ViewOpen(self.path))

    def replace(self, buffer: Buffer) -> None:
        """Takes ``buffer``: the same values, for rows that lie elsewhere. ``Relation.permute`` calls this."""
        self.buffer = buffer
        structure_changed()

    def swap_with(self, other: Field) -> None:
        """Exchanges the values with those of a field of the same relation and type.

        That takes constant time, but for the first time where one of the two lies in columns. The caller holds
        ``launching()``.
        """
        if self.type.shape:
            join(self, other)
        if self.holds_keys:
            structure_changed()  # first, since an interrupt may come before any call; launches wait meanwhile
        elif not (self.buffer.is_only_on_host and other.buffer.is_only_on_host):
            tell_host_code()
        self.buffer, other.buffer = other.buffer, self.buffer
        self._unset, other._unset = other._unset, self._unset
        self.version += 1
        other.version += 1

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        if copy is False:
            raise ValueError(f"the values of {self.path} are copied to NumPy; use view() for an array without a copy")
        values = self.to_numpy()
        return values if dtype is None else values.astype(dtype, copy=False)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """The GPU's memory on the backend ``cuda``, read-only; on others there is no such attribute."""
        device = _device_of_libraries()
        if device is None:
            raise AttributeError(f"kernels do not run on a GPU of NVIDIA's, so {self.path} has no memory there")
        from ebb.relations.device_view import device_view

        return device_view(self, device).__cuda_array_interface__

    def __dlpack__(self, **options: Any) -> Any:
        """The memory that kernels work on for another library, as DLPack says: read-only where the consumer knows how.

        It is the GPU's on the backend ``cuda``, else that of ``view()``.
        """
        device = _device_of_libraries()
        if device is not None and options.get("dl_device") != _ON_HOST:
            from ebb.relations.device_view import device_view

            return device_view(self, device).__dlpack__(**options)
        if options.get("max_version") is None and target_of(self.type) is None:
            refuse(f"reading {self.path}", "read it when the step has run")
            return self._shaped().__dlpack__(**options)  # older consumers take no read-only memory
        return self.view().__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        device = _device_of_libraries()
        return _ON_HOST if device is None else device.dlpack_device or _ON_HOST

    def __repr__(self) -> str:
        return f"<field {self.path}: {self.type!r}, {self.relation.size} rows>"

    @contextmanager
    def held(self) -> Generator[None, None, None]:
        """Within it, launches that touch the field raise; afterwards its values count as changed, wherever they are."""
        with launching():  # a launch that has not seen it any more is waited for
            self._open_views += 1
            structure_changed()
        try:
            yield
        finally:
            self._open_views -= 1
            self.version += 1
            structure_changed()

    @contextmanager
    def _writable_view(self) -> Generator[Array, None, None]:
        with self.held():
            array = self._shaped()
            self.buffer.changed_on_host()
            try:
                yield array
            finally:
                array.flags.writeable = False
                self.buffer.changed_on_host()

    def _place(self) -> Place:
        return Place(self.path, self.type, self.relation.shape)

    def pin(self) -> None:
        """Keeps rows and layout as they are from now on, since somebody may keep the memory."""
        self.relation.storage.pinned = True
        if self.target is not None:  # keys show where its rows lie
            self.target.storage.pinned = True

    def _shaped(self) -> Array:
        """A new array object on the memory, in the shape of the relation."""
        self.pin()
        return self.data.reshape(self.relation.shape + self.type.shape)

    def _load_field(self, source: Field) -> None:
        if source.relation is not self.relation:
            raise RelationError(ForeignField(self.relation.name, source.path))
        source.check_no_view()
        if source.type == self.type:
            self._overwrite(source.data)
            self._unset = source._unset
        elif source.type.shape != self.type.shape or source.target is not None or self.target is not None:
            raise RelationError(
                TypeMismatch("load", self.path, repr(self.type), source.path, repr(source.type)),
            )
        else:
            self._store(converted(source.to_numpy(), self._place()))

    def _store(self, values: Array) -> None:
        """Writes what ``converted`` gave."""
        size, shape = self.relation.size, self.type.shape
        order = self.relation.storage.order
        rows = values
        if values.ndim > len(shape):
            rows = values.reshape(size, *shape)
            rows = rows if order is None else rows[order]
        self._overwrite(rows)

    def _overwrite(self, rows: Array) -> None:
        # Before it too: an interrupt while values are written would come before what follows, and they would be taken
        # for those that were there.
        self.version += 1
        if self.holds_keys:
            self._unset = None
            structure_changed()
        self.buffer.overwrite(rows)
        self.changed()


all_fields: Living[Field] = Living()
"""All fields that there are, those too that the compiler has made for itself."""


def _device_of_libraries() -> Device | None:
    """The device that kernels run on, if other libraries can use its memory."""
    device = current_device()
    return None if device is None or device.dlpack_device is None else device


def _is_function(value: Any) -> bool:
    return callable(value) and not hasattr(value, "__array__")


def _index_tuples(positions: Array, shape: tuple[int, ...]) -> Array:
    """The indices of grid rows on one more trailing axis; -1 for each index of an unset key."""
    indices = np.empty((*positions.shape, len(shape)), dtype=positions.dtype)
    rest = positions
    for axis in range(len(shape) - 1, 0, -1):
        rest, indices[..., axis] = np.divmod(rest, max(shape[axis], 1))
    indices[..., 0] = rest
    indices[positions < 0] = UNSET
    return indices
