"""Memory of the runtime: aligned arrays on the host, where a device will keep its copy beside the host's."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[Any]

ALIGNMENT = 64
"""Bytes: a cache line, and the widest vector register of the machines that LLVM emits for here."""


class Buffer:
    """A block of memory of a fixed shape and dtype, zero at first.

    ``host`` is the copy that the host reads and writes: C-contiguous and aligned to ``ALIGNMENT`` bytes. Its address is
    fixed for the life of the buffer; ``address`` is that of the host's copy.
    """

    __slots__ = ("address", "host")

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.host: Array = aligned_zeros(shape, dtype)
        self.address: int = self.host.ctypes.data

    @property
    def nbytes(self) -> int:
        """The size of one copy in bytes."""
        return self.host.nbytes

    def permuted(self, order: npt.NDArray[np.int64]) -> Buffer:
        """A new buffer whose row ``p`` is row ``order[p]`` of this one."""
        result = Buffer(self.host.shape, self.host.dtype)
        # mode="clip": with the default, NumPy would gather into a temporary and copy that.
        np.take(self.host, order, axis=0, out=result.host, mode="clip")
        return result

    def mapped(self, table: npt.NDArray[np.int64]) -> Buffer:
        """A new buffer with ``table[k]`` for every key ``k`` of this one; unset keys, -1, stay -1."""
        result = Buffer(self.host.shape, self.host.dtype)
        # Wrapped around, the index -1 is that of the last entry.
        np.take(np.append(table, -1).astype(self.host.dtype), self.host, out=result.host, mode="wrap")
        return result


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    """A zeroed C-contiguous array whose first byte is aligned to ``ALIGNMENT``."""
    nbytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    block = np.zeros(nbytes + ALIGNMENT, dtype=np.uint8)
    start = -block.ctypes.data % ALIGNMENT
    return block[start : start + nbytes].view(dtype).reshape(shape)
