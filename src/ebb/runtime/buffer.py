"""Memory of the runtime: aligned arrays on the host, where a device will keep its copy beside the host's."""

from __future__ import annotations

from enum import Enum
from math import prod
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

Array: TypeAlias = "npt.NDArray[Any]"

ALIGNMENT = 64
"""Bytes: a cache line, and the widest vector register of the machines that LLVM emits for here."""


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
    the buffer; ``address`` is that of the host's copy.
    """

    __slots__ = ("address", "host", "layout")

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any], layout: Layout = Layout.ROWS) -> None:
        self.layout = layout
        self.host: Array = aligned_zeros(shape, dtype) if layout is Layout.ROWS else _columns(shape, dtype)
        self.address: int = self.host.ctypes.data

    @classmethod
    def of(cls, host: Array) -> Buffer:
        """The memory of ``host`` itself, a C-contiguous array of rows."""
        result = cls((0,), host.dtype)
        result.host, result.address = host, host.ctypes.data
        return result

    def in_layout(self, layout: Layout) -> Buffer:
        """The same values in ``layout``: this buffer if they lie so already, else a new one."""
        if layout is self.layout:
            return self
        result = Buffer(self.host.shape, self.host.dtype, layout)
        for source, target in zip(self._components(), result._components(), strict=True):
            np.copyto(target, source)
        return result

    def permuted(self, order: npt.NDArray[np.int64]) -> Buffer:
        """A new buffer of the same layout whose row ``p`` is row ``order[p]`` of this one."""
        result = Buffer(self.host.shape, self.host.dtype, self.layout)
        if self.layout is Layout.ROWS:
            # mode="clip": with the default, NumPy would gather into a temporary and copy that.
            np.take(self.host, order, axis=0, out=result.host, mode="clip")
        else:
            for source, target in zip(self._components(), result._components(), strict=True):
                np.take(source, order, out=target, mode="clip")
        return result

    def mapped(self, table: npt.NDArray[np.int64]) -> Buffer:
        """A new buffer of the same layout with ``table[k]`` for every key ``k``; unset keys, -1, stay -1."""
        result = Buffer(self.host.shape, self.host.dtype, self.layout)
        # Wrapped around, the index -1 is that of the last entry.
        np.take(np.append(table, -1).astype(self.host.dtype), self.host, out=result.host, mode="wrap")
        return result

    def _components(self) -> list[Array]:
        """Each component of all rows, a one-dimensional view."""
        rows, *shape = self.host.shape
        flat = self.host.reshape(rows, prod(shape))
        return [flat[:, component] for component in range(prod(shape))]


def column_stride(rows: int, itemsize: int) -> int:
    """How many elements after a column of ``rows`` rows the next one begins, in the layout of columns.

    Each column begins at a line of the cache. The distance is an odd number of lines, so that a row's components do
    not all fall into the same few sets of the cache, as they would where the number of rows is a power of two.
    """
    lines = -(-rows * itemsize // ALIGNMENT) | 1
    return lines * (ALIGNMENT // itemsize)


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    """A zeroed C-contiguous array whose first byte is aligned to ``ALIGNMENT``.

    At least ``ALIGNMENT`` bytes behind it may be read: kernels load the rows of short vectors by whole registers.
    """
    nbytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    block = np.zeros(nbytes + 2 * ALIGNMENT, dtype=np.uint8)
    start = -block.ctypes.data % ALIGNMENT
    return block[start : start + nbytes].view(dtype).reshape(shape)


def _columns(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    """A zeroed array of ``shape`` in columns along its first axis."""
    rows, *components = shape
    block = aligned_zeros((*components, column_stride(rows, dtype.itemsize)), dtype)
    return np.moveaxis(block[..., :rows], -1, 0)
