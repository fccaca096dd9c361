"""Devices beside the processor: memory of their own, loaded kernels, and one queue that runs what it is given in order.

What the host and the code of a device agree on stands here too: how a launch on work-groups tells of rows that failed.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Protocol, TypeAlias

import numpy as np

from ebb.records import record
from ebb.runtime.buffer import Array

FAILURE_WORDS = 12
"""The int64 words of a failure record: the number of the row in the launch, its position, the site + 1, the payload."""

FAILURE_CHUNK = 64
"""Rows are told apart to this many by the word that keeps the lowest failure."""

FAILURE_CAPACITY = 1024
"""How many records there is room for. Once a row has failed, only those of its chunk and of lower ones leave one."""

FAILURE_LOWEST, FAILURE_COUNT = range(2)
"""The 32-bit words before the records: the lowest chunk that has failed, all ones at first, and how many records."""

FAILURE_START = 16
"""The byte at which the records begin."""

FAILURE_BYTES = FAILURE_START + FAILURE_CAPACITY * FAILURE_WORDS * 8


DLPACK_CUDA = 2
"""DLPack's number of the memory of NVIDIA's GPUs."""


class Feature(Enum):
    """What code may need of a device and not every device has. The values are its names in messages."""

    FLOAT64 = "ebb.float64"
    ATOMICS64 = "atomic operations on 64-bit integers"
    FLOAT32_ADD = "atomic addition of ebb.float32"
    FLOAT64_ADD = "atomic addition of ebb.float64"


class Memory(Protocol):
    """A block of a device's memory. It is given back when nobody holds it any more and what uses it has run."""

    @property
    def nbytes(self) -> int:
        """How many bytes it has."""
        ...


class Entry(Protocol):
    """A kernel of loaded code. It keeps the code loaded."""


KernelArgument: TypeAlias = Memory | np.generic
"""What a kernel takes: memory, or a scalar in the very type of the parameter."""


class Device(Protocol):
    """A device. What it is given runs in order; who needs to see the effects waits."""

    @property
    def name(self) -> str:
        """What messages call it."""
        ...

    @property
    def lacks(self) -> frozenset[Feature]:
        """What it does not have."""
        ...

    @property
    def dlpack_device(self) -> tuple[int, int] | None:
        """What DLPack calls it where other libraries can use its memory, by an attribute ``address``; else None."""
        ...

    def allocate(self, nbytes: int) -> Memory:
        """Memory of ``nbytes`` bytes, whatever they hold.

        Raises:
            BackendError: there is not so much.
        """
        ...

    def upload(self, target: Memory, source: Array) -> None:
        """Copies the bytes of ``source``, a flat array of bytes, to the beginning of ``target``.

        ``source`` may be changed as soon as this returns.
        """
        ...

    def download(self, source: Memory, target: Array) -> None:
        """Copies the beginning of ``source`` to ``target``, a flat array of bytes, after all that was queued before."""
        ...

    def load(self, kernel: str, image: bytes, entries: tuple[str, ...]) -> tuple[Entry, ...]:
        """Loads compiled code.

        Args:
            kernel: the name of the user's kernel, for messages.
            image: what the target of the device is compiled to.
            entries: the names of its kernels.

        Raises:
            BackendError: the device does not take it.
        """
        ...

    def launch(self, entry: Entry, groups: int, group_size: int, arguments: Sequence[KernelArgument]) -> None:
        """Queues a kernel on ``groups`` work-groups of ``group_size`` threads; returns at once.

        Raises:
            BackendError: the device cannot run such a launch.
        """
        ...

    def wait(self) -> None:
        """Waits until all that was queued has run.

        Raises:
            BackendError: the device failed meanwhile.
        """
        ...


# ---- The device that kernels run on ----


@record(frozen=False)
class _Current:
    """What ``use_device`` was told last."""

    device: Device | None = None


_current = _Current()


def current_device() -> Device | None:
    """The device of the backend that launches run on; None for the processor."""
    return _current.device


def use_device(device: Device | None) -> None:
    """Says on which device launches run from now on. Choosing a backend calls this."""
    _current.device = device
