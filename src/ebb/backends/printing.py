"""``print`` in compiled kernels: records that the machine code leaves, written out after the launch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ebb.compiler import kir, lir
from ebb.compiler.print_format import format_value
from ebb.runtime.buffer import aligned_zeros
from ebb.types.types import KeyType, ScalarType, Type, int64

MOST_LINES = 1 << 16
"""The lines that one launch keeps; it says how many more there were."""

_MOST_WORDS = 1 << 20


class PrintBuffer:
    """The records of one kernel's prints: the number of the print, the row's position, and each value in a word."""

    def __init__(self, kernel: kir.Kernel, program: lir.Program) -> None:
        self._kernel = kernel
        self._prints: Sequence[kir.Print] = program.prints
        self._width = lir.PRINT_HEADER + program.print_words
        self._lines = min(MOST_LINES, _MOST_WORDS // self._width)
        self._words = aligned_zeros((lir.PRINT_RECORDS + self._lines * self._width,), np.dtype(np.int64))
        self._words[lir.PRINT_CAPACITY] = self._lines
        self.address = self._words.ctypes.data

    def flush(self) -> None:
        """Prints the lines of the last launch in the order of rows, and says how many were too many to keep."""
        count = int(self._words[lir.PRINT_COUNTER])
        if not count:
            return
        kept = min(count, self._lines)
        records = self._words[lir.PRINT_RECORDS : lir.PRINT_RECORDS + kept * self._width].reshape(kept, self._width)
        self._words[lir.PRINT_COUNTER] = 0  # before any line is written, which may fail or launch the kernel again
        for record in records[np.argsort(records[:, 1], kind="stable")]:
            print(self._line(self._prints[int(record[0])], record[lir.PRINT_HEADER :]))
        if count > kept:
            print(
                f"... and {count - kept} more lines of kernel '{self._kernel.name}', which keeps {self._lines} a launch"
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


def _decoded(words: Any, type_: Type) -> Any:
    """The value whose components stand in the low ends of ``words``, as NumPy has it."""
    scalar: ScalarType = int64 if isinstance(type_.scalar, KeyType) else type_.scalar
    low = np.ascontiguousarray(words).view(f"u{scalar.dtype.itemsize}").reshape(len(words), -1)[:, 0]
    values = np.ascontiguousarray(low).view(scalar.dtype)
    return values.reshape(type_.shape)[()]
