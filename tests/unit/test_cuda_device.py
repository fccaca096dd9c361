"""The device of ``cuda`` over a driver that writes its calls down: their order, arguments, and what errors become."""

from __future__ import annotations

import ctypes
import gc
import sys
import threading
import types

import numpy as np
import pytest
from fake_cuda_driver import CONTEXT, OTHER_CONTEXT, CUresult, FakeDriver

import ebb
from ebb.environment import describe_environment
from ebb.runtime.cuda import cuda_device, describe_devices
from ebb.runtime.cuda_device import MOST_COPIES, MOST_GROUPS, MOST_STAGED, CudaDevice

PTX = b"""
.version 7.0
.target sm_80
.visible .entry ebb_step(
	.param .u64 .ptr .global .align 1 ebb_step_param_0,
	.param .u64 ebb_step_param_1,
	.param .f32 ebb_step_param_2,
	.param .u8 ebb_step_param_3,
	.param .f64 ebb_step_param_4
)
{ ret; }
.visible .entry ebb_step_finish(
)
{ ret; }
"""


@pytest.fixture
def driver() -> FakeDriver:
    return FakeDriver()


@pytest.fixture
def device(driver: FakeDriver) -> CudaDevice:
    device = CudaDevice(driver, 0)
    driver.calls.clear()
    return device


def bytes_of(*values: int) -> np.ndarray:
    return np.array(values, np.uint8)


def error_of(call, *arguments) -> str:
    with pytest.raises(ebb.BackendError) as caught:
        call(*arguments)
    return " ".join(str(caught.value).split())


# ---- Memory ----


def test_bytes_go_there_and_back(device: CudaDevice, driver: FakeDriver) -> None:
    memory = device.allocate(8)
    device.upload(memory, bytes_of(1, 2, 3))
    back = np.zeros(3, np.uint8)
    device.download(memory, back)
    assert back.tolist() == [1, 2, 3]
    assert driver.names == ["cuMemAllocAsync", "cuMemcpyHtoDAsync", "cuMemcpyDtoHAsync", "cuStreamSynchronize"]


def test_all_goes_to_the_legacy_stream(device: CudaDevice, driver: FakeDriver) -> None:
    memory = device.allocate(4)
    device.upload(memory, bytes_of(1))
    device.download(memory, np.zeros(1, np.uint8))
    device.wait()
    del memory
    streams = {arguments[-1] for name, arguments in driver.calls if name in driver.names}
    assert streams == {driver.CU_STREAM_LEGACY}


def test_few_bytes_are_uploaded_from_a_copy(device: CudaDevice, driver: FakeDriver) -> None:
    """Which the driver may read later, where a GPU reads the memory of the processor by itself."""
    memory, source = device.allocate(4), bytes_of(1, 2, 3, 4)
    device.upload(memory, source)
    assert driver.names == ["cuMemAllocAsync", "cuMemcpyHtoDAsync"], "nobody waits"
    (place,) = (arguments[1] for name, arguments in driver.calls if name == "cuMemcpyHtoDAsync")
    assert place != source.ctypes.data
    source[:] = 0
    assert ctypes.string_at(place, 4) == bytes((1, 2, 3, 4)), "it is still there"


def test_copies_do_not_pile_up(device: CudaDevice, driver: FakeDriver) -> None:
    memory = device.allocate(4)
    for _ in range(3 * MOST_COPIES):
        device.upload(memory, bytes_of(1))
    assert driver.names.count("cuStreamSynchronize") == 3


def test_many_bytes_are_waited_for(device: CudaDevice, driver: FakeDriver) -> None:
    memory, source = device.allocate(MOST_STAGED + 1), np.zeros(MOST_STAGED + 1, np.uint8)
    device.upload(memory, source)
    assert driver.names == ["cuMemAllocAsync", "cuMemcpyHtoDAsync", "cuStreamSynchronize"]
    (place,) = (arguments[1] for name, arguments in driver.calls if name == "cuMemcpyHtoDAsync")
    assert place == source.ctypes.data, "without a copy"


def test_no_bytes_are_no_call(device: CudaDevice, driver: FakeDriver) -> None:
    memory = device.allocate(0)
    device.upload(memory, bytes_of())
    device.download(memory, bytes_of())
    assert memory.nbytes == 0
    del memory
    assert driver.calls == []


@pytest.mark.parametrize(("pools", "freed_by"), [(True, "cuMemFreeAsync"), (False, "cuMemFree")])
def test_memory_is_given_back_when_nobody_holds_it(pools: bool, freed_by: str) -> None:
    driver = FakeDriver(pools=pools)
    device = CudaDevice(driver, 0)
    memory, other = device.allocate(100), device.allocate(28)
    assert device.taken == 128
    del memory
    assert device.taken == 28
    assert len(driver.memory) == 1
    assert driver.names[-1] == freed_by
    del other
    assert driver.memory == {}


def test_memory_outlives_the_device_at_the_end_of_the_process(device: CudaDevice, driver: FakeDriver) -> None:
    memory = device.allocate(4)
    (module,) = device.load("step", PTX, ("ebb_step",))
    device._close()
    driver.calls.clear()
    del memory, module
    assert driver.calls == []


def test_what_is_held_in_cycles_makes_room(device: CudaDevice, driver: FakeDriver) -> None:
    gc.disable()
    try:
        cycle: list[object] = [device.allocate(driver.total)]
        cycle.append(cycle)
        del cycle
        assert device.allocate(driver.total // 2).nbytes == driver.total // 2
    finally:
        gc.enable()


def test_no_memory_left_says_how_much_there_is(device: CudaDevice, driver: FakeDriver) -> None:
    held = device.allocate(driver.total - 1000)
    text = error_of(device.allocate, 2000)
    assert "error[E614]: the device 'Fake 0' has no 2,000 bytes left" in text
    assert f"{driver.total - 1000:,}" in text, "what this process has"
    assert "one field may have 1,000" in text, "what is free"
    assert device.taken == held.nbytes


# ---- Kernels ----


def test_parameters_lie_as_the_kernel_reads_them(device: CudaDevice, driver: FakeDriver) -> None:
    memory = device.allocate(4)
    entry, finish = device.load("step", PTX, ("ebb_step", "ebb_step_finish"))
    device.launch(entry, 5, 64, [memory, np.int64(-2), np.float32(1.5), np.int8(1), np.float64(0.1)])
    device.launch(finish, 1, 64, [])
    first, second = driver.launches
    assert first[:3] == ("ebb_step", 5, 64)
    pointer, integer, single, byte, double = first[3]
    assert int.from_bytes(pointer, "little") == memory.address
    assert integer == np.int64(-2).tobytes()
    assert single == np.float32(1.5).tobytes()
    assert byte == b"\1"
    assert double == np.float64(0.1).tobytes()
    assert second == ("ebb_step_finish", 1, 64, ())


def test_launches_wait_for_nothing(device: CudaDevice, driver: FakeDriver) -> None:
    (entry,) = device.load("step", PTX, ("ebb_step_finish",))
    device.launch(entry, 1, 64, [])
    device.launch(entry, 1, 64, [])
    assert driver.names == ["cuModuleLoadDataEx", "cuModuleGetFunction", "cuLaunchKernel", "cuLaunchKernel"]


def test_a_launch_of_no_groups_is_none(device: CudaDevice, driver: FakeDriver) -> None:
    (entry,) = device.load("step", PTX, ("ebb_step_finish",))
    device.launch(entry, 0, 64, [])
    assert driver.launches == []


def test_an_entry_keeps_its_code(device: CudaDevice, driver: FakeDriver) -> None:
    (entry,) = device.load("step", PTX, ("ebb_step_finish",))
    gc.collect()
    assert len(driver.modules) == 1
    del entry
    assert driver.modules == {}
    assert driver.names[-2:] == ["cuStreamSynchronize", "cuModuleUnload"], "it may be running until then"


def test_too_many_groups_are_refused(device: CudaDevice, driver: FakeDriver) -> None:
    (entry,) = device.load("step", PTX, ("ebb_step_finish",))
    assert "error[E615]" in error_of(device.launch, entry, MOST_GROUPS + 1, 64, [])
    assert driver.launches == []


def test_code_that_the_driver_does_not_take(device: CudaDevice, driver: FakeDriver) -> None:
    driver.fail("cuModuleLoadDataEx", CUresult.CUDA_ERROR_UNSUPPORTED_PTX_VERSION)
    driver.log = b"ptxas fatal: Unsupported .version 9.9"
    text = error_of(device.load, "step", PTX, ("ebb_step",))
    assert "error[E616]: the device 'Fake 0' does not take the code of kernel 'step'" in text
    assert "unsupported ptx version (CUDA_ERROR_UNSUPPORTED_PTX_VERSION)" in text
    assert "ptxas fatal: Unsupported .version 9.9" in text
    assert "update the driver" in text
    device.load("step", PTX, ("ebb_step",))


# ---- The context ----


def test_each_thread_gets_back_its_context(device: CudaDevice, driver: FakeDriver) -> None:
    driver.contexts.append(OTHER_CONTEXT)
    memory = device.allocate(4)
    driver.fail("cuMemcpyHtoDAsync", CUresult.CUDA_ERROR_LAUNCH_FAILED)
    error_of(device.upload, memory, bytes_of(1))
    assert driver.contexts == [OTHER_CONTEXT]
    seen: list[list[str]] = []

    def elsewhere() -> None:
        device.upload(memory, bytes_of(1))
        seen.append(list(driver.contexts))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert seen == [[]]
    pushed = [arguments for name, arguments in driver.calls if name == "cuCtxPushCurrent"]
    assert set(pushed) == {(CONTEXT,)}


def test_memory_may_go_in_any_thread(device: CudaDevice, driver: FakeDriver) -> None:
    held = [device.allocate(4)]
    thread = threading.Thread(target=held.clear)
    thread.start()
    thread.join()
    assert driver.memory == {}


# ---- Failures ----


def test_a_lost_device_says_so_at_every_call(device: CudaDevice, driver: FakeDriver) -> None:
    (entry,) = device.load("step", PTX, ("ebb_step_finish",))
    memory = device.allocate(4)
    device.launch(entry, 1, 64, [])
    driver.sticky = CUresult.CUDA_ERROR_ILLEGAL_ADDRESS
    for call, *arguments in (
        (device.wait,),
        (device.download, memory, np.zeros(1, np.uint8)),
        (device.upload, memory, bytes_of(1)),
        (device.launch, entry, 1, 64, []),
        (device.allocate, 4),
    ):
        text = error_of(call, *arguments)
        assert "error[E617]: the device 'Fake 0' failed at " in text
        assert "illegal address (CUDA_ERROR_ILLEGAL_ADDRESS)" in text
    del memory, entry  # raises nothing


@pytest.mark.parametrize("name", ["cuDeviceGet", "cuDeviceGetName", "cuDeviceGetAttribute", "cuDevicePrimaryCtxRetain"])
def test_a_device_that_cannot_be_opened(driver: FakeDriver, name: str) -> None:
    driver.fail(name, CUresult.CUDA_ERROR_LAUNCH_FAILED)
    assert "failed at being opened: launch failed" in error_of(CudaDevice, driver, 0)


def test_a_device_that_is_too_old() -> None:
    text = error_of(CudaDevice, FakeDriver(capability=(5, 2)), 0)
    assert "error[E613]: the device 'Fake 0' lacks compute capability 6.0 (it has 5.2)" in text


# ---- Which devices there are ----


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch):
    def install(module: object) -> None:
        monkeypatch.setitem(sys.modules, "cuda.bindings.driver", module)

    return install


def test_a_device_is_opened_once(installed) -> None:
    driver = FakeDriver(count=2)
    installed(driver)
    assert cuda_device() is cuda_device(0) is cuda_device(np.int64(0))
    assert cuda_device(1) is not cuda_device(0)
    assert cuda_device(1).dlpack_device == (2, 1)
    assert describe_devices() == ("0: Fake 0, 0.1 GiB", "1: Fake 1, 0.1 GiB")


def test_ebb_info_lists_them(installed) -> None:
    installed(FakeDriver(count=2))
    lines = describe_environment()
    assert ("backend cuda", "available") in lines
    assert [text for title, text in lines if title == "cuda device"] == ["0: Fake 0, 0.1 GiB", "1: Fake 1, 0.1 GiB"]


@pytest.mark.parametrize("choice", [2, -1, True, "0", 0.0])
def test_a_choice_that_is_no_device(installed, choice: object) -> None:
    installed(FakeDriver(count=2))
    text = error_of(cuda_device, choice)
    assert f"error[E612]: device={choice!r} names no device: there are devices 0 to 1" in text
    assert "1: Fake 1, 0.1 GiB" in text


def test_no_device(installed) -> None:
    installed(FakeDriver(count=0))
    assert "error[E611]: the backend 'cuda' has no device to run on: the driver finds no GPU" in error_of(cuda_device)
    driver = FakeDriver()
    driver.fail("cuInit", CUresult.CUDA_ERROR_NO_DEVICE)
    installed(driver)
    assert "has no device to run on: no device (CUDA_ERROR_NO_DEVICE)" in error_of(cuda_device)


def test_no_driver(installed) -> None:
    def init(flags: int) -> None:
        raise RuntimeError("Failed to dlopen libcuda.so.1")

    installed(types.SimpleNamespace(cuInit=init))
    text = error_of(cuda_device)
    assert "error[E611]: the backend 'cuda' has no device to run on: NVIDIA's driver is not installed" in text
    assert "install or update the driver of the GPU" in text


def test_no_package(installed) -> None:
    installed(None)
    text = error_of(cuda_device)
    assert "error[E610]: the backend 'cuda' needs the package 'cuda-bindings'" in text
    assert 'pip install "ebblang[cuda]"' in text
