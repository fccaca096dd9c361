"""What the lanes of a strip of rows hold: one value for all, one for each, or integers that addresses come from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from ebb.backends.llvm.transpose import LANES, Writer
from ebb.compiler import lir
from ebb.records import record


@record
class Same:
    """A scalar that all lanes have in common."""

    name: str


@record
class Lanes:
    """A vector with a value for each lane."""

    name: str


@record
class Place:
    """An int64 for each lane: ``scale * root + base + offset``.

    Attributes:
        root: what differs between lanes: None for the number of the lane, else the number of an integer that each has.
        scale: a constant.
        base: a scalar that all lanes have in common, or ``0``.
        offset: a constant.
    """

    root: int | None
    scale: int
    base: str
    offset: int


@record
class Loaded:
    """What lies at a place in each lane, to be loaded when it is wanted: with its neighbours in the row by then."""

    slot: lir.Slot
    place: Place


Held: TypeAlias = Same | Lanes | Place | Loaded


def picked(w: Writer, element: str, parts: Sequence[str], chosen: Sequence[tuple[int, int]]) -> str:
    """A vector of elements of ``parts``.

    Args:
        w: where the shuffles go.
        element: LLVM's type of an element.
        parts: vectors of as many elements as there are lanes.
        chosen: for each lane the number of a part, and of an element in it.
    """
    t = f"<{LANES} x {element}>"
    used = sorted({part for part, _ in chosen})
    made = parts[used[0]]
    for step, part in enumerate(used[1:] or used[:1]):
        order: list[int] = []
        for lane, (source, index) in enumerate(chosen):
            if source == part and len(used) > 1:
                order.append(LANES + index)
            elif step == 0:
                order.append(index if source == used[0] else 0)
            else:
                order.append(lane)
        mask = ", ".join(f"i32 {k}" for k in order)
        made = w.emit(f"shufflevector {t} {made}, {t} {parts[part]}, <{LANES} x i32> <{mask}>")
    return made


def columns_of(w: Writer, element: str, parts: Sequence[str], column: int) -> str:
    """Element ``column`` of each row, where ``parts`` are rows side by side, as long as there are parts."""
    size = len(parts)
    places = [lane * size + column for lane in range(LANES)]
    return picked(w, element, parts, [(place // LANES, place % LANES) for place in places])


def side_by_side(w: Writer, element: str, columns: Sequence[str]) -> list[str]:
    """The rows whose elements ``columns`` hold, side by side: the inverse of ``columns_of``."""
    size = len(columns)
    return [
        picked(w, element, columns, [((LANES * part + k) % size, (LANES * part + k) // size) for k in range(LANES)])
        for part in range(size)
    ]


_EVEN, _ODD = (0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15)
_LOW, _HIGH = (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)


def rows_of(w: Writer, element: str, columns: Sequence[str]) -> list[str]:
    """For each lane a vector of what ``columns``, at most 4, hold there; a scalar where there is one, 4 for 3."""
    if len(columns) == 1:
        return [w.emit(f"extractelement <{LANES} x {element}> {columns[0]}, i64 {k}") for k in range(LANES)]
    pairs = [_shuffled(w, element, columns[0], columns[1], order) for order in (_EVEN, _ODD)]
    if len(columns) == 2:
        return [_part(w, element, pairs[k % 2], k - k % 2, 2) for k in range(LANES)]
    others = [_shuffled(w, element, columns[2], columns[-1], order) for order in (_EVEN, _ODD)]
    halves = {
        2 * high + odd: _shuffled(w, element, pairs[odd], others[odd], order)
        for high, order in enumerate((_LOW, _HIGH))
        for odd in (0, 1)
    }
    return [_part(w, element, halves[k % 4], 4 * (k // 4), 4) for k in range(LANES)]


def _shuffled(w: Writer, element: str, a: str, b: str, order: Sequence[int]) -> str:
    t, mask = f"<{LANES} x {element}>", ", ".join(f"i32 {k}" for k in order)
    return w.emit(f"shufflevector {t} {a}, {t} {b}, <{LANES} x i32> <{mask}>")


def _part(w: Writer, element: str, lanes: str, first: int, size: int) -> str:
    t, mask = f"<{LANES} x {element}>", ", ".join(f"i32 {first + k}" for k in range(size))
    return w.emit(f"shufflevector {t} {lanes}, {t} poison, <{size} x i32> <{mask}>")
