"""What can be wrong with devices beside the processor, and with what they are given."""

from __future__ import annotations

from typing import Any, ClassVar

from ebb.diagnostics.diagnostic import Diagnostic
from ebb.records import record


@record
class MissingPackage(Diagnostic):
    """A backend needs a package of an extra that is not installed, or cannot be imported."""

    code: ClassVar[str] = "E610"
    backend: str
    package: str
    extra: str
    reason: str

    @property
    def title(self) -> str:
        return f"the backend '{self.backend}' needs the package '{self.package}': {self.reason}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (f'pip install "ebblang[{self.extra}]"', 'run without a device: ebb.set_backend("cpu")')


@record
class NoDevice(Diagnostic):
    """There is no device that a backend could use. ``found`` is what there is instead, a line each."""

    code: ClassVar[str] = "E611"
    backend: str
    reason: str
    found: tuple[str, ...]
    remedies: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"the backend '{self.backend}' has no device to run on: {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return self.found

    @property
    def hints(self) -> tuple[str, ...]:
        return (*self.remedies, 'run without a device: ebb.set_backend("cpu")')


@record
class UnknownDevice(Diagnostic):
    """A choice of a device that fits none or several. ``devices`` are those there are, a line each."""

    code: ClassVar[str] = "E612"
    source: str
    choice: Any
    reason: str
    devices: tuple[str, ...]
    example: str

    @property
    def title(self) -> str:
        return f"{self.source}={self.choice!r} names no device: {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return self.devices

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.example, "list the devices: ebb info")


def numbers_there(count: int) -> str:
    """Which numbers name one of ``count`` devices."""
    return "there is only device 0" if count == 1 else f"there are devices 0 to {count - 1}"


@record
class DeviceLacks(Diagnostic):
    """A device lacks what all kernels need (``kernel`` is None), or what one does."""

    code: ClassVar[str] = "E613"
    device: str
    kernel: str | None
    features: tuple[str, ...]
    remedies: tuple[str, ...]

    @property
    def title(self) -> str:
        who = "every kernel" if self.kernel is None else f"kernel '{self.kernel}'"
        return f"the device '{self.device}' lacks {' and '.join(self.features)}, which {who} needs"

    @property
    def hints(self) -> tuple[str, ...]:
        return self.remedies


@record
class OutOfDeviceMemory(Diagnostic):
    """A device has not as much memory as is asked for. ``most`` is what one block may have."""

    code: ClassVar[str] = "E614"
    device: str
    asked: int
    taken: int
    total: int
    most: int

    @property
    def title(self) -> str:
        return f"the device '{self.device}' has no {self.asked:,} bytes left"

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            f"it has {self.total:,} bytes, of which this process has taken {self.taken:,}; "
            f"one field may have {self.most:,}",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            "see what takes it: print(ebb.memory())",
            "keep numbers in ebb.float32, or delete relations that are needed no more",
            'run where there is more memory: ebb.set_backend("cpu")',
        )


@record
class LaunchTooLarge(Diagnostic):
    """A launch is beyond a limit of its device."""

    code: ClassVar[str] = "E615"
    device: str
    kernel: str
    what: str
    asked: int
    most: int
    remedy: str

    @property
    def title(self) -> str:
        return (
            f"kernel '{self.kernel}' cannot run on the device '{self.device}': "
            f"it takes {self.asked:,} {self.what}, and there may be {self.most:,}"
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.remedy,)


@record
class CodeRefused(Diagnostic):
    """A device, or the compiler in its driver, does not take the code of a kernel."""

    code: ClassVar[str] = "E616"
    device: str
    kernel: str
    log: str

    @property
    def title(self) -> str:
        return f"the device '{self.device}' does not take the code of kernel '{self.kernel}'"

    @property
    def notes(self) -> tuple[str, ...]:
        return tuple(f"its compiler says: {line}" for line in self.log.splitlines() if line.strip())

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            "update the driver of the device; if that does not help, report it with the output of ebb info",
            'run on the processor: ebb.set_backend("cpu")',
        )


@record
class DeviceFailed(Diagnostic):
    """A device failed at something that it should be able to do, or has been lost."""

    code: ClassVar[str] = "E617"
    device: str
    action: str
    reason: str
    remedies: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"the device '{self.device}' failed at {self.action}: {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("what kernels have written there and nobody has read since is lost",)

    @property
    def hints(self) -> tuple[str, ...]:
        return self.remedies or ("start the program again; if that does not help, update the driver of the device",)


def forked(device: str) -> DeviceFailed:
    """What is wrong with a device that the process has from the one that it was forked from."""
    reason = "it was opened by the process from which this one was forked, and does not work here"
    return DeviceFailed(
        device, "being used", reason, ('start processes afresh: multiprocessing.set_start_method("spawn")',)
    )


@record
class NoLibdevice(Diagnostic):
    """A kernel calls functions that are NVIDIA's library for GPUs, which is not installed."""

    code: ClassVar[str] = "E618"
    functions: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"the code of {' and '.join(self.functions)} for NVIDIA's GPUs is not installed"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("it is a library of NVIDIA's, libdevice.10.bc, which kernels need that call such functions",)

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            'pip install "ebblang[cuda]"',
            "or name the folder of a CUDA toolkit: export CUDA_HOME=/usr/local/cuda",
        )


@record
class NoSuchView(Diagnostic):
    """A view of a field's memory on a device, while kernels run elsewhere. ``current`` is what they run on."""

    code: ClassVar[str] = "E619"
    function: str
    field: str
    backend: str
    current: str

    @property
    def title(self) -> str:
        return f"{self.function}({self.field}) is for the backend '{self.backend}', and kernels run on '{self.current}'"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("such a view is the memory that kernels work on",)

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            f'choose the backend before: ebb.set_backend("{self.backend}")',
            f"or take the memory of the host: {self.field}.view()",
        )
