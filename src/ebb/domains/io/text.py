"""Lines of a text file with their numbers, and blocks of numbers read from them."""

from __future__ import annotations

import re
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np

from ebb.diagnostics.span import Source, Span
from ebb.domains.io.data import Floats, Integers, Ragged, line_span
from ebb.domains.io.errors import MalformedLine, TruncatedFile, UnreadableFile
from ebb.errors import MeshFormatError

# At most 18 digits, which int64 holds whatever they are.
_INTEGER = re.compile("[+-]?[0-9]{1,18}")


class Lines:
    """A cursor over the lines of a file that hold something: comments (``#``) and blank lines are left out.

    Raises:
        MeshFormatError: the file cannot be read (E701).
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self.source = Source(str(path), _read(path))
        self.texts: list[str] = []
        self.numbers: list[int] = []
        # Not by str.splitlines: an editor does not count form feeds and Unicode separators as ends of lines.
        for number, line in enumerate(self.source.text.split("\n"), start=1):
            text = line.partition("#")[0].strip()
            if text:
                self.texts.append(text)
                self.numbers.append(number)
        self.position = 0

    @property
    def at_end(self) -> bool:
        """Whether every line has been taken."""
        return self.position >= len(self.texts)

    @property
    def peek(self) -> str:
        """The next line, empty at the end."""
        return "" if self.at_end else self.texts[self.position]

    def take(self, expected: str) -> str:
        """The next line.

        Raises:
            MeshFormatError: there is none (E703).
        """
        if self.at_end:
            raise self.malformed(expected, self.position - 1)
        self.position += 1
        return self.texts[self.position - 1]

    def take_keyword(self, expected: str) -> tuple[str, str]:
        """The first word of the next line, and the rest of it.

        Raises:
            MeshFormatError: there is none (E703).
        """
        keyword, *rest = self.take(expected).split(maxsplit=1)
        return keyword, "".join(rest)

    def malformed(self, expected: str, index: int | None = None) -> MeshFormatError:
        """The error that ``index``, by default the line taken last, is not ``expected``."""
        return MeshFormatError(MalformedLine(self.span(self.position - 1 if index is None else index), expected))

    def span(self, index: int) -> Span:
        """Where the line ``index``, counted without comments and blank lines, stands in the file."""
        number = self.numbers[index] if 0 <= index < len(self.numbers) else 1
        return line_span(self.source, number)

    def take_counts(self, least: int, expected: str, text: str | None = None) -> list[int]:
        """The integers >= 0 of the next line, or of ``text``, at least ``least`` of them.

        Raises:
            MeshFormatError: the line holds something else (E703).
        """
        words = (self.take(expected) if text is None else text).split()
        counts = [_as_integer(word) for word in words]
        if len(counts) < least or any(count is None or count < 0 for count in counts):
            raise self.malformed(expected)
        return [count for count in counts if count is not None]

    def take_floats(self, count: int, columns: int, what: str) -> Floats:
        """The first ``columns`` numbers of each of the next ``count`` lines, as float64 of shape (count, columns).

        Raises:
            MeshFormatError: the file ends before (E704), or a line is not numbers (E703).
        """
        return self._take_block(count, columns, what, np.float64, as_float)

    def take_integers(self, count: int, columns: int, what: str) -> Integers:
        """The first ``columns`` integers of each of the next ``count`` lines, as int64 of shape (count, columns).

        Raises:
            MeshFormatError: the file ends before (E704), or a line is not integers (E703).
        """
        return self._take_block(count, columns, what, np.int64, _as_integer)

    def take_ragged(self, count: int, least: int, what: str) -> Ragged:
        """The integers of each of the next ``count`` lines, of which the first says how many of the others count.

        Raises:
            MeshFormatError: the file ends before (E704), a line is not integers, or has fewer than it says or than
                ``least`` (E703).
        """
        first = self.position
        lengths = self.take_integers(count, 1, what)[:, 0]
        short = np.flatnonzero(lengths < least)
        if short.size:
            raise self.malformed(f"{least} or more, and so many point numbers", first + int(short[0]))
        offsets = np.concatenate([[0], np.cumsum(lengths)])
        values = np.empty(int(offsets[-1]), dtype=np.int64)
        for length in sorted(set(lengths.tolist())):
            rows = np.flatnonzero(lengths == length)
            table = self._table(first + rows, length + 1, np.int64, _as_integer)
            values[offsets[rows][:, None] + np.arange(length)] = table[:, 1:]
        return Ragged(offsets, values)

    def _take_block(self, count: int, columns: int, what: str, dtype: type, convert: Callable[[str], Any]) -> Any:
        start, stop = self.position, self.position + count
        if stop > len(self.texts):
            found = len(self.texts) - start
            raise MeshFormatError(TruncatedFile(self.span(len(self.texts) - 1), what, count, found))
        self.position = stop
        if count == 0:
            return np.zeros((0, columns), dtype=np.dtype(dtype))
        return self._table(np.arange(start, stop), columns, dtype, convert)

    def _table(self, lines: Integers, columns: int, dtype: type, convert: Callable[[str], Any]) -> Any:
        block: list[str] = [self.texts[line] for line in lines.tolist()]
        try:
            return cast(Any, np.loadtxt)(block, dtype=dtype, comments=None, usecols=range(columns), ndmin=2)
        except ValueError:
            kind = "integers" if dtype is np.int64 else "numbers"
            bad = int(lines[_first_bad(block, columns, convert)])
            raise self.malformed(f"{columns} {kind}", bad) from None


def as_float(word: str) -> float | None:
    """The number that a word is, or None. Python's underscores and other scripts' digits are no part of numbers."""
    try:
        return float(word) if word.isascii() and "_" not in word else None
    except ValueError:
        return None


def _first_bad(block: list[str], columns: int, convert: Callable[[str], Any]) -> int:
    """The first line that has fewer than ``columns`` words, or one that is no number."""
    for index, line in enumerate(block):
        words = line.split()[:columns]
        if len(words) < columns or any(convert(word) is None for word in words):
            return index
    return 0


def _as_integer(word: str) -> int | None:
    return int(word) if _INTEGER.fullmatch(word) else None


def _read(path: str | PathLike[str]) -> str:
    try:
        return Path(path).read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise MeshFormatError(UnreadableFile(str(path), error.strerror or type(error).__name__)) from None
    except ValueError as error:
        raise MeshFormatError(UnreadableFile(str(path), str(error))) from None
