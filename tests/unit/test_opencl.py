"""A device of OpenCL: its memory, queue and code, and how it fails."""

from __future__ import annotations

import multiprocessing
import os
from functools import cache
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest

import ebb
from backends import lacking
from ebb.backends.llvm.spirv_code import spirv_binary
from ebb.runtime.opencl import opencl_device
from fake_opencl import Device, Platform, machine, one_device

reason = lacking("opencl")
if reason is not None:
    pytest.skip(reason, allow_module_level=True)

HEADER = """
target triple = "spirv64-unknown-unknown"
declare spir_func i64 @_Z13get_global_idj(i32)
declare spir_func i64 @_Z12get_local_idj(i32)
declare spir_func i64 @_Z12get_group_idj(i32)
declare spir_func void @_Z7barrierj(i32)
"""
# Each number becomes itself times a factor plus a term.
SCALE = """
define spir_kernel void @scale(ptr addrspace(1) %numbers, i64 %factor, i8 %term) {
  %row = call spir_func i64 @_Z13get_global_idj(i32 0)
  %place = getelementptr i64, ptr addrspace(1) %numbers, i64 %row
  %number = load i64, ptr addrspace(1) %place
  %product = mul i64 %number, %factor
  %wide = sext i8 %term to i64
  %sum = add i64 %product, %wide
  store i64 %sum, ptr addrspace(1) %place
  ret void
}
"""
# The groups' numbers, each turned round in memory that the group shares, to another place.
TURN = """
@shared = internal addrspace(3) global [64 x i64] undef, align 16
define spir_kernel void @turn(ptr addrspace(1) %from, ptr addrspace(1) %to) {
  %row = call spir_func i64 @_Z13get_global_idj(i32 0)
  %thread = call spir_func i64 @_Z12get_local_idj(i32 0)
  %place = getelementptr i64, ptr addrspace(1) %from, i64 %row
  %number = load i64, ptr addrspace(1) %place
  %own = getelementptr [64 x i64], ptr addrspace(3) @shared, i64 0, i64 %thread
  store i64 %number, ptr addrspace(3) %own
  call spir_func void @_Z7barrierj(i32 1)
  %mirrored = sub i64 63, %thread
  %other = getelementptr [64 x i64], ptr addrspace(3) @shared, i64 0, i64 %mirrored
  %found = load i64, ptr addrspace(3) %other
  %target = getelementptr i64, ptr addrspace(1) %to, i64 %row
  store i64 %found, ptr addrspace(1) %target
  ret void
}
"""


@pytest.fixture(scope="module")
def device() -> Any:
    return opencl_device()


@cache
def spirv(*kernels: str) -> bytes:
    """What LLVM makes of kernels."""
    return spirv_binary(llvm.parse_assembly("".join((HEADER, *kernels))))


def put(device: Any, numbers: Any) -> Any:
    source = np.asarray(numbers, np.int64)
    memory = device.allocate(source.nbytes)
    device.upload(memory, source.view(np.uint8))
    return memory


def got(device: Any, memory: Any) -> list[int]:
    target = np.zeros(memory.nbytes, np.uint8)
    device.download(memory, target)
    return target.view(np.int64).tolist()


def raised(action: Any, *arguments: Any) -> Any:
    """The diagnostic with which ``action`` fails."""
    with pytest.raises(ebb.BackendError) as caught:
        action(*arguments)
    return caught.value.diagnostics[0]


# ---- Memory ----


@pytest.mark.parametrize("size", [0, 1, 2, 3, 7, 8, 16, 63, 64, 65, 100, 128, 129, 1000, 4096, 1_000_003])
def test_bytes_go_to_the_device_and_come_back(device: Any, size: int) -> None:
    source = np.random.default_rng(size).integers(0, 256, size, np.uint8)
    memory = device.allocate(size)
    assert memory.nbytes == size
    device.upload(memory, source)
    target = np.zeros_like(source)
    device.download(memory, target)
    assert (target == source).all()


@pytest.mark.parametrize("shift", [1, 3, 5])
@pytest.mark.parametrize("size", [8, 1000])
def test_host_arrays_need_no_alignment(device: Any, shift: int, size: int) -> None:
    source = np.random.default_rng(shift).integers(0, 256, size + shift, np.uint8)[shift:]
    memory, target = device.allocate(size), np.zeros(size + shift, np.uint8)[shift:]
    device.upload(memory, source)
    device.download(memory, target)
    assert (target == source).all()


@pytest.mark.parametrize("size", [8, 100])
def test_a_part_goes_to_the_beginning_and_the_rest_stays(device: Any, size: int) -> None:
    memory = device.allocate(1000)
    device.upload(memory, np.full(1000, 7, np.uint8))
    device.upload(memory, np.full(size, 9, np.uint8))
    target = np.zeros(1000, np.uint8)
    device.download(memory, target)
    assert target.tolist() == [9] * size + [7] * (1000 - size)
    beginning = np.zeros(size + 1, np.uint8)
    device.download(memory, beginning)
    assert beginning.tolist() == [9] * size + [7]


@pytest.mark.parametrize("count", [1, 4, 10, 1000])
def test_what_is_uploaded_may_change_at_once(device: Any, count: int) -> None:
    (scale,) = device.load("scale", spirv(SCALE), ("scale",))
    source = np.ones(count, np.int64)
    memory = device.allocate(source.nbytes)
    for turn in range(50):
        source[:] = turn
        device.upload(memory, source.view(np.uint8))
        source[:] = -1
        device.launch(scale, count, 1, (memory, np.int64(2), np.int8(1)))
        if turn % 10 == 9:
            assert got(device, memory) == [2 * turn + 1] * count


def test_memory_is_counted_and_given_back(device: Any) -> None:
    before = device.taken
    memory = device.allocate(1000)
    assert device.taken == before + 1000
    del memory
    assert device.taken == before


def test_memory_that_is_given_up_stays_until_what_uses_it_has_run(device: Any) -> None:
    (scale,) = device.load("scale", spirv(SCALE), ("scale",))
    kept = put(device, [1] * 64)
    for _ in range(20):
        passing = put(device, [1] * 10_000)
        device.launch(scale, 10_000, 1, (passing, np.int64(2), np.int8(0)))
        del passing
    device.launch(scale, 1, 64, (kept, np.int64(3), np.int8(0)))
    assert got(device, kept) == [3] * 64


def test_more_memory_than_there_is(device: Any) -> None:
    diagnostic = raised(device.allocate, 1 << 50)
    assert diagnostic.code == "E614"
    assert (diagnostic.asked, diagnostic.total) == (1 << 50, device.candidate.memory)


# ---- Code and launches ----


def test_launches_run_in_order(device: Any) -> None:
    (scale,) = device.load("scale", spirv(SCALE), ("scale",))
    memory = put(device, range(256))
    for step in range(30):
        device.launch(scale, 4, 64, (memory, np.int64(1 + step % 2), np.int8(-1)))
    expected = np.arange(256)
    for step in range(30):
        expected = expected * (1 + step % 2) - 1
    assert got(device, memory) == expected.tolist()


def test_a_kernel_takes_several_memories_and_shares_memory_in_a_group(device: Any) -> None:
    (turn,) = device.load("turn", spirv(TURN), ("turn",))
    source, target = put(device, range(192)), put(device, [0] * 192)
    device.launch(turn, 3, 64, (source, target))
    assert got(device, target) == [group * 64 + 63 - row for group in range(3) for row in range(64)]
    assert got(device, source) == list(range(192))
    device.launch(turn, 3, 64, (target, source))
    device.wait()
    assert got(device, source) == list(range(192))


def test_a_module_has_several_entries(device: Any) -> None:
    scale, turn = device.load("both", spirv(SCALE, TURN), ("scale", "turn"))
    source, target = put(device, range(64)), put(device, [0] * 64)
    device.launch(scale, 1, 64, (source, np.int64(10), np.int8(2)))
    device.launch(turn, 1, 64, (source, target))
    assert got(device, target) == [10 * (63 - row) + 2 for row in range(64)]


def test_no_groups_are_no_launch(device: Any) -> None:
    (scale,) = device.load("scale", spirv(SCALE), ("scale",))
    device.launch(scale, 0, 64, (device.allocate(0), np.int64(1), np.int8(1)))
    device.wait()


@pytest.mark.parametrize("group_size", [1, 7, 64, 100, 1024])
def test_groups_of_any_size(device: Any, group_size: int) -> None:
    (scale,) = device.load("scale", spirv(SCALE), ("scale",))
    memory = put(device, [1] * 3 * group_size)
    device.launch(scale, 3, group_size, (memory, np.int64(5), np.int8(0)))
    assert got(device, memory) == [5] * 3 * group_size


def test_a_group_larger_than_the_device_takes(device: Any) -> None:
    (scale,) = device.load("scale", spirv(SCALE), ("scale",))
    most = device.candidate.group_size
    diagnostic = raised(device.launch, scale, 1, most + 1, (device.allocate(8), np.int64(1), np.int8(0)))
    assert (diagnostic.code, diagnostic.kernel, diagnostic.asked) == ("E615", "scale", most + 1)
    assert "block_size" in diagnostic.hints[0]


def test_code_that_says_how_large_its_groups_are_is_refused_before_the_driver_sees_it() -> None:
    sized = SCALE.replace(") {", ") !reqd_work_group_size !0 {") + "\n!0 = !{i32 512, i32 1, i32 1}\n"
    with one_device():
        diagnostic = raised(opencl_device().load, "scale", spirv(sized), ("scale",))
    assert (diagnostic.code, diagnostic.asked, diagnostic.most) == ("E615", 512, 256)


def test_more_arguments_than_the_device_takes() -> None:
    with one_device():
        fake = opencl_device()
        (scale,) = fake.load("scale", spirv(SCALE), ("scale",))
        fake.launch(scale, 1, 1, [np.int8(0), *[fake.allocate(8)] * 127])
        (scale,) = fake.load("scale", spirv(SCALE), ("scale",))
        diagnostic = raised(fake.launch, scale, 1, 1, [np.int8(0), *[fake.allocate(8)] * 127, np.int8(0)])
    assert (diagnostic.code, diagnostic.asked, diagnostic.most) == ("E615", 1025, 1024)


def test_more_memory_a_group_than_the_device_has() -> None:
    with one_device(group_memory_of_kernels=70_000):
        diagnostic = raised(opencl_device().load, "turn", spirv(TURN), ("turn",))
    assert (diagnostic.code, diagnostic.asked, diagnostic.most) == ("E615", 70_000, 65_536)


def test_code_that_lacks_a_function(device: Any) -> None:
    lacking = SCALE.replace("  ret void", "  call spir_func void @missing()\n  ret void")
    diagnostic = raised(device.load, "lacking", spirv("declare spir_func void @missing()", lacking), ("scale",))
    assert (diagnostic.code, diagnostic.kernel) == ("E616", "lacking")
    assert "missing" in diagnostic.log


class Store(dict[str, bytes]):
    """A cache of code in memory."""

    def put(self, key: str, image: bytes) -> None:
        self[key] = image


def test_what_the_driver_has_compiled_is_kept(device: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store()
    monkeypatch.setattr(device, "binaries", store)
    image = spirv(SCALE, TURN)
    device.load("both", image, ("scale", "turn"))
    ((key, binary),) = store.items()
    assert len(key) == 64
    assert binary != image
    scale, turn = device.load("both", image, ("scale", "turn"))
    source, target = put(device, range(64)), put(device, [0] * 64)
    device.launch(scale, 1, 64, (source, np.int64(10), np.int8(2)))
    device.launch(turn, 1, 64, (source, target))
    assert got(device, target) == [10 * (63 - row) + 2 for row in range(64)]
    device.load("scale", spirv(SCALE), ("scale",))
    assert len(store) == 2


def test_kept_code_is_not_compiled_again() -> None:
    store, gpu = Store(), Device("Fake GPU")
    for _ in range(2):
        with machine(Platform("Fake Platform", gpu)):
            fake = opencl_device()
            fake.binaries = store
            fake.load("scale", spirv(SCALE), ("scale",))
        gpu.fails["clBuildProgram"] = "COMPILER_NOT_AVAILABLE"


def test_kept_code_of_another_driver_is_compiled_again() -> None:
    store = Store()
    for driver in ("1.0", "2.0"):
        with one_device(driver_version=driver):
            fake = opencl_device()
            fake.binaries = store
            fake.load("scale", spirv(SCALE), ("scale",))
    assert len(store) == 2


def test_kept_code_that_the_driver_refuses_is_compiled_again() -> None:
    with one_device():
        fake = opencl_device()
        fake.binaries = store = Store()
        fake.load("scale", spirv(SCALE), ("scale",))
        (key,) = store
        store[key] = b"of another kind"
        fake.load("scale", spirv(SCALE), ("scale",))
        assert store[key] == b"built for Fake GPU"


def test_code_of_a_newer_spirv_than_the_device_takes() -> None:
    with one_device(il_version="SPIR-V_1.0"):
        image = bytearray(spirv(SCALE))
        image[4:8] = (0, 3, 1, 0)
        diagnostic = raised(opencl_device().load, "new", bytes(image), ("scale",))
    assert (diagnostic.code, diagnostic.log) == ("E616", "this is SPIR-V 1.3, and it takes up to 1.0")


@pytest.mark.parametrize(
    ("routine", "status", "action"),
    [
        ("clCreateBuffer", "MEM_OBJECT_ALLOCATION_FAILURE", None),
        ("clEnqueueCopyBuffer", "OUT_OF_HOST_MEMORY", None),
        ("clEnqueueCopyBuffer", "DEVICE_NOT_AVAILABLE", "copying to it"),
        ("clBuildProgram", "OUT_OF_HOST_MEMORY", None),
        ("clEnqueueNDRangeKernel", "MEM_OBJECT_ALLOCATION_FAILURE", None),
        ("clEnqueueNDRangeKernel", "OUT_OF_RESOURCES", "launching kernel 'scale'"),
        ("clFinish", "DEVICE_NOT_AVAILABLE", "running kernels"),
    ],
)
def test_a_device_that_fails(routine: str, status: str, action: str | None) -> None:
    def use() -> None:
        fake = opencl_device()
        (scale,) = fake.load("scale", spirv(SCALE), ("scale",))
        memory = fake.allocate(1000)
        fake.upload(memory, np.zeros(1000, np.uint8))
        fake.launch(scale, 1, 1, (memory, np.int64(1), np.int8(1)))
        fake.wait()

    with one_device(fails={routine: status}):
        diagnostic = raised(use)
    assert diagnostic.code == ("E614" if action is None else "E617")
    assert getattr(diagnostic, "action", None) == action


def test_a_device_that_does_not_start() -> None:
    with one_device(fails={"clCreateContext": "DEVICE_NOT_AVAILABLE"}):
        diagnostic = raised(opencl_device)
    assert (diagnostic.code, diagnostic.action) == ("E617", "starting")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_process_is_told_that_it_cannot_use_the_device(device: Any) -> None:
    def child(answers: Any) -> None:
        answers.put(raised(device.allocate, 8).code)

    context = multiprocessing.get_context("fork")
    answers: Any = context.SimpleQueue()
    process = context.Process(target=child, args=(answers,))
    process.start()
    process.join(60)
    assert process.exitcode == 0
    assert answers.get() == "E617"
