"""NVIDIA's GPUs: a device of ``ebb.runtime.device`` over the CUDA driver.

All goes to the legacy default stream of the device's primary context, one after the other. What other libraries of the
process do with the same memory, they do by default on that stream too, so that it keeps its order with launches.
"""

from __future__ import annotations

import atexit
import gc
import os
from collections.abc import Callable, Sequence
from struct import Struct, calcsize
from typing import Any

import numpy as np

from ebb.errors import BackendError
from ebb.runtime import device
from ebb.runtime.buffer import Array
from ebb.runtime.device import DLPACK_CUDA, Feature
from ebb.runtime.errors_devices import (
    CodeRefused,
    DeviceFailed,
    DeviceLacks,
    LaunchTooLarge,
    OutOfDeviceMemory,
    forked,
)
from ebb.runtime.threads import end_launches_at_exit

OLDEST = 60
"""The least compute capability, 10 major + minor: from here on float64 is added atomically by an instruction."""

MOST_GROUPS = 2**31 - 1
"""How many groups a launch may have."""

MOST_STAGED, MOST_COPIES = 1 << 16, 1 << 8
"""Uploads of so many bytes are from copies, of which there are at most so many before somebody waits."""

_LOG_BYTES = 1 << 14
_END = bytes(1)
"""What strings end with."""


class Memory:
    """A block of a GPU's memory."""

    __slots__ = ("__weakref__", "_device", "address", "nbytes")

    def __init__(self, owner: CudaDevice, address: int, nbytes: int) -> None:
        self._device = owner
        self.address = address
        self.nbytes = nbytes

    def __del__(self) -> None:
        self._device.free(self)


class Module:
    """Loaded code."""

    __slots__ = ("_device", "handle")

    def __init__(self, owner: CudaDevice, handle: Any) -> None:
        self._device = owner
        self.handle = handle

    def __del__(self) -> None:
        self._device.unload(self)


class Entry:
    """A kernel of loaded code, which it keeps, and where its parameters are put for the driver."""

    __slots__ = ("function", "kernel", "module", "parameters")

    def __init__(self, kernel: str, module: Module, function: Any) -> None:
        self.kernel = kernel
        self.module = module
        self.function = function
        self.parameters: Parameters | None = None


class Parameters:
    """Memory for the parameters of a kernel, each at the beginning of a word, and the addresses of these words."""

    __slots__ = ("_layout", "_places", "_words", "address")

    def __init__(self, arguments: Sequence[device.KernelArgument]) -> None:
        words = np.zeros(len(arguments), np.uint64)
        self._words = words.data
        self._places = words.ctypes.data + np.arange(0, words.nbytes, words.itemsize, dtype=np.uint64)
        self.address: int = self._places.ctypes.data
        codes = [_code(each) for each in arguments]
        self._layout = Struct("".join([f"{code}{8 - calcsize(code)}x" for code in codes]))

    def put(self, arguments: Sequence[device.KernelArgument]) -> None:
        """Puts ``arguments`` there, of the types that the first ones had. The caller holds ``launching()``."""
        values = [each.address if isinstance(each, Memory) else each for each in arguments]
        self._layout.pack_into(self._words, 0, *values)


class CudaDevice:
    """A GPU.

    Attributes:
        name: what messages call it.
        capability: its compute capability, 10 major + minor.
        lacks: what it does not have: minima of floats are loops there.
        dlpack_device: what DLPack calls it, the kind of its memory and its number.
        taken: how many bytes of its memory this process holds.
    """

    def __init__(self, driver: Any, number: int) -> None:
        """The GPU ``number`` of ``driver``, which is ``cuda.bindings.driver`` or stands for it.

        Raises:
            BackendError: it cannot be used.
        """
        self._driver = driver
        self._process = os.getpid()
        end_launches_at_exit()
        self._open = False
        self.name = f"cuda {number}"
        self.lacks = frozenset[Feature]()
        self.dlpack_device = (DLPACK_CUDA, number)
        self.taken = 0
        self._staged: list[Array] = []
        handle = self._result("being opened", driver.cuDeviceGet(number))
        self.name = self._result("being opened", driver.cuDeviceGetName(256, handle)).split(_END)[0].decode()
        major, minor, self._has_pools = (
            self._result("being opened", driver.cuDeviceGetAttribute(getattr(driver.CUdevice_attribute, name), handle))
            for name in (
                "CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR",
                "CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR",
                "CU_DEVICE_ATTRIBUTE_MEMORY_POOLS_SUPPORTED",
            )
        )
        self.capability: int = 10 * major + minor
        if self.capability < OLDEST:
            lacked = f"compute capability {OLDEST / 10} (it has {major}.{minor})"
            raise BackendError(DeviceLacks(self.name, None, (lacked,), ('run elsewhere: ebb.set_backend("cpu")',)))
        self._stream = driver.CUstream(driver.CU_STREAM_LEGACY)
        self._context = self._result("being opened", driver.cuDevicePrimaryCtxRetain(handle))
        self._open = True
        atexit.register(self._close)

    # ---- Memory ----

    def allocate(self, nbytes: int) -> Memory:
        """As ``Device.allocate``."""
        if not nbytes:
            return Memory(self, 0, 0)
        none_left = self._driver.CUresult.CUDA_ERROR_OUT_OF_MEMORY
        answer = self._allocate(nbytes)
        if answer[0] == none_left:
            gc.collect()  # what was held in cycles is free now
            answer = self._allocate(nbytes)
        if answer[0] == none_left:
            free, total = self._call("being asked for its memory", self._driver.cuMemGetInfo)
            raise BackendError(OutOfDeviceMemory(self.name, nbytes, self.taken, total, free))
        address = int(self._result("taking memory", answer))
        self.taken += nbytes
        return Memory(self, address, nbytes)

    def _allocate(self, nbytes: int) -> tuple[Any, ...]:
        if self._has_pools:
            return self._in_context(self._driver.cuMemAllocAsync, nbytes, self._stream)
        return self._in_context(self._driver.cuMemAlloc, nbytes)

    def free(self, memory: Memory) -> None:
        """Gives back memory that nobody holds any more, once all that is queued has run."""
        if memory.address and self._is_here:
            self.taken -= memory.nbytes
            if self._has_pools:
                self._in_context(self._driver.cuMemFreeAsync, memory.address, self._stream)
            else:
                self._in_context(self._driver.cuMemFree, memory.address)  # waits for what runs

    def upload(self, target: device.Memory, source: Array) -> None:
        """As ``Device.upload``. Few bytes are copied first, so that nobody waits.

        Memory that is not pinned may be read when this has returned, where GPUs see the processor's page tables.
        """
        assert isinstance(target, Memory)
        if not source.nbytes:
            return
        few = source.nbytes <= MOST_STAGED
        if few:
            source = source.copy()
            self._staged.append(source)
        copy, stream = self._driver.cuMemcpyHtoDAsync, self._stream
        self._call("copying to it", copy, target.address, source.ctypes.data, source.nbytes, stream)
        if not few or len(self._staged) >= MOST_COPIES:
            self.wait()

    def download(self, source: device.Memory, target: Array) -> None:
        """As ``Device.download``."""
        assert isinstance(source, Memory)
        if target.nbytes:
            copy, stream = self._driver.cuMemcpyDtoHAsync, self._stream
            self._call("copying from it", copy, target.ctypes.data, source.address, target.nbytes, stream)
            self.wait()

    # ---- Kernels ----

    def load(self, kernel: str, image: bytes, entries: tuple[str, ...]) -> tuple[Entry, ...]:
        """As ``Device.load``, for PTX."""
        driver, log = self._driver, bytearray(_LOG_BYTES)
        names = driver.CUjit_option
        options = [names.CU_JIT_ERROR_LOG_BUFFER, names.CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES]
        text = image + _END
        status, handle = self._in_context(driver.cuModuleLoadDataEx, text, len(options), options, [log, len(log)])
        if status:
            said = bytes(log).split(_END)[0].decode(errors="replace")
            raise BackendError(CodeRefused(self.name, kernel, f"{reason(driver, status)}\n{said}"))
        module, action = Module(self, handle), f"loading kernel '{kernel}'"
        functions = [self._call(action, driver.cuModuleGetFunction, handle, entry.encode()) for entry in entries]
        return tuple(Entry(kernel, module, function) for function in functions)

    def unload(self, module: Module) -> None:
        """Drops code that nobody holds any more."""
        if self._is_here:
            self._in_context(self._driver.cuStreamSynchronize, self._stream)  # it may be running
            self._in_context(self._driver.cuModuleUnload, module.handle)

    def launch(
        self, entry: device.Entry, groups: int, group_size: int, arguments: Sequence[device.KernelArgument]
    ) -> None:
        """As ``Device.launch``."""
        assert isinstance(entry, Entry)
        if not groups:
            return
        if groups > MOST_GROUPS:
            remedy = "let more rows run together: @ebb.kernel(block_size=256), or block_size=256 in the launch"
            raise BackendError(LaunchTooLarge(self.name, entry.kernel, "work-groups", groups, MOST_GROUPS, remedy))
        parameters = entry.parameters
        if parameters is None:
            parameters = entry.parameters = Parameters(arguments)
        parameters.put(arguments)  # the driver reads them before it returns
        grid, group, group_memory = (groups, 1, 1), (group_size, 1, 1), 0
        launch, stream = self._driver.cuLaunchKernel, self._stream
        action = f"launching kernel '{entry.kernel}'"
        self._call(action, launch, entry.function, *grid, *group, group_memory, stream, parameters.address, 0)

    def wait(self) -> None:
        """As ``Device.wait``."""
        self._call("running kernels", self._driver.cuStreamSynchronize, self._stream)
        self._staged.clear()

    # ---- The driver ----

    @property
    def _is_here(self) -> bool:
        """Whether the driver still has what it gave to this process."""
        return self._open and os.getpid() == self._process

    def _call(self, action: str, function: Callable[..., Any], *arguments: Any) -> Any:
        if os.getpid() != self._process:
            raise BackendError(forked(self.name))
        return self._result(action, self._in_context(function, *arguments))

    def _in_context(self, function: Callable[..., Any], *arguments: Any) -> tuple[Any, ...]:
        """What a function of the driver answers where the device's context is the one of this thread.

        Afterwards it is the one that it was: another library may have chosen it.
        """
        answer = self._driver.cuCtxPushCurrent(self._context)
        if answer[0]:
            return (*answer, None)
        try:
            return function(*arguments)
        finally:
            self._driver.cuCtxPopCurrent()

    def _result(self, action: str, answer: tuple[Any, ...]) -> Any:
        """What the driver answered behind the status: nothing, a value or several."""
        status, *values = answer
        if status:
            raise BackendError(DeviceFailed(self.name, action, reason(self._driver, status), ()))
        return values[0] if len(values) == 1 else values

    def _close(self) -> None:
        """The process ends, and the driver frees what is left. It may be gone before the last objects are."""
        self._open = False


def _code(argument: Any) -> str:
    """What ``struct`` calls the type of a parameter."""
    return "P" if isinstance(argument, Memory) else argument.dtype.char


def reason(driver: Any, status: Any) -> str:
    """What the driver calls a status that is an error."""
    _, text = driver.cuGetErrorString(status)
    return f"{text.decode()} ({status.name})" if text else status.name
