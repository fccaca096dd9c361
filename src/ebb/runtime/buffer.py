"""Memory of the runtime: aligned arrays on the host, with the copies that devices keep beside them."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from math import prod
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ebb.runtime.copies import Copies, host_code_relies

if TYPE_CHECKING:
    import numpy.typing as npt

    from ebb.runtime.device import Device, Memory

Array: TypeAlias = "npt.NDArray[Any]"

ALIGNMENT = 64
"""Bytes: a cache line, and the widest vector register of the machines that LLVM emits for here."""

_ROWS_AROUND = 48
"""How many rows beyond the first and the last may be read: kernels load whole registers, and those next to them."""


class Layout(Enum):
    """How the values of a field with several components lie in memory. With one component the two are the same."""

    ROWS = "rows"
    """The components of a row together: a row is a line of the cache, or a part of one."""

    COLUMNS = "columns"
    """One component of all rows after the other: consecutive rows fill a vector register."""


class Buffer:
    """A block of memory of a fixed shape and dtype, zero at first: some rows, each of the same components.

    ``host`` is the copy that the host reads and writes. Its shape is the same in either layout; its strides are not.
    In rows it is C-contiguous. In columns each component is a contiguous array of the rows, the next one begins
    ``column_stride`` elements later, and each is aligned to ``ALIGNMENT`` bytes. The address is fixed for the life of
    the buffer; ``address`` is that of the host's copy. Devices' copies are of the same bytes, so they lie alike.
    """

    __slots__ = ("_array", "address", "copies", "layout")

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any], layout: Layout = Layout.ROWS) -> None:
        self.layout = layout
        room = _ROWS_AROUND * prod(shape[1:]) * dtype.itemsize
        block = aligned_zeros(shape if layout is Layout.ROWS else _column_block(shape, dtype), dtype, room)
        self._array: Array = block if layout is Layout.ROWS else _in_columns(block, shape[0])
        self.address: int = block.ctypes.data
        self.copies = Copies(block.reshape(-1).view(np.uint8))

    # ---- The copies ----

    @property
    def host(self) -> Array:
        """The host's copy, made current: a device that has a newer one is waited for. Who writes to it says so."""
        if not self.copies.is_current:
            self.copies.refresh()
        return self._array

    @property
    def is_current(self) -> bool:
        """Whether the host's copy is valid, so that ``host`` moves nothing."""
        return self.copies.is_current

    @property
    def is_only_on_host(self) -> bool:
        """Whether no device has a valid copy."""
        return self.copies.is_only_on_host

    @property
    def shape(self) -> tuple[int, ...]:
        """The number of rows, then of the components."""
        return self._array.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of a component."""
        return self._array.dtype

    @property
    def strides(self) -> tuple[int, ...]:
        """How many bytes the next row lies behind a row, then the same of components, in every copy."""
        return self._array.strides

    @property
    def nbytes(self) -> int:
        """The bytes of the values, without what lies between columns."""
        return self._array.nbytes

    def on(self, device: Device, overwritten: bool = False) -> Memory:
        """The copy of ``device``, made current. The caller holds ``launching()``.

        Args:
            device: which; the copy stays there until the buffer goes.
            overwritten: whatever the copy holds will do, since what is launched next writes all of it.

        Raises:
            BackendError: there is no room for it, or it cannot be moved. The copies are as valid as before.
        """
        return self.copies.on(device, overwritten)

    def changed_on(self, device: Device) -> None:
        """Says that what was launched on ``device`` writes its copy, which is then the only valid one.

        Called before that is launched where the copy was current, so that no interrupt can come in between; after it
        where all is overwritten, so that what was there stays valid if the device takes no launch.
        """
        self.copies.changed_on(device)

    def changed_on_host(self) -> None:
        """Says that the host's copy has been written, or will be, and is the only valid one."""
        self.copies.changed_on_host()

    def overwrite(self, values: Any) -> None:
        """Sets all values on the host, to what NumPy broadcasts to them; nothing is downloaded for that."""
        self.copies.overwrite(self._array, values)

    # ---- The same values elsewhere ----

    def reshaped(self, shape: tuple[int, ...]) -> Buffer:
        """The same memory, with all of its copies, as other rows. The buffer lies in rows."""
        assert self.layout is Layout.ROWS
        result = Buffer.__new__(Buffer)
        result.layout = self.layout
        result._array = self._array.reshape(shape)
        result.address = self.address
        result.copies = self.copies
        return result

    def in_layout(self, layout: Layout) -> Buffer:
        """The same values in ``layout``: this buffer if they lie so already, else a new one."""
        if layout is self.layout:
            return self
        result = Buffer(self.shape, self.dtype, layout)
        for source, target in zip(self._components(), result._components(), strict=True):
            np.copyto(target, source)
        return result

    def permuted(self, order: npt.NDArray[np.int64]) -> Buffer:
        """A new buffer of the same layout whose row ``p`` is row ``order[p]`` of this one."""
        result = Buffer(self.shape, self.dtype, self.layout)
        if self.layout is Layout.ROWS:
            # mode="clip": with the default, NumPy would gather into a temporary and copy that.
            np.take(self.host, order, axis=0, out=result.host, mode="clip")
        else:
            for source, target in zip(self._components(), result._components(), strict=True):
                np.take(source, order, out=target, mode="clip")
        return result

    def mapped(self, table: npt.NDArray[np.int64]) -> Buffer:
        """A new buffer of the same layout with ``table[k]`` for every key ``k``; unset keys, -1, stay -1."""
        result = Buffer(self.shape, self.dtype, self.layout)
        # Wrapped around, the index -1 is that of the last entry.
        np.take(np.append(table, -1).astype(self.dtype), self.host, out=result.host, mode="wrap")
        return result

    def _components(self) -> list[Array]:
        """Each component of all rows, a one-dimensional view."""
        rows, *shape = self.host.shape
        flat = self.host.reshape(rows, prod(shape))
        return [flat[:, component] for component in range(prod(shape))]


def host_code_uses(buffers: Iterable[Buffer], written: Iterable[Buffer]) -> None:
    """Readies the host's copies for code on the processor, which goes by addresses, until the structure changes.

    Args:
        buffers: what it reads or writes: made current.
        written: those of them that it writes: the host's copy is then the only valid one.

    Raises:
        BackendError: a device does not give what it has.
    """
    host_code_relies()
    for buffer in buffers:
        if not buffer.copies.is_current:
            buffer.copies.refresh()
    for buffer in written:
        buffer.changed_on_host()


def column_stride(rows: int, itemsize: int) -> int:
    """How many elements after a column of ``rows`` rows the next one begins, in the layout of columns.

    Each column begins at a line of the cache. The distance is an odd number of lines, so that a row's components do
    not all fall into the same few sets of the cache, as they would where the number of rows is a power of two.
    """
    lines = -(-rows * itemsize // ALIGNMENT) | 1
    return lines * (ALIGNMENT // itemsize)


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype[Any], room: int = 0) -> Array:
    """A zeroed C-contiguous array whose first byte is aligned to ``ALIGNMENT``.

    At least ``ALIGNMENT`` bytes behind it may be read: kernels load the rows of short vectors by whole registers. So
    may ``room`` bytes before and behind.
    """
    nbytes = prod(shape) * dtype.itemsize
    block = np.zeros(nbytes + 2 * room + 2 * ALIGNMENT, dtype=np.uint8)
    start = room + -(block.ctypes.data + room) % ALIGNMENT
    return block[start : start + nbytes].view(dtype).reshape(shape)


def _column_block(shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, ...]:
    """The shape of the block of memory that an array of ``shape`` lies in, in columns along its first axis."""
    rows, *components = shape
    return (*components, column_stride(rows, dtype.itemsize))


def _in_columns(block: Array, rows: int) -> Array:
    return np.moveaxis(block[..., :rows], -1, 0)
