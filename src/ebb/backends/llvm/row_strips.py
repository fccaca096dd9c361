"""Loops over rows in strips as LLVM IR: eight rows at once, one a lane.

The last strip begins eight rows before the end; rows in it that have been done are computed again, but neither stored
nor checked. So all lanes read rows that are there, and all rows of a launch round alike, but where it has fewer than
eight. Rows of other relations are loaded a row at a time and transposed, and changed a row at a time, in the order of
lanes. A failure leaves for the plain loop, from the first row of the strip on: all that a strip stores comes after its
last check.
"""

from __future__ import annotations

from collections.abc import Callable

from ebb.backends.llvm import ops
from ebb.backends.llvm.fit import is_failure
from ebb.backends.llvm.lane_ops import NUMBERS_64, LaneWriter, identity, wide, wide_type
from ebb.backends.llvm.lanes import Emitter, Flags
from ebb.backends.llvm.row_memory import RowMemory
from ebb.backends.llvm.row_plan import RowPlan
from ebb.backends.llvm.row_skips import assigned, is_left_out, only_calculates
from ebb.backends.llvm.row_values import Held, Lanes, Place, Same
from ebb.backends.llvm.transpose import LANES
from ebb.compiler import lir
from ebb.compiler.lir_walk import operands
from ebb.types.types import Kind, ScalarType, int64


def emit_row_strips(
    emitter: Emitter, loop: lir.RowLoop, plan: RowPlan, flags: Flags, bounds: tuple[str, str], notes: tuple[str, str]
) -> None:
    """Appends the innermost loop over rows in strips; the function goes on behind it.

    Args:
        emitter: of the function.
        loop: the loop.
        plan: how it runs in strips.
        flags: the fast-math flags of arithmetic and of sums.
        bounds: the first row, and the one behind the last.
        notes: the metadata of the branches that close the strips and the plain loop.
    """
    RowStrips(emitter, loop, plan, flags).emit(*bounds, *notes)


class RowStrips:
    """The body of a loop in strips, and the loop over rows that follow one another."""

    def __init__(self, emitter: Emitter, loop: lir.RowLoop, plan: RowPlan, flags: Flags) -> None:
        self.e, self.w = emitter, emitter.w
        self.v = LaneWriter(self.w, flags.arithmetic)
        self.sum_flags = flags.sums
        self.loop, self.plan = loop, plan
        self.held: dict[int, Held] = {}
        self.private: dict[tuple[int, int], Held] = {}
        self.sums: dict[tuple[int, int, str], tuple[lir.Accumulate, str]] = {}
        self.later: list[Callable[[], None]] = []
        self.checks = plan.checks
        self.mask = ""
        self.nested: bool = False
        self.guards: bool = False  # whether lanes that are not to be done may lead anywhere
        self.memory = RowMemory(emitter, self.v)

    # ---- The loop ----

    def emit(self, low: str, high: str, note: str, plain_note: str) -> None:
        """Appends the strips, and the plain loop for fewer rows and for failures."""
        w, counter = self.w, self.loop.index[-1]
        strip, plain, end = (w.fresh(stem) for stem in ("rows", "plain", "end"))
        self.plain, self.start = plain, w.allocate("i64")
        self.open_sums()
        w.do(f"store i64 {low}, ptr {self.start}")
        last = w.emit(f"sub nsw i64 {high}, {LANES}")
        before, following = w.label, f"%{w.fresh('next')}"
        w.branch_if(w.emit(f"icmp sle i64 {low}, {last}"), strip, plain)
        w.start(strip)
        closed = w.fresh("closed")
        turn = w.emit(f"phi i64 [ {low}, %{before} ], [ {following}, %{closed} ]")
        w.declare("i64 @llvm.smin.i64(i64, i64)")
        row = w.emit(f"call i64 @llvm.smin.i64(i64 {turn}, i64 {last})")
        w.do(f"store i64 {turn}, ptr {self.start}")
        w.remember()
        self.open_strip(row, w.emit(f"sub nsw i64 {turn}, {row}"))
        self.run_strip(counter, row, closed)
        w.do(f"{following} = add nsw i64 {turn}, {LANES}")
        more = w.emit(f"icmp slt i64 {following}, {high}")
        w.do(f"br i1 {more}, label %{strip}, label %{end}{note}")
        w.start(plain)
        first = w.emit(f"load i64, ptr {self.start}")
        self.e.count(counter, first, high, self.loop.body, plain_note)
        w.branch(end)
        w.start(end)
        self.close_sums()

    def open_strip(self, row: str, done: str) -> None:
        """Which lanes are rows that have not been done before."""
        behind = self.v.broadcast("i64", done)
        self.active = self.mask = self.w.emit(f"icmp uge {wide('i64')} {NUMBERS_64}, {behind}")
        self.memory.open("uge", done, self.active)

    def run_strip(self, counter: lir.Temp, first: str, closed: str) -> None:
        """The body for the rows from ``first`` on; what follows is in the block ``closed``."""
        self.held[counter.number] = Place(None, 1, first, 0)
        self.body(self.loop.body)
        self.memory.finish()
        self.w.forget()
        self.w.branch(closed)
        self.w.start(closed)

    def open_sums(self) -> None:
        """Makes a vector for each sum of the loop."""
        for stmt in self.loop.body:
            self.open_sum(stmt)

    def open_sum(self, stmt: lir.Stmt) -> None:
        """Makes the vectors of the sums in ``stmt``."""
        match stmt:
            case lir.Accumulate(var, lir.Literal(k), op, value):
                key = var.number, k, op
                if key not in self.sums:
                    t = wide_type(value.type)
                    self.sums[key] = stmt, self.w.allocate(t)
                    self.w.do(f"store {t} {identity(op, value.type)}, ptr {self.sums[key][1]}")
            case lir.If(_, then, orelse):
                for inner in (*then, *orelse):
                    self.open_sum(inner)
            case _:
                pass

    def close_sums(self) -> None:
        """Adds the lanes of each sum to its variable."""
        for stmt, place in self.sums.values():
            scalar = stmt.value.type
            lanes = self.w.emit(f"load {wide_type(scalar)}, ptr {place}")
            total = self.v.reduce(stmt.op, scalar, lanes)
            self.e.add_to(stmt.var, self.e.value(stmt.index), stmt.op, total)

    # ---- Statements ----

    def body(self, body: lir.Body) -> None:
        """Emits the statements of ``body``."""
        for stmt in body:
            match stmt:
                case lir.Let(temp, operation):
                    self.let(temp, operation)
                case lir.Declare(var):
                    zero = ops.literal(0, var.type) if var.type.kind is not Kind.BOOL else "false"
                    self.private.update({(var.number, k): Same(zero) for k in range(var.size)})
                case lir.StoreVar(var, lir.Literal(k), value):
                    self.private[var.number, k] = self.chosen(value, self.private[var.number, k])
                case lir.If() if is_failure(stmt):
                    self.leave_on_failure(stmt)
                case lir.If(condition, then, orelse):
                    self.branches(condition, then, orelse)
                case lir.Store():
                    self.store(stmt)
                case lir.Accumulate():
                    self.after_checks(lambda stmt=stmt, mask=self.mask: self.accumulate(stmt, mask))
                case _:
                    raise AssertionError(stmt)

    def chosen(self, value: lir.Value, before: Held) -> Held:
        """``value``, and in lanes that do not come here what was there before."""
        if not self.nested:
            return self.of(value)
        old = self.vector(before, value.type)
        return Lanes(self.v.select(self.mask, value.type, self.wide(value), old))

    def branches(self, condition: lir.Value, then: lir.Body, orelse: lir.Body) -> None:
        """Both sides, each under its own mask."""
        around = self.mask, self.nested
        holds = self.wide(condition)
        for side, body in ((holds, then), (self.v.inverted(holds) if orelse else "", orelse)):
            if body:
                # Lanes that are not to be done may calculate too: to ask which these are takes longer.
                anywhere = not around[1] and only_calculates(body)
                self.mask, self.nested = side if anywhere else self.v.both(around[0], side), True
                if is_left_out(body):
                    self.unless_nobody(body)
                else:
                    self.body(body)
        self.mask, self.nested = around

    def unless_nobody(self, body: lir.Body) -> None:
        """A side of a condition, if some lane takes it."""
        before = {(var, k): self.vector(self.private[var.number, k], var.type) for var, k in assigned(body)}
        w, some = self.w, self.v.any(self.mask)
        taken, joined, skipped = w.fresh("taken"), w.fresh("joined"), w.label
        # Likely not, or LLVM would rather compute it for nobody.
        likely = w.module.note('!{{!"branch_weights", i32 1, i32 2000}}')
        w.do(f"br i1 {some}, label %{taken}, label %{joined}, !prof {likely}")
        w.start(taken)
        with self.memory.apart():
            self.body(body)
            after = {(var, k): self.vector(self.private[var.number, k], var.type) for var, k in before}
        last = w.label
        w.branch(joined)
        w.start(joined)
        for (var, k), old in before.items():
            t, new = wide_type(var.type), after[var, k]
            self.private[var.number, k] = Lanes(w.emit(f"phi {t} [ {old}, %{skipped} ], [ {new}, %{last} ]"))

    def leave_on_failure(self, stmt: lir.If) -> None:
        """To the plain loop if some row fails that has not been done."""
        condition, held = self.wide(stmt.condition), self.w.fresh("held")
        failing = condition if stmt.then else self.v.inverted(condition)
        some = self.v.any(self.v.both(self.mask, failing))
        self.w.branch_if(some, self.plain, held)
        self.w.start(held)
        self.checks -= 1
        if not self.checks:
            for action in self.later:
                action()
            self.later = []

    def after_checks(self, action: Callable[[], None]) -> None:
        """Does ``action`` once nothing can fail any more."""
        if self.checks:
            self.later.append(action)
        else:
            action()

    def store(self, stmt: lir.Store) -> None:
        """Stores into the own row, or changes another."""
        place = self.place(stmt.index)
        update = self.plan.updates.get(id(stmt))
        if update is not None:
            op, scalar, value = update.op, update.value.type, self.wide(update.value)
            nothing = identity(op, scalar)
            masked = self.v.select(self.active, scalar, value, nothing)
            self.after_checks(lambda: self.memory.change(stmt.slot, place, op, masked))
            return
        held = self.chosen(stmt.value, self.memory.load(stmt.slot, place)) if self.nested else self.of(stmt.value)
        value = self.vector(held, stmt.value.type)
        self.memory.forward(stmt.slot, place, value)
        self.after_checks(lambda: self.memory.store(stmt.slot, place, value))

    def accumulate(self, stmt: lir.Accumulate, mask: str) -> None:
        """Adds the lanes in ``mask`` to those of a sum."""
        assert isinstance(stmt.index, lir.Literal)
        place, scalar = self.sums[stmt.var.number, stmt.index.value, stmt.op][1], stmt.value.type
        t = wide_type(scalar)
        value = self.v.select(mask, scalar, self.wide(stmt.value), identity(stmt.op, scalar))
        old = self.w.emit(f"load {t}, ptr {place}")
        new = self.v.binary(stmt.op, scalar, old, value, self.sum_flags)
        self.w.do(f"store {t} {new}, ptr {place}")

    # ---- Operations ----

    def let(self, temp: lir.Temp, operation: lir.Operation) -> None:
        """Notes what ``operation`` gives."""
        if temp.number in self.plan.skipped:
            return
        held = self.result(temp, operation)
        self.held[temp.number] = held

    def result(self, temp: lir.Temp, operation: lir.Operation) -> Held:
        """What ``operation`` gives."""
        match operation:
            case lir.Load(slot, index):
                return self.load(slot, self.place(index))
            case lir.LoadVar(var, lir.Literal(k)):
                return self.private[var.number, k]
            case lir.LoadArgument():
                return Same(self.e.operation(operation, temp))
            case lir.Binary(op, left, right) if temp.type == int64 and op in ("+", "-", "*"):
                placed = self.memory.combined(op, self.of(left), self.of(right))
                return placed or self.computed(temp, operation)
            case lir.Convert(operand) if temp.type == int64 and operand.type.kind is Kind.SIGNED:
                held = self.of(operand)
                return held if isinstance(held, Place) else self.computed(temp, operation)
            case _:
                return self.computed(temp, operation)

    def load(self, slot: lir.Slot, place: Place) -> Held:
        """What lies at ``place``, which lanes that are off may not lead to."""
        if (self.nested or self.guards) and place.root is not None:
            place = self.memory.guarded(place, self.mask)
        return self.memory.load(slot, place)

    def computed(self, temp: lir.Temp, operation: lir.Operation) -> Held:
        """On scalars where all lanes have the same operands, else on vectors."""
        values = operands(operation)
        scalars = [self.scalar(value) for value in values]
        if None not in scalars:
            for value, name in zip(values, scalars, strict=True):
                if isinstance(value, lir.Temp):
                    self.e.temps[value.number] = name or ""
            return Same(self.e.operation(operation, temp))
        return Lanes(self.in_lanes(operation, temp.type))

    def in_lanes(self, operation: lir.Operation, scalar: ScalarType) -> str:
        """What ``operation`` gives in each lane."""
        match operation:
            case lir.Binary(">>", left, right):
                bits = self.scalar(right) or ""
                t = ops.llvm_type(scalar)
                self.w.declare(f"{t} @llvm.umin.{t}({t}, {t})")
                amount = self.w.emit(f"call {t} @llvm.umin.{t}({t} {bits}, {t} {scalar.bits - 1})")
                return self.w.emit(f"ashr {wide(t)} {self.wide(left)}, {self.v.broadcast(t, amount)}")
            case _:
                return self.v.operation(operation, scalar, self.wide)

    # ---- Values ----

    def of(self, value: lir.Value) -> Held:
        """What is held for ``value``."""
        if isinstance(value, lir.Temp):
            return self.held[value.number] if value.number in self.held else Same(self.e.temps[value.number])
        return Same(ops.literal(value.value, value.type))

    def scalar(self, value: lir.Value) -> str | None:
        """The value that all lanes have in common, if they have."""
        match self.of(value):
            case Same(name):
                return name
            case Place(scale=0) as place:
                return self.memory.scalar(place)
            case _:
                return None

    def place(self, index: lir.Value) -> Place:
        """An index as a place."""
        return self.memory.as_place(self.of(index))

    def wide(self, value: lir.Value) -> str:
        """The lanes of ``value``."""
        if isinstance(value, lir.Literal):
            return f"splat ({ops.llvm_type(value.type)} {ops.literal(value.value, value.type)})"
        return self.vector(self.of(value), value.type)

    def vector(self, held: Held, scalar: ScalarType) -> str:
        """The lanes of what is held."""
        match held:
            case Same(name):
                return self.v.broadcast(ops.llvm_type(scalar), name)
            case Lanes(name):
                return name
            case Place():
                return self.memory.integers(held, scalar)
            case _:
                return self.memory.loaded(held)
