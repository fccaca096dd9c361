"""Where in the user's source a thing stands."""

from __future__ import annotations

from functools import lru_cache

from ebb.records import field, record


@record(eq=False)
class Source:
    """The text of one file, notebook cell or string, as the user wrote it."""

    filename: str
    text: str

    def line(self, number: int) -> str:
        """The line of that number, counted from 1, without its end; empty where there is none."""
        lines = _lines(self.text)
        return lines[number - 1] if 0 < number <= len(lines) else ""


@lru_cache(maxsize=64)
def _lines(text: str) -> list[str]:
    # Only what ends a line for Python: str.splitlines would also split at form feeds and Unicode separators.
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


@record
class Span:
    """A stretch of source. Lines count from 1, columns from 0, both in characters, the end exclusive.

    ``caller`` is the place of the call by which this code was inlined into a kernel, None in the kernel itself.
    """

    source: Source = field(repr=False)
    line: int
    column: int
    end_line: int
    end_column: int
    caller: Span | None = field(default=None, repr=False)

    @property
    def text(self) -> str:
        """The source that the span covers, up to the end of its first line."""
        line = self.source.line(self.line)
        return line[self.column : self.end_column if self.end_line == self.line else len(line)]

    def __str__(self) -> str:
        return f"{self.source.filename}:{self.line}"
