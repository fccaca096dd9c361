"""What the lanes of a strip of rows read.

Rows that follow one another are loaded as they lie, and shuffled into columns; other rows are loaded one by one, up to
four elements each, and transposed.
"""

from __future__ import annotations

from typing import TypeAlias

from ebb.backends.llvm import ops
from ebb.backends.llvm.lane_ops import NUMBERS_64, LaneWriter, wide
from ebb.backends.llvm.lanes import Emitter
from ebb.backends.llvm.row_places import Computed, Guarded, Integers, RowPlaces
from ebb.backends.llvm.row_values import Held, Lanes, Loaded, Place, Same, columns_of
from ebb.backends.llvm.transpose import LANES, transposed, width_of
from ebb.compiler import lir
from ebb.types.types import Kind, ScalarType, int64

MOST_SHUFFLED = 4
"""Rows of more elements than this are loaded one by one, though they follow one another."""

Row: TypeAlias = tuple[int, int | None, int, str, int]
"""A row in each lane: the slot, and the root, scale, base and offset of where it begins."""


class RowLoads(RowPlaces):
    """The loads of one loop in strips."""

    def __init__(self, emitter: Emitter, lanes: LaneWriter) -> None:
        super().__init__(emitter, lanes)
        self.asked: dict[Row, set[int]] = {}
        self.columns: dict[tuple[Row, int], str] = {}
        self.parts: dict[tuple[Row, int], str] = {}
        self.stored: dict[tuple[int, Place], str] = {}

    # ---- Integers ----

    def as_place(self, held: Held) -> Place:
        """An int64 as a place."""
        match held:
            case Place():
                return held
            case Same(name):
                return Place(None, 0, "0", int(name)) if name.lstrip("-").isdigit() else Place(None, 0, name, 0)
            case Lanes(name):
                return Place(self.root(Computed(name, "i64")), 1, "0", 0)
            case Loaded():
                return Place(self.root(Computed(self.loaded(held), "i64")), 1, "0", 0)

    def combined(self, op: str, left: Held, right: Held) -> Place | None:
        """``left op right``, if that is a place."""
        a, b = self.as_place(left), self.as_place(right)
        match op:
            case "*" if not a.scale and not b.scale and "0" not in (a.base, b.base):
                return Place(None, 0, self.arithmetic("mul", self.scalar(a), self.scalar(b)), 0)
            case "*":
                a, b = (a, b) if not b.scale and b.base == "0" else (b, a)
                if b.scale or b.base != "0":
                    return None
                return Place(
                    a.root, a.scale * b.offset, self.arithmetic("mul", a.base, str(b.offset)), a.offset * b.offset
                )
            case "-":
                if b.scale:
                    return None
                return Place(a.root, a.scale, self.arithmetic("sub", a.base, b.base), a.offset - b.offset)
            case _:
                if a.scale and b.scale and a.root != b.root:
                    return None
                root = a.root if a.scale else b.root
                base = self.arithmetic("add", a.base, b.base)
                return Place(root, a.scale + b.scale, base, a.offset + b.offset)

    def integers(self, place: Place, scalar: ScalarType) -> str:
        """The lanes of integers."""
        t = wide(ops.llvm_type(scalar))
        if place.root is None:
            lanes, kind = NUMBERS_64, int64
        else:
            lanes, kind = self.root_lanes(place.root)
        if kind != scalar:
            lanes = self.v.convert(kind, scalar, lanes)
        element = ops.llvm_type(scalar)
        if place.scale != 1:
            lanes = self.w.emit(f"mul {t} {lanes}, splat ({element} {place.scale})")
        if place.base != "0" or place.offset:
            lanes = self.w.emit(
                f"add {t} {lanes}, {self.v.broadcast(element, self.scalar(Place(None, 0, place.base, place.offset)))}"
            )
        return lanes

    def root_lanes(self, number: int) -> tuple[str, ScalarType]:
        """The lanes of a root, and their type."""
        match self.roots[number]:
            case Integers(slot, place):
                return self.loaded(Loaded(slot, place)), slot.type
            case Computed(name, _):
                return name, int64
            case Guarded():
                lanes = [self.root_lane(number, k) for k in range(LANES)]
                return transposed(self.w, "i64", 64, lanes, 1)[0], int64

    # ---- Loads ----

    def load(self, slot: lir.Slot, place: Place) -> Held:
        """What lies at ``place``."""
        known = self.stored.get((slot.number, place))
        if known is not None:
            return Lanes(known)
        if not place.scale:
            return Same(self.e.load(slot, self.scalar(place)))
        if slot.type.kind is Kind.SIGNED and slot.access is lir.Access.READ:
            return Place(self.root(Integers(slot, place)), 1, "0", 0)
        row, column = self.row(slot, place)
        self.asked.setdefault(row, set()).add(column)
        loaded = Loaded(slot, place)
        return loaded if slot.access is lir.Access.READ else Lanes(self.loaded(loaded))

    def row(self, slot: lir.Slot, place: Place) -> tuple[Row, int]:
        """The row that a place is in, and where it is in the row."""
        column = place.offset % place.scale
        return (slot.number, place.root, place.scale, place.base, place.offset - column), column

    def loaded(self, loaded: Loaded) -> str:
        """The lanes of what lies at a place."""
        slot = loaded.slot
        row, column = self.row(slot, loaded.place)
        if (row, column) not in self.columns:
            if loaded.place.root is None and loaded.place.scale <= MOST_SHUFFLED:
                parts = [self.part(slot, row, k) for k in range(loaded.place.scale)]
                self.columns[row, column] = columns_of(self.w, ops.memory_type(slot.type), parts, column)
            else:
                self.load_columns(slot, row, column)
        return self.columns[row, column]

    def part(self, slot: lir.Slot, row: Row, k: int) -> str:
        """Part ``k`` of rows that lie side by side."""
        if (row, k) not in self.parts:
            self.parts[row, k] = self.load_part(slot, row, k)
        return self.parts[row, k]

    def load_part(self, slot: lir.Slot, row: Row, k: int) -> str:
        """Loads part ``k`` of rows that lie side by side."""
        memory = ops.memory_type(slot.type)
        return self.w.emit(f"load {wide(memory)}, ptr {self.part_address(slot, row, k)}, align {size_of(slot)}")

    def part_address(self, slot: lir.Slot, row: Row, k: int) -> str:
        """Where part ``k`` of rows begins that lie side by side."""
        _, _, _, base, offset = row
        return self.behind(slot, self.e.element(slot, base), offset + LANES * k)

    def load_columns(self, slot: lir.Slot, row: Row, column: int) -> None:
        """Loads, lane by lane, ``column`` and what else has been asked for of the four columns that it is one of."""
        first = column - column % 4
        asked = sorted(each for each in {column, *self.asked.get(row, ())} if first <= each < first + 4)
        low, high = asked[0], asked[-1] + 1
        width = width_of(high - low)
        memory = ops.memory_type(slot.type)
        element = memory if width == 1 else f"<{width} x {memory}>"
        place = begin(row, low)
        parts = [
            # The padding behind a buffer takes what is read beyond the last row.
            self.w.emit(f"load {element}, ptr {self.address(slot, place, k)}, align {size_of(slot)}")
            for k in range(LANES)
        ]
        turned = transposed(self.w, memory, 8 * size_of(slot), parts, width)
        self.columns.update({(row, low + k): turned[k] for k in range(high - low)})


def begin(row: Row, column: int) -> Place:
    """Where a column of a row is."""
    _, root, scale, base, offset = row
    return Place(root, scale, base, offset + column)


def size_of(slot: lir.Slot) -> int:
    """The bytes of an element."""
    return slot.type.dtype.itemsize
