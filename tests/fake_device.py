"""A device whose memory is the host's: it runs Python functions when somebody waits, and notes what is moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ebb.relations.field import Field
from ebb.runtime.buffer import Buffer
from ebb.runtime.threads import launching


@dataclass(eq=False)
class FakeMemory:
    bytes: np.ndarray

    @property
    def nbytes(self) -> int:
        return self.bytes.size

    def values(self, buffer: Buffer) -> np.ndarray:
        """The copy of ``buffer`` that the memory holds, as an array of its shape."""
        return np.ndarray(buffer.shape, buffer.dtype, self.bytes.data, strides=buffer.strides)


@dataclass(eq=False)
class FakeDevice:
    """Launches and copies run in order, and only when there is no way around it.

    Attributes:
        moves: what has been moved: "up" or "down", and how many bytes.
        launched: how many launches have been queued.
        failure: raised by the next transfer or allocation, after half of it is done.
    """

    name: str = "fake"
    lacks: frozenset = frozenset()
    dlpack_device: tuple[int, int] | None = None
    moves: list[tuple[str, int]] = field(default_factory=list)
    launched: int = 0
    failure: BaseException | None = None
    _queue: list[Callable[[], None]] = field(default_factory=list)

    def allocate(self, nbytes):
        assert nbytes > 0
        self._fail()
        return FakeMemory(np.full(nbytes, 0xAB, np.uint8))

    def upload(self, target, source):
        assert source.dtype == np.uint8 and source.ndim == 1 and 0 < source.size <= target.nbytes
        taken = source.copy()
        if self.failure is not None:
            self._queue.append(lambda: target.bytes.__setitem__(slice(taken.size // 2), taken[: taken.size // 2]))
            self._fail()
        self._queue.append(lambda: target.bytes.__setitem__(slice(taken.size), taken))
        self.moves.append(("up", source.size))

    def download(self, source, target):
        assert target.dtype == np.uint8 and target.ndim == 1 and 0 < target.size <= source.nbytes
        self.wait()
        if self.failure is not None:
            target[: target.size // 2] = 0xCD
            self._fail()
        target[:] = source.bytes[: target.size]
        self.moves.append(("down", target.size))

    def load(self, kernel, image, entries):
        raise NotImplementedError("the fake device runs functions")

    def launch(self, entry, groups, group_size, arguments):
        self.launched += 1
        self._queue.append(lambda: entry(*arguments))

    def wait(self):
        queue, self._queue = self._queue, []
        for command in queue:
            command()

    def taken_moves(self) -> list[tuple[str, int]]:
        """What has been moved since this was last asked."""
        taken, self.moves = self.moves, []
        return taken

    def _fail(self):
        failure, self.failure = self.failure, None
        if failure is not None:
            raise failure


def run_on(device, compute, *places, changed=(), overwritten=()):
    """Launches ``compute`` as a backend does, on the copies of fields and globals: of all, in the order given.

    Args:
        device: where.
        compute: takes arrays.
        places: what is only read.
        changed: what is written but not all of it.
        overwritten: what is written without a look at it.
    """
    buffers = [each.buffer for each in (*places, *changed, *overwritten)]
    with launching():
        memories = [buffer.on(device, overwritten=False) for buffer in buffers[: len(places) + len(changed)]]
        memories += [each.buffer.on(device, overwritten=True) for each in overwritten]
        arrays = [memory.values(buffer) for memory, buffer in zip(memories, buffers, strict=True)]
        for each in changed:
            each.buffer.changed_on(device)
        device.launch(lambda: compute(*arrays), 1, 1, ())
        for each in overwritten:
            each.buffer.changed_on(device)
        for each in (*changed, *overwritten):
            if isinstance(each, Field):
                each.rewritten()
