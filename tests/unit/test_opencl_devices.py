"""Which OpenCL devices there are, which is taken, and how the runtimes of a machine are found."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ebb
from ebb.environment import describe_environment
from ebb.runtime import opencl, opencl_runtime
from ebb.runtime.device import Feature
from ebb.runtime.opencl import describe_devices, opencl_device
from fake_opencl import CPU, GPU, Device, Platform, imported, machine, module, without_pyopencl


def raised(action: Any, *arguments: Any) -> Any:
    """The diagnostic with which ``action`` fails."""
    with pytest.raises(ebb.BackendError) as caught:
        action(*arguments)
    return caught.value.diagnostics[0]


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
        "share 64 KiB; lacks ebb.float64, atomic operations on 64-bit integers, atomic addition of ebb.float64"
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
