"""Names, captured values, attributes and places: E120 to E133."""

from __future__ import annotations

from typing import ClassVar

from ebb.compiler.elaborate.errors import KernelDiagnostic
from ebb.diagnostics.diagnostic import Label
from ebb.diagnostics.nearest import nearest
from ebb.diagnostics.span import Span
from ebb.records import record


def did_you_mean(name: str, known: tuple[str, ...]) -> tuple[str, ...]:
    """A hint that names the known name most like ``name``, or none."""
    close = nearest(name, known)
    return (f"did you mean '{close}'?",) if close else ()


@record
class UndefinedName(KernelDiagnostic):
    """A name that is nowhere defined."""

    code: ClassVar[str] = "E120"
    name: str
    known: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"name '{self.name}' is not defined"

    @property
    def hints(self) -> tuple[str, ...]:
        return did_you_mean(self.name, self.known)


@record
class MaybeUnset(KernelDiagnostic):
    """A local that has no value on some way to where it is read."""

    code: ClassVar[str] = "E121"
    name: str
    assigned: Span | None
    reason: str = "some way to this place does not assign it"

    @property
    def title(self) -> str:
        return f"'{self.name}' may be unset here"

    @property
    def label(self) -> str:
        return self.reason

    @property
    def secondary(self) -> tuple[Label, ...]:
        return () if self.assigned is None else (Label(self.assigned, "assigned here"),)

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"assign '{self.name}' on every way: give it a first value before the branch or loop",)


@record
class ReadBeforeAssignment(KernelDiagnostic):
    """A local that is read before any assignment to it."""

    code: ClassVar[str] = "E122"
    name: str
    assigned: Span | None
    shadowed: str | None

    @property
    def title(self) -> str:
        return f"'{self.name}' is read before it is assigned"

    @property
    def secondary(self) -> tuple[Label, ...]:
        return () if self.assigned is None else (Label(self.assigned, "this makes it a local of the whole function"),)

    @property
    def notes(self) -> tuple[str, ...]:
        if self.shadowed is None:
            return ()
        return (f"as in Python, the local '{self.name}' hides {self.shadowed} of that name in the whole function",)

    @property
    def hints(self) -> tuple[str, ...]:
        if self.shadowed is None:
            return (f"assign '{self.name}' first",)
        return ("give the local another name",)


@record
class CapturedAssigned(KernelDiagnostic):
    """An assignment to a name that the kernel captures."""

    code: ClassVar[str] = "E123"
    name: str
    what: str
    advice: str

    @property
    def title(self) -> str:
        return f"a captured name cannot be assigned: '{self.name}' is {self.what}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.advice,)


@record
class NotAssignable(KernelDiagnostic):
    """Something that is no place stands on the left of an assignment."""

    code: ClassVar[str] = "E124"
    what: str
    advice: str

    @property
    def title(self) -> str:
        return f"{self.what} cannot be assigned in a kernel"

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.advice,)


@record
class NoMeaning(KernelDiagnostic):
    """A Python object that means nothing in a kernel, or not where it stands."""

    code: ClassVar[str] = "E125"
    name: str
    what: str
    advice: str

    @property
    def title(self) -> str:
        return f"'{self.name}' is {self.what}, which is no value in a kernel"

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.advice,)


@record
class CaptureFailed(KernelDiagnostic):
    """Evaluating a captured expression raises."""

    code: ClassVar[str] = "E126"
    expression: str
    reason: str

    @property
    def title(self) -> str:
        return f"'{self.expression}' cannot be evaluated"

    @property
    def label(self) -> str:
        return self.reason

    @property
    def notes(self) -> tuple[str, ...]:
        return ("arithmetic among Python numbers is done by Python, when the kernel is launched",)


@record
class UnknownAttribute(KernelDiagnostic):
    """A key, a vector or a captured object has no such attribute."""

    code: ClassVar[str] = "E127"
    owner: str
    name: str
    known: tuple[str, ...]
    advice: str | None = None

    @property
    def title(self) -> str:
        return f"{self.owner} has no '{self.name}'"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"it has {', '.join(self.known)}",) if 0 < len(self.known) <= 12 else ()

    @property
    def hints(self) -> tuple[str, ...]:
        close = did_you_mean(self.name, self.known)
        return close if close or self.advice is None else (self.advice,)


@record
class UnknownFunction(KernelDiagnostic):
    """A call of something that kernels cannot call."""

    code: ClassVar[str] = "E128"
    name: str
    what: str
    advice: str

    @property
    def title(self) -> str:
        return f"a kernel cannot call '{self.name}', {self.what}"

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.advice,)


@record
class Recursion(KernelDiagnostic):
    """A function that, in the end, calls itself."""

    code: ClassVar[str] = "E129"
    cycle: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"recursion: {' -> '.join(self.cycle)}"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("functions and members are inlined where they are used, so none may lead back to itself",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("write it as a loop",)


@record
class CompileTimeOnly(KernelDiagnostic):
    """A local that would hold something that is no value, and is assigned more than once."""

    code: ClassVar[str] = "E130"
    name: str
    what: str

    @property
    def title(self) -> str:
        return f"the local '{self.name}' cannot hold {self.what} and be assigned more than once"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("queries and captured objects are known when the kernel is compiled; locals that change hold values",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("give each of them a name of its own",)
