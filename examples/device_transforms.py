"""Fourier transforms where the fields are: on an OpenCL device, by reikna, in the device's own memory.

reikna's transforms are of complex numbers. Those along rows read a field of reals as such, and keep half of what comes
out, the rest being its conjugates; back, they read the conjugates too, and keep the real part. So fields are all that
is read and written, in order with the kernels on the queue of these, and nothing passes through the host. Beside fields
the library has memory of its own only where the length of a row or a column is no power of two, or is a large one.

The library comes with ``pip install ebblang[fft]``. The first transforms of a process compile for a second or two.
"""

from __future__ import annotations

import warnings
from importlib.util import find_spec
from typing import Any

import numpy as np

import ebb
import ebb.interop


def installed() -> bool:
    """Whether the library is there."""
    return find_spec("reikna") is not None


class DeviceTransforms:
    """Transforms of real fields on a square grid, as ``fluids_fft.Transforms`` makes them on the host.

    Attributes:
        memory: what the library has read and written, by the path of the field: OpenCL's handles of the memory.
    """

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
