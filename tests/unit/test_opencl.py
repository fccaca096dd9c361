"""OpenCL devices: which there are and which is taken, memory, queue and code of a real one, and how they fail."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import pytest

import ebb
from ebb.backends.llvm.spirv_code import spirv_binary
from ebb.environment import describe_environment
from ebb.runtime import opencl, opencl_runtime
from ebb.runtime.device import Feature
from ebb.runtime.opencl import describe_devices, opencl_device
from fake_opencl import CPU, GPU, Device, Platform, imported, machine, module, one_device, without_pyopencl

if not opencl_runtime.HAS_WHEEL:
    try:
        opencl_device()
    except ebb.BackendError as missing:
        pytest.skip(str(missing), allow_module_level=True)

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


# ---- Which device ----

ARC = Device("Intel(R) Arc(TM) A770", extensions="", atomic_floats=(2, 0))
XEON = Device("Intel(R) Xeon(R)", type=CPU)
TESLA = Device("Tesla", il_version="")
BOARD = Device("FPGA board", type=8)


@pytest.fixture
def four() -> Iterator[None]:
    with machine(Platform("NVIDIA CUDA", TESLA), Platform("Intel(R) OpenCL", XEON, ARC), Platform("Boards", BOARD)):
        yield


@pytest.mark.usefixtures("four")
@pytest.mark.parametrize(
    ("choice", "name"),
    [
        (None, ARC.name),  # a GPU, but the first takes no SPIR-V
        (1, XEON.name),
        ("1", XEON.name),
        (np.int64(3), BOARD.name),
        ("xeon", XEON.name),
        (" ARC ", ARC.name),
        ("boards", BOARD.name),
        ("Intel(R) Xeon(R)", XEON.name),
    ],
)
def test_a_device_is_chosen_by_number_or_name(choice: Any, name: str) -> None:
    assert opencl_device(choice).name == name


@pytest.mark.usefixtures("four")
def test_the_environment_chooses_where_the_program_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EBB_OPENCL_DEVICE", "xeon")
    assert opencl_device().name == XEON.name
    assert opencl_device("board").name == BOARD.name
    monkeypatch.setenv("EBB_OPENCL_DEVICE", "2")
    assert opencl_device().name == ARC.name
    monkeypatch.setenv("EBB_OPENCL_DEVICE", "4")
    assert raised(opencl_device).title == "EBB_OPENCL_DEVICE='4' names no device: there are devices 0 to 3"


@pytest.mark.usefixtures("four")
@pytest.mark.parametrize(
    ("choice", "code", "words"),
    [
        (4, "E612", "devices 0 to 3"),
        (-1, "E612", "devices 0 to 3"),
        (True, "E612", "devices 0 to 3"),
        (1.5, "E612", "neither a number"),
        ("radeon", "E612", "no name has that in it"),
        ("intel", "E612", "2 devices have that"),
        ("tesla", "E613", "lacks SPIR-V"),
    ],
)
def test_a_choice_that_does_not_fit(choice: Any, code: str, words: str) -> None:
    diagnostic = raised(opencl_device, choice)
    assert diagnostic.code == code
    assert words in diagnostic.title


@pytest.mark.usefixtures("four")
def test_several_names_that_fit_are_listed() -> None:
    notes = raised(opencl_device, "intel").notes
    assert [note.split(" (")[0] for note in notes] == ["1: Intel(R) Xeon(R)", "2: Intel(R) Arc(TM) A770"]


@pytest.mark.usefixtures("four")
def test_a_device_is_opened_once() -> None:
    assert opencl_device("arc") is opencl_device(2)


@pytest.mark.usefixtures("four")
def test_what_devices_lack() -> None:
    tesla, xeon, arc, _ = opencl.find_devices()
    assert tesla.missing == ("SPIR-V",)
    assert xeon.lacks == frozenset()
    assert arc.lacks == set(Feature) - {Feature.FLOAT32_ADD}
    assert str(tesla).endswith("; lacks SPIR-V")
    assert "GPU" in str(arc)


def test_a_device_that_answers_no_question_about_spirv() -> None:
    class Old(Device):
        @property
        def il_version(self) -> str:
            raise module().Error("clGetDeviceInfo", "INVALID_VALUE")

        @il_version.setter
        def il_version(self, value: str) -> None: ...

    with machine(Platform("Old", Old("Old GPU"))):
        assert opencl.find_devices()[0].missing == ("SPIR-V",)
        assert raised(opencl_device).title.endswith("none takes SPIR-V with 64-bit addresses")


def test_platforms_without_devices_are_listed() -> None:
    with machine(Platform("Idle"), Platform("Busy", Device("GPU", type=GPU))):
        assert opencl_device().name == "GPU"
        assert describe_devices()[1] == "none of the platform Idle"
    with machine(Platform("Idle")):
        assert raised(opencl_device).title.endswith("no OpenCL platform has a device")


@pytest.mark.usefixtures("four")
def test_info_lists_devices_and_what_they_lack() -> None:
    devices = [value for name, value in describe_environment() if name == "opencl device"]
    assert [device.split(":")[0] for device in devices] == ["0", "1", "2", "3"]
    assert devices[2] == (
        "2: Intel(R) Arc(TM) A770 (Intel(R) OpenCL, driver 1.0), GPU, 1.0 GiB, work-groups of up to 256 threads that "
        "share 64 KiB; lacks ebb.float64, atomic operations on 64-bit integers, atomic minima of ebb.float32, "
        "atomic addition of ebb.float64, atomic minima of ebb.float64"
    )


def test_info_without_pyopencl() -> None:
    with without_pyopencl():
        rows = describe_environment()
    assert "opencl device" not in dict(rows)
    assert dict(rows)["backend opencl"].startswith("not available: the backend 'opencl' needs the package 'pyopencl'")


def test_this_machine_has_a_device_that_lacks_nothing() -> None:
    if not opencl_runtime.HAS_WHEEL:
        pytest.skip("there is no wheel with a runtime for this machine")
    device = opencl_device("Intel(R) OpenCL")
    assert device.lacks == frozenset()
    assert device.candidate.spirv >= (1, 4)
    assert any(device.name in line and "lacks nothing" in line for line in describe_devices())


def test_pyopencl_that_cannot_be_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pyopencl.py").write_text("raise ImportError('libOpenCL.so.1: cannot open shared object file')")
    monkeypatch.syspath_prepend(tmp_path)
    with imported(None):
        del sys.modules["pyopencl"]
        diagnostic = raised(opencl_runtime.platforms.__wrapped__)
    assert (diagnostic.code, diagnostic.reason) == ("E610", "libOpenCL.so.1: cannot open shared object file")


# ---- Runtimes: each of these in a process of its own, since a process looks for them once ----

LIST = """
import os, sys
from ebb.errors import BackendError
from ebb.runtime import opencl, opencl_runtime
{before}
try:
    for platform in opencl_runtime.platforms():
        print(platform.name)
    opencl.opencl_device()
except BackendError as error:
    print(error.diagnostics[0].title, *error.diagnostics[0].notes, sep=chr(10))
print("environment", os.environ.get("OCL_ICD_VENDORS"))
"""
WITHOUT_WHEEL = "opencl_runtime.files = lambda name: None"

needs_wheel = pytest.mark.skipif(opencl_runtime.wheel() is None, reason="the runtime of the wheel is not installed")


def listed(before: str = "", **environment: str) -> list[str]:
    """The platforms of a process, then what ``OCL_ICD_VENDORS`` is to those that it starts."""
    inherited = {
        name: value for name, value in os.environ.items() if name not in ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH")
    }
    result = subprocess.run(
        [sys.executable, "-c", LIST.format(before=before)],
        capture_output=True,
        text=True,
        check=True,
        env={**inherited, **environment},
    )
    return result.stdout.splitlines()


def vendors(folder: Path, *drivers: object) -> str:
    """A folder of ``.icd`` files."""
    folder.mkdir(exist_ok=True)
    for number, driver in enumerate(drivers):
        (folder / f"{number}.icd").write_text(f"{driver}\n")
    return str(folder)


@needs_wheel
def test_the_runtime_of_the_wheel_is_found() -> None:
    platform, *_, environment = listed()
    assert (platform, environment) == ("Intel(R) OpenCL", "environment None")


@needs_wheel
def test_a_runtime_that_is_named_twice_is_listed_once(tmp_path: Path) -> None:
    folder = vendors(tmp_path, opencl_runtime.wheel().driver)
    assert listed(OCL_ICD_VENDORS=folder) == ["Intel(R) OpenCL", f"environment {folder}"]


@needs_wheel
@pytest.mark.parametrize("form", ["folder", "file", "driver", "path"])
def test_what_the_user_has_set_is_offered_too(tmp_path: Path, form: str) -> None:
    """As a folder, a file, a driver, or in the older variable. The wheel is another driver here, which is not there."""
    driver = opencl_runtime.wheel().driver
    folder = vendors(tmp_path / "vendors", driver)
    setting = {"folder": folder, "file": f"{folder}/0.icd", "driver": str(driver), "path": folder}[form]
    name = "OPENCL_VENDOR_PATH" if form == "path" else "OCL_ICD_VENDORS"
    before = f"opencl_runtime.wheel = lambda: opencl_runtime.Wheel({str(tmp_path / 'libnone.so')!r}, None)"
    assert "Intel(R) OpenCL" in listed(before, **{name: setting})


@needs_wheel
def test_a_runtime_of_the_system_is_enough(tmp_path: Path) -> None:
    folder = vendors(tmp_path, opencl_runtime.wheel().driver)
    assert listed(WITHOUT_WHEEL, OCL_ICD_VENDORS=folder) == ["Intel(R) OpenCL", f"environment {folder}"]


@needs_wheel
def test_without_the_wheel_and_without_another_runtime_there_is_none(tmp_path: Path) -> None:
    title, *_ = listed(WITHOUT_WHEEL, OCL_ICD_VENDORS=vendors(tmp_path))
    assert title == "the backend 'opencl' has no device to run on: no OpenCL platform is installed"


@needs_wheel
def test_a_wheel_without_what_it_links_to_says_so(tmp_path: Path) -> None:
    """The driver alone, as where a wheel is missing."""
    copied = tmp_path / "libintelocl.so"
    copied.symlink_to(opencl_runtime.wheel().driver)
    before = f"""
from pathlib import Path
opencl_runtime._libraries = lambda: {{"libintelocl": Path({str(copied)!r})}}
"""
    title, fault, _ = listed(before, OCL_ICD_VENDORS=vendors(tmp_path / "none"))
    assert title == "the backend 'opencl' has no device to run on: no OpenCL platform is installed"
    assert "cannot open shared object file" in fault


@needs_wheel
def test_the_folder_for_the_loader_is_gone(tmp_path: Path) -> None:
    assert "Intel(R) OpenCL" in listed(TMPDIR=str(tmp_path))
    assert list(tmp_path.glob("ebb-opencl-*")) == []


def test_drivers_named_by_files_of_the_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "vendors"
    vendors(folder, "libfirst.so", "/opt/second.so\nignored", "")
    (folder / "3.icd").write_bytes(b"\xff\xfe")
    (folder / "notes.txt").write_text("libthird.so")
    monkeypatch.setattr(opencl_runtime, "_STANDARD_VENDORS", (str(folder), str(tmp_path / "none")))
    monkeypatch.delenv("OPENCL_VENDOR_PATH", raising=False)
    assert opencl_runtime._vendors(None) == ["libfirst.so", "/opt/second.so"]
    assert opencl_runtime._vendors("1.icd") == ["/opt/second.so"]
    assert opencl_runtime._vendors(str(folder / "none.icd")) == []
    assert opencl_runtime._vendors("libown.so") == ["libown.so"]


def test_ebb_does_not_load_opencl_unless_it_is_asked_to() -> None:
    code = "import sys, ebb; print([name for name in sys.modules if 'opencl' in name])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout == "[]\n"
