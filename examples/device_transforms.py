"""Fourier transforms where the fields are: in the memory of a device, by reikna on opencl and by cuFFT on cuda.

reikna's transforms are of complex numbers. Those along rows read a field of reals as such, and keep half of what comes
out, the rest being its conjugates; back, they read the conjugates too, and keep the real part. So fields are all that
is read and written, in order with the kernels on the queue of these, and nothing passes through the host. Beside fields
the library has memory of its own only where the length of a row or a column is no power of two, or is a large one.

The library comes with ``pip install ebblang[fft]``. The first transforms of a process compile for a second or two.

cuFFT has transforms of reals in two dimensions, which go from one field to the other. It is called by nvmath-python,
NVIDIA's own package, on the stream that kernels go to (``pip install ebblang[cufft]``).
"""

from __future__ import annotations

import warnings
import weakref
from importlib.util import find_spec
from typing import Any

import numpy as np

import ebb
import ebb.interop


def transforms_on(backend: str) -> DeviceTransforms | CudaTransforms | None:
    """Transforms in the memory of the backend's device, or None if there is no library for it."""
    if backend == "opencl" and find_spec("reikna") is not None:
        return DeviceTransforms()
    if backend == "cuda" and find_spec("nvmath") is not None:
        try:
            return CudaTransforms()
        except RuntimeError:  # nvmath-python comes without cuFFT itself
            return None
    return None


class DeviceTransforms:
    """Transforms of real fields on a square grid, as ``fluids_fft.Transforms`` makes them on the host.

    Attributes:
        package: what transforms.
        memory: what the library has read and written, by the path of the field: OpenCL's handles of the memory.
    """

    package = "reikna"

    def __init__(self) -> None:
        """Nothing is compiled before the first transform."""
        self.memory = dict[str, int]()
        self._programs = dict[int, _Programs]()

    def forward(self, field: ebb.Field, spectrum: ebb.Field) -> None:
        """Set ``spectrum`` to the transform of ``field``."""
        values = ebb.interop.opencl_array(field)
        with ebb.interop.opencl_array(spectrum, write=True) as pairs:
            numbers, programs = self._begin(field, values, spectrum, pairs)
            programs.rows_forward(numbers, values, 0)
            programs.columns(numbers, numbers, 0)

    def inverse(self, spectrum: ebb.Field, field: ebb.Field) -> None:
        """Set ``field`` to the inverse transform of ``spectrum``, whose values are lost."""
        with (
            ebb.interop.opencl_array(spectrum, write=True) as pairs,
            ebb.interop.opencl_array(field, write=True) as values,
        ):
            numbers, programs = self._begin(field, values, spectrum, pairs)
            programs.columns(numbers, numbers, 1)
            programs.rows_inverse(values, numbers, 1)

    def _begin(self, field: ebb.Field, values: Any, spectrum: ebb.Field, pairs: Any) -> tuple[Any, _Programs]:
        """The pairs as complex numbers, and what transforms them."""
        from pyopencl.array import Array

        n = values.shape[0]
        if n not in self._programs:
            self._programs[n] = _Programs(n, values.queue)
        numbers = Array(values.queue, pairs.shape[:2], np.complex64, data=pairs.base_data, offset=pairs.offset)
        self.memory |= {field.path: values.data.int_ptr, spectrum.path: numbers.data.int_ptr}
        return numbers, self._programs[n]


class _Programs:
    """What reikna compiles for grids of n x n cells.

    Attributes:
        rows_forward: takes complex numbers to write, reals to read, and 0.
        columns: takes the same complex numbers twice, and 0, or 1 for the inverse.
        rows_inverse: takes reals to write, complex numbers to read, and 1.
    """

    def __init__(self, n: int, queue: Any) -> None:
        from pyopencl import CompilerWarning
        from reikna.cluda import ocl_api
        from reikna.core import Annotation, Parameter, Transformation, Type
        from reikna.fft import FFT

        def change(given: Any, out: Any, code: str) -> Any:
            """What is done with each number of ``given``, or for each of ``out``: whichever is a full one."""
            places = [Parameter("out", Annotation(out, "o")), Parameter("given", Annotation(given, "i"))]
            return Transformation(places, code, connectors=["out" if out is full else "given"])

        thread = ocl_api().Thread(queue)
        reals, full, half = (
            Type(dtype, shape)
            for dtype, shape in ((np.float32, (n, n)), (np.complex64, (n, n)), (np.complex64, (n, n // 2 + 1)))
        )
        read_reals = change(reals, full, _READ_REALS)
        keep_half = change(full, half, _KEEP_HALF % (n // 2))
        read_half = change(half, full, _READ_HALF % (n // 2, n))
        keep_reals = change(full, reals, _KEEP_REALS)
        forward, columns, inverse = FFT(full, axes=(1,)), FFT(half, axes=(0,)), FFT(full, axes=(1,))
        forward.parameter.input.connect(read_reals, read_reals.out, field=read_reals.given)
        forward.parameter.output.connect(keep_half, keep_half.given, waves=keep_half.out)
        inverse.parameter.input.connect(read_half, read_half.out, waves=read_half.given)
        inverse.parameter.output.connect(keep_reals, keep_reals.given, field=keep_reals.out)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CompilerWarning)  # that the driver's compiler has said something
            self.rows_forward = forward.compile(thread)
            self.columns = columns.compile(thread)
            self.rows_inverse = inverse.compile(thread)


@ebb.kernel
def scale(c, name: str, share: ebb.float32):
    c[name] *= share


class CudaTransforms:
    """The same by cuFFT, on the device of the backend ``cuda``.

    Attributes:
        package: what transforms.
        memory: what the library has read and written, by the path of the field: addresses on the device.
    """

    package = "cuFFT"

    def __init__(self) -> None:
        """No plan is made before the first transform.

        Raises:
            RuntimeError: cuFFT, or the driver, cannot be loaded.
        """
        from nvmath.bindings import cufft

        cufft.get_version()
        self.memory = dict[str, int]()
        self._cufft = cufft
        self._plans = dict[tuple[int, Any], int]()
        weakref.finalize(self, _destroy, cufft, self._plans)

    def forward(self, field: ebb.Field, spectrum: ebb.Field) -> None:
        """Set ``spectrum`` to the transform of ``field``."""
        values = ebb.interop.cuda_array(field)
        with ebb.interop.cuda_array(spectrum, write=True) as pairs:
            plan = self._plan(values, self._cufft.Type.R2C)
            self._cufft.exec_r2c(plan, self._place(field, values), self._place(spectrum, pairs))

    def inverse(self, spectrum: ebb.Field, field: ebb.Field) -> None:
        """Set ``field`` to the inverse transform of ``spectrum``, whose values are lost."""
        with (
            ebb.interop.cuda_array(spectrum, write=True) as pairs,
            ebb.interop.cuda_array(field, write=True) as values,
        ):
            plan = self._plan(values, self._cufft.Type.C2R)
            self._cufft.exec_c2r(plan, self._place(spectrum, pairs), self._place(field, values))
        scale(field.relation, field.name, 1 / field.relation.size)  # cuFFT's are not normalised

    def _plan(self, values: Any, kind: Any) -> int:
        """A plan for n x n reals, on the stream of Ebb's kernels. The device is made the current one of cuFFT."""
        from cuda.bindings import runtime

        _, number = values.__dlpack_device__()
        (status,) = runtime.cudaSetDevice(number)
        if status:
            raise RuntimeError(f"the device {number} cannot be used: {status.name}")
        n = values.shape[0]
        if (n, kind) not in self._plans:
            plan = self._plans[n, kind] = self._cufft.create()
            self._cufft.make_plan2d(plan, n, n, kind)
            self._cufft.set_stream(plan, runtime.cudaStreamLegacy)
        return self._plans[n, kind]

    def _place(self, field: ebb.Field, view: Any) -> int:
        """Where the entries lie, one after the other as cuFFT takes them."""
        interface = view.__cuda_array_interface__
        packed = [view.dtype.itemsize]
        for extent in view.shape[:0:-1]:
            packed.insert(0, packed[0] * extent)
        if tuple(interface["strides"]) != tuple(packed):
            raise ValueError(f"{field.path} does not lie in rows")
        self.memory[field.path] = interface["data"][0]
        return self.memory[field.path]


def _destroy(cufft: Any, plans: dict[tuple[int, Any], int]) -> None:
    for plan in plans.values():
        cufft.destroy(plan)


# How they read and write, in reikna's language.
_READ_REALS = "${out.store_same}(COMPLEX_CTR(${out.ctype})(${given.load_same}, 0));"
_KEEP_REALS = "${out.store_same}((${given.load_same}).x);"
_KEEP_HALF = """
    if (${idxs[1]} <= %d)
        ${out.store_idx}(${idxs[0]}, ${idxs[1]}, ${given.load_same});
"""
_READ_HALF = """
    const bool is_there = ${idxs[1]} <= %d;
    ${given.ctype} number = ${given.load_idx}(${idxs[0]}, is_there ? ${idxs[1]} : %d - ${idxs[1]});
    ${out.store_same}(COMPLEX_CTR(${out.ctype})(number.x, is_there ? number.y : -number.y));
"""
