"""The memory of fields on devices, as other libraries see it: pyopencl for real, a GPU's as far as it is told."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from fake_cuda_driver import FakeDriver

import ebb
from backends import lacking
from ebb.interop import cuda_array, opencl_array
from ebb.runtime.buffer import Layout
from ebb.runtime.device import current_device


def make_rows(size: int = 6) -> ebb.Relation:
    rows = ebb.Relation("rows", size=size)
    rows.new_field("q", ebb.vec3f, init=np.arange(3 * size).reshape(size, 3))
    rows.new_field("flag", ebb.bool_, init=np.arange(size) % 2 == 0)
    rows.new_field("next", rows, init=np.roll(np.arange(size), -1))
    return rows


def make_cells() -> ebb.Relation:
    cells = ebb.Relation("cells", shape=(4, 6))
    cells.new_field("u", ebb.float64, init=np.arange(24.0).reshape(4, 6))
    return cells


def doubling(rows: ebb.Relation) -> ebb.Kernel:
    @ebb.kernel
    def double(r: rows):
        r.q = 2 * r.q

    return double


# ---- pyopencl ----


@pytest.mark.skipif(lacking("opencl") is not None, reason="there is no OpenCL")
@pytest.mark.filterwarnings("ignore:Non-empty compiler output")
class TestOpenCL:
    @pytest.fixture(autouse=True)
    def on_opencl(self) -> Iterator[None]:
        with ebb.backend("opencl"):
            yield

    def test_it_is_the_memory_that_kernels_work_on(self) -> None:
        rows = make_rows()
        array = opencl_array(rows.q)
        assert array.base_data is opencl_array(rows.q).base_data is rows.q.buffer.on(current_device()).buffer
        assert array.get().tolist() == rows.q.to_numpy().tolist()
        doubling(rows)(rows)
        assert array.get()[1].tolist() == [6, 8, 10]

    def test_kernels_and_the_host_see_what_is_written(self) -> None:
        rows = make_rows()
        double = doubling(rows)
        double(rows)
        version = rows.q.version
        with opencl_array(rows.q, write=True) as array:
            array += 1
            assert rows.q.to_numpy()[1].tolist() == [7, 9, 11], "the host may look meanwhile"
            array += 1
        assert rows.q.version > version
        assert rows.q.to_numpy()[1].tolist() == [8, 10, 12]
        double(rows)
        assert rows.q.to_numpy()[1].tolist() == [16, 20, 24]

    def test_launches_wait_until_it_is_left(self) -> None:
        rows = make_rows()
        double = doubling(rows)
        for _ in range(10):
            double(rows)
        with opencl_array(rows.q, write=True):
            for use in (lambda: double(rows), lambda: rows.q.fill(0), lambda: opencl_array(rows.q)):
                with pytest.raises(ebb.RelationError, match="E512"):
                    use()
        double(rows)

    def test_the_processor_sees_it_too(self) -> None:
        rows = make_rows()
        double = doubling(rows)
        for _ in range(10):
            double(rows)
        with ebb.backend("cpu"):
            double(rows)
        with opencl_array(rows.q, write=True) as array:
            array.fill(1)
        with ebb.backend("cpu"):
            double(rows)
            assert rows.q.to_numpy().tolist() == [[2, 2, 2]] * 6

    def test_grids_have_their_shape(self) -> None:
        cells = make_cells()
        array = opencl_array(cells.u)
        assert array.shape == (4, 6)
        assert (array + 1).get().tolist() == (np.arange(24.0).reshape(4, 6) + 1).tolist()

    def test_columns_have_their_strides(self) -> None:
        rows = make_rows()
        rows.q.replace(rows.q.buffer.in_layout(Layout.COLUMNS))
        array = opencl_array(rows.q)
        assert array.strides == rows.q.view().strides
        assert array[:, 1].get().tolist() == rows.q.to_numpy()[:, 1].tolist()

    def test_bools_are_bytes(self) -> None:
        rows = make_rows()
        array = opencl_array(rows.flag)
        assert array.dtype == np.int8
        assert array.get().tolist() == [1, 0, 1, 0, 1, 0]

    def test_rows_stay_where_they_are(self) -> None:
        rows = make_rows()
        opencl_array(rows.q)
        assert rows.storage.pinned

    @pytest.mark.parametrize("size", [0, 1])
    def test_few_rows(self, size: int) -> None:
        rows = make_rows(size)
        assert opencl_array(rows.q).shape == (size, 3)

    def test_keys_are_not_written(self) -> None:
        rows = make_rows()
        assert opencl_array(rows.next).get().tolist() == [1, 2, 3, 4, 5, 0]
        with pytest.raises(ebb.RelationError, match="E513"), opencl_array(rows.next, write=True):
            pass

    def test_other_libraries_get_the_memory_of_the_host(self) -> None:
        rows = make_rows()
        doubling(rows)(rows)
        assert rows.q.__dlpack_device__() == (1, 0)
        assert np.from_dlpack(rows.q)[1].tolist() == [6, 8, 10]
        assert not hasattr(rows.q, "__cuda_array_interface__")


# ---- CUDA ----


@contextmanager
def on_cuda(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeDriver]:
    driver = FakeDriver()
    monkeypatch.setitem(sys.modules, "cuda.bindings.driver", driver)
    with ebb.backend("cuda"):
        yield driver


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeDriver]:
    with on_cuda(monkeypatch) as driver:
        yield driver


def values_at(interface: dict, count: int) -> list[float]:
    """The first numbers at an address, which the fake driver has in the memory of the host."""
    address, _ = interface["data"]
    return list((ctypes.c_float * count).from_address(address))


def test_the_array_interface_tells_address_and_form(driver: FakeDriver) -> None:
    rows = make_rows()
    interface = cuda_array(rows.q).__cuda_array_interface__
    memory = rows.q.buffer.on(current_device())
    assert interface["data"] == (memory.address, True)
    assert memory.address in driver.memory
    assert interface["shape"] == (6, 3)
    assert interface["strides"] == (12, 4)
    assert interface["typestr"] == "<f4"
    assert interface["version"] == 3
    assert interface["stream"] == 1, "the legacy default stream, to which launches go"
    assert values_at(interface, 3) == [0, 1, 2]
    assert rows.q.__cuda_array_interface__ == interface
    assert rows.flag.__cuda_array_interface__["typestr"] == "|b1"


def test_grids_have_their_shape_on_a_gpu(driver: FakeDriver) -> None:
    interface = cuda_array(make_cells().u).__cuda_array_interface__
    assert (interface["shape"], interface["strides"]) == ((4, 6), (48, 8))


def test_columns_have_their_strides_on_a_gpu(driver: FakeDriver) -> None:
    rows = make_rows(100)
    rows.q.replace(rows.q.buffer.in_layout(Layout.COLUMNS))
    interface = cuda_array(rows.q).__cuda_array_interface__
    assert interface["strides"] == rows.q.view().strides != (12, 4)


def test_nothing_lies_at_no_address(driver: FakeDriver) -> None:
    assert cuda_array(make_rows(0).q).__cuda_array_interface__["data"] == (0, True)


def test_what_is_written_on_a_gpu_is_what_counts(driver: FakeDriver) -> None:
    rows = make_rows()
    version = rows.q.version
    with cuda_array(rows.q, write=True) as view:
        interface = view.__cuda_array_interface__
        assert interface["data"][1] is False
        ctypes.c_float.from_address(interface["data"][0]).value = 7
        assert rows.q.to_numpy()[0, 0] == 7
        ctypes.c_float.from_address(interface["data"][0]).value = 8
        with pytest.raises(ebb.RelationError, match="E512"):
            doubling(rows)(rows)
    assert rows.q.version > version
    assert rows.q.to_numpy()[0, 0] == 8
    assert view.__cuda_array_interface__["data"][1] is True


@pytest.mark.parametrize("max_version", [None, (1, 0)])
def test_dlpack_tells_address_and_form(driver: FakeDriver, max_version: tuple[int, int] | None) -> None:
    rows = make_rows()
    assert rows.q.__dlpack_device__() == (2, 0)
    capsule = rows.q.__dlpack__(max_version=max_version, stream=1)
    start, words = record_of(capsule), slice(None)
    if max_version:
        assert ctypes.c_uint64.from_address(start + 24).value & 1, "read-only"
    tensor = start + (32 if max_version else 0)
    address = ctypes.c_uint64.from_address(tensor).value + ctypes.c_uint64.from_address(tensor + 40).value
    assert address == rows.q.buffer.on(current_device()).address
    assert list((ctypes.c_int32 * 3).from_address(tensor + 8))[words] == [2, 0, 2], "kind, number, dimensions"
    assert bytes((ctypes.c_uint8 * 4).from_address(tensor + 20)) == bytes((2, 32, 1, 0)), "float, bits, lanes"
    shape, strides = (ctypes.c_uint64.from_address(tensor + offset).value for offset in (24, 32))
    assert list((ctypes.c_int64 * 2).from_address(shape)) == [6, 3]
    assert list((ctypes.c_int64 * 2).from_address(strides)) == [3, 1], "in elements"


def record_of(capsule: object) -> int:
    """Where the record lies that a capsule of DLPack holds."""
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetPointer.restype = ctypes.c_char_p, ctypes.c_void_p
    name = api.PyCapsule_GetName(ctypes.py_object(capsule))
    return api.PyCapsule_GetPointer(ctypes.py_object(capsule), ctypes.c_char_p(name))


def test_a_capsule_keeps_the_memory(driver: FakeDriver) -> None:
    rows = make_rows()
    capsule = rows.q.__dlpack__()
    del rows
    gc.collect()
    assert len(driver.memory) == 1
    del capsule
    gc.collect()
    assert driver.memory == {}


def test_who_takes_the_memory_gives_it_back(driver: FakeDriver) -> None:
    """As a consumer does: it renames the capsule, and calls the record's own function when it is done."""
    rows = make_rows()
    capsule = rows.q.__dlpack__()
    start = record_of(capsule)
    ctypes.pythonapi.PyCapsule_SetName(ctypes.py_object(capsule), ctypes.c_char_p(b"used_dltensor"))
    del rows, capsule
    gc.collect()
    assert len(driver.memory) == 1
    deleter = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(ctypes.c_uint64.from_address(start + 56).value)
    deleter(start)
    gc.collect()
    assert driver.memory == {}


def test_the_consumers_stream_waits(driver: FakeDriver) -> None:
    rows = make_rows()
    rows.q.__dlpack__()
    driver.calls.clear()
    for stream in (None, 1, -1):
        rows.q.__dlpack__(stream=stream)
    assert "cuStreamSynchronize" not in driver.names
    rows.q.__dlpack__(stream=2)
    assert "cuStreamSynchronize" in driver.names


def test_what_is_no_view_is_refused(driver: FakeDriver) -> None:
    rows = make_rows()
    with pytest.raises(BufferError):
        rows.q.__dlpack__(copy=True)
    with pytest.raises(BufferError):
        cuda_array(rows.q).__dlpack__(dl_device=(2, 1))
    with pytest.raises(BufferError):
        rows.next.__dlpack__()  # read-only, which cannot be said there
    assert rows.q.__dlpack__(dl_device=(1, 0)) is not None, "the host's"


def test_there_is_no_gpus_memory_elsewhere() -> None:
    rows = make_rows()
    assert not hasattr(rows.q, "__cuda_array_interface__")
    for take, name in ((cuda_array, "cuda"), (opencl_array, "opencl")):
        with pytest.raises(ebb.BackendError, match="E619") as caught:
            take(rows.q)
        assert f'ebb.set_backend("{name}")' in str(caught.value)


def test_nothing_is_taken_while_a_step_is_captured(driver: FakeDriver) -> None:
    rows = make_rows()
    with ebb.capture(), pytest.raises(ebb.BackendError, match="E607"):
        cuda_array(rows.q)
