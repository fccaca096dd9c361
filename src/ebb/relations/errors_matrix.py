"""What can be wrong about fields that are to be a sparse matrix: E552 and E553."""

from __future__ import annotations

from typing import ClassVar

from ebb.diagnostics.diagnostic import Diagnostic
from ebb.records import record


@record
class NoMatrix(Diagnostic):
    """A field, with the keys that are to say where its values stand, is no matrix by rows."""

    code: ClassVar[str] = "E552"
    field: str
    complaint: str
    advice: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        return f"'{self.field}' is no sparse matrix: {self.complaint}"

    @property
    def hints(self) -> tuple[str, ...]:
        return self.advice


@record
class MissingSciPy(Diagnostic):
    """A SciPy matrix is wanted, and SciPy is not installed. Raised as a ``BackendError``."""

    code: ClassVar[str] = "E553"
    function: str

    @property
    def title(self) -> str:
        return f"'{self.function}' needs the package scipy, which is not installed"

    @property
    def hints(self) -> tuple[str, ...]:
        return ('pip install "ebblang[mesh]"',)
