"""The base of the elaborator's errors, and what can be wrong before a kernel's body is read: E101 to E108."""

from __future__ import annotations

import inspect
from typing import Any, ClassVar

from ebb.diagnostics.diagnostic import Diagnostic, Label
from ebb.diagnostics.span import Span
from ebb.errors import EbbError, KernelSyntaxError, KernelTypeError
from ebb.records import record


@record
class KernelDiagnostic(Diagnostic):
    """An error at a place of a kernel. ``exception`` is what it is raised as when it is the first of a kernel."""

    exception: ClassVar[type[EbbError]] = KernelTypeError
    span: Span

    @property
    def label(self) -> str:
        """The text beside the caret."""
        return ""

    @property
    def primary(self) -> Label | None:
        return Label(self.span, self.label)


@record
class SourceNotFound(Diagnostic):
    """Python keeps no source of a function."""

    code: ClassVar[str] = "E101"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    name: str
    filename: str

    @property
    def title(self) -> str:
        return f"the source of '{self.name}' cannot be found: Python keeps none for '{self.filename}'"

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            "a kernel is compiled from its source; code run by 'exec', 'python -c' or a pipe has none that is kept",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            "define it in a file or a notebook cell",
            "or give the text that defines it: @ebb.kernel(source=text), @ebb.func(source=text)",
        )


@record
class NotAFunction(Diagnostic):
    """A decorator was given something that is no function written with ``def``."""

    code: ClassVar[str] = "E102"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    value: Any

    @property
    def title(self) -> str:
        return f"a kernel, func or member is a function written with 'def', not {self._what()}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("write it as 'def name(row): ...' and decorate that",)

    def _what(self) -> str:
        if getattr(self.value, "__name__", "") == "<lambda>":
            return "a lambda"
        if inspect.iscoroutinefunction(self.value):
            return "an 'async def'"
        return f"a {type(self.value).__name__}"


@record
class SourceChanged(Diagnostic):
    """The source that Python keeps does not hold the function where Python says that it is."""

    code: ClassVar[str] = "E103"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    name: str
    filename: str
    line: int
    reason: str

    @property
    def title(self) -> str:
        return f"the source of '{self.name}' is not the function that runs: {self.reason}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"Python says that '{self.name}' begins at line {self.line} of '{self.filename}'",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("restart Python if the file was edited after it was imported",)


@record
class UnresolvedAnnotation(KernelDiagnostic):
    """An annotation that is kept as text cannot be evaluated."""

    code: ClassVar[str] = "E104"
    function: str
    parameter: str
    reason: str

    @property
    def title(self) -> str:
        return f"the annotation of '{self.parameter}' in '{self.function}' cannot be evaluated"

    @property
    def label(self) -> str:
        return self.reason

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            "an annotation that Python keeps as text is looked up where the decorator stands and among the globals",
        )


@record
class BadAnnotation(KernelDiagnostic):
    """An annotation is not what may stand there."""

    code: ClassVar[str] = "E105"
    parameter: str
    value: str
    expected: str

    @property
    def title(self) -> str:
        return f"the annotation of '{self.parameter}' is {self.expected}"

    @property
    def label(self) -> str:
        return f"this is {self.value}"

    @property
    def hints(self) -> tuple[str, ...]:
        instead = _EBB_TYPES.get(self.value, "one of these")
        return (f"annotate with {instead}, or leave the parameter bare: it is then typed by what it gets",)


_EBB_TYPES = {
    "<class 'bool'>": "ebb.bool_",
    "<class 'int'>": "ebb.int32 or ebb.int64",
    "<class 'float'>": "ebb.float32 or ebb.float64",
}


@record
class NoRowParameter(KernelDiagnostic):
    """A kernel without parameters."""

    code: ClassVar[str] = "E106"
    name: str

    @property
    def title(self) -> str:
        return f"kernel '{self.name}' has no parameter for its row"

    @property
    def label(self) -> str:
        return "runs once a row, and has no name for it"

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"def {self.name}(row: relation): ...",)
