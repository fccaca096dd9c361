"""Transposition in registers: what each lane loaded of its own row becomes one vector a column.

The shuffles are those that processors do within parts of 128 bits, so they differ with the size of the elements; LLVM
chooses the instructions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeAlias

_Order: TypeAlias = tuple[int, ...]

LANES = 8
"""The lanes of a strip: they fill a register of AVX in float32, one of AVX-512 in float64."""

# Orders of the elements of two vectors: of 2 and of 4 elements, side by side, ...
_SIDE_BY_SIDE = {2: (0, 1, 2, 3), 4: (0, 1, 2, 3, 4, 5, 6, 7)}
# ... and of 8 elements, numbered 0 to 7 and 8 to 15, within the halves.
_PAIRS_LOW = (0, 8, 1, 9, 4, 12, 5, 13)
_PAIRS_HIGH = (2, 10, 3, 11, 6, 14, 7, 15)
_PAIRS_EVEN = (0, 8, 2, 10, 4, 12, 6, 14)
_PAIRS_ODD = (1, 9, 3, 11, 5, 13, 7, 15)
_HALVES_LOW = (0, 1, 8, 9, 4, 5, 12, 13)
_HALVES_HIGH = (2, 3, 10, 11, 6, 7, 14, 15)
_EVEN = (0, 2, 8, 10, 4, 6, 12, 14)
_ODD = (1, 3, 9, 11, 5, 7, 13, 15)

# The pairing of neighbouring lanes, and the halves of the pairs, that make each of four columns.
_FOUR_COLUMNS = {
    32: (
        (_PAIRS_LOW, _HALVES_LOW),
        (_PAIRS_LOW, _HALVES_HIGH),
        (_PAIRS_HIGH, _HALVES_LOW),
        (_PAIRS_HIGH, _HALVES_HIGH),
    ),
    64: (
        (_PAIRS_EVEN, _HALVES_LOW),
        (_PAIRS_ODD, _HALVES_LOW),
        (_PAIRS_EVEN, _HALVES_HIGH),
        (_PAIRS_ODD, _HALVES_HIGH),
    ),
}
# The lanes in the order in which they are put side by side, and what makes each of two columns then.
_TWO_COLUMNS = {
    32: ((0, 1, 4, 5, 2, 3, 6, 7), (_EVEN, _ODD)),
    64: ((0, 2, 4, 6, 1, 3, 5, 7), (_PAIRS_EVEN, _PAIRS_ODD)),
}


class Writer(Protocol):
    """Where instructions go."""

    def emit(self, instruction: str) -> str:
        """Appends ``instruction`` and returns the name of its result."""
        ...


def width_of(columns: int) -> int:
    """How many elements each lane loads where so many columns, at most 4, are wanted."""
    return 4 if columns == 3 else columns


def transposed(w: Writer, element: str, bits: int, parts: Sequence[str], width: int) -> list[str]:
    """The ``width`` columns of ``parts``.

    Args:
        w: where the shuffles go.
        element: LLVM's type of an element.
        bits: its size.
        parts: for each lane a vector of ``width`` elements, or a scalar where that is 1.
        width: 1, 2 or 4.
    """
    assert len(parts) == LANES
    columns, kind = _Columns(w, element), 64 if bits == 64 else 32
    match width:
        case 1:
            return [columns.inserted(parts)]
        case 2:
            return columns.two(parts, *_TWO_COLUMNS[kind])
        case _:
            return columns.four(parts, _FOUR_COLUMNS[kind])


class _Columns:
    def __init__(self, w: Writer, element: str) -> None:
        self.w, self.element = w, element

    def inserted(self, parts: Sequence[str]) -> str:
        lanes = "poison"
        for k, part in enumerate(parts):
            lanes = self.w.emit(f"insertelement <{LANES} x {self.element}> {lanes}, {self.element} {part}, i64 {k}")
        return lanes

    def two(self, parts: Sequence[str], lanes: _Order, orders: Sequence[_Order]) -> list[str]:
        twos = [self.shuffle(parts[lanes[k]], parts[lanes[k + 1]], _SIDE_BY_SIDE[2]) for k in range(0, LANES, 2)]
        fours = [self.shuffle(twos[k], twos[k + 1], _SIDE_BY_SIDE[4]) for k in (0, 2)]
        return [self.shuffle(fours[0], fours[1], order) for order in orders]

    def four(self, parts: Sequence[str], orders: Sequence[tuple[_Order, _Order]]) -> list[str]:
        """Lane k and lane k + 4 share a register, so that the shuffles stay within its halves."""
        rows = [self.shuffle(parts[k], parts[k + 4], _SIDE_BY_SIDE[4]) for k in range(4)]
        paired = {
            pairing: [self.shuffle(rows[k], rows[k + 1], pairing) for k in (0, 2)]
            for pairing in dict.fromkeys(pairing for pairing, _ in orders)
        }
        return [self.shuffle(paired[pairing][0], paired[pairing][1], halves) for pairing, halves in orders]

    def shuffle(self, a: str, b: str, order: _Order) -> str:
        """The elements of ``a`` and ``b`` by ``order``."""
        size = len(order) // 2 if order in _SIDE_BY_SIDE.values() else LANES
        t, chosen = f"<{size} x {self.element}>", ", ".join(f"i32 {k}" for k in order)
        return self.w.emit(f"shufflevector {t} {a}, {t} {b}, <{len(order)} x i32> <{chosen}>")
