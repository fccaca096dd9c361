"""What kernels on a device leave for the host to look at: rows that failed, and lines to print."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ebb.backends.printing import PrintLayout
from ebb.compiler import kir, lir
from ebb.runtime.buffer import Array
from ebb.runtime.device import (
    FAILURE_BYTES,
    FAILURE_CAPACITY,
    FAILURE_COUNT,
    FAILURE_LOWEST,
    FAILURE_START,
    FAILURE_WORDS,
    Device,
)

_ROW, _POSITION, _SITE, _PAYLOAD = range(4)
"""Where the words of a failure record begin."""

Failure: TypeAlias = tuple[int, int, tuple[int, ...]]
"""The number of the site, the position of the row, and the payload."""


class FailureRecords:
    """The memory in which kernels on one device say which rows failed. One launch uses it at a time.

    Attributes:
        memory: what kernels get.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self.memory = device.allocate(FAILURE_BYTES)
        self._none = np.zeros(FAILURE_START, dtype=np.uint8)
        self._none.view(np.uint32)[FAILURE_LOWEST] = 0xFFFFFFFF
        self._head = np.zeros(FAILURE_START, dtype=np.uint8)
        self._words = self._head.view(np.uint32)
        self._clear = False

    def prepare(self) -> None:
        """Makes sure that nothing is left of a launch that nobody has looked at: it was interrupted."""
        if not self._clear:
            self._device.upload(self.memory, self._none)
        self._clear = False

    def take(self) -> Failure | None:
        """Waits for the launch, and gives the failure of the row that comes first in it, or None.

        Where more threads than there is room for fail at one moment, the first row's record may be gone: then it is
        the first of those that are left.
        """
        self._device.download(self.memory, self._head)
        count = int(self._words[FAILURE_COUNT])
        if not count:
            self._clear = True
            return None
        content = np.zeros(FAILURE_BYTES, dtype=np.uint8)
        self._device.download(self.memory, content)
        self._device.upload(self.memory, self._none)
        self._clear = True
        records = content[FAILURE_START:].view(np.int64).reshape(FAILURE_CAPACITY, FAILURE_WORDS)[:count]
        first = records[np.argmin(records[:, _ROW])].tolist()
        return first[_SITE] - 1, first[_POSITION], tuple(first[_PAYLOAD:])


class PrintMemory:
    """The records of one kernel's prints in a device's memory.

    Attributes:
        memory: what the kernel gets.
    """

    def __init__(self, kernel: kir.Kernel, program: lir.Program, device: Device) -> None:
        self._layout = PrintLayout(kernel, program)
        self._device = device
        self.memory = device.allocate(8 * self._layout.words)
        self._none = np.zeros(lir.PRINT_RECORDS, dtype=np.int64)
        self._none[lir.PRINT_CAPACITY] = self._layout.lines
        self._clear = False

    def prepare(self) -> None:
        """Makes sure that nothing is left of a launch that nobody has looked at."""
        if not self._clear:
            self._device.upload(self.memory, self._none.view(np.uint8))
        self._clear = False

    def flush(self, failed: int | None) -> None:
        """Waits for the launch and prints its lines; ``failed`` is the position of the row at which it failed."""
        count = int(self._download(lir.PRINT_RECORDS)[lir.PRINT_COUNTER])
        words = self._download(self._layout.used(count)) if count else None
        if count:
            self._device.upload(self.memory, self._none.view(np.uint8))
        self._clear = True  # before any line is written, which may fail or launch the kernel again
        if words is not None:
            self._layout.write_out(words, failed)

    def _download(self, words: int) -> Array:
        found = np.zeros(words, dtype=np.int64)
        self._device.download(self.memory, found.view(np.uint8))
        return found
