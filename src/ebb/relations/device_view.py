"""A field's memory on a device, for other libraries: by CUDA's array interface, by DLPack, or as it is."""

from __future__ import annotations

import ctypes
from collections.abc import Generator
from contextlib import contextmanager
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from ebb.errors import RelationError
from ebb.relations.errors import KeysNotWritable
from ebb.runtime.device import DLPACK_CUDA, Device
from ebb.runtime.recording import refuse
from ebb.runtime.threads import launching

if TYPE_CHECKING:
    from ebb.relations.field import Field

_NO_STREAM, _LEGACY_STREAM = -1, 1
"""What a consumer says that wants no order, and the stream that all of Ebb's work goes to."""

_DEVICE_PLACES = {b"dltensor": 8, b"dltensor_versioned": 40}
"""Behind how many bytes of the record that a capsule of this name holds DLPack says where the memory is."""


class DeviceView:
    """The memory of a field on a device. It is that of the field as long as nothing replaces it: see ``Field.view``.

    Attributes:
        shape: that of the relation, then of the components.
        strides: how many bytes lie from one entry to the next, in each dimension.
        dtype: of an entry.
        memory: the device's, in which the first entry comes first.
        writable: whether others may write to it, which is said to those who ask.
    """

    def __init__(self, field: Field, device: Device) -> None:
        """The field keeps rows and layout from now on. The caller holds ``launching()``."""
        field.pin()
        self.memory: Any = field.buffer.on(device)
        rows, components = field.relation.shape, field.type.shape
        step, *within = field.buffer.strides
        self.shape = (*rows, *components)
        self.strides = (*(step * prod(rows[axis + 1 :]) for axis in range(len(rows))), *within)
        self.dtype = field.buffer.dtype
        self.writable = False
        self._device = device
        self._holds_keys = field.holds_keys

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """Its address and its form, as Numba, CuPy and PyTorch read them."""
        kind = self._device.dlpack_device
        if kind is None or kind[0] != DLPACK_CUDA:
            raise AttributeError("this memory is not a GPU's of NVIDIA's")
        return {**self._interface(self.writable), "stream": _LEGACY_STREAM}

    def _interface(self, writable: bool) -> dict[str, Any]:
        address = self.memory.address if 0 not in self.shape else 0
        return {
            "shape": self.shape,
            "strides": self.strides,
            "typestr": self.dtype.str,
            "data": (address, not writable),
            "version": 3,
        }

    def __dlpack_device__(self) -> tuple[int, int]:
        kind = self._device.dlpack_device
        if kind is None:
            raise BufferError(f"the memory of {self._device.name} has no address")
        return kind

    def __dlpack__(
        self,
        *,
        stream: Any = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        """A capsule that keeps the memory: read-only where the consumer knows how.

        Raises:
            BufferError: a copy is asked for, or memory elsewhere.
        """
        kind = self.__dlpack_device__()
        if copy:
            raise BufferError("this is the memory itself, of which the consumer can make a copy")
        if dl_device not in (None, kind):
            raise BufferError(f"the memory is on the device {kind}, not {dl_device}")
        if stream not in (None, _NO_STREAM, _LEGACY_STREAM):
            self._device.wait()
        older = max_version is None and not self._holds_keys  # such consumers take no read-only memory
        array = np.asarray(_Described(self, self._interface(self.writable or older)))
        capsule = array.__dlpack__() if max_version is None else array.__dlpack__(max_version=max_version)
        _move(capsule, kind)
        return capsule


class _Described:
    """Says to NumPy that an array lies where a view lies, and keeps it. Nobody may look at the array's values."""

    def __init__(self, view: DeviceView, interface: dict[str, Any]) -> None:
        self.view = view
        self.__array_interface__ = interface


def _move(capsule: Any, kind: tuple[int, int]) -> None:
    """Makes NumPy's description of an array one of memory of a device: all but where it is stays the same."""
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    name = api.PyCapsule_GetName(ctypes.py_object(capsule))
    start: Any = api.PyCapsule_GetPointer(ctypes.py_object(capsule), ctypes.c_char_p(name))
    (ctypes.c_int32 * 2).from_address(start + _DEVICE_PLACES[name])[:] = kind


def device_view(field: Field, device: Device) -> DeviceView:
    """The memory of ``field`` on ``device``, with the present values, to be read.

    Raises:
        RelationError: a writable view of the field is open.
        BackendError: a step is being captured, or the device has no room.
    """
    _check(field)
    with launching():
        return DeviceView(field, device)


@contextmanager
def writable_device_view(field: Field, device: Device) -> Generator[DeviceView, None, None]:
    """The memory of ``field`` on ``device``, to be written; until the context is left, launches that touch it raise.

    Raises:
        RelationError: the field holds keys, or a writable view of it is open already.
        BackendError: as ``device_view``.
    """
    if field.target is not None:
        raise RelationError(KeysNotWritable(field.path))
    _check(field)
    with field.held():
        with launching():
            view, buffer = DeviceView(field, device), field.buffer
            buffer.changed_on(device)
        view.writable = True
        try:
            yield view
        finally:
            view.writable = False
            with launching():
                buffer.changed_on(device)  # again: the host may have looked meanwhile


def _check(field: Field) -> None:
    refuse(f"taking a view of {field.path}", "take it before the with statement, or when the step has run")
    field.check_no_view()
