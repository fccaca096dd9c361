"""The backends for devices: one for each choice of options, so that a kernel that meets it again is compiled."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from ebb.backends.cache import ObjectCache, cache_directory
from ebb.backends.devices.backend import DeviceBackend
from ebb.backends.target import Target, nvptx, spirv
from ebb.runtime.device import Device


def opencl_backend(device: Any, deterministic: bool, reorder: bool) -> DeviceBackend:
    """The backend ``opencl``.

    Args:
        device: the device's number, a part of its name, or None for the best there is.
        deterministic: whether reductions into other rows have the same bits at each run.
        reorder: whether launches may permute relations so that kernels find rows closer together.

    Raises:
        BackendError: there is no such device.
    """
    from ebb.runtime.opencl import opencl_device

    chosen = opencl_device(device)
    chosen.binaries = ObjectCache()  # what the driver makes of SPIR-V, too
    return _backend_of("opencl", chosen, spirv(chosen.lacks), cache_directory(), deterministic, reorder)


def cuda_backend(device: Any, deterministic: bool, reorder: bool) -> DeviceBackend:
    """The backend ``cuda``; ``device`` is the number of the GPU, the rest as for ``opencl_backend``."""
    from ebb.runtime.cuda import cuda_device

    chosen = cuda_device(device)
    return _backend_of("cuda", chosen, nvptx(chosen.capability), cache_directory(), deterministic, reorder)


@cache
def _backend_of(
    name: str, device: Device, target: Target, directory: Path, deterministic: bool, reorders: bool
) -> DeviceBackend:
    return DeviceBackend(name, device, target, ObjectCache(directory), deterministic, reorders)
