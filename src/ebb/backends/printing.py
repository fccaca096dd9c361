"""``print`` in compiled kernels: records that the code leaves, written out after the launch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ebb.compiler import kir, lir
from ebb.compiler.print_format import format_value
from ebb.runtime.buffer import Array, aligned_zeros
from ebb.types.types import KeyType, ScalarType, Type, int64

MOST_LINES = 1 << 16
"""The lines that one launch keeps; it says how many more there were."""

_MOST_WORDS = 1 << 20


class PrintLayout:
    """How the records of one kernel's prints lie: the number of the print, the row's position, each value in a word.

    Attributes:
        lines: how many records there is room for.
        words: the int64 words of the whole: ``lir.PrintRecords``.
    """

    def __init__(self, kernel: kir.Kernel, program: lir.Program) -> None:
        self._kernel = kernel
        self._prints: Sequence[kir.Print] = program.prints
        self._width = lir.PRINT_HEADER + program.print_words
        self.lines = min(MOST_LINES, _MOST_WORDS // self._width)
        self.words = self.used(self.lines)

    def used(self, count: int) -> int:
        """How many words are in use after ``count`` prints."""
        return lir.PRINT_RECORDS + min(count, self.lines) * self._width

    def write_out(self, words: Array, failed: int | None) -> None:
        """Prints the lines of a launch in the order of rows, and says how many were too many to keep.

        ``words`` may be used again meanwhile: what is printed to may fail, or launch the kernel.

        Args:
            words: at least those in use.
            failed: the position of the row at which the launch failed: a row behind it would not have run.
        """
        count = int(words[lir.PRINT_COUNTER])
        kept = min(count, self.lines)
        records = words[lir.PRINT_RECORDS : self.used(count)].reshape(kept, self._width)
        if failed is not None:
            records = records[records[:, 1] <= failed]
        for record in records[np.argsort(records[:, 1], kind="stable")]:
            print(self._line(self._prints[int(record[0])], record[lir.PRINT_HEADER :]))
        if count > kept:
            print(
                f"... and {count - kept} more lines of kernel '{self._kernel.name}', which keeps {self.lines} a launch"
            )

    def _line(self, stmt: kir.Print, words: Any) -> str:
        texts: list[str] = []
        start = 0
        for part in stmt.parts:
            if isinstance(part, str):
                texts.append(part)
                continue
            expr, spec = part
            texts.append(format_value(_decoded(words[start : start + expr.type.size], expr.type), expr.type, spec))
            start += expr.type.size
        return "".join(texts)


class PrintBuffer:
    """The records of one kernel's prints in the host's memory."""

    def __init__(self, kernel: kir.Kernel, program: lir.Program) -> None:
        self._layout = PrintLayout(kernel, program)
        self._words = aligned_zeros((self._layout.words,), np.dtype(np.int64))
        self._words[lir.PRINT_CAPACITY] = self._layout.lines
        self.address = self._words.ctypes.data

    def flush(self) -> None:
        """Prints the lines of the last launch."""
        count = int(self._words[lir.PRINT_COUNTER])
        if count:
            taken = self._words[: self._layout.used(count)].copy()
            self._words[lir.PRINT_COUNTER] = 0  # before any line is written
            self._layout.write_out(taken, None)


def _decoded(words: Any, type_: Type) -> Any:
    """The value whose components stand in the low ends of ``words``, as NumPy has it."""
    scalar: ScalarType = int64 if isinstance(type_.scalar, KeyType) else type_.scalar
    low = np.ascontiguousarray(words).view(f"u{scalar.dtype.itemsize}").reshape(len(words), -1)[:, 0]
    values = np.ascontiguousarray(low).view(scalar.dtype)
    return values.reshape(type_.shape)[()]
