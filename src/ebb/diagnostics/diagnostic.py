"""What an error says, as a value: one record a kind, facts in, text computed."""

from __future__ import annotations

from typing import ClassVar

from ebb.diagnostics.span import Span
from ebb.records import record


@record
class Label:
    """A stretch of source and what to know about it, printed under it."""

    span: Span
    text: str


@record
class Diagnostic:
    """The base of all kinds of error. A kind sets ``code``, stores facts and computes its texts from them.

    ``title`` is one sentence without a full stop; ``primary`` is the cause and gets the caret; ``secondary`` is what
    it conflicts with; notes are facts, hints are commands.
    """

    code: ClassVar[str]

    @property
    def title(self) -> str:
        """One sentence without a full stop: what is wrong."""
        raise NotImplementedError(f"{type(self).__name__} has no title")

    @property
    def primary(self) -> Label | None:
        """The cause, which gets the caret; None where it has no place in a program."""
        return None

    @property
    def secondary(self) -> tuple[Label, ...]:
        """What the cause conflicts with."""
        return ()

    @property
    def location(self) -> tuple[str, int | None] | None:
        """A file, and the line where known, of a cause in a file that is no program (a mesh); spans go before it."""
        return None

    @property
    def notes(self) -> tuple[str, ...]:
        """Facts that explain the error."""
        return ()

    @property
    def hints(self) -> tuple[str, ...]:
        """What to do, as commands."""
        return ()
