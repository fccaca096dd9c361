"""What can be wrong with backends, their options and the tools they need."""

from __future__ import annotations

from typing import Any, ClassVar

from ebb.diagnostics.diagnostic import Diagnostic
from ebb.diagnostics.nearest import nearest
from ebb.records import record

_GPU = ("gpu", "device", "nvidia", "intel", "amd")
"""What people call the backends for devices."""


@record
class UnknownBackend(Diagnostic):
    """There is no backend of that name."""

    code: ClassVar[str] = "E601"
    name: str
    known: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"there is no backend '{self.name}'"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"there are {', '.join(self.known)}",)

    @property
    def hints(self) -> tuple[str, ...]:
        if self.name.casefold() in _GPU:
            return ('for NVIDIA\'s: ebb.set_backend("cuda")', 'for others: ebb.set_backend("opencl")')
        close = nearest(self.name.lower(), self.known)
        return (f"did you mean '{close}'?",) if close else (f'choose one: ebb.set_backend("{self.known[0]}")',)


@record
class UnknownBackendOption(Diagnostic):
    """A backend does not take an option."""

    code: ClassVar[str] = "E602"
    backend: str
    option: str
    accepted: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"the backend '{self.backend}' has no option '{self.option}'"

    @property
    def notes(self) -> tuple[str, ...]:
        if not self.accepted:
            return ("it has no options",)
        return (f"its options are {', '.join(self.accepted)}",)

    @property
    def hints(self) -> tuple[str, ...]:
        close = nearest(self.option, self.accepted)
        return (f"did you mean '{close}'?",) if close else ("leave it out",)


@record
class BadThreadCount(Diagnostic):
    """The number of threads is no whole number from 1 on."""

    code: ClassVar[str] = "E603"
    source: str
    value: Any
    most: int

    @property
    def title(self) -> str:
        return f"{self.source} is {self.value!r}, which is no number of threads"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"a number of threads is a whole number from 1 to {self.most}",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("leave it out to use all cores",)


@record
class NoMachineCode(Diagnostic):
    """LLVM cannot generate code for this machine."""

    code: ClassVar[str] = "E604"
    machine: str
    reason: str

    @property
    def title(self) -> str:
        return f"LLVM cannot compile for this machine, {self.machine}: {self.reason}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            "install an llvmlite for this machine: pip install --upgrade llvmlite",
            'run without compiling: ebb.set_backend("reference")',
        )


@record
class VariablesTooLarge(Diagnostic):
    """The variables of a kernel are too large for the stack of a thread."""

    code: ClassVar[str] = "E605"
    kernel: str
    size: int
    most: int

    @property
    def title(self) -> str:
        return (
            f"the variables of kernel '{self.kernel}' take {self.size} bytes a row, more than the {self.most} there are"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        return ("vectors and matrices in kernels are small: each row has its own, on the stack of a thread",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("keep long arrays in a relation of their own, one row an entry",)


@record
class BadSwitch(Diagnostic):
    """An option of a backend that is neither True nor False."""

    code: ClassVar[str] = "E606"
    backend: str
    option: str
    value: Any

    @property
    def title(self) -> str:
        return f"the option {self.option}={self.value!r} of the backend '{self.backend}' is neither True nor False"

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"write {self.option}=True or {self.option}=False, or leave it out",)


@record
class HostStepInCapture(Diagnostic):
    """Something inside ``with ebb.capture()`` that cannot be recorded."""

    code: ClassVar[str] = "E607"
    action: str
    instead: str

    @property
    def title(self) -> str:
        return f"{self.action} cannot be captured"

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            "inside 'with ebb.capture()' nothing runs: launches, swaps and sets of globals are recorded, and run "
            "later without Python in between",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.instead,)


@record
class BadRepeatCount(Diagnostic):
    """How often a captured step shall run is no whole number from 0 on."""

    code: ClassVar[str] = "E608"
    value: Any

    @property
    def title(self) -> str:
        return f"a captured step cannot run {self.value!r} times"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("step.run(n) takes a whole number from 0 on",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("leave it out to run the step once",)


@record
class IndexInCapture(Diagnostic):
    """A captured step changes keys by which one of its launches looks rows up. ``change`` is what changes them."""

    code: ClassVar[str] = "E609"
    change: str
    field: str
    kernel: str

    @property
    def title(self) -> str:
        return f"{self.change} changes {self.field}, by which kernel '{self.kernel}' of the same step looks rows up"

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            f"when {self.field} has changed, Python builds the index of its rows anew before the next query; "
            "a captured step runs without Python in between",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return ("capture them as two steps and run one after the other, or launch them as they are",)
