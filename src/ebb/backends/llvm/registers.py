"""Rows of straight-line arithmetic on floats, a register of them at a time: stencils as one writes them by hand.

What rows read of the same line of a grid, or compute of it, is read and computed once, in registers that begin where
lines of the cache do; for neighbours along the line registers are shifted into one another. A 27-point stencil, written
by the sums of its faces and corners, loads 9 registers instead of 27, and none of them from two lines of the cache.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from ebb.backends.llvm import ops
from ebb.backends.llvm.shifts import Key, Known, Names
from ebb.backends.llvm.strides import is_unit
from ebb.backends.llvm.turns import FETCHED_AHEAD, Emitter
from ebb.compiler import lir
from ebb.compiler.lir_walk import operands
from ebb.records import record
from ebb.types.types import Kind, ScalarType

REGISTER_BYTES = 64
_BINARY = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv"}
_MATH = {"sqrt": "llvm.sqrt", "abs": "llvm.fabs"}


@record
class Registers:
    """How the rows of a straight-line body are computed in registers.

    Attributes:
        body: the statements.
        names: what each temporary of it is.
        scalar: the type of all that differs from row to row.
        made: how what is named so is computed, and for which shift.
        kept: what rows need of several rows, by the least and the greatest shift.
    """

    body: lir.Body
    names: Names
    scalar: ScalarType
    made: dict[Key, tuple[lir.Let, int]]
    kept: dict[Key, tuple[int, int]]

    @property
    def lanes(self) -> int:
        """The rows of a register."""
        return REGISTER_BYTES * 8 // self.scalar.bits


def plan_registers(body: lir.Body, counter: lir.Temp) -> Registers | None:
    """How rows that run ``body`` are computed in registers, or None where that is left to LLVM."""
    if not is_unit(body, counter):
        return None
    names = Names(counter)
    made: dict[Key, tuple[lir.Let, int]] = {}
    stored: list[lir.Store] = []
    for stmt in body:
        match stmt:
            case lir.Let():
                known = names.name(stmt)
                if known.shift is not None:
                    made.setdefault(known.key, (stmt, known.shift))
            case lir.Store():
                stored.append(stmt)
            case _:
                return None
    scalars = {stmt.slot.type for stmt in stored}
    if len(scalars) != 1:
        return None
    scalar = scalars.pop()
    requests = _requests(names, made, [names.of(stmt.value) for stmt in stored], REGISTER_BYTES * 8 // scalar.bits)
    if scalar.kind is not Kind.FLOAT or not all(_fits(made[key][0], scalar, names) for key in requests):
        return None
    kept = {key: (min(shifts), max(shifts)) for key, shifts in requests.items() if len(shifts) > 1}
    return Registers(body, names, scalar, made, kept)


def only_streams(body: lir.Body, streaming: lir.Streaming) -> bool:
    """Whether ``body`` leaves nothing but in slots that stream, and reads what has room around it."""
    slots = {place.slot.number for place in streaming.written}
    for stmt in body:
        match stmt:
            case lir.Accumulate():
                return False
            case lir.Store(slot) if slot.number not in slots:
                return False
            case lir.Let(_, lir.Load(slot)) if not isinstance(slot.binding, lir.FieldData | lir.GlobalData):
                return False
            case _:
                pass
    return True


def _requests(
    names: Names, made: dict[Key, tuple[lir.Let, int]], results: list[Known], lanes: int
) -> dict[Key, set[int]]:
    """By which shifts each of what ``made`` says is needed, of all that ``results`` depend on.

    Where it is by several, but by less than a register, it is computed for whole registers alone.
    """
    requests = defaultdict[Key, set[int]](set)
    for known in results:
        if known.shift is not None:
            requests[known.key].add(known.shift)
    for key in reversed(made):
        if key not in requests:
            continue
        shifts = requests[key]
        if len(shifts) > 1 and max(map(abs, shifts)) <= lanes:
            shifts = {lanes if max(shifts) > 0 else 0}
        elif len(shifts) > 1:
            requests[key] = {0}  # too far apart: computed for each
        let, made_for = made[key]
        if isinstance(let.operation, lir.Load):
            continue
        for value in operands(let.operation):
            known = names.of(value)
            if known.shift is not None:
                requests[known.key] |= {shift + known.shift - made_for for shift in shifts}
    return requests


def _fits(let: lir.Let, scalar: ScalarType, names: Names) -> bool:
    """Whether what differs from row to row is a number of the one type, by a regular operation."""
    match let.operation:
        case lir.Load(slot) if slot.access is lir.Access.READ:
            return let.temp.type == scalar
        case lir.Binary(op):
            return let.temp.type == scalar and op in _BINARY
        case lir.Unary("-"):
            return let.temp.type == scalar
        case lir.Math(function):
            return let.temp.type == scalar and function in _MATH
        case _:
            return False


class RowRegisters:
    """Emits the calculation of rows in registers: each turn one register, which follows that of the turn before."""

    def __init__(self, e: Emitter, plan: Registers, counter: lir.Temp, ahead: Sequence[lir.RowPlace]) -> None:
        self.e, self.w, self.plan, self.counter, self.ahead = e, e.w, plan, counter, ahead
        self.type = f"<{plan.lanes} x {ops.llvm_type(plan.scalar)}>"
        self.kept: dict[Key, dict[int, str]] = {}
        self.computed: dict[tuple[Key, int], str] = {}
        self.invariant: dict[Key, str] = {}
        self.places: dict[tuple[int, lir.Value], str] = {}
        self.row = ""
        # What is kept from turn to turn, which LLVM puts into registers.
        self.memory = {(key, at): self.w.allocate(self.type) for key in plan.kept for at in self.carried(key)}

    def start(self, row: str) -> None:
        """Emits what comes before the first turn, whose register begins with ``row`` and a line of the cache."""
        self.begin(row)
        self.fix_places(row)
        for (key, at), place in self.memory.items():
            self.w.do(f"store {self.type} {self.compute(key, at)}, ptr {place}")

    def turn(self, row: str) -> list[tuple[lir.Store, str]]:
        """Emits a turn: what each statement that stores is to store of the register that begins with ``row``.

        What is ``ahead`` of it is asked for.
        """
        self.begin(row)
        for place in self.ahead:
            self.fetch(place)
        self.kept = {key: {} for key in self.plan.kept}
        for (key, at), place in self.memory.items():
            self.kept[key][at] = self.w.emit(f"load {self.type}, ptr {place}")
        self.take_over()
        stores = [stmt for stmt in self.plan.body if isinstance(stmt, lir.Store)]
        results = [(stmt, self.value(stmt.value, 0, 0)) for stmt in stores]
        for (key, at), place in self.memory.items():
            self.w.do(f"store {self.type} {self.kept[key][at + self.plan.lanes]}, ptr {place}")
        return results

    def stream(self, results: Sequence[tuple[lir.Store, str]]) -> None:
        """Stores what a turn gave past the cache."""
        for stmt, value in results:
            place, note = self.place(stmt.slot, stmt.index, 0), self.e.module.note("!{{i32 1}}")
            self.w.do(f"store {self.type} {value}, ptr {place}, align {REGISTER_BYTES}, !nontemporal {note}")

    def carried(self, key: Key) -> list[int]:
        """Which registers of what is kept are those of the turn before: by the shift of their first row."""
        low, high = self.plan.kept[key]
        lanes = self.plan.lanes
        return [at for at in (-lanes, 0) if (at < 0 and low < 0) or (at == 0 and high > 0)]

    def take_over(self) -> None:
        """Computes the next register of all that is kept."""
        lanes = self.plan.lanes
        for key in self.plan.made:
            if key in self.plan.kept:
                last = lanes if self.plan.kept[key][1] > 0 else 0
                self.kept[key][last] = self.compute(key, last)
                self.kept[key].setdefault(0, self.kept[key][last])

    def fetch(self, ahead: lir.RowPlace) -> None:
        """Asks for what rows some way behind will read, into the second cache."""
        self.w.declare("void @llvm.prefetch.p0(ptr, i32, i32, i32)")
        line = self.place(ahead.slot, ahead.row, FETCHED_AHEAD * 8 // ahead.slot.type.bits)
        self.w.do(f"call void @llvm.prefetch.p0(ptr {line}, i32 0, i32 2, i32 1)")

    def fix_places(self, start: str) -> None:
        """Emits the addresses of what the row 0 would read and write, from those of ``start``: in the loop all are so
        many rows further, so that a single number is to be counted."""
        places = [(place.slot, place.row) for place in self.ahead]
        for stmt in self.plan.body:
            match stmt:
                case lir.Let(_, lir.Load(slot, index)) | lir.Store(slot, index):
                    places.append((slot, index))
                case _:
                    pass
        back = self.w.emit(f"mul i64 {start}, {-self.plan.scalar.bits // 8}")
        for slot, index in places:
            if self.plan.names.of(index).shift is not None and (slot.number, index) not in self.places:
                at = f"%slot{slot.number}, i64 {self.e.value(index)}"
                at = self.w.emit(f"getelementptr {ops.memory_type(slot.type)}, ptr {at}")
                self.places[slot.number, index] = self.w.emit(f"getelementptr i8, ptr {at}, i64 {back}")

    def place(self, slot: lir.Slot, index: lir.Value, later: int) -> str:
        """The address of what is at ``index`` in the row ``later`` than the first of the register."""
        size = self.plan.scalar.bits // 8
        row = self.w.emit(f"mul i64 {self.row}, {size}")
        first = self.w.emit(f"getelementptr i8, ptr {self.places[slot.number, index]}, i64 {row}")
        return self.w.emit(f"getelementptr i8, ptr {first}, i64 {later * size}")

    def begin(self, row: str) -> None:
        """Emits what is the same in all rows, and addresses, for the register that begins at ``row``."""
        self.row = self.e.temps[self.counter.number] = row
        self.kept, self.computed, self.invariant = {}, {}, {}
        for stmt in self.plan.body:
            if isinstance(stmt, lir.Let):
                number = stmt.temp.number
                if self.plan.names.known[number].shift is None or number in self.plan.names.linear:
                    self.e.statement(stmt)

    # ---- Values ----

    def value(self, value: lir.Value, shift: int, made_for: int) -> str:
        """A register of ``value``, which something names that is made for ``made_for`` and wanted for ``shift``."""
        known = self.plan.names.of(value)
        if known.shift is not None:
            return self.at(known.key, known.shift + shift - made_for)
        if known.key not in self.invariant:
            self.invariant[known.key] = self._broadcast(self.e.value(value))
        return self.invariant[known.key]

    def at(self, key: Key, shift: int) -> str:
        """A register of what is named ``key``, of rows ``shift`` later."""
        held, lanes = self.kept.get(key, {}), self.plan.lanes
        if shift in held:
            return held[shift]
        first = shift // lanes * lanes
        if (key, shift) not in self.computed and first in held and first + lanes in held:
            order = ", ".join(f"i32 {shift - first + k}" for k in range(lanes))
            both = f"{self.type} {held[first]}, {self.type} {held[first + lanes]}"
            self.computed[key, shift] = self.w.emit(f"shufflevector {both}, <{lanes} x i32> <{order}>")
        return self.compute(key, shift)

    def compute(self, key: Key, shift: int) -> str:
        """As ``at``, whatever is kept."""
        if (key, shift) not in self.computed:
            let, made_for = self.plan.made[key]
            self.computed[key, shift] = self._made(let, shift, made_for)
        return self.computed[key, shift]

    def _made(self, let: lir.Let, shift: int, made_for: int) -> str:
        def part(value: lir.Value) -> str:
            return self.value(value, shift, made_for)

        flags, t = self.e.flags, self.type
        match let.operation:
            case lir.Load(slot, index):
                return self._load(slot, index, shift - made_for)
            case lir.Unary(_, operand):
                return self.w.emit(f"fneg{flags} {t} {part(operand)}")
            case lir.Binary(op, left, right):
                return self.w.emit(f"{_BINARY[op]}{flags} {t} {part(left)}, {part(right)}")
            case lir.Math(function, values):
                name = f"{_MATH[function]}.v{self.plan.lanes}f{self.plan.scalar.bits}"
                self.w.declare(f"{t} @{name}({t})")
                return self.w.emit(f"call{flags} {t} @{name}({t} {part(values[0])})")
            case _:
                raise AssertionError("not planned")

    def _load(self, slot: lir.Slot, index: lir.Value, later: int) -> str:
        place = self.place(slot, index, later)
        return self.w.emit(f"load {self.type}, ptr {place}, align {plan_align(self.plan)}")

    def _broadcast(self, scalar: str) -> str:
        element, lanes = ops.llvm_type(self.plan.scalar), self.plan.lanes
        one = self.w.emit(f"insertelement {self.type} poison, {element} {scalar}, i64 0")
        return self.w.emit(f"shufflevector {self.type} {one}, {self.type} poison, <{lanes} x i32> zeroinitializer")


def plan_align(plan: Registers) -> int:
    """The alignment of elements."""
    return plan.scalar.bits // 8


def put_rows(e: Emitter, plan: Registers, value: str, place: str, row: str, rows: tuple[str, str]) -> None:
    """Puts those of ``rows`` that are in a register to where the register belongs; it begins with ``row``."""
    lanes, type_ = plan.lanes, f"<{plan.lanes} x {ops.llvm_type(plan.scalar)}>"
    numbers = f"<{lanes} x i64> <" + ", ".join(f"i64 {k}" for k in range(lanes)) + ">"
    masks = list[str]()
    for how, at in zip(("sge", "slt"), rows, strict=True):
        number = e.w.emit(f"sub i64 {at}, {row}")
        one = e.w.emit(f"insertelement <{lanes} x i64> poison, i64 {number}, i64 0")
        all_ = f"shufflevector <{lanes} x i64> {one}, <{lanes} x i64> poison, <{lanes} x i32> zeroinitializer"
        masks.append(e.w.emit(f"icmp {how} {numbers}, {e.w.emit(all_)}"))
    mask = e.w.emit(f"and <{lanes} x i1> {masks[0]}, {masks[1]}")
    name = f"llvm.masked.store.v{lanes}f{plan.scalar.bits}.p0"
    e.w.declare(f"void @{name}({type_}, ptr, i32, <{lanes} x i1>)")
    e.w.do(f"call void @{name}({type_} {value}, ptr {place}, i32 {plan_align(plan)}, <{lanes} x i1> {mask})")
