"""A stand-in for ``cuda.bindings.driver``: it answers as the driver does, writes calls down, and runs no kernel.

Memory is memory of the host, so that copies copy. What the driver would take for a fault of the caller, it asserts:
memory that was freed, calls without a context, parameters that lead nowhere.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from enum import IntEnum
from typing import Any


class CUresult(IntEnum):
    CUDA_SUCCESS = 0
    CUDA_ERROR_OUT_OF_MEMORY = 2
    CUDA_ERROR_NO_DEVICE = 100
    CUDA_ERROR_INVALID_DEVICE = 101
    CUDA_ERROR_INVALID_CONTEXT = 201
    CUDA_ERROR_UNSUPPORTED_PTX_VERSION = 222
    CUDA_ERROR_NOT_FOUND = 500
    CUDA_ERROR_ILLEGAL_ADDRESS = 700
    CUDA_ERROR_LAUNCH_FAILED = 719


class CUdevice_attribute(IntEnum):
    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR = 75
    CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR = 76
    CU_DEVICE_ATTRIBUTE_MEMORY_POOLS_SUPPORTED = 115


class CUjit_option(IntEnum):
    CU_JIT_ERROR_LOG_BUFFER = 5
    CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES = 6


OK = CUresult.CUDA_SUCCESS
CONTEXT = "primary context"
OTHER_CONTEXT = "the context of another library"


class FakeDriver:
    """The functions of the driver that Ebb calls. ``calls`` has the name and the arguments of each.

    Attributes:
        fails: what the next calls of a function answer instead, by its name.
        sticky: what every call answers, once the device is lost.
        memory: the blocks that are allocated, by address.
        launches: kernel, groups, threads and the bytes of the parameters of each launch.
        run: called with the name of the kernel and its words, in place of running it.
    """

    CUresult = CUresult
    CUdevice_attribute = CUdevice_attribute
    CUjit_option = CUjit_option
    CU_STREAM_LEGACY = 1

    def __init__(self, count: int = 1, capability: tuple[int, int] = (8, 0), pools: bool = True) -> None:
        self.count = count
        self.capability = capability
        self.pools = pools
        self.total = 1 << 26
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self.fails: dict[str, list[CUresult]] = {}
        self.sticky: CUresult | None = None
        self.memory: dict[int, Any] = {}
        self.modules: dict[str, bytes] = {}
        self.launches: list[tuple[str, int, int, tuple[bytes, ...]]] = []
        self.run: Callable[[str, tuple[bytes, ...]], None] = lambda kernel, words: None
        self.log = b""
        self._stacks = threading.local()

    @property
    def names(self) -> list[str]:
        """The names of the calls, without the changes of the context and what was asked."""
        quiet = ("Ctx", "DeviceGet", "Init", "Error", "TotalMem", "GetInfo")
        return [name for name, _ in self.calls if not any(word in name for word in quiet)]

    @property
    def contexts(self) -> list[str]:
        """The contexts of this thread, the current one last."""
        if not hasattr(self._stacks, "contexts"):
            self._stacks.contexts = []
        return self._stacks.contexts

    def fail(self, name: str, status: CUresult, times: int = 1, after: int = 0) -> None:
        """Has the calls of the function ``name`` fail, ``times`` times, when ``after`` have gone well."""
        self.fails.setdefault(name, []).extend([OK] * after + [status] * times)

    def _answer(self, name: str, *arguments: Any, needs_context: bool = True) -> CUresult:
        self.calls.append((name, arguments))
        if self.sticky is not None:
            return self.sticky
        planned = self.fails.get(name)
        if planned and (status := planned.pop(0)):
            return status
        if needs_context and self.contexts[-1:] != [CONTEXT]:
            return CUresult.CUDA_ERROR_INVALID_CONTEXT
        return OK

    # ---- What needs no context ----

    def CUstream(self, number: int) -> int:
        return number

    def cuInit(self, flags: int) -> tuple[CUresult]:
        return (self._answer("cuInit", flags, needs_context=False),)

    def cuGetErrorString(self, status: CUresult) -> tuple[CUresult, bytes]:
        return OK, status.name.removeprefix("CUDA_ERROR_").lower().replace("_", " ").encode()

    def cuDeviceGetCount(self) -> tuple[CUresult, int]:
        return self._answer("cuDeviceGetCount", needs_context=False), self.count

    def cuDeviceGet(self, number: int) -> tuple[CUresult, int]:
        status = self._answer("cuDeviceGet", number, needs_context=False)
        return status or (OK if number < self.count else CUresult.CUDA_ERROR_INVALID_DEVICE), number

    def cuDeviceGetName(self, length: int, device: int) -> tuple[CUresult, bytes]:
        return self._answer("cuDeviceGetName", device, needs_context=False), f"Fake {device}".encode().ljust(
            length, b"\0"
        )

    def cuDeviceTotalMem(self, device: int) -> tuple[CUresult, int]:
        return self._answer("cuDeviceTotalMem", device, needs_context=False), self.total

    def cuDeviceGetAttribute(self, attribute: CUdevice_attribute, device: int) -> tuple[CUresult, int]:
        values = dict(zip(CUdevice_attribute, (*self.capability, int(self.pools)), strict=True))
        return self._answer("cuDeviceGetAttribute", attribute, needs_context=False), values[attribute]

    def cuDevicePrimaryCtxRetain(self, device: int) -> tuple[CUresult, str]:
        return self._answer("cuDevicePrimaryCtxRetain", device, needs_context=False), CONTEXT

    def cuCtxPushCurrent(self, context: str) -> tuple[CUresult]:
        status = self._answer("cuCtxPushCurrent", context, needs_context=False)
        if not status:
            self.contexts.append(context)
        return (status,)

    def cuCtxPopCurrent(self) -> tuple[CUresult, str]:
        self.calls.append(("cuCtxPopCurrent", ()))
        return OK, self.contexts.pop()

    # ---- Memory ----

    def cuMemGetInfo(self) -> tuple[CUresult, int, int]:
        taken = sum(len(block) for block in self.memory.values())
        return self._answer("cuMemGetInfo"), self.total - taken, self.total

    def cuMemAlloc(self, nbytes: int) -> tuple[CUresult, int]:
        return self._allocated(self._answer("cuMemAlloc", nbytes), nbytes)

    def cuMemAllocAsync(self, nbytes: int, stream: int) -> tuple[CUresult, int]:
        return self._allocated(self._answer("cuMemAllocAsync", nbytes, stream), nbytes)

    def _allocated(self, status: CUresult, nbytes: int) -> tuple[CUresult, int]:
        assert nbytes > 0
        if not status and sum(map(len, self.memory.values())) + nbytes > self.total:
            status = CUresult.CUDA_ERROR_OUT_OF_MEMORY
        if status:
            return status, 0
        block = (ctypes.c_ubyte * nbytes)(*[0xA5] * min(nbytes, 16))
        self.memory[ctypes.addressof(block)] = block
        return OK, ctypes.addressof(block)

    def cuMemFree(self, address: int) -> tuple[CUresult]:
        return self._freed(self._answer("cuMemFree", address), address)

    def cuMemFreeAsync(self, address: int, stream: int) -> tuple[CUresult]:
        return self._freed(self._answer("cuMemFreeAsync", address, stream), address)

    def _freed(self, status: CUresult, address: int) -> tuple[CUresult]:
        if not status:
            assert self.memory.pop(address, None) is not None, "freed twice"
        return (status,)

    def cuMemcpyHtoDAsync(self, target: int, source: int, nbytes: int, stream: int) -> tuple[CUresult]:
        status = self._answer("cuMemcpyHtoDAsync", target, source, nbytes, stream)
        return self._copied(status, target, target, source, nbytes)

    def cuMemcpyDtoHAsync(self, target: int, source: int, nbytes: int, stream: int) -> tuple[CUresult]:
        status = self._answer("cuMemcpyDtoHAsync", target, source, nbytes, stream)
        return self._copied(status, source, target, source, nbytes)

    def _copied(self, status: CUresult, here: int, target: int, source: int, nbytes: int) -> tuple[CUresult]:
        if not status:
            assert nbytes <= len(self.memory[here]), "beyond the end of the memory"
            ctypes.memmove(target, source, nbytes)
        return (status,)

    # ---- Kernels ----

    def cuModuleLoadDataEx(
        self, image: bytes, count: int, options: list[Any], values: list[Any]
    ) -> tuple[CUresult, str]:
        status = self._answer("cuModuleLoadDataEx", image)
        assert image.endswith(b"\0")
        assert count == len(options) == len(values)
        if status:
            settings = dict(zip(options, values, strict=True))
            log = settings[CUjit_option.CU_JIT_ERROR_LOG_BUFFER]
            assert settings[CUjit_option.CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES] == len(log)
            log[: len(self.log)] = self.log
            return status, ""
        module = f"module {len(self.modules)}"
        self.modules[module] = image
        return OK, module

    def cuModuleUnload(self, module: str) -> tuple[CUresult]:
        status = self._answer("cuModuleUnload", module)
        del self.modules[module]
        return (status,)

    def cuModuleGetFunction(self, module: str, name: bytes) -> tuple[CUresult, tuple[str, str]]:
        status = self._answer("cuModuleGetFunction", module, name)
        if f".entry {name.decode()}(".encode() not in self.modules[module]:
            status = CUresult.CUDA_ERROR_NOT_FOUND
        return status, (module, name.decode())

    def cuLaunchKernel(self, function: Any, *shape_and_parameters: int) -> tuple[CUresult]:
        status = self._answer("cuLaunchKernel", function, *shape_and_parameters)
        groups, one, another, size, a, b, group_memory, _stream, parameters, extra = shape_and_parameters
        assert (one, another, a, b, group_memory, extra) == (1, 1, 1, 1, 0, 0)
        assert groups > 0 < size
        module, name = function
        assert module in self.modules, "the code has been unloaded"
        if not status:
            words = self._words(module, name, parameters)
            self.launches.append((name, groups, size, words))
            self.run(name, words)
        return (status,)

    def _words(self, module: str, name: str, parameters: int) -> tuple[bytes, ...]:
        """The parameters of the kernel, each in its own size, as the driver reads them by the kernel's signature."""
        words: list[bytes] = []
        for number, declaration in enumerate(self._signature(module, name)):
            place = ctypes.c_uint64.from_address(parameters + 8 * number).value
            size = int(declaration.split()[1].lstrip(".ubsf")) // 8
            words.append(ctypes.string_at(place, size))
            if ".ptr" in declaration:
                address = int.from_bytes(words[-1], "little")
                assert address == 0 or address in self.memory, "no memory of the device, or freed"
        return tuple(words)

    def _signature(self, module: str, name: str) -> list[str]:
        text = self.modules[module].decode()
        start = text.index(f".entry {name}(") + len(f".entry {name}(")
        inside = text[start : text.index(")", start)]
        return [each.strip() for each in inside.split(",") if each.strip()]

    def cuStreamSynchronize(self, stream: int) -> tuple[CUresult]:
        return (self._answer("cuStreamSynchronize", stream),)
