"""A device of OpenCL, through pyopencl: memory, loaded kernels, and one queue in order."""

from __future__ import annotations

import gc
import os
import warnings
from collections.abc import Sequence
from contextlib import suppress
from hashlib import blake2b
from typing import Any, Protocol

import llvmlite.binding as llvm
import numpy as np
import pyopencl as cl

from ebb.errors import BackendError
from ebb.runtime import device
from ebb.runtime.buffer import Array
from ebb.runtime.errors_devices import CodeRefused, DeviceFailed, LaunchTooLarge, OutOfDeviceMemory, forked
from ebb.runtime.opencl import Candidate, Kind
from ebb.runtime.opencl_runtime import right_instructions
from ebb.runtime.threads import end_launches_at_exit

_NO_MEMORY = (
    cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE,
    cl.status_code.OUT_OF_HOST_MEMORY,
    cl.status_code.INVALID_BUFFER_SIZE,
)

_PATTERNS = frozenset(1 << power for power in range(8))
"""The sizes in bytes of what OpenCL can fill memory with."""

_ADDRESS = 8
"""Bytes of a parameter that is memory: devices with other addresses are not opened."""

_EXACT = "-cl-fp32-correctly-rounded-divide-sqrt"
"""Division and square roots of float32 as everywhere else, where a device can; else they may be off by three units."""

#: The parts of SPIR-V that are read here: words of the header, instructions, and an execution mode.
_HEADER_WORDS, _EXECUTION_MODE, _FUNCTION, _LOCAL_SIZE = 5, 16, 54, 17

_SMALLER = "let fewer rows run together: @ebb.kernel(block_size=32), or block_size=32 in the launch"


class Memory:
    """A block of the memory of an OpenCL device. ``buffer`` has at least a byte, since OpenCL knows no empty ones."""

    __slots__ = ("__weakref__", "_device", "buffer", "nbytes")

    def __init__(self, owner: OpenCLDevice, buffer: cl.Buffer, nbytes: int) -> None:
        self._device = owner
        self.buffer = buffer
        self.nbytes = nbytes
        owner.taken += nbytes

    def __del__(self) -> None:
        self._device.taken -= self.nbytes


class Entry:
    """A kernel of loaded code, with the most threads that a work-group of it may have here."""

    __slots__ = ("group_size", "handle", "kernel", "prepared")

    def __init__(self, kernel: str, handle: cl.Kernel, group_size: int) -> None:
        self.kernel = kernel
        self.handle = handle
        self.group_size = group_size
        self.prepared = False


class CodeStore(Protocol):
    """What keeps code from one process to the next: the cache of ``ebb.backends``, which may forget anything."""

    def get(self, key: str) -> bytes | None:
        """The code under ``key``, if it is there."""
        ...

    def put(self, key: str, image: bytes) -> None:
        """Keeps code under ``key``, 64 hexadecimal digits."""
        ...


class OpenCLDevice:
    """A device of OpenCL.

    Attributes:
        taken: how many bytes of its memory this process holds.
        binaries: what keeps the driver's code for the next process; None if nothing does.
    """

    def __init__(self, candidate: Candidate) -> None:
        self.candidate = candidate
        self.name = candidate.name
        self.lacks = candidate.lacks
        self.dlpack_device = None
        self.taken = 0
        self._process = os.getpid()
        end_launches_at_exit()
        self._handle = candidate.handle
        try:
            with right_instructions() as instructions:
                self.context = cl.Context([self._handle])
            self.queue = cl.CommandQueue(self.context, self._handle)
        except cl.Error as error:
            raise self._failure("starting", error) from error
        self._most_bytes = self._handle.max_mem_alloc_size
        exact = self._handle.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT
        self._options = [_EXACT] if exact else []
        self.binaries: CodeStore | None = None
        self._identity = _identity(candidate, self._options, instructions)

    def allocate(self, nbytes: int) -> Memory:
        """As ``Device.allocate``."""
        self._check_process()
        if not self._fits(nbytes):
            gc.collect()  # what was held in cycles is free now
        if not self._fits(nbytes):
            raise self._out_of_memory(nbytes)
        try:
            return Memory(self, cl.Buffer(self.context, cl.mem_flags.READ_WRITE, max(nbytes, 1)), nbytes)
        except cl.Error as error:
            raise self._failure("taking memory", error, nbytes) from error

    def _fits(self, nbytes: int) -> bool:
        # Processors promise memory that is not there, and end who uses it.
        return nbytes <= self._most_bytes and self.taken + nbytes <= self.candidate.memory

    def upload(self, target: device.Memory, source: Array) -> None:
        """As ``Device.upload``. A few bytes go as a pattern: the queue has a copy of it at once, and nobody waits."""
        assert isinstance(target, Memory)
        self._check_process()
        try:
            if source.nbytes in _PATTERNS:
                cl.enqueue_fill_buffer(self.queue, target.buffer, source, 0, source.nbytes)
            elif source.nbytes:
                cl.enqueue_copy(self.queue, target.buffer, source, is_blocking=True)
        except cl.Error as error:
            raise self._failure("copying to it", error, source.nbytes) from error

    def download(self, source: device.Memory, target: Array) -> None:
        """As ``Device.download``."""
        assert isinstance(source, Memory)
        self._check_process()
        try:
            if target.nbytes:
                cl.enqueue_copy(self.queue, target, source.buffer, is_blocking=True)
        except cl.Error as error:
            raise self._failure("copying from it", error, target.nbytes) from error

    def load(self, kernel: str, image: bytes, entries: tuple[str, ...]) -> tuple[Entry, ...]:
        """As ``Device.load``, for SPIR-V."""
        self._check_process()
        version = (image[6], image[5])
        if version > self.candidate.spirv:
            log = "this is SPIR-V {}.{}, and it takes up to {}.{}".format(*version, *self.candidate.spirv)
            raise BackendError(CodeRefused(self.name, kernel, log))
        self._check_group(kernel, _required_threads(image), self.candidate.group_size)
        try:
            program = self._program(image)
            return tuple(self._entry(kernel, cl.Kernel(program, entry)) for entry in entries)
        except cl.Error as error:
            if error.code in (*_NO_MEMORY, cl.status_code.DEVICE_NOT_AVAILABLE):
                raise self._failure(f"loading kernel '{kernel}'", error, len(image)) from error
            raise BackendError(CodeRefused(self.name, kernel, str(error))) from error

    def _program(self, image: bytes) -> cl.Program:
        """What the driver makes of SPIR-V, or has made of it before: that takes a tenth of the time."""
        key = blake2b(image, digest_size=32, key=self._identity).hexdigest()
        binary = None if self.binaries is None else self.binaries.get(key)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", cl.CompilerWarning)  # what compilers say when all is well
            if binary is not None:
                with suppress(cl.Error):  # the driver has become another one in spite of its version
                    return cl.Program(self.context, [self._handle], [binary]).build()
            program = cl.Program(self.context, image).build(self._options, [self._handle])
        if self.binaries is not None:
            self.binaries.put(key, program.binaries[0])
        return program

    def _entry(self, kernel: str, handle: cl.Kernel) -> Entry:
        ask, most = cl.kernel_work_group_info, self.candidate.group_memory
        shared = handle.get_work_group_info(ask.LOCAL_MEM_SIZE, self._handle)
        if shared > most:
            what = "bytes of memory for a work-group"
            raise BackendError(LaunchTooLarge(self.name, kernel, what, shared, most, _SMALLER))
        threads = handle.get_work_group_info(ask.WORK_GROUP_SIZE, self._handle)
        return Entry(kernel, handle, min(threads, self.candidate.group_size))

    def launch(
        self, entry: device.Entry, groups: int, group_size: int, arguments: Sequence[device.KernelArgument]
    ) -> None:
        """As ``Device.launch``."""
        assert isinstance(entry, Entry)
        self._check_process()
        if not entry.prepared:
            self._prepare(entry, arguments)
        self._check_group(entry.kernel, group_size, entry.group_size)
        if not groups:
            return
        values: list[Any] = [each.buffer if isinstance(each, Memory) else each for each in arguments]
        try:
            entry.handle.set_args(*values)
            cl.enqueue_nd_range_kernel(self.queue, entry.handle, (groups * group_size,), (group_size,))
            self.queue.flush()  # else it may begin only when somebody waits
        except cl.Error as error:
            nbytes = sum(each.nbytes for each in arguments if isinstance(each, Memory))
            raise self._failure(f"launching kernel '{entry.kernel}'", error, nbytes) from error

    def _check_group(self, kernel: str, asked: int, most: int) -> None:
        if asked > most:
            what = "threads in a work-group"
            raise BackendError(LaunchTooLarge(self.name, kernel, what, asked, most, _SMALLER))

    def _prepare(self, entry: Entry, arguments: Sequence[device.KernelArgument]) -> None:
        """Tells pyopencl the types of the parameters: to set them takes a tenth of the time then."""
        given: list[Any] = list(arguments)
        types = [None if isinstance(each, Memory) else each.dtype for each in given]
        size = 0
        for scalar in types:
            width = _ADDRESS if scalar is None else scalar.itemsize
            size = -(-size // width) * width + width
        most = self._handle.max_parameter_size
        if size > most:
            what, remedy = "bytes of arguments", "use fewer fields, globals and parameters in it: make two of it"
            raise BackendError(LaunchTooLarge(self.name, entry.kernel, what, size, most, remedy))
        entry.handle.set_arg_types(types)  # pyright: ignore[reportUnknownMemberType]
        entry.prepared = True

    def wait(self) -> None:
        """As ``Device.wait``."""
        self._check_process()
        try:
            self.queue.finish()
        except cl.Error as error:
            raise self._failure("running kernels", error) from error

    def _check_process(self) -> None:
        if os.getpid() != self._process:
            raise BackendError(forked(self.name))

    def _failure(self, action: str, error: cl.Error, nbytes: int = 0) -> BackendError:
        """What to raise for an error of pyopencl while ``nbytes`` bytes were needed."""
        if error.code in _NO_MEMORY:
            return self._out_of_memory(nbytes)
        remedies = (_SMALLER,) if error.code == cl.status_code.OUT_OF_RESOURCES else ()
        return BackendError(DeviceFailed(self.name, action, str(error), remedies))

    def _out_of_memory(self, nbytes: int) -> BackendError:
        total, most = self.candidate.memory, self._most_bytes
        return BackendError(OutOfDeviceMemory(self.name, nbytes, self.taken, total, most))


def _identity(candidate: Candidate, options: list[str], instructions: str) -> bytes:
    """A hash of all that the driver's code depends on besides the kernel: of the processor too, if that is the device.

    A driver calls all processors of a family alike, and users share their folders among machines.
    """
    facts: list[object] = [candidate.platform, candidate.driver, candidate.name, candidate.handle.version, options]
    if candidate.kind is Kind.PROCESSOR:
        facts += [llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten(), instructions]
    return blake2b(repr(facts).encode()).digest()


def _required_threads(image: bytes) -> int:
    """The most threads that a kernel of a SPIR-V module says its work-groups have, 0 where none says.

    Compilers refuse what is beyond the device, each in its own words.
    """
    words = np.frombuffer(image, np.uint32)
    most, at = 0, _HEADER_WORDS
    while at < words.size:
        count, instruction = divmod(int(words[at]), 1 << 16)
        if instruction == _EXECUTION_MODE and words[at + 2] == _LOCAL_SIZE:
            most = max(most, int(np.prod(words[at + 3 : at + 6])))
        if instruction == _FUNCTION:
            break
        at += max(count, 1)
    return most
