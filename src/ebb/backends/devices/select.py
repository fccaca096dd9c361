"""The backends for devices: one for each choice of options, so that a kernel that meets it again is compiled."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from ebb.backends.cache import ObjectCache, cache_directory
from ebb.backends.devices.backend import DeviceBackend
from ebb.backends.target import Target, nvptx, spirv
from ebb.errors import BackendError
from ebb.runtime.device import Device
from ebb.runtime.errors import BadSwitch


def opencl_backend(device: Any, deterministic: Any, reorder: Any) -> DeviceBackend:
    """The backend ``opencl``.

    Args:
        device: the device's number, a part of its name, or None for the best there is.
        deterministic: whether reductions into other rows have the same bits at each run.
        reorder: whether launches may permute relations so that kernels find rows closer together.

    Raises:
        BackendError: there is no such device, or an option is none.
    """
    from ebb.runtime.opencl import opencl_device

    _check_switches("opencl", deterministic=deterministic, reorder=reorder)
    chosen = opencl_device(device)
    chosen.binaries = ObjectCache()  # what the driver makes of SPIR-V, too
    return _backend_of("opencl", chosen, spirv(chosen.lacks), "spirv", cache_directory(), deterministic, reorder)


def cuda_backend(device: Any, deterministic: Any, reorder: Any) -> DeviceBackend:
    """The backend ``cuda``; ``device`` is the number of the GPU, the rest as for ``opencl_backend``."""
    from ebb.runtime.cuda import cuda_device

    _check_switches("cuda", deterministic=deterministic, reorder=reorder)
    chosen = cuda_device(device)
    return _backend_of("cuda", chosen, nvptx(chosen.capability), "ptx", cache_directory(), deterministic, reorder)


def _check_switches(backend: str, **switches: Any) -> None:
    for option, value in switches.items():
        if not isinstance(value, bool):
            raise BackendError(BadSwitch(backend, option, value))


@cache
def _backend_of(
    name: str,
    device: Device,
    target: Target,
    assembly: str,
    directory: Path,
    deterministic: bool,
    reorders: bool,
) -> DeviceBackend:
    return DeviceBackend(name, device, target, assembly, ObjectCache(directory), deterministic, reorders)
