"""What the lanes of a strip of rows write: into rows that follow one another as they lie, else transposed back."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from ebb.backends.llvm import ops
from ebb.backends.llvm.lane_ops import MASK, LaneWriter, identity, suffix, wide
from ebb.backends.llvm.lanes import Emitter
from ebb.backends.llvm.row_loads import MOST_SHUFFLED, Row, RowLoads, begin, size_of
from ebb.backends.llvm.row_values import Loaded, Place, rows_of, side_by_side
from ebb.backends.llvm.transpose import LANES, width_of
from ebb.compiler import lir
from ebb.types.types import Kind, ScalarType


class RowMemory(RowLoads):
    """The loads and stores of one loop in strips."""

    def __init__(self, emitter: Emitter, lanes: LaneWriter) -> None:
        super().__init__(emitter, lanes)
        self.written: dict[Row, tuple[lir.Slot, dict[int, str]]] = {}
        self.changed: dict[tuple[Row, str], tuple[lir.Slot, dict[int, str]]] = {}
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

    def complete(self, row: Row, slot: lir.Slot, columns: dict[int, str]) -> None:
        """Puts what the row holds where nothing has been stored."""
        for column in range(row[2]):
            if column not in columns:
                place = begin(row, column)
                known = self.stored.get((slot.number, place))
                columns[column] = known or self.loaded(Loaded(slot, place))

    def write(self, row: Row, slot: lir.Slot, columns: dict[int, str]) -> None:
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
        w.do(f"store {wide(memory)} {part}, ptr {address}, align {size_of(slot)}")
        w.branch(stored)
        w.start(some)
        name = f"llvm.masked.store.{suffix(slot.type)}.p0"
        w.declare(f"void @{name}({wide(memory)}, ptr, {MASK})")
        w.do(f"call void @{name}({wide(memory)} {part}, ptr align {size_of(slot)} {address}, {MASK} {mask})")
        w.branch(stored)
        w.start(stored)

    def part_mask(self, scale: int, k: int) -> str:
        """Which elements of part ``k`` are in rows that are to be done."""
        if scale == 1:
            return self.active
        numbers = f"<{', '.join(f'i64 {LANES * k + lane}' for lane in range(LANES))}>"
        bound = self.v.broadcast("i64", self.arithmetic("mul", self.bound, str(scale)))
        return self.w.emit(f"icmp {self.predicate} {wide('i64')} {numbers}, {bound}")

    def write_lanes(self, row: Row, slot: lir.Slot, columns: dict[int, str]) -> None:
        """Stores long rows four elements at a time, lane by lane; for one that is not to be done, one that is again."""
        memory = ops.memory_type(slot.type)
        sure = 0 if self.predicate == "ult" else LANES - 1
        for first in range(0, row[2], 4):
            chunk = [columns[c] for c in range(first, min(first + 4, row[2]))]
            size, width = len(chunk), width_of(len(chunk))
            t = memory if size == 1 else f"<{width} x {memory}>"
            parts = rows_of(self.w, memory, chunk)
            places = [self.address(slot, begin(row, first), k) for k in range(LANES)]
            for k in range(LANES):
                on = self.w.emit(f"icmp {self.predicate} i64 {k}, {self.bound}")
                address = self.w.emit(f"select i1 {on}, ptr {places[k]}, ptr {places[sure]}")
                new = self.w.emit(f"select i1 {on}, {t} {parts[k]}, {t} {parts[sure]}")
                if size == 1:
                    self.w.do(f"store {memory} {new}, ptr {address}, align {size_of(slot)}")
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

    def change_rows(self, row: Row, slot: lir.Slot, op: str, columns: dict[int, str]) -> None:
        """Changes a row in each lane: one line of memory at once, or lane by lane."""
        _, root, scale, _, _ = row
        nothing = identity(op, slot.type)
        whole = [columns.get(c, nothing) for c in range(scale)]
        if root is None and scale <= MOST_SHUFFLED:
            for k, part in enumerate(side_by_side(self.w, ops.memory_type(slot.type), whole)):
                old = self.load_part(slot, row, k)
                new = self.v.binary(op, slot.type, old, part, "")
                address = self.part_address(slot, row, k)
                self.w.do(f"store {wide(ops.llvm_type(slot.type))} {new}, ptr {address}, align {size_of(slot)}")
            return
        for first in range(0, scale, 4):
            if columns.keys() & set(range(first, first + 4)):
                self.change_lanes(row, slot, op, first, whole[first : first + 4])

    def change_lanes(self, row: Row, slot: lir.Slot, op: str, first: int, columns: list[str]) -> None:
        """Changes up to four elements of a row in each lane, one lane after the other."""
        memory, size = ops.memory_type(slot.type), len(columns)
        place, align = begin(row, first), size_of(slot)
        for k, part in enumerate(rows_of(self.w, memory, columns)):
            address = self.address(slot, place, k)
            if size == 1:
                old = self.w.emit(f"load {memory}, ptr {address}, align {align}")
                new = ops.binary(self.w, op, slot.type, old, part, "")
                self.w.do(f"store {memory} {new}, ptr {address}, align {align}")
                continue
            width = width_of(size)
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
        memory, width, align = ops.memory_type(slot.type), width_of(size), size_of(slot)
        if size != width:
            t = f"<{width} x {memory}>"
            two = self.w.emit(f"shufflevector {t} {lanes}, {t} poison, <2 x i32> <i32 0, i32 1>")
            self.w.do(f"store <2 x {memory}> {two}, ptr {address}, align {align}")
            third = self.w.emit(f"extractelement {t} {lanes}, i64 2")
            self.w.do(f"store {memory} {third}, ptr {self.behind(slot, address, 2)}, align {align}")
            return
        self.w.do(f"store <{width} x {memory}> {lanes}, ptr {address}, align {align}")
