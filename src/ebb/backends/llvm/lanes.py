"""Loops in strips as LLVM IR: several turns at once, one a lane, the turns beyond the end masked off.

Lanes beyond the end compute what the first lane does, so that they read and fail as some turn does; only sums know of
the mask. What belongs to another row is loaded a row at a time and transposed, which beats the gather instructions of
the processors at hand by far. A failure leaves the strip for the plain loop, from its first turn on, which then fails
in the right turn: a strip has changed nothing yet.
"""

from __future__ import annotations

from typing import Protocol

from ebb.backends.llvm import ops
from ebb.backends.llvm.fit import is_failure
from ebb.backends.llvm.lane_ops import MASK, NUMBERS, LaneWriter, identity, suffix, wide, wide_type
from ebb.backends.llvm.strips import PlaceKey, RowLoad, StripPlan, Sum, Update
from ebb.backends.llvm.transpose import LANES, transposed, width_of
from ebb.backends.llvm.writer import Carried, FunctionWriter
from ebb.compiler import lir
from ebb.records import record
from ebb.types.types import Kind, ScalarType


@record
class Flags:
    """The fast-math flags of arithmetic, and of sums whose order means nothing."""

    arithmetic: str
    sums: str


class Emitter(Protocol):
    """What emits the scalar code around and inside a strip."""

    w: FunctionWriter
    temps: dict[int, str]

    def value(self, value: lir.Value) -> str:
        """The name or literal of a scalar."""
        ...

    def operation(self, operation: lir.Operation, result: lir.Temp) -> str:
        """Emits a scalar operation."""
        ...

    def element(self, slot: lir.Slot, index: str) -> str:
        """The address of an element of a slot."""
        ...

    def load(self, slot: lir.Slot, index: str) -> str:
        """Loads an element of a slot."""
        ...

    def add_to(self, place: lir.Slot | lir.Var, index: str, op: str, value: str) -> None:
        """``place[index] = place[index] op value``."""
        ...

    def count(self, counter: lir.Temp, start: str, stop: str, body: lir.Body, metadata: str = "") -> None:
        """Emits a plain loop."""
        ...


def emit_strips(emitter: Emitter, loop: lir.For, plan: StripPlan, flags: Flags, metadata: str) -> None:
    """Appends ``loop`` in strips; the function goes on behind it.

    Args:
        emitter: of the function.
        loop: the loop.
        plan: how it runs in strips.
        flags: the fast-math flags of arithmetic and of sums.
        metadata: of the branch that closes the loop.
    """
    _Strip(emitter, loop, plan, flags).emit(metadata)


class _Strip:
    """Emits one loop in strips."""

    def __init__(self, emitter: Emitter, loop: lir.For, plan: StripPlan, flags: Flags) -> None:
        self.e, self.w = emitter, emitter.w
        self.v = LaneWriter(self.w, flags.arithmetic)
        self.sum_flags = flags.sums
        self.loop, self.plan = loop, plan
        self.early = {let.temp.number for let in plan.early}
        self.wide: dict[int, str] = {}
        self.narrow: dict[tuple[int, int], str] = {}
        self.stored: dict[int, str] = {}
        self.private: dict[tuple[int, int], str] = {}
        self.sums: dict[PlaceKey, str] = {}
        self.turn = self.mask = self.ahead = ""
        self.nested: bool = False
        self.plain = self.w.fresh("plain")

    # ---- The loop ----

    def emit(self, metadata: str) -> None:
        """Appends the loop; the function goes on behind it."""
        w, e, loop = self.w, self.e, self.loop
        start, stop = e.value(loop.start), e.value(loop.stop)
        for let in self.plan.early:
            e.temps[let.temp.number] = e.operation(let.operation, let.temp)
        some, end = w.fresh("some"), w.fresh("end")
        # Without turns nothing is stored either: rows that run at once may have that place in common.
        w.branch_if(w.emit(f"icmp slt i64 {start}, {stop}"), some, end)
        w.start(some)
        carried = {key: self.carried(sum_) for key, sum_ in self.plan.sums.items()}
        with w.loop(start, stop, LANES, metadata, carried=tuple(carried.values()), label="strip") as strip:
            self.turn, entered = strip.counter, dict(zip(carried, strip.carried, strict=True))
            self.sums = dict(entered)
            self.open_strip(stop)
            self.body(loop.body)
            for key, each in carried.items():
                new, old = (f"{each.type} {lanes[key]}" for lanes in (self.sums, entered))
                w.do(f"{each.last} = select {MASK} {self.mask}, {new}, {old}")
        for key, sum_ in self.plan.sums.items():
            total = self.v.reduce(sum_.op, sum_.place.type, entered[key])
            e.add_to(sum_.place, e.value(sum_.index), sum_.op, total)
        w.branch(end)
        if self.plan.fails:
            w.start(self.plain)
            e.count(loop.counter, start, stop, loop.body)
            w.branch(end)
        w.start(end)

    def carried(self, sum_: Sum) -> Carried:
        """The lanes of a sum, which strips hand on."""
        scalar = sum_.place.type
        return Carried(wide_type(scalar), identity(sum_.op, scalar), f"%{self.w.fresh('grown')}")

    def open_strip(self, stop: str) -> None:
        """The mask of the strip, and how far ahead of the first turn each lane is: not at all beyond the end."""
        w, t = self.w, wide("i32")
        w.declare("i64 @llvm.umin.i64(i64, i64)")
        left = w.emit(f"sub nsw i64 {stop}, {self.turn}")
        count = w.emit(f"trunc i64 {w.emit(f'call i64 @llvm.umin.i64(i64 {left}, i64 {LANES})')} to i32")
        self.mask = w.emit(f"icmp ult {t} {NUMBERS}, {self.v.broadcast('i32', count)}")
        self.ahead = w.emit(f"select {MASK} {self.mask}, {t} {NUMBERS}, {t} zeroinitializer")
        self.e.temps[self.loop.counter.number] = self.turn
        self.narrow[self.loop.counter.number, 0] = self.turn

    # ---- Statements ----

    def body(self, body: lir.Body) -> None:
        for stmt in body:
            match stmt:
                case lir.Let(temp, operation):
                    self.let(temp, operation)
                case lir.Declare(var):
                    self.private.update({(var.number, k): "zeroinitializer" for k in range(var.size)})
                case lir.If() if is_failure(stmt):
                    self.leave_on_failure(stmt)
                case lir.If(condition, then, orelse):
                    self.branches(condition, then, orelse)
                case lir.StoreVar(var, lir.Literal(k), value) if id(stmt) not in self.plan.updates:
                    self.assign((var.number, k), value)
                case _:
                    self.add(self.plan.updates[id(stmt)])

    def assign(self, component: tuple[int, int], value: lir.Value) -> None:
        new, old = self.value(value), self.private.get(component)
        if self.nested and old is not None:
            new = self.v.select(self.mask, value.type, new, old)
        self.private[component] = new

    def add(self, update: Update) -> None:
        old, scalar = self.sums[update.key], update.value.type
        new = self.v.binary(update.op, scalar, old, self.value(update.value), self.sum_flags)
        self.sums[update.key] = self.v.select(self.mask, scalar, new, old) if self.nested else new

    def branches(self, condition: lir.Value, then: lir.Body, orelse: lir.Body) -> None:
        """Both sides, each under its own mask."""
        around = self.mask, self.nested
        holds = self.value(condition)
        fails = self.v.inverted(holds) if orelse else ""
        for side, body in ((holds, then), (fails, orelse)):
            if body:
                self.mask, self.nested = self.v.both(around[0], side), True
                self.body(body)
        self.mask, self.nested = around

    def leave_on_failure(self, stmt: lir.If) -> None:
        """To the plain loop if some turn fails."""
        condition, held = self.value(stmt.condition), self.w.fresh("held")
        failing = condition if stmt.then else self.v.inverted(condition)
        self.w.branch_if(self.v.any(self.v.both(self.mask, failing)), self.plain, held)
        self.w.start(held)

    # ---- Operations ----

    def let(self, temp: lir.Temp, operation: lir.Operation) -> None:
        number = temp.number
        if number in self.plan.skipped or number in self.plan.members or number in self.early:
            return
        if number not in self.plan.varying:
            self.e.temps[number] = self.uniform(temp, operation)
            return
        match operation:
            case lir.Load():
                self.load_row(self.plan.rows[number])
            case lir.LoadVar(var, lir.Literal(k)):
                self.wide[number] = self.private[var.number, k]
            case _ if not _is_address(operation, temp.type):
                self.wide[number] = self.operation(operation, temp.type)
            case _:
                pass  # computed where it is wanted: for all lanes, or lane by lane for an address

    def uniform(self, temp: lir.Temp, operation: lir.Operation) -> str:
        """What does not vary. A load that perhaps no turn asks for reads the first element then."""
        if isinstance(operation, lir.Load) and self.nested:
            asked = self.v.any(self.mask)
            index = self.w.emit(f"select i1 {asked}, i64 {self.e.value(operation.index)}, i64 0")
            return self.e.load(operation.slot, index)
        return self.e.operation(operation, temp)

    def value(self, value: lir.Value) -> str:
        """The lanes of ``value``."""
        if isinstance(value, lir.Literal):
            return f"splat ({ops.llvm_type(value.type)} {ops.literal(value.value, value.type)})"
        number = value.number
        if number not in self.plan.varying:
            return self.v.broadcast(ops.llvm_type(value.type), self.e.value(value))
        if number not in self.wide:
            counts = number == self.loop.counter.number
            self.wide[number] = self.counters() if counts else self.operation(self.plan.definitions[number], value.type)
        return self.wide[number]

    def counters(self) -> str:
        ahead = self.w.emit(f"zext nneg {wide('i32')} {self.ahead} to {wide('i64')}")
        return self.w.emit(f"add {wide('i64')} {self.v.broadcast('i64', self.turn)}, {ahead}")

    def operation(self, operation: lir.Operation, scalar: ScalarType) -> str:
        return self.v.operation(operation, scalar, self.value)

    # ---- Addresses, lane by lane ----

    def lane(self, value: lir.Value, k: int) -> str:
        """Lane ``k`` of an integer, computed from its operands' lanes where that is simple arithmetic."""
        if not isinstance(value, lir.Temp) or value.number not in self.plan.varying:
            return self.e.value(value)
        key = value.number, k
        if key not in self.narrow:
            self.narrow[key] = self.computed_lane(value, k)
        return self.narrow[key]

    def computed_lane(self, value: lir.Temp, k: int) -> str:
        w, t = self.w, ops.llvm_type(value.type)
        if value.number == self.loop.counter.number:
            ahead = self.reloaded(value.number, "i32", k)
            return w.emit(f"add nsw i64 {self.turn}, {w.emit(f'zext nneg i32 {ahead} to i64')}")
        operation = self.plan.definitions[value.number]
        match operation:
            case lir.Binary(op, left, right) if _is_address(operation, value.type):
                return w.emit(f"{ops.regular(op, value.type)} {t} {self.lane(left, k)}, {self.lane(right, k)}")
            case lir.Convert(operand) if _is_address(operation, value.type):
                return ops.convert(w, operand.type, value.type, self.lane(operand, k))
            case _:
                return self.reloaded(value.number, t, k)

    def reloaded(self, number: int, t: str, k: int) -> str:
        """Lane ``k`` of a vector, through memory: taking it out of the register costs more than twice as much.

        LLVM would turn plain loads into just that, so they are volatile.
        """
        if number not in self.stored:
            place = self.stored[number] = self.w.allocate(wide(t))
            lanes = self.ahead if number == self.loop.counter.number else self.wide[number]
            self.w.do(f"store {wide(t)} {lanes}, ptr {place}")
        place = self.w.emit(f"getelementptr inbounds {t}, ptr {self.stored[number]}, i64 {k}")
        return self.w.emit(f"load volatile {t}, ptr {place}")

    # ---- Loads ----

    def load_row(self, row: RowLoad) -> None:
        """All loads of a row: what lies side by side for all lanes at once, the rest lane by lane."""
        if self.contiguous(row.root):
            for offset, temp in row.loads:
                self.wide[temp.number] = self.load_contiguous(row, offset, temp)
            return
        wanted = sorted({offset for offset, _ in row.loads})
        columns: dict[int, str] = {}
        while wanted:
            first = wanted[0]
            last = max(offset for offset in wanted if offset < first + 4)
            columns |= self.load_columns(row, first, last - first + 1)
            wanted = [offset for offset in wanted if offset > last]
        for offset, temp in row.loads:
            self.wide[temp.number] = columns[offset]

    def contiguous(self, index: lir.Value) -> bool:
        """Whether ``index`` goes up by one from turn to turn."""
        if not isinstance(index, lir.Temp):
            return False
        if index.number == self.loop.counter.number:
            return True
        match self.plan.definitions.get(index.number):
            case lir.Binary("+", left, right):
                first, second = (left, right) if self.plan.varies(left) else (right, left)
                return not self.plan.varies(second) and self.contiguous(first)
            case _:
                return False

    def load_contiguous(self, row: RowLoad, offset: int, temp: lir.Temp) -> str:
        memory = ops.memory_type(row.slot.type)
        t, place = wide(memory), self.place(row.slot, self.lane(row.root, 0), offset)
        rest = "zeroinitializer"
        if temp.number in self.plan.addressing and not self.nested:
            # The lanes beyond the end look where the first does.
            rest = self.v.broadcast(memory, self.w.emit(f"load {memory}, ptr {place}"))
        name = f"llvm.masked.load.{suffix(row.slot.type) if memory != 'i8' else f'v{LANES}i8'}.p0"
        self.w.declare(f"{t} @{name}(ptr, {MASK}, {t})")
        align = row.slot.type.dtype.itemsize
        loaded = self.w.emit(f"call {t} @{name}(ptr align {align} {place}, {MASK} {self.mask}, {t} {rest})")
        return self.from_memory(row.slot, loaded)

    def place(self, slot: lir.Slot, index: str, offset: int) -> str:
        place = self.e.element(slot, index)
        if not offset:
            return place
        return self.w.emit(f"getelementptr inbounds {ops.memory_type(slot.type)}, ptr {place}, i64 {offset}")

    def from_memory(self, slot: lir.Slot, loaded: str) -> str:
        is_bool = slot.type.kind is Kind.BOOL
        return self.w.emit(f"icmp ne {wide('i8')} {loaded}, zeroinitializer") if is_bool else loaded

    def row_start(self, row: RowLoad, k: int) -> str:
        """Where the row of lane ``k`` begins; the first row in a lane that does not ask for it."""
        if not self.nested and not self.plan.is_loose(row.root):
            return self.lane(row.root, k)
        asked = self.v.extract("i1", self.mask, k)
        first = max(0, -min(offset for offset, _ in row.loads))
        return self.w.emit(f"select i1 {asked}, i64 {self.lane(row.root, k)}, i64 {first}")

    def load_columns(self, row: RowLoad, first: int, columns: int) -> dict[int, str]:
        """``columns`` columns from ``first`` on, at most 4: each lane loads its part of a row."""
        memory, itemsize = ops.memory_type(row.slot.type), row.slot.type.dtype.itemsize
        width = width_of(columns)
        element = memory if width == 1 else f"<{width} x {memory}>"
        parts: list[str] = []
        for k in range(LANES):
            place = self.place(row.slot, self.row_start(row, k), first)
            # The padding behind a buffer takes what is read beyond the last row.
            parts.append(self.w.emit(f"load {element}, ptr {place}, align {itemsize}"))
        turned = transposed(self.w, memory, 8 * itemsize, parts, width)
        return {first + k: self.from_memory(row.slot, turned[k]) for k in range(columns)}


def _is_address(operation: lir.Operation, scalar: ScalarType) -> bool:
    """Whether ``operation`` is arithmetic that an address may be computed by."""
    match operation:
        case lir.Binary("+" | "-" | "*"):
            return scalar.kind in (Kind.SIGNED, Kind.UNSIGNED)
        case lir.Convert(operand):
            integers = (Kind.SIGNED, Kind.UNSIGNED)
            return scalar.kind in integers and operand.type.kind in integers
        case _:
            return False
