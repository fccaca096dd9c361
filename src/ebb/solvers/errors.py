"""What can be wrong about a linear system: the kinds of ``RelationError`` from E550 on."""

from __future__ import annotations

from typing import ClassVar

from ebb.diagnostics.diagnostic import Diagnostic
from ebb.records import record


@record
class UnfitSystem(Diagnostic):
    """What a solver is given makes no linear system."""

    code: ClassVar[str] = "E550"
    complaint: str
    found: str = ""

    @property
    def title(self) -> str:
        return f"no linear system: {self.complaint}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (self.found,) if self.found else ()


@record
class BadOption(Diagnostic):
    """A tolerance, a limit or the name of a preconditioner is none."""

    code: ClassVar[str] = "E551"
    option: str
    expected: str
    found: str

    @property
    def title(self) -> str:
        return f"{self.option} is {self.expected}, not {self.found}"
