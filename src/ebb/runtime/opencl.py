"""The OpenCL devices of this machine, what each lacks, and the one that a program runs on."""

from __future__ import annotations

import ctypes
import operator
import os
import re
from contextlib import suppress
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any

from ebb.errors import BackendError
from ebb.records import record
from ebb.runtime.device import Feature
from ebb.runtime.errors_devices import DeviceLacks, NoDevice, UnknownDevice, numbers_there
from ebb.runtime.opencl_runtime import HAS_WHEEL, WHEEL, platforms, wheel

if TYPE_CHECKING:
    import pyopencl as cl

    from ebb.runtime.opencl_device import OpenCLDevice

_ENVIRONMENT = "EBB_OPENCL_DEVICE"

#: The numbers that OpenCL gives to what a device can do with atomic floats, which pyopencl does not name.
_SINGLE_ATOMICS, _DOUBLE_ATOMICS = 0x4231, 0x4232
_GLOBAL_ADD = 1 << 1

_SPIRV = re.compile(r"SPIR-V_(\d+)\.(\d+)")


class Kind(Enum):
    """What a device is, the most wanted first. The values are the names in messages."""

    GPU = "GPU"
    ACCELERATOR = "accelerator"
    PROCESSOR = "processor"


@record(eq=False)
class Candidate:
    """A device that the loader found. ``number`` is its place in the list of all.

    ``spirv`` is the last version of SPIR-V that it takes, (0, 0) if it takes none. ``group_size`` is the most threads
    of a work-group, ``group_memory`` the bytes that they share; ``memory`` is all that it has.
    """

    number: int
    platform: str
    driver: str
    name: str
    kind: Kind
    spirv: tuple[int, int]
    address_bits: int
    lacks: frozenset[Feature]
    group_size: int
    group_memory: int
    memory: int
    handle: cl.Device

    @property
    def missing(self) -> tuple[str, ...]:
        """What it lacks that every kernel needs."""
        spirv = () if self.spirv > (0, 0) else ("SPIR-V",)
        return spirv if self.address_bits == 64 else (*spirv, "64-bit addresses")

    def __str__(self) -> str:
        lacks = (*self.missing, *(feature.value for feature in Feature if feature in self.lacks))
        return (
            f"{self.number}: {self.name} ({self.platform}, driver {self.driver}), {self.kind.value}, "
            f"{self.memory / 2**30:.1f} GiB, work-groups of up to {self.group_size:,} threads that share "
            f"{self.group_memory / 2**10:,.0f} KiB; lacks {', '.join(lacks) or 'nothing'}"
        )


def opencl_device(choice: Any = None) -> OpenCLDevice:
    """The device that ``choice`` names, made ready; the same object each time.

    Args:
        choice: its place in the list of ``ebb info``, or a part of its name or of its platform's; None for
            ``EBB_OPENCL_DEVICE``, or else a GPU that takes SPIR-V, or else any device that does.

    Raises:
        BackendError: pyopencl is missing, there is no such device, or it lacks what every kernel needs.
    """
    candidate = _choose(choice)
    if candidate.missing:
        better = _most_wanted(find_devices())
        remedies = () if better is None else (f"choose another: device={better.number} is {better.name}",)
        remedies = (*remedies, "update the driver of the device", 'run on the processor: ebb.set_backend("cpu")')
        raise BackendError(DeviceLacks(candidate.name, None, candidate.missing, remedies))
    return _open(candidate)


@cache
def _open(candidate: Candidate) -> OpenCLDevice:
    from ebb.runtime.opencl_device import OpenCLDevice  # here: it needs pyopencl

    return OpenCLDevice(candidate)


@cache
def find_devices() -> tuple[Candidate, ...]:
    """All OpenCL devices of this machine, in the loader's order.

    Raises:
        BackendError: pyopencl is missing.
    """
    found: list[cl.Device] = []
    for platform in platforms():
        with suppress(_cl().Error):  # a platform without devices
            found += platform.get_devices()
    return tuple(_candidate(number, device) for number, device in enumerate(found))


def describe_devices() -> tuple[str, ...]:
    """The OpenCL devices of this machine, and the platforms that have none, a line each, for ``ebb info``.

    Raises:
        BackendError: pyopencl is missing.
    """
    devices = find_devices()
    used = {device.handle.platform for device in devices}
    idle = (f"none of the platform {platform.name.strip()}" for platform in platforms() if platform not in used)
    return (*map(str, devices), *idle)


def _cl() -> Any:
    import pyopencl as cl  # not at the top: without it, there is still something to say

    return cl


def _choose(choice: Any) -> Candidate:
    source = "device"
    if choice is None:
        source, choice = _ENVIRONMENT, os.environ.get(_ENVIRONMENT, "").strip()
    devices = find_devices()
    if not devices:
        raise BackendError(_no_device())
    if isinstance(choice, str) and not choice.isdecimal():
        return _named(source, choice, devices) if choice.strip() else _default(devices)
    try:
        number = -1 if isinstance(choice, bool) else int(choice) if isinstance(choice, str) else operator.index(choice)
    except TypeError:
        raise _unknown(source, choice, "it is neither a number of the list nor a part of a name", devices) from None
    if 0 <= number < len(devices):
        return devices[number]
    raise _unknown(source, choice, numbers_there(len(devices)), devices)


def _named(source: str, choice: str, devices: tuple[Candidate, ...]) -> Candidate:
    """The one device whose name, or whose platform's, has ``choice`` in it, or is just that."""
    text = choice.strip().casefold()
    names = [(device, (device.name.casefold(), device.platform.casefold())) for device in devices]
    whole = [device for device, known in names if text in known]
    parts = [device for device, known in names if any(text in name for name in known)]
    match whole or parts:
        case [device]:
            return device
        case []:
            raise _unknown(source, choice, "no name has that in it", devices)
        case several:
            raise _unknown(source, choice, f"{len(several)} devices have that in their names", tuple(several))


def _default(devices: tuple[Candidate, ...]) -> Candidate:
    device = _most_wanted(devices)
    if device is None:
        raise BackendError(_no_device())
    return device


def _most_wanted(devices: tuple[Candidate, ...]) -> Candidate | None:
    kinds = list(Kind)
    fit = [device for device in devices if not device.missing]
    return min(fit, key=lambda device: kinds.index(device.kind), default=None)


def _unknown(source: str, choice: Any, reason: str, devices: tuple[Candidate, ...]) -> BackendError:
    number = devices[0].number
    example = f'choose by number: ebb.set_backend("opencl", device={number})'
    return BackendError(UnknownDevice(source, choice, reason, tuple(map(str, devices)), example))


def _no_device() -> NoDevice:
    """Why no device fits, and what to install."""
    devices, runtime = find_devices(), wheel()
    if devices:
        reason = "none takes SPIR-V with 64-bit addresses"
    elif not platforms():
        reason = "no OpenCL platform is installed"
    else:
        reason = "no OpenCL platform has a device"
    if runtime is not None and runtime.fault is not None:
        install = f'mend the runtime of the wheel {WHEEL}: pip install --force-reinstall "ebblang[opencl]"'
        return NoDevice("opencl", reason, (*map(str, devices), runtime.fault), (install,))
    if runtime is not None and not devices:
        return NoDevice("opencl", reason, (f"{runtime.driver} has been offered, and is not listed",), ())
    driver = "install the OpenCL driver of the GPU"
    if not HAS_WHEEL:
        return NoDevice("opencl", reason, tuple(map(str, devices)), (driver,))
    install = 'install a runtime for the processor: pip install "ebblang[opencl]"'
    return NoDevice("opencl", reason, tuple(map(str, devices)), (install, driver))


def _candidate(number: int, device: cl.Device) -> Candidate:
    cl = _cl()
    kind = Kind.PROCESSOR
    if device.type & cl.device_type.GPU:
        kind = Kind.GPU
    elif device.type & cl.device_type.ACCELERATOR:
        kind = Kind.ACCELERATOR
    return Candidate(
        number,
        device.platform.name.strip(),
        device.driver_version.strip(),
        device.name.strip(),
        kind,
        _spirv_version(device),
        device.address_bits,
        frozenset(Feature) - _features(device),
        min(device.max_work_group_size, device.max_work_item_sizes[0]),
        device.local_mem_size,
        device.global_mem_size,
        device,
    )


def _spirv_version(device: cl.Device) -> tuple[int, int]:
    """The last version that it names, as in ``SPIR-V_1.0 SPIR-V_1.4``."""
    with suppress(_cl().Error):  # before OpenCL 2.1, unless it has the extension
        named = _SPIRV.findall(str(device.il_version))
        return max(((int(major), int(minor)) for major, minor in named), default=(0, 0))
    return (0, 0)


def _features(device: cl.Device) -> frozenset[Feature]:
    extensions = frozenset(device.extensions.split())
    single, double = _atomic_floats(device, extensions)
    there = {
        Feature.FLOAT64: "cl_khr_fp64" in extensions,
        Feature.ATOMICS64: {"cl_khr_int64_base_atomics", "cl_khr_int64_extended_atomics"} <= extensions,
        Feature.FLOAT32_ADD: single & _GLOBAL_ADD,
        Feature.FLOAT64_ADD: double & _GLOBAL_ADD,
    }
    return frozenset(feature for feature, has in there.items() if has)


def _atomic_floats(device: cl.Device, extensions: frozenset[str]) -> tuple[int, int]:
    """What it can do with atomic float32 and float64: asked without pyopencl, which does not let it through."""
    if "cl_ext_float_atomics" not in extensions:
        return 0, 0
    # pyopencl's module is linked to the loader that it uses, so that its symbols are found by way of it.
    loader = ctypes.CDLL(_cl()._cl.__file__)
    answers: list[int] = []
    for question in (_SINGLE_ATOMICS, _DOUBLE_ATOMICS):
        answer = ctypes.c_uint64(0)
        failed = loader.clGetDeviceInfo(ctypes.c_void_p(device.int_ptr), question, 8, ctypes.byref(answer), None)
        answers.append(0 if failed else answer.value)
    return answers[0], answers[1]
