"""The GPUs of NVIDIA's in this machine, and the one that a program runs on."""

from __future__ import annotations

import operator
from functools import cache
from importlib import import_module
from typing import Any

from ebb.errors import BackendError
from ebb.runtime.cuda_device import CudaDevice, reason
from ebb.runtime.errors_devices import MissingPackage, NoDevice, UnknownDevice, numbers_there


def cuda_device(choice: Any = None) -> CudaDevice:
    """The GPU that ``choice`` names, made ready; the same object each time.

    Args:
        choice: its number, 0 if None.

    Raises:
        BackendError: the driver is missing, there is no such GPU, or it cannot be used.
    """
    driver = _driver()
    names = describe_devices()
    try:
        number = -1 if isinstance(choice, bool) else operator.index(0 if choice is None else choice)
    except TypeError:
        number = -1
    if 0 <= number < len(names):
        return _opened(driver, number)
    example = 'ebb.set_backend("cuda", device=0)'
    raise BackendError(UnknownDevice("device", choice, numbers_there(len(names)), names, example))


@cache
def _opened(driver: Any, number: int) -> CudaDevice:
    return CudaDevice(driver, number)


def describe_devices() -> tuple[str, ...]:
    """The GPUs of this machine, a line each.

    Raises:
        BackendError: the driver is missing, or finds none.
    """
    driver = _driver()
    status, count = driver.cuDeviceGetCount()
    if status or not count:
        raise BackendError(_no_device(reason(driver, status) if status else "the driver finds no GPU"))
    lines: list[str] = []
    for number in range(count):
        _, handle = driver.cuDeviceGet(number)
        _, name = driver.cuDeviceGetName(256, handle)
        _, nbytes = driver.cuDeviceTotalMem(handle)
        lines.append(f"{number}: {name.split(bytes(1))[0].decode()}, {nbytes / 2**30:.1f} GiB")
    return tuple(lines)


def _driver() -> Any:
    """The package that calls the driver, which is initialised."""
    try:
        driver = import_module("cuda.bindings.driver")
    except ImportError as error:
        raise BackendError(MissingPackage("cuda", "cuda-bindings", "cuda", str(error))) from error
    try:
        (status,) = driver.cuInit(0)
    except RuntimeError as error:  # so it says that there is no library of that name
        raise BackendError(_no_device("NVIDIA's driver is not installed")) from error
    if status:
        raise BackendError(_no_device(reason(driver, status)))
    return driver


def _no_device(reason: str) -> NoDevice:
    remedies = (
        "install or update the driver of the GPU: https://www.nvidia.com/drivers",
        "see what it finds: nvidia-smi",
    )
    return NoDevice("cuda", reason, (), remedies)
