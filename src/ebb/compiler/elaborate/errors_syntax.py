"""Python that kernels do not have, and statements that do nothing: E110 to E119."""

from __future__ import annotations

from typing import ClassVar

from ebb.compiler.elaborate.errors import KernelDiagnostic
from ebb.diagnostics.diagnostic import Diagnostic
from ebb.errors import EbbError, KernelSyntaxError
from ebb.records import record


@record
class RejectedSyntax(KernelDiagnostic):
    """A construct of Python that kernels do not have."""

    code: ClassVar[str] = "E110"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    construct: str
    alternative: str

    @property
    def title(self) -> str:
        return f"a kernel cannot contain {self.construct}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.alternative,)


@record
class UselessExpression(KernelDiagnostic):
    """A statement that is only an expression."""

    code: ClassVar[str] = "E111"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError

    @property
    def title(self) -> str:
        return "this expression does nothing: its value is dropped"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("a line that begins with an operator is a statement of its own, not a continuation of the line above",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("assign it, put parentheses around an expression of several lines, or remove it",)


@record
class TooDeep(Diagnostic):
    """Expressions or statements that are nested deeper than the compiler can follow."""

    code: ClassVar[str] = "E118"
    kernel: str

    @property
    def title(self) -> str:
        return f"kernel '{self.kernel}' is nested too deeply: Python's recursion limit was reached in compiling it"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("a sum of n terms is n - 1 operations inside one another",)

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            "compute parts of a long expression in statements of their own",
            "raise the limit before the first launch: sys.setrecursionlimit(10_000)",
        )


@record
class DroppedResult(KernelDiagnostic):
    """A call for its value whose value is not used."""

    code: ClassVar[str] = "E112"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    function: str

    @property
    def title(self) -> str:
        return f"the value of '{self.function}' is dropped"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("assign it, or remove the call",)


@record
class KernelReturnsValue(KernelDiagnostic):
    """``return value`` in a kernel."""

    code: ClassVar[str] = "E113"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    kernel: str

    @property
    def title(self) -> str:
        return f"kernel '{self.kernel}' returns a value"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("a kernel runs once a row and has no one to return a value to; a bare 'return' ends the row",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("store the value in a field, or reduce it into an ebb.Global",)


@record
class StringValue(KernelDiagnostic):
    """A string where a value is expected."""

    code: ClassVar[str] = "E114"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    text: str

    @property
    def title(self) -> str:
        return "a kernel has no strings as values"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("a string names a field, as in c['pos'], or is the text of 'print' or 'assert'",)


@record
class UnknownConstant(KernelDiagnostic):
    """``None``, ``...``, bytes or a complex number."""

    code: ClassVar[str] = "E115"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    text: str

    @property
    def title(self) -> str:
        return f"a kernel has no value {self.text}"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("values are bools, integers, floats, vectors and matrices of these, and keys",)


@record
class AssertText(KernelDiagnostic):
    """The message of an ``assert`` is no literal text."""

    code: ClassVar[str] = "E116"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError

    @property
    def title(self) -> str:
        return "the message of an 'assert' is text in quotes"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("print the values with print(f'...') before the assert",)


@record
class PrintForm(KernelDiagnostic):
    """Something in a ``print`` that cannot be printed."""

    code: ClassVar[str] = "E117"
    exception: ClassVar[type[EbbError]] = KernelSyntaxError
    what: str

    @property
    def title(self) -> str:
        return f"'print' in a kernel does not take {self.what}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("print text, values and f-strings: print('x =', x), print(f'{x:.3f}')",)
