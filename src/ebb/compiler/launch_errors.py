"""What can be wrong with the call that launches a kernel."""

from __future__ import annotations

import operator
from typing import Any, ClassVar

import numpy as np

from ebb.compiler.lir import MOST_THREADS
from ebb.diagnostics.diagnostic import Diagnostic
from ebb.diagnostics.nearest import nearest
from ebb.errors import KernelTypeError
from ebb.records import record
from ebb.relations.field import Field
from ebb.types.types import KeyType, Type


@record
class NotRows(Diagnostic):
    """The first argument of a launch is neither a relation nor a subset."""

    code: ClassVar[str] = "E260"
    kernel: str
    value: Any

    @property
    def title(self) -> str:
        return f"kernel '{self.kernel}' runs on a relation or a subset, not on {_shown(self.value)}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"launch it as {self.kernel}(relation, ...)",)


@record
class RowsMismatch(Diagnostic):
    """The rows of a launch are of another relation than the kernel is for."""

    code: ClassVar[str] = "E261"
    kernel: str
    expected: str
    given: str

    @property
    def title(self) -> str:
        return f"kernel '{self.kernel}' is for rows of '{self.expected}', and was launched on '{self.given}'"

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            f"launch it on '{self.expected}' or a subset of it",
            "leave the parameter without annotation to run the kernel on any relation that has the fields it uses",
        )


@record
class ArgumentCount(Diagnostic):
    """A launch has arguments that the kernel's signature does not take."""

    code: ClassVar[str] = "E262"
    kernel: str
    signature: str
    reason: str

    @property
    def title(self) -> str:
        return f"the arguments do not fit kernel '{self.kernel}': {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"its signature is {self.kernel}{self.signature}; the first argument is the rows to run on",)


@record
class ArgumentType(Diagnostic):
    """An argument of a launch is of another type than the parameter."""

    code: ClassVar[str] = "E263"
    kernel: str
    parameter: str
    value: Any
    expected: Type | str | None

    @property
    def title(self) -> str:
        return f"the parameter '{self.parameter}' of kernel '{self.kernel}' does not take {_shown(self.value)}"

    @property
    def notes(self) -> tuple[str, ...]:
        if isinstance(self.expected, KeyType):
            return (f"it is declared as {self.expected!r}, and keys are not passed: a kernel reads them from fields",)
        if self.expected is None:
            return ("a parameter is a number, a bool, a small NumPy array or the name of a field",)
        return (f"it is declared as {self.expected!r}" if not isinstance(self.expected, str) else self.expected,)

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"pass its name: '{self.value.name}'",) if isinstance(self.value, Field) else ()


@record
class UniformFailed(Diagnostic):
    """What a kernel captures has no value at this launch, or none that fits the type that the kernel uses it as."""

    code: ClassVar[str] = "E264"
    kernel: str
    expression: str
    reason: str

    @property
    def title(self) -> str:
        return f"'{self.expression}' in kernel '{self.kernel}' has no value for this launch: {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("captured numbers are read, and arithmetic among them done by Python, at each launch",)


@record
class UnknownStage(Diagnostic):
    """``kernel.inspect`` was asked for a stage that there is not."""

    code: ClassVar[str] = "E265"
    kernel: str
    stage: Any
    backend: str
    stages: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"kernel '{self.kernel}' has no stage {self.stage!r} on the backend '{self.backend}'"

    @property
    def hints(self) -> tuple[str, ...]:
        close = nearest(str(self.stage), self.stages)
        return (f"did you mean '{close}'?",) if close else (f"ask for one of {', '.join(self.stages)}",)


@record
class BadBlockSize(Diagnostic):
    """The rows of a work-group are no whole number in range."""

    code: ClassVar[str] = "E266"
    kernel: str
    value: Any

    @property
    def title(self) -> str:
        return f"block_size={self.value!r} is no size of a work-group for kernel '{self.kernel}'"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"block_size is a whole number from 1 to {MOST_THREADS}; on cpu and reference it changes nothing",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("leave it out, or choose a multiple of 32",)


@record
class CaptureChanged(Diagnostic):
    """A kernel that came from the cache has to be made, and would be another one now."""

    code: ClassVar[str] = "E267"
    kernel: str

    @property
    def title(self) -> str:
        return f"what kernel '{self.kernel}' captures has changed since the step was captured"

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            "its code came from the cache; to say more of it, the kernel has to be made anew, and is another one now",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return ("leave what it captures as it is while captured steps run, or capture the step anew",)


def checked_block_size(kernel: str, value: Any) -> int:
    """``value`` as the rows of a work-group.

    Raises:
        KernelTypeError: it is no whole number, or none that devices have so many threads for.
    """
    try:
        size = operator.index(value)
    except TypeError:
        size = 0
    if isinstance(value, bool | np.bool_) or not 1 <= size <= MOST_THREADS:
        raise KernelTypeError(BadBlockSize(kernel, value))
    return size


def _shown(value: Any) -> str:
    text = repr(value)
    text = text if len(text) <= 60 and "\n" not in text else "a value"
    return f"{text} ({type(value).__name__})"
