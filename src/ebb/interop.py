"""The memory of fields for other libraries: matrices for SciPy, arrays of CuPy, Numba, PyTorch, pyopencl on devices.

On the processor the memory is ``field.view()``. Everywhere ``field.__dlpack__`` gives what kernels work on.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any, Literal, overload

from ebb.backends.select import current_backend
from ebb.errors import BackendError
from ebb.relations.field import Field
from ebb.runtime.device import Device
from ebb.runtime.recording import refuse

if TYPE_CHECKING:
    from pyopencl.array import Array

    from ebb.relations.device_view import DeviceView

__all__ = ["bsr_matrix", "cuda_array", "opencl_array"]


def bsr_matrix(values: Field, *, row: Field, col: Field) -> Any:
    """A SciPy matrix on the memory of a field of entries: BSR where they are matrices, CSR where they are numbers.

    Nothing is copied: the matrix shows what kernels on the processor write into the field, until its keys change. Where
    kernels run on a device, ask for it anew after launches. It is read-only; SciPy's functions that would sort its
    entries or sum up duplicates in place take ``matrix.copy()``.

    Rows and columns are numbered as the rows of the relations that the keys refer to, so vectors come from
    ``field.to_numpy()``, and as well from ``view()``: if those relations have been stored in another order, their rows
    are brought back into that of their numbers, and stay there.

    Args:
        values: numbers or matrices, the entries or blocks of the matrix.
        row: the key field of the same relation that says in which row (of blocks) an entry stands. The relation is
            grouped by it if it is not yet, and it must have been grouped by no other field before.
        col: the key field that says in which column.

    Raises:
        RelationError: the fields make no matrix, or earlier views fix another order (E552).
        BackendError: SciPy is not installed, or a step is being captured.
    """
    from ebb.relations.sparse import matrix_rows  # here: few programs ask for it

    try:
        from scipy import sparse  # pyright: ignore[reportMissingTypeStubs]
    except ModuleNotFoundError:
        from ebb.relations.errors_matrix import MissingSciPy

        raise BackendError(MissingSciPy("ebb.interop.bsr_matrix")) from None
    refuse("making a matrix of a field", "make it before the with statement")
    found = matrix_rows(values, row, col)
    blocks = values.type.shape or (1, 1)
    shape = (found.shape[0] * blocks[0], found.shape[1] * blocks[1])
    library: Any = sparse
    if values.type.shape:
        matrix = library.bsr_matrix(shape, blocksize=blocks, dtype=values.type.dtype)
    else:
        matrix = library.csr_matrix(shape, dtype=values.type.dtype)
    # Set one by one: given to the constructor, SciPy copies arrays that are part of larger memory.
    matrix.data, matrix.indices, matrix.indptr = found.data, found.columns, found.starts
    return matrix


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
