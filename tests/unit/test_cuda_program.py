"""Programs on ``cuda`` over a driver that runs nothing: what they upload, launch and download, in which order."""

from __future__ import annotations

import ctypes
import gc
import sys
import threading
import weakref
from collections.abc import Iterator

import numpy as np
import pytest
from fake_cuda_driver import CUresult, FakeDriver

import ebb
from ebb.runtime.device import current_device

UPLOAD, DOWNLOAD, WAIT, LAUNCH = "cuMemcpyHtoDAsync", "cuMemcpyDtoHAsync", "cuStreamSynchronize", "cuLaunchKernel"
MOVING = (UPLOAD, DOWNLOAD, WAIT, LAUNCH)


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeDriver]:
    driver = FakeDriver()
    monkeypatch.setitem(sys.modules, "cuda.bindings.driver", driver)
    with ebb.backend("cuda", device=0):
        yield driver


def moves(driver: FakeDriver) -> list[str]:
    """What has been moved and launched since this was last asked."""
    names = [name for name, _ in driver.calls if name in MOVING]
    driver.calls.clear()
    return names


class Springs:
    """Points that move, and what is summed over them."""

    def __init__(self, size: int = 100) -> None:
        points = self.points = ebb.Relation("points", size=size)
        points.new_field("q", ebb.vec3f, init=1.0)
        points.new_field("force", ebb.vec3f, init=2.0)
        points.new_field("mass", ebb.float32, init=4.0)
        energy = self.energy = ebb.Global(ebb.float64, 0.0)

        @ebb.kernel
        def clear(p: points):
            p.force = [0, 0, 0]

        @ebb.kernel
        def move(p: points, dt: ebb.float32):
            p.q += p.force * dt / p.mass

        @ebb.kernel
        def measure(p: points):
            energy.value += 0.5 * p.mass * ebb.dot(p.q, p.q)

        self.clear, self.move, self.measure = clear, move, measure


def test_what_a_program_moves(driver: FakeDriver) -> None:
    springs = Springs()
    points = springs.points
    springs.clear(points)
    assert moves(driver) == [LAUNCH], "all of the field is overwritten"
    springs.move(points, 0.5)
    assert moves(driver) == [UPLOAD, UPLOAD, LAUNCH], "q and mass"
    springs.move(points, 0.25)
    springs.measure(points)
    assert moves(driver) == [LAUNCH, UPLOAD, LAUNCH, LAUNCH], "the global; its partial sums stay there"
    assert springs.energy.value == 0.0
    assert moves(driver) == [DOWNLOAD, WAIT]
    points.mass.to_numpy()
    assert moves(driver) == [], "the host's is valid: kernels only read it"
    points.q.to_numpy()
    points.q.to_numpy()
    assert moves(driver) == [DOWNLOAD, WAIT], "once"
    points.q.fill(3)
    springs.move(points, 0.5)
    assert moves(driver) == [UPLOAD, LAUNCH], "q alone"
    with ebb.backend("cpu"):
        springs.move(points, 0.5)
    assert moves(driver) == [DOWNLOAD, WAIT, DOWNLOAD, WAIT], "q and force"


def test_launches_have_the_right_size_and_parameters(driver: FakeDriver) -> None:
    springs = Springs(100)
    springs.move(springs.points, 0.5)
    springs.move(springs.points, 0.25, block_size=32)
    springs.measure(springs.points)
    shapes = [launch[:3] for launch in driver.launches]
    assert shapes == [
        ("ebb_move", 2, 64),
        ("ebb_move", 4, 32),
        ("ebb_measure", 2, 64),
        ("ebb_measure_finish", 1, 64),
    ]
    words = driver.launches[1][3]
    assert words[-1] == np.float32(0.25).tobytes()
    _failures, first_block, first_row, low, high, *slots = words[:-1]
    assert [int.from_bytes(word, "little") for word in (first_block, first_row, low, high)] == [0, 0, 0, 100]
    fields = [springs.points.fields[name].buffer.on(current_device()).address for name in ("q", "force", "mass")]
    assert sorted(int.from_bytes(slot, "little") for slot in slots) == sorted(fields)


def test_what_a_kernel_writes_is_what_is_read(driver: FakeDriver) -> None:
    """The stand-in writes in the kernel's place."""
    springs = Springs()
    points = springs.points

    def clear(name: str, words: tuple[bytes, ...]) -> None:
        assert name == "ebb_clear"
        address = int.from_bytes(words[-1], "little")
        ctypes.memset(address, 0, points.q.buffer.nbytes)

    driver.run = clear
    springs.clear(points)
    assert points.force.to_numpy().tolist() == [[0, 0, 0]] * 100


def test_code_is_loaded_once(driver: FakeDriver) -> None:
    springs = Springs()
    for _ in range(3):
        springs.move(springs.points, 0.5)
    images = [arguments[0] for name, arguments in driver.calls if name == "cuModuleLoadDataEx"]
    assert len(images) == 1
    assert b".target sm_80" in images[0]
    assert b".reqntid 64" in images[0]


def test_memory_and_code_go_with_the_relation(driver: FakeDriver) -> None:
    springs = Springs()
    springs.move(springs.points, 0.5)
    springs.measure(springs.points)
    assert driver.memory
    assert driver.modules
    device, points = current_device(), weakref.ref(springs.points)
    del springs
    gc.collect()
    assert points() is None
    assert driver.modules == {}
    assert sum(map(len, driver.memory.values())) == device.taken


def test_threads_launch_in_their_own_context(driver: FakeDriver) -> None:
    springs = Springs()
    errors: list[BaseException] = []

    def work() -> None:
        try:
            for _ in range(5):
                springs.move(springs.points, 0.5)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert len(driver.launches) == 20
    assert driver.contexts == []


def test_no_room_leaves_all_as_it_was(driver: FakeDriver) -> None:
    springs = Springs()
    driver.fail("cuMemAllocAsync", CUresult.CUDA_ERROR_OUT_OF_MEMORY, times=2, after=2)
    with pytest.raises(ebb.BackendError, match="E614"):
        springs.move(springs.points, 0.5)
    assert driver.launches == []
    assert springs.points.q.to_numpy()[0].tolist() == [1, 1, 1]
    springs.move(springs.points, 0.5)
    assert len(driver.launches) == 1


def test_a_device_that_fails_in_a_kernel_says_so_when_somebody_looks(driver: FakeDriver) -> None:
    springs = Springs()
    springs.move(springs.points, 0.5)
    driver.sticky = CUresult.CUDA_ERROR_LAUNCH_FAILED
    with pytest.raises(ebb.BackendError, match="E617") as caught:
        springs.points.q.to_numpy()
    assert "launch failed (CUDA_ERROR_LAUNCH_FAILED)" in " ".join(str(caught.value).split())


def test_captured_steps_are_launched_one_by_one(driver: FakeDriver) -> None:
    springs = Springs()
    with ebb.capture() as step:
        springs.clear(springs.points)
        springs.move(springs.points, 0.5)
    assert driver.launches == []
    step.run(3)
    assert [name for name, *_ in driver.launches] == ["ebb_clear", "ebb_move"] * 3
