"""What can be wrong with particles: the kinds of ``RelationError`` from E540 on."""

from __future__ import annotations

from typing import ClassVar

from ebb.diagnostics.diagnostic import Diagnostic
from ebb.records import record


@record
class BadParticles(Diagnostic):
    """An argument that particles are made from is of the wrong shape or kind."""

    code: ClassVar[str] = "E540"
    argument: str
    expected: str
    found: str

    @property
    def title(self) -> str:
        return f"Particles takes {self.expected} as {self.argument}, not {self.found}"


@record
class NowherePlaced(Diagnostic):
    """A particle would have a coordinate that is not finite."""

    code: ClassVar[str] = "E541"
    row: int
    position: tuple[float, ...]
    dtype: str

    @property
    def title(self) -> str:
        at = ", ".join(f"{value:g}" for value in self.position)
        return f"particle {self.row} lies nowhere: ({at}) is not finite in {self.dtype}"


@record
class CannotCouple(Diagnostic):
    """Particles are to be coupled with what has no cells for them."""

    code: ClassVar[str] = "E542"
    complaint: str
    advice: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        return f"the particles cannot be coupled: {self.complaint}"

    @property
    def hints(self) -> tuple[str, ...]:
        return self.advice
