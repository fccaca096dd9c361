"""Where the lanes of a strip of rows read and write.

Rows that follow one another are loaded as they lie, and shuffled into columns; other rows are loaded one by one, up to
four elements each, and transposed. What changes other rows is transposed back.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from ebb.backends.llvm import ops
from ebb.backends.llvm.lane_ops import MASK, LaneWriter, identity, suffix, wide
from ebb.backends.llvm.lanes import Emitter
from ebb.backends.llvm.row_values import Held, Lanes, Loaded, Place, Same, columns_of, rows_of, side_by_side
from ebb.backends.llvm.transpose import LANES, transposed
from ebb.compiler import lir
from ebb.records import record
from ebb.types.types import Kind, ScalarType, int64

MOST_SHUFFLED = 4
"""Rows of more elements than this are loaded one by one, though they follow one another."""

NUMBERS_64 = f"<{', '.join(f'i64 {k}' for k in range(LANES))}>"
"""The numbers of lanes, as int64."""


@record
class _Integers:
    """Integers that are loaded."""

    slot: lir.Slot
    place: Place


@record
class _Computed:
    """Integers in a vector."""

    name: str
    element: str


@record
class _Guarded:
    """The integers of ``place``, but 0 in lanes that are not in ``mask``."""

    place: Place
    mask: str


_Root = _Integers | _Computed | _Guarded
_Row = tuple[int, int | None, int, str, int]
"""A row in each lane: the slot, and the root, scale, base and offset of where it begins."""


class RowMemory:
    """The loads and stores of one loop in strips."""

    def __init__(self, emitter: Emitter, lanes: LaneWriter) -> None:
        self.e, self.w, self.v = emitter, emitter.w, lanes
        self.roots: list[_Root] = []
        self.narrow: dict[tuple[int, int], str] = {}
        self.asked: dict[_Row, set[int]] = {}
        self.columns: dict[tuple[_Row, int], str] = {}
        self.parts: dict[tuple[_Row, int], str] = {}
        self.stored: dict[tuple[int, Place], str] = {}
        self.written: dict[_Row, tuple[lir.Slot, dict[int, str]]] = {}
        self.changed: dict[tuple[_Row, str], tuple[lir.Slot, dict[int, str]]] = {}
        self.bound = self.predicate = self.active = ""

    def open(self, predicate: str, bound: str, active: str) -> None:
        """Begins a strip, of which only some rows are to be done, by the vector ``active``.

        Args:
            predicate: LLVM's: ``uge`` where these are the rows from ``bound`` on, ``ult`` where they are those before.
            bound: the number of a lane.
            active: the same as a vector.
        """
        self.predicate, self.bound, self.active = predicate, bound, active

    @contextmanager
    def apart(self) -> Generator[None, None, None]:
        """What is loaded within the ``with`` statement is not to be had behind it: not every way leads through it."""
        narrow, columns, parts = dict(self.narrow), dict(self.columns), dict(self.parts)
        with self.w.apart():
            yield
        self.narrow, self.columns, self.parts = narrow, columns, parts

    def finish(self) -> None:
        """Writes what has been stored in part of a row."""
        for row, (slot, columns) in self.written.items():
            self.complete(row, slot, columns)
            self.write(row, slot, columns)
        for (row, op), (slot, columns) in self.changed.items():
            self.change_rows(row, slot, op, columns)
        self.written, self.changed = {}, {}

    # ---- Places ----

    def root(self, root: _Root) -> int:
        """The number of a root."""
        if root not in self.roots:
            self.roots.append(root)
        return self.roots.index(root)

    def as_place(self, held: Held) -> Place:
        """An int64 as a place."""
        match held:
            case Place():
                return held
            case Same(name):
                return Place(None, 0, "0", int(name)) if name.lstrip("-").isdigit() else Place(None, 0, name, 0)
            case Lanes(name):
                return Place(self.root(_Computed(name, "i64")), 1, "0", 0)
            case Loaded():
                return Place(self.root(_Computed(self.loaded(held), "i64")), 1, "0", 0)

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

    def arithmetic(self, instruction: str, left: str, right: str) -> str:
        """An operation on two scalars."""
        if instruction == "mul" and "0" in (left, right):
            return "0"
        if right == ("1" if instruction == "mul" else "0"):
            return left
        if instruction == "add" and left == "0":
            return right
        return self.w.emit(f"{instruction} i64 {left}, {right}")

    def scalar(self, place: Place) -> str:
        """A place that is the same in all lanes."""
        return self.arithmetic("add", place.base, str(place.offset)) if place.base != "0" else str(place.offset)

    def lane(self, place: Place, k: int) -> tuple[str, int]:
        """Where lane ``k`` is: an integer, and a constant to be added to it."""
        if place.root is None:
            return place.base, place.scale * k + place.offset
        scaled = self.arithmetic("mul", self.root_lane(place.root, k), str(place.scale))
        return self.arithmetic("add", scaled, place.base), place.offset

    def root_lane(self, number: int, k: int) -> str:
        """Lane ``k`` of a root, as an int64."""
        if (number, k) not in self.narrow:
            match self.roots[number]:
                case _Integers(slot, place):
                    name = self.w.emit(f"load {ops.memory_type(slot.type)}, ptr {self.address(slot, place, k)}")
                    name = ops.convert(self.w, slot.type, int64, name)
                case _Computed(vector, element):
                    name = self.v.extract(element, vector, k)
                case _Guarded(place, mask):
                    index, constant = self.lane(place, k)
                    index = self.arithmetic("add", index, str(constant))
                    name = self.w.emit(f"select i1 {self.v.extract('i1', mask, k)}, i64 {index}, i64 0")
            self.narrow[number, k] = name
        return self.narrow[number, k]

    def address(self, slot: lir.Slot, place: Place, k: int) -> str:
        """The address of an element in lane ``k``."""
        index, constant = self.lane(place, k)
        return self.behind(slot, self.e.element(slot, index), constant)

    def behind(self, slot: lir.Slot, address: str, constant: int) -> str:
        """The address so many elements behind another."""
        if not constant:
            return address
        return self.w.emit(f"getelementptr inbounds {ops.memory_type(slot.type)}, ptr {address}, i64 {constant}")

    def guarded(self, place: Place, mask: str) -> Place:
        """``place`` in the lanes of ``mask``, and the first row in others."""
        if place.root is None and not place.scale:
            some = self.v.any(mask)
            return Place(None, 0, self.w.emit(f"select i1 {some}, i64 {self.scalar(place)}, i64 0"), 0)
        if place.root is None or place.base != "0":
            return Place(self.root(_Guarded(place, mask)), 1, "0", 0)
        own = Place(place.root, 1, "0", 0)
        return Place(self.root(_Guarded(own, mask)), place.scale, "0", place.offset)

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
            case _Integers(slot, place):
                return self.loaded(Loaded(slot, place)), slot.type
            case _Computed(name, _):
                return name, int64
            case _Guarded():
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
            return Place(self.root(_Integers(slot, place)), 1, "0", 0)
        row, column = self.row(slot, place)
        self.asked.setdefault(row, set()).add(column)
        loaded = Loaded(slot, place)
        return loaded if slot.access is lir.Access.READ else Lanes(self.loaded(loaded))

    def row(self, slot: lir.Slot, place: Place) -> tuple[_Row, int]:
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

    def part(self, slot: lir.Slot, row: _Row, k: int) -> str:
        """Part ``k`` of rows that lie side by side."""
        if (row, k) not in self.parts:
            self.parts[row, k] = self.load_part(slot, row, k)
        return self.parts[row, k]

    def load_part(self, slot: lir.Slot, row: _Row, k: int) -> str:
        """Loads part ``k`` of rows that lie side by side."""
        memory = ops.memory_type(slot.type)
        return self.w.emit(f"load {wide(memory)}, ptr {self.part_address(slot, row, k)}, align {_size(slot)}")

    def part_address(self, slot: lir.Slot, row: _Row, k: int) -> str:
        """Where part ``k`` of rows begins that lie side by side."""
        _, _, _, base, offset = row
        return self.behind(slot, self.e.element(slot, base), offset + LANES * k)

    def load_columns(self, slot: lir.Slot, row: _Row, column: int) -> None:
        """Loads, lane by lane, ``column`` and what else has been asked for of the four columns that it is one of."""
        first = column - column % 4
        asked = sorted(each for each in {column, *self.asked.get(row, ())} if first <= each < first + 4)
        low, high = asked[0], asked[-1] + 1
        width = _width(high - low)
        memory = ops.memory_type(slot.type)
        element = memory if width == 1 else f"<{width} x {memory}>"
        place = _begin(row, low)
        parts = [
            # The padding behind a buffer takes what is read beyond the last row.
            self.w.emit(f"load {element}, ptr {self.address(slot, place, k)}, align {_size(slot)}")
            for k in range(LANES)
        ]
        turned = transposed(self.w, memory, 8 * _size(slot), parts, width)
        self.columns.update({(row, low + k): turned[k] for k in range(high - low)})

    # ---- Stores to the own row ----

    def forward(self, slot: lir.Slot, place: Place, value: str) -> None:
        """Notes what is read there from now on."""
        self.stored[slot.number, place] = value

    def store(self, slot: lir.Slot, place: Place, value: str) -> None:
        """Stores into the own row, whole rows as soon as all of one is there."""
        row, column = self.row(slot, place)
        _, columns = self.written.setdefault(row, (slot, {}))
        columns[column] = value
        if len(columns) == place.scale:
            self.write(row, slot, self.written.pop(row)[1])

    def complete(self, row: _Row, slot: lir.Slot, columns: dict[int, str]) -> None:
        """Puts what the row holds where nothing has been stored."""
        for column in range(row[2]):
            if column not in columns:
                place = _begin(row, column)
                known = self.stored.get((slot.number, place))
                columns[column] = known or self.loaded(Loaded(slot, place))

    def write(self, row: _Row, slot: lir.Slot, columns: dict[int, str]) -> None:
        """Stores rows that follow one another, those that are to be done."""
        _, _, scale, _, _ = row
        assert row[1] is None
        memory = ops.memory_type(slot.type)
        if scale > MOST_SHUFFLED:
            self.write_lanes(row, slot, columns)
            return
        for k, part in enumerate(side_by_side(self.w, memory, [columns[c] for c in range(scale)])):
            self.write_part(slot, self.part_address(slot, row, k), part, self.part_mask(scale, k))

    def write_part(self, slot: lir.Slot, address: str, part: str, mask: str) -> None:
        """Stores eight elements; by the mask only in strips that need it, since that takes many times as long."""
        w, memory = self.w, ops.memory_type(slot.type)
        whole, some, stored = (w.fresh(stem) for stem in ("whole", "some", "stored"))
        every = w.emit(f"icmp eq i64 {self.bound}, {LANES if self.predicate == 'ult' else 0}")
        w.branch_if(every, whole, some)
        w.start(whole)
        w.do(f"store {wide(memory)} {part}, ptr {address}, align {_size(slot)}")
        w.branch(stored)
        w.start(some)
        name = f"llvm.masked.store.{suffix(slot.type)}.p0"
        w.declare(f"void @{name}({wide(memory)}, ptr, {MASK})")
        w.do(f"call void @{name}({wide(memory)} {part}, ptr align {_size(slot)} {address}, {MASK} {mask})")
        w.branch(stored)
        w.start(stored)

    def part_mask(self, scale: int, k: int) -> str:
        """Which elements of part ``k`` are in rows that are to be done."""
        if scale == 1:
            return self.active
        numbers = f"<{', '.join(f'i64 {LANES * k + lane}' for lane in range(LANES))}>"
        bound = self.v.broadcast("i64", self.arithmetic("mul", self.bound, str(scale)))
        return self.w.emit(f"icmp {self.predicate} {wide('i64')} {numbers}, {bound}")

    def write_lanes(self, row: _Row, slot: lir.Slot, columns: dict[int, str]) -> None:
        """Stores long rows four elements at a time, lane by lane; for one that is not to be done, one that is again."""
        memory = ops.memory_type(slot.type)
        sure = 0 if self.predicate == "ult" else LANES - 1
        for first in range(0, row[2], 4):
            chunk = [columns[c] for c in range(first, min(first + 4, row[2]))]
            size, width = len(chunk), _width(len(chunk))
            t = memory if size == 1 else f"<{width} x {memory}>"
            parts = rows_of(self.w, memory, chunk)
            places = [self.address(slot, _begin(row, first), k) for k in range(LANES)]
            for k in range(LANES):
                on = self.w.emit(f"icmp {self.predicate} i64 {k}, {self.bound}")
                address = self.w.emit(f"select i1 {on}, ptr {places[k]}, ptr {places[sure]}")
                new = self.w.emit(f"select i1 {on}, {t} {parts[k]}, {t} {parts[sure]}")
                if size == 1:
                    self.w.do(f"store {memory} {new}, ptr {address}, align {_size(slot)}")
                else:
                    self.store_short(slot, address, new, size)

    # ---- Changes of other rows ----

    def change(self, slot: lir.Slot, place: Place, op: str, value: str) -> None:
        """Changes an element of another row by ``op``; lanes that have been done change nothing by their ``value``."""
        row, column = self.row(slot, place)
        _, columns = self.changed.setdefault((row, op), (slot, {}))
        if column in columns:  # a second time
            self.change_rows(row, slot, op, columns)
            columns = {}
            self.changed[row, op] = slot, columns
        columns[column] = value
        if len(columns) == place.scale:
            self.change_rows(row, slot, op, self.changed.pop((row, op))[1])

    def change_rows(self, row: _Row, slot: lir.Slot, op: str, columns: dict[int, str]) -> None:
        """Changes a row in each lane: one line of memory at once, or lane by lane."""
        _, root, scale, _, _ = row
        nothing = identity(op, slot.type)
        whole = [columns.get(c, nothing) for c in range(scale)]
        if root is None and scale <= MOST_SHUFFLED:
            for k, part in enumerate(side_by_side(self.w, ops.memory_type(slot.type), whole)):
                old = self.load_part(slot, row, k)
                new = self.v.binary(op, slot.type, old, part, "")
                address = self.part_address(slot, row, k)
                self.w.do(f"store {wide(ops.llvm_type(slot.type))} {new}, ptr {address}, align {_size(slot)}")
            return
        for first in range(0, scale, 4):
            if columns.keys() & set(range(first, first + 4)):
                self.change_lanes(row, slot, op, first, whole[first : first + 4])

    def change_lanes(self, row: _Row, slot: lir.Slot, op: str, first: int, columns: list[str]) -> None:
        """Changes up to four elements of a row in each lane, one lane after the other."""
        memory, size = ops.memory_type(slot.type), len(columns)
        place, align = _begin(row, first), _size(slot)
        for k, part in enumerate(rows_of(self.w, memory, columns)):
            address = self.address(slot, place, k)
            if size == 1:
                old = self.w.emit(f"load {memory}, ptr {address}, align {align}")
                new = ops.binary(self.w, op, slot.type, old, part, "")
                self.w.do(f"store {memory} {new}, ptr {address}, align {align}")
                continue
            width = _width(size)
            # The padding behind a buffer takes what is read beyond the last row.
            old = self.w.emit(f"load <{width} x {memory}>, ptr {address}, align {align}")
            self.store_short(slot, address, self.short_binary(op, slot.type, width, old, part), size)

    def short_binary(self, op: str, scalar: ScalarType, width: int, a: str, b: str) -> str:
        """``a op b`` on a few elements of a row."""
        t = f"<{width} x {ops.llvm_type(scalar)}>"
        if op not in ("min", "max"):
            return self.w.emit(f"{ops.regular(op, scalar)} {t} {a}, {b}")
        name = f"{ops.min_max(op, scalar)}.v{width}{suffix(scalar)[2:]}"
        self.w.declare(f"{t} @{name}({t}, {t})")
        return self.w.emit(f"call{' nsz' if scalar.kind is Kind.FLOAT else ''} {t} @{name}({t} {a}, {t} {b})")

    def store_short(self, slot: lir.Slot, address: str, lanes: str, size: int) -> None:
        """Stores the first ``size`` elements of a short vector."""
        memory, width, align = ops.memory_type(slot.type), _width(size), _size(slot)
        if size != width:
            t = f"<{width} x {memory}>"
            two = self.w.emit(f"shufflevector {t} {lanes}, {t} poison, <2 x i32> <i32 0, i32 1>")
            self.w.do(f"store <2 x {memory}> {two}, ptr {address}, align {align}")
            third = self.w.emit(f"extractelement {t} {lanes}, i64 2")
            self.w.do(f"store {memory} {third}, ptr {self.behind(slot, address, 2)}, align {align}")
            return
        self.w.do(f"store <{width} x {memory}> {lanes}, ptr {address}, align {align}")


def _begin(row: _Row, column: int) -> Place:
    _, root, scale, base, offset = row
    return Place(root, scale, base, offset + column)


def _width(columns: int) -> int:
    return 4 if columns == 3 else columns


def _size(slot: lir.Slot) -> int:
    return slot.type.dtype.itemsize
