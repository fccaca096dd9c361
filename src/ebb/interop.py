"""The memory of fields on devices, for other libraries: CuPy, Numba, PyTorch on ``cuda``, pyopencl on ``opencl``.

On the processor the memory is ``field.view()``. Everywhere ``field.__dlpack__`` gives what kernels work on.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Literal, overload

from ebb.backends.select import current_backend
from ebb.errors import BackendError
from ebb.relations.field import Field
from ebb.runtime.device import Device

if TYPE_CHECKING:
    from pyopencl.array import Array

    from ebb.relations.device_view import DeviceView

__all__ = ["cuda_array", "opencl_array"]


@overload
def cuda_array(field: Field, write: Literal[False] = False) -> DeviceView: ...


@overload
def cuda_array(field: Field, write: Literal[True]) -> AbstractContextManager[DeviceView]: ...


def cuda_array(field: Field, write: bool = False) -> DeviceView | AbstractContextManager[DeviceView]:
    """The GPU's own memory of a field, without a copy, while kernels run on ``cuda``.

    What is returned has ``__cuda_array_interface__`` and ``__dlpack__``, so ``cupy.asarray(view)``,
    ``torch.from_dlpack(view)`` and ``numba.cuda.as_cuda_array(view)`` are arrays on it. Shape, order of the rows and
    layout are those of ``Field.view``; like that, it shows the memory that the field has now.

    Args:
        field: whose memory.
        write: returns a context manager instead, whose value may be written to. Until it is left, launches that touch
            the field raise. What is written is seen by what comes after it, by kernels and by the host, if it went to
            the default stream or has been waited for.

    Raises:
        RelationError: ``write`` on a field of keys, or a writable view of it is open.
        BackendError: kernels do not run on ``cuda``, or a step is being captured.
    """
    from ebb.relations.device_view import device_view, writable_device_view  # here: few programs ask for it

    device = _device_of("cuda", "ebb.interop.cuda_array", field)
    return writable_device_view(field, device) if write else device_view(field, device)


@overload
def opencl_array(field: Field, write: Literal[False] = False) -> Array: ...


@overload
def opencl_array(field: Field, write: Literal[True]) -> AbstractContextManager[Array]: ...


def opencl_array(field: Field, write: bool = False) -> Array | AbstractContextManager[Array]:
    """The device's own memory of a field as a ``pyopencl.array.Array``, while kernels run on ``opencl``.

    It is no copy. Its queue is the one that launches go to, so that what is done with it comes in order with them.
    Shape, order of the rows and layout are those of ``Field.view``; like that, it shows the memory that the field has
    now. Bools are int8. pyopencl knows no read-only arrays: write to it only with ``write=True``.

    Args:
        field: whose memory.
        write: returns a context manager instead, whose value may be written to. Until it is left, launches that touch
            the field raise.

    Raises:
        RelationError: ``write`` on a field of keys, or a writable view of it is open.
        BackendError: kernels do not run on ``opencl``, or a step is being captured.
    """
    from ebb.relations.device_view import device_view

    device = _device_of("opencl", "ebb.interop.opencl_array", field)
    return _writable_opencl_array(field, device) if write else _opencl_array(device_view(field, device), device)


@contextmanager
def _writable_opencl_array(field: Field, device: Device) -> Generator[Array, None, None]:
    from ebb.relations.device_view import writable_device_view

    with writable_device_view(field, device) as view:
        yield _opencl_array(view, device)


def _opencl_array(view: DeviceView, device: Device) -> Array:
    import numpy as np
    from pyopencl.array import Array

    from ebb.runtime.opencl_device import OpenCLDevice  # here: it needs pyopencl

    assert isinstance(device, OpenCLDevice)
    dtype = np.dtype(np.int8) if view.dtype == np.bool_ else view.dtype
    return Array(device.queue, view.shape, dtype, data=view.memory.buffer, strides=view.strides)


def _device_of(backend: str, function: str, field: Field) -> Device:
    current = current_backend()
    if current.name != backend or current.device is None:
        from ebb.runtime.errors_devices import NoSuchView

        raise BackendError(NoSuchView(function, field.path, backend, current.name))
    return current.device
