"""Copies of a block of bytes: the host's and those of devices, which of them are valid, and what moves between them.

One copy at least is valid at any time. Nothing moves before somebody needs it where it is not: a device that is to read
it, or the host. A transfer that raises leaves its target as it was known: not valid.

Machine code on the processor reads and writes the host's copies without asking. So what binds such code makes them
current, and calls ``host_code_relies``: as long as the structure stays the same, no host's copy may go out of date, and
no device's come up beside it. What does either says that the structure has changed.

Copies are moved, and become valid and invalid, under ``launching()``: so no launch comes between a download and the
account of it. Blocks that are on no device need no lock.
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ebb.records import record
from ebb.runtime.epoch import structure, structure_changed
from ebb.runtime.threads import launching

if TYPE_CHECKING:
    import numpy.typing as npt

    from ebb.runtime.device import Device, Memory

Bytes: TypeAlias = "npt.NDArray[np.uint8]"

GRAIN = 64
"""Devices' memory is taken in multiples of this many bytes: an update of a byte may go by the word around it."""


@record(frozen=False)
class Traffic:
    """What has been moved since the process began: how many transfers there were, and their bytes."""

    uploads: int = 0
    uploaded: int = 0
    downloads: int = 0
    downloaded: int = 0


traffic = Traffic()


@record(frozen=False)
class _HostCode:
    """The epoch in which code on the processor has come to rely on the host's copies."""

    epoch: object = None


_host_code = _HostCode()


def host_code_relies() -> None:
    """Says that what is bound from now on takes the host's copies that it uses for valid, and for the only valid ones
    where it writes them, until the structure changes."""
    _host_code.epoch = structure.epoch


def tell_host_code() -> None:
    """Has code on the processor look again which copies are valid, if any relies on what it saw."""
    if _host_code.epoch is structure.epoch:
        structure_changed()


@record(frozen=False, eq=False)
class _DeviceCopy:
    """A device's copy."""

    memory: Memory
    valid: bool = False


@record
class CopyState:
    """What ``ebb.memory`` tells of a device's copy."""

    device: str
    nbytes: int
    valid: bool


class Copies:
    """A block of bytes on the host, at an address that is fixed, and its copies on devices.

    Attributes:
        host: the host's copy, a flat array, whether valid or not.
        is_current: whether the host's copy is valid.
    """

    __slots__ = ("_on_devices", "host", "is_current")

    def __init__(self, host: Bytes) -> None:
        self.host = host
        self.is_current = True
        self._on_devices: dict[Device, _DeviceCopy] = {}

    def refresh(self) -> None:
        """Makes the host's copy valid: waits for the device whose copy is, and downloads it.

        Raises:
            BackendError: the device does not give it.
        """
        with launching():
            if self.is_current:  # another thread was quicker
                return
            device, copy = next(item for item in self._on_devices.items() if item[1].valid)
            if self.host.size:
                device.download(copy.memory, self.host)
                traffic.downloads += 1
                traffic.downloaded += self.host.size
            self.is_current = True

    def on(self, device: Device, overwritten: bool) -> Memory:
        """The device's copy, made valid unless all of it will be overwritten."""
        copy = self._on_devices.get(device)
        if copy is not None and copy.valid:
            if overwritten and self.is_current:
                self.changed_on(device)  # now: of a launch that is interrupted nobody knows what it has written
            return copy.memory
        with launching():
            # In the table before its bytes are taken: who changes the host's copy meanwhile then waits, and says so.
            copy = self._on_devices.get(device)
            if copy is None:
                copy = self._on_devices[device] = _DeviceCopy(device.allocate(_whole_grains(self.host.size)))
            if not (copy.valid or overwritten):
                self.refresh()
                tell_host_code()
                _upload(device, copy.memory, self.host)
                copy.valid = True
            return copy.memory

    def changed_on(self, device: Device) -> None:
        """Says that the copy that ``on`` gave is the only valid one. The caller holds ``launching()`` since then."""
        copy = self._on_devices[device]
        if copy.valid and not self.is_current and len(self._on_devices) == 1:
            return
        with launching():
            tell_host_code()
            others = self._all_outdated()
            others[device] = copy
            # At once: no interrupt comes in between, after which an old copy would be valid as well, or none.
            copy.valid, self.is_current, self._on_devices = True, False, others

    def changed_on_host(self) -> None:
        """Says that the host's copy is the only valid one."""
        if self._on_devices:
            with launching():
                outdated = self._all_outdated()
                self.is_current, self._on_devices = True, outdated  # at once

    def overwrite(self, target: npt.NDArray[Any], values: Any) -> None:
        """Sets ``target``, an array on all of the host's copy, to ``values``, without looking at what was there."""
        if self._on_devices:
            with launching():
                if self.is_current:
                    self.changed_on_host()
                target[...] = values  # if this is interrupted while the host's copy is out of date, it still is
                self.changed_on_host()
        else:
            target[...] = values
            self.changed_on_host()  # should a device have taken a copy meanwhile

    def _all_outdated(self) -> dict[Device, _DeviceCopy]:
        """The devices' copies, none of which is valid."""
        return {device: _DeviceCopy(copy.memory) for device, copy in self._on_devices.items()}

    @property
    def is_only_on_host(self) -> bool:
        """Whether no device has a valid copy."""
        return not self._on_devices or not any([copy.valid for copy in list(self._on_devices.values())])

    def states(self) -> tuple[CopyState, ...]:
        """The devices' copies."""
        return tuple([CopyState(d.name, copy.memory.nbytes, copy.valid) for d, copy in list(self._on_devices.items())])


# ---- Arrays that never change ----

_constants: dict[int, tuple[weakref.ref[npt.NDArray[Any]], dict[Device, Memory]]] = {}
"""The devices' copies of arrays that never change, by ``id``; an entry goes with its array."""


def constant_on(device: Device, array: npt.NDArray[Any]) -> Memory:
    """A copy of ``array``, which nobody changes any more; it is uploaded once, and kept as long as the array.

    Raises:
        BackendError: the device has no room for it.
    """
    kept = _constants.get(id(array))
    if kept is not None and device in kept[1]:
        return kept[1][device]
    with launching():
        number = id(array)
        if number not in _constants:

            def forget(_: object) -> None:
                _constants.pop(number, None)

            _constants[number] = weakref.ref(array, forget), {}
        copies = _constants[number][1]
        if device not in copies:
            flat: Bytes = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
            memory = device.allocate(_whole_grains(flat.size))
            _upload(device, memory, flat)
            copies[device] = memory
        return copies[device]


def constant_states(array: npt.NDArray[Any]) -> tuple[CopyState, ...]:
    """The devices' copies of an array that never changes."""
    kept = _constants.get(id(array))
    return () if kept is None else tuple([CopyState(d.name, m.nbytes, True) for d, m in list(kept[1].items())])


def _upload(device: Device, memory: Memory, source: Bytes) -> None:
    if source.size:
        device.upload(memory, source)
        traffic.uploads += 1
        traffic.uploaded += source.size


def _whole_grains(nbytes: int) -> int:
    return max(1, -(-nbytes // GRAIN)) * GRAIN
