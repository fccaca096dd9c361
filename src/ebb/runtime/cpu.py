"""The processor as a device: machine code is linked into the process and called, on one thread or many.

The argument block is one array of 64-bit words by which the host hands a launch to the machine code: a header, the
address of each slot, and each scalar argument in the low end of a word.
"""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from ebb.errors import BackendError
from ebb.runtime.buffer import aligned_zeros
from ebb.runtime.errors import NoMachineCode
from ebb.runtime.replay import REPLAY
from ebb.runtime.symbols import external_symbols
from ebb.runtime.threads import openmp, usable_threads

THREADS, ROWS, BOXES, FORK, THREAD_NUMBER, FAILURES, ITEMS, STARTS, WAVES, WAVE = range(10)
SHARES, TEAM, CHUNK, BLOCK_CODE, FINISH_CODE = range(10, 15)
HEADER_WORDS = 15
"""The header: how many threads and rows; the boxes of the blocks; OpenMP's entries; the failure records; then
what may run at once: the stretches of blocks that are the items, each as its first block and the one behind its last
(no address: each block is an item); the item that each wave starts with; how many waves there are; and the present one.
The items of a wave run at once. In each wave they ascend. Then how they are shared: the shares, how many there are, and
how many items a thread takes at a time. Last where the entries of the kernel are."""

FAILURE_WORDS = 16
"""A thread's failure record: the site + 1 (0: none), the block, the row's position, and the payload."""

PAYLOAD_START = 3

BLOCK_ENTRY, FINISH_ENTRY = "ebb_blocks", "ebb_finish"
"""The entries of a kernel: ``i64 BLOCK_ENTRY(block*, record*, i64 first, i64 end)`` runs some blocks of rows and
returns 1 on failure, which the record tells of, ``void FINISH_ENTRY(block*)`` does what is left behind the last wave.
"""

SHARE_WORDS = 16
"""What a thread has left of a wave, in a word that has two cache lines to itself, since they are fetched in pairs: in
its low half the first item, in its high half the one behind the last, both counted from the first of the wave."""

LAUNCH, DEAL, SHARE = "ebb_launch", "ebb_deal", "ebb_share"
"""The entries of the driver: ``i64 LAUNCH(block*)`` runs everything on the threads of OpenMP and returns 1 on failure.
For other threads there are ``void DEAL(block*, i64 threads)``, which shares the present wave out among threads, and
``void SHARE(block*, i64 thread)``, what one of them does.
"""

_links = itertools.count()

_LINKED_TOGETHER = 256
"""What one linker links. LLVM forgets unloaded code all but some 10 kB, and the rest with the linker, which lives as
long as any code that it has linked. To make one takes 3 ms."""


class ArgumentBlock:
    """The words that one launch hands over.

    Attributes:
        words: all of them, as an array.
        address: where they begin; it never changes.
        views: the same memory by type, which is quicker to write one word of than the array is.
        numbers: the view as int64.
        failures: the failure records, one row a thread.
    """

    __slots__ = ("address", "failures", "numbers", "views", "words")

    def __init__(self, words: int, threads: int) -> None:
        self.words = aligned_zeros((words,), np.dtype(np.int64))
        self.address = self.words.ctypes.data
        raw: Any = memoryview(self.words)  # pyright: ignore[reportArgumentType] - NumPy's stubs have no __buffer__
        self.views: dict[str, memoryview[Any]] = {code: raw.cast("B").cast(code) for code in "qQiIdf?"}
        self.numbers = self.views["q"]
        self.failures = aligned_zeros((threads, FAILURE_WORDS), np.dtype(np.int64))
        self.words[FAILURES] = self.failures.ctypes.data

    def join_threads(self) -> None:
        """Puts in place what a launch on several threads needs. One on a single thread need not wait for OpenMP."""
        runtime = openmp()
        if runtime is not None:
            self.words[[FORK, THREAD_NUMBER]] = runtime.fork, runtime.thread_number

    def take_failure(self) -> tuple[int, int, tuple[int, ...]]:
        """The site, position and payload of the first failure in the order of rows; the records are cleared.

        After its first failure a thread only goes on with blocks that precede it, and every wave runs: so one of the
        threads knows the first failure, however many there are.
        """
        failed = np.flatnonzero(self.failures[:, 0])
        record = self.failures[failed[np.argmin(self.failures[failed, 1])]].tolist()
        self.failures.fill(0)
        return record[0] - 1, record[2], tuple(record[PAYLOAD_START:])


class CpuCode:
    """Machine code of a kernel in this process. It is unloaded with this object.

    Attributes:
        blocks, finish: the addresses of its entries.
    """

    __slots__ = ("_tracker", "blocks", "finish")

    def __init__(self, tracker: Any) -> None:
        self._tracker = tracker
        self.blocks: int = tracker[BLOCK_ENTRY]
        self.finish: int = tracker[FINISH_ENTRY]


class Driver:
    """The machine code that takes launches, and captured steps, through that of kernels. It goes with this object."""

    __slots__ = ("_tracker", "deal", "launch", "replay", "share")

    def __init__(self, tracker: Any) -> None:
        self._tracker = tracker
        word, pointer = ctypes.c_int64, ctypes.c_void_p
        self.launch: Callable[[int], int] = ctypes.CFUNCTYPE(word, pointer)(tracker[LAUNCH])
        self.deal: Callable[[int, int], None] = ctypes.CFUNCTYPE(None, pointer, word)(tracker[DEAL])
        self.share: Callable[[int, int], None] = ctypes.CFUNCTYPE(None, pointer, word)(tracker[SHARE])
        self.replay: Callable[[int], int] = ctypes.CFUNCTYPE(word, pointer)(tracker[REPLAY])


class CpuDevice:
    """This machine's processor.

    Attributes:
        threads: how many threads a launch may use.
        shares: what each of them has left to do of the present launch; there is one at a time.
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self.shares = aligned_zeros((threads, SHARE_WORDS), np.dtype(np.int64))

    def load(self, name: str, image: bytes) -> CpuCode:
        """Links the object code ``image`` into the process.

        Raises:
            BackendError: it cannot be linked.
        """
        return CpuCode(_link(name, image, (BLOCK_ENTRY, FINISH_ENTRY)))

    def load_driver(self, image: bytes) -> Driver:
        """Links the object code of the driver into the process.

        Raises:
            BackendError: it cannot be linked.
        """
        return Driver(_link("driver", image, (LAUNCH, DEAL, SHARE, REPLAY)))

    def launch(self, driver: Driver, block: ArgumentBlock, shares: int) -> bool:
        """Runs the code of ``block`` over its blocks of rows, which at most ``shares`` threads share.

        Returns:
            Whether some row failed.
        """
        threads = block.numbers[THREADS] = self.threads_for(shares)
        if threads == 1 or block.numbers[FORK]:
            return driver.launch(block.address) != 0
        return _launch_on_python_threads(driver, block, threads)

    def threads_for(self, shares: int) -> int:
        """How many threads a launch gets that as many as ``shares`` threads can share."""
        threads = shares if shares < self.threads else self.threads
        return usable_threads(threads) if threads > 1 else 1


def _launch_on_python_threads(driver: Driver, block: ArgumentBlock, threads: int) -> bool:
    from concurrent.futures import ThreadPoolExecutor  # here: few machines get here

    def share(thread: int) -> None:
        driver.share(block.address, thread)

    with ThreadPoolExecutor(threads) as pool:
        for wave in range(block.numbers[WAVES]):
            block.numbers[WAVE] = wave
            driver.deal(block.address, threads)
            list(pool.map(share, range(threads)))
    if block.failures[:, 0].any():
        return True
    ctypes.CFUNCTYPE(None, ctypes.c_void_p)(block.numbers[FINISH_CODE])(block.address)
    return False


def _link(name: str, image: bytes, entries: tuple[str, ...]) -> Any:
    """Links object code into the process; the result has the addresses of its ``entries``, and keeps it there."""
    builder = llvm.JITLibraryBuilder().add_object_img(image)
    for symbol, address in external_symbols(image).items():
        builder.import_symbol(symbol, address)
    for entry in entries:
        builder.export_symbol(entry)
    try:
        return builder.link(_linker(), f"{name}.{next(_links)}")
    except RuntimeError as error:
        raise BackendError(NoMachineCode(llvm.get_process_triple(), str(error))) from error


class _Linker:
    """LLVM's linker of this process, made on first use, and how much it has linked."""

    instance: Any = None
    linked: int = 0


def _linker() -> Any:
    if _Linker.instance is None:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
    if _Linker.instance is None or _Linker.linked == _LINKED_TOGETHER:
        # It links and compiles nothing: for the processor as it is, LLVM would have to find out about it again.
        target = llvm.Target.from_triple(llvm.get_process_triple())
        machine = target.create_target_machine(opt=0, reloc="pic", codemodel="small")
        # JITLink puts the parts of an object next to one another; LLVM's older linker may put them out of reach.
        _Linker.instance = llvm.create_lljit_compiler(machine, use_jit_link=True)
        _Linker.linked = 0
    _Linker.linked += 1
    return _Linker.instance
