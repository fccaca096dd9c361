"""A pyopencl whose devices are as a test wants them, for what none here lacks, and at which none here fails.

Kernels on such a device do nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.machinery import ModuleSpec
from importlib.util import module_from_spec
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import patch

from ebb.runtime import opencl
from ebb.runtime.opencl_runtime import Wheel

CPU, GPU = 2, 4
DEVICE = "ebb.runtime.opencl_device"

PROPERTIES: dict[str, Any] = {
    "driver_version": "1.0",
    "version": "OpenCL 3.0",
    "type": GPU,
    "il_version": "SPIR-V_1.0 SPIR-V_1.6",
    "extensions": "cl_khr_fp64 cl_khr_int64_base_atomics cl_khr_int64_extended_atomics",
    "address_bits": 64,
    "max_work_group_size": 256,
    "max_work_item_sizes": [256, 256, 256],
    "local_mem_size": 2**16,
    "global_mem_size": 2**30,
    "max_mem_alloc_size": 2**28,
    "max_parameter_size": 1024,
    "single_fp_config": 0,
    "atomic_floats": (7, 7),
    "group_memory_of_kernels": 0,
}


class Error(Exception):
    """What pyopencl raises when the driver refuses: ``code`` is a name here, not a number."""

    def __init__(self, routine: str, code: str) -> None:
        super().__init__(f"{routine} failed: {code}")
        self.code = code


class Platform:
    """An OpenCL platform with its devices."""

    def __init__(self, name: str, *devices: Device) -> None:
        self.name, self._devices = name, list(devices)
        for device in devices:
            device.platform = self

    def get_devices(self) -> list[Device]:
        if not self._devices:
            raise Error("clGetDeviceIDs", "DEVICE_NOT_FOUND")
        return self._devices


class Device(SimpleNamespace):
    """A device of ``PROPERTIES`` but those given; ``fails`` has the code with which a routine fails."""

    platform: Platform

    def __init__(self, name: str, fails: dict[str, str] | None = None, **properties: Any) -> None:
        super().__init__(name=name, fails=fails or {}, **{**PROPERTIES, **properties})

    def call(self, routine: str) -> None:
        if routine in self.fails:
            raise Error(routine, self.fails[routine])


class Names:
    """Enumerators, each of which is its name."""

    def __getattr__(self, name: str) -> str:
        return name


class Kernel:
    def __init__(self, program: Program, name: str) -> None:
        self.device = program.device
        self.device.call("clCreateKernel")

    def get_work_group_info(self, question: str, device: Device) -> int:
        return device.max_work_group_size if question == "WORK_GROUP_SIZE" else device.group_memory_of_kernels

    def set_arg_types(self, types: list[Any]) -> None: ...

    def set_args(self, *arguments: Any) -> None: ...


class Program:
    """Code of a device, from SPIR-V or from ``binaries``, which are those of a device by its name."""

    def __init__(self, context: Context, image: Any, binaries: list[bytes] | None = None) -> None:
        self.device = context.device
        self.binaries = [f"built for {self.device.name}".encode()]
        if binaries not in (None, self.binaries):
            raise Error("clCreateProgramWithBinary", "INVALID_BINARY")

    def build(self, *arguments: Any) -> Program:
        """Without arguments, there is nothing to compile any more."""
        if arguments:
            self.device.call("clBuildProgram")
        return self


class Context:
    def __init__(self, devices: list[Device]) -> None:
        (self.device,) = devices
        self.device.call("clCreateContext")


class CommandQueue:
    def __init__(self, context: Context, device: Device) -> None:
        self.device = device

    def flush(self) -> None: ...

    def finish(self) -> None:
        self.device.call("clFinish")


def create_buffer(context: Context, flags: Any, nbytes: int) -> object:
    context.device.call("clCreateBuffer")
    return object()


def enqueue(routine: str) -> Any:
    return lambda queue, *arguments, **options: queue.device.call(routine)


def module() -> ModuleType:
    """The module ``pyopencl`` itself."""
    made = module_from_spec(ModuleSpec("pyopencl", None))
    vars(made).update(
        Error=Error,
        CompilerWarning=UserWarning,
        device_type=SimpleNamespace(GPU=GPU, ACCELERATOR=8),
        device_fp_config=SimpleNamespace(CORRECTLY_ROUNDED_DIVIDE_SQRT=128),
        status_code=Names(),
        kernel_work_group_info=Names(),
        mem_flags=Names(),
        Context=Context,
        CommandQueue=CommandQueue,
        Program=Program,
        Kernel=Kernel,
        Buffer=create_buffer,
        enqueue_copy=enqueue("clEnqueueCopyBuffer"),
        enqueue_fill_buffer=enqueue("clEnqueueFillBuffer"),
        enqueue_nd_range_kernel=enqueue("clEnqueueNDRangeKernel"),
    )
    return made


@contextmanager
def machine(*platforms: Platform, wheel: Wheel | None = None) -> Iterator[None]:
    """A machine with these platforms, for as long as the ``with`` statement runs."""
    with (
        imported(module()),
        patch.object(opencl, "platforms", lambda: platforms),
        patch.object(opencl, "wheel", lambda: wheel),
        patch.object(opencl, "_atomic_floats", lambda device, extensions: device.atomic_floats),
        patch.object(opencl, "find_devices", cache(opencl.find_devices.__wrapped__)),
    ):
        yield


@contextmanager
def without_pyopencl() -> Iterator[None]:
    """A machine where pyopencl is not installed."""
    with (
        imported(None),
        patch.object(opencl, "platforms", opencl.platforms.__wrapped__),
        patch.object(opencl, "find_devices", opencl.find_devices.__wrapped__),
    ):
        yield


@contextmanager
def imported(pyopencl: ModuleType | None) -> Iterator[None]:
    """Lets this be what ``import pyopencl`` gives; None is an error. The module of devices is imported anew with it."""
    modules: dict[str, Any] = sys.modules
    real = {name: modules.pop(name, None) for name in ("pyopencl", DEVICE)}
    modules["pyopencl"] = pyopencl
    try:
        yield
    finally:
        for name, before in real.items():
            modules.pop(name, None)
            if before is not None:
                modules[name] = before


def one_device(name: str = "Fake GPU", fails: dict[str, str] | None = None, **properties: Any) -> Any:
    """A machine with one device."""
    return machine(Platform("Fake Platform", Device(name, fails, **properties)))
