"""The statements and operations of LIR as LLVM IR, in the function that is being written.

What a row loop, a failure and a variable of a group are differs between a thread that takes a block of rows
(``block``) and a group of threads (``group``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from ebb.backends.llvm import atomics, ops
from ebb.backends.llvm.hooks import Strips
from ebb.backends.llvm.lanes import Flags, emit_strips
from ebb.backends.llvm.products import emit_products, plan_products
from ebb.backends.llvm.strides import meets_itself
from ebb.backends.llvm.strips import plan_strips
from ebb.backends.llvm.unroll import FULLY, is_unrolled
from ebb.backends.llvm.vector_math import VectorForms
from ebb.backends.llvm.writer import FunctionWriter, ModuleWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import variable_reads

_FUSED = " contract"
_REGROUPED = " reassoc nsz contract"
"""The flags of sums whose order means nothing, where several turns of a loop or rows are computed at once."""

AS_IT_IS = ('!"llvm.loop.isvectorized", i32 1', '!"llvm.loop.unroll.disable"')
"""What tells LLVM to leave a loop alone: that it is vectorised, and that it is not to be unrolled."""

NO_VECTORS = '!"llvm.loop.vectorize.enable", i1 false'
"""What keeps LLVM from making vectors of the turns of a loop."""


class StatementEmitter(ABC):
    """Emits the statements of one function."""

    def __init__(self, program: lir.Program, module: ModuleWriter, memory: str = "") -> None:
        """Begins a function.

        Args:
            program: what it is of.
            module: what it is for.
            memory: the address space of slots.
        """
        self.program = program
        self.module = module
        self.memory = memory
        self.w = FunctionWriter(module)
        fast = program.precision is lir.Precision.FAST
        self.flags = module.hooks.fast if fast else _FUSED
        self.sum_flags = self.flags if fast or module.hooks.groups is not None else _REGROUPED
        self.forms: VectorForms = {}
        self.variable_reads = variable_reads((*program.block, *program.finish))
        self.temps: dict[int, str] = {program.block_number.number: "%block"}
        self.vars: dict[int, str] = {}
        self.labels: dict[int, str] = {}
        self.access_group: str | None = None

    def value(self, value: lir.Value) -> str:
        """The name or literal of ``value``."""
        match value:
            case lir.Temp(number, _):
                return self.temps[number]
            case lir.Literal(literal, scalar):
                return ops.literal(literal, scalar)

    # ---- Operations ----

    def operation(self, operation: lir.Operation, result: lir.Temp) -> str:  # noqa: C901 - one case a kind of operation
        """What ``operation`` gives."""
        value, w = self.value, self.w
        match operation:
            case lir.Unary(op, operand):
                return ops.unary(w, op, result.type, value(operand), self.flags)
            case lir.Binary(op, left, right):
                return ops.binary(w, op, result.type, value(left), value(right), self.flags)
            case lir.Compare(op, left, right):
                return ops.compare(w, op, left.type, value(left), value(right))
            case lir.Select(condition, then, other):
                t = ops.llvm_type(result.type)
                return w.emit(f"select i1 {value(condition)}, {t} {value(then)}, {t} {value(other)}")
            case lir.Convert(operand):
                return ops.convert(w, operand.type, result.type, value(operand))
            case lir.Math(function, operands):
                forms = self.forms.get((function, result.type.bits), ())
                return ops.math(w, function, result.type, tuple(value(x) for x in operands), self.flags, forms)
            case lir.Load(slot, index):
                return self.load(slot, value(index))
            case lir.LoadVar(var, index):
                return self.load_var(var, value(index))
            case lir.LoadArgument(argument):
                name = f"%argument{argument.number}"
                is_bool = ops.memory_type(argument.type) != ops.llvm_type(argument.type)
                return w.emit(f"icmp ne i8 {name}, 0") if is_bool else name
            case lir.ThreadNumber():
                return "%thread"

    def load(self, slot: lir.Slot, index: str) -> str:
        """An element of a slot."""
        memory = ops.memory_type(slot.type)
        loaded = self.w.emit(f"load {memory}, ptr{self.memory} {self.element(slot, index)}{self.group()}")
        return loaded if memory == ops.llvm_type(slot.type) else self.w.emit(f"icmp ne i8 {loaded}, 0")

    def element(self, slot: lir.Slot, index: str) -> str:
        """The address of an element of a slot."""
        base = f"ptr{self.memory} %slot{slot.number}"
        return self.w.emit(f"getelementptr inbounds {ops.memory_type(slot.type)}, {base}, i64 {index}")

    def load_var(self, var: lir.Var, index: str) -> str:
        """A component of a variable."""
        return self.w.emit(f"load {ops.llvm_type(var.type)}, ptr {self.component(var, index)}")

    def component(self, var: lir.Var, index: str) -> str:
        """The address of a component of a private variable."""
        return self.w.emit(
            f"getelementptr inbounds {ops.llvm_type(var.type)}, ptr {self.vars[var.number]}, i64 {index}"
        )

    def group(self) -> str:
        """What says of an access that it is of a loop over independent rows."""
        return f", !llvm.access.group {self.access_group}" if self.access_group else ""

    # ---- Statements ----

    def body(self, body: lir.Body) -> None:
        """Emits the statements of ``body``."""
        for stmt in body:
            self.statement(stmt)

    def statement(self, stmt: lir.Stmt) -> None:  # noqa: C901 - one case a kind of statement
        """Emits ``stmt``."""
        match stmt:
            case lir.Let(temp, operation):
                self.temps[temp.number] = self.operation(operation, temp)
            case lir.Declare(var):
                self.declare(var)
            case lir.StoreVar(var, index, value):
                self.store_var(var, self.value(index), self.value(value))
            case lir.Store(slot, index, value):
                self.store(slot, self.value(index), self.value(value))
            case lir.AtomicUpdate(slot, index, op, value):
                place = f"ptr{self.memory} {self.element(slot, self.value(index))}"
                atomics.update(self.w, op, slot.type, place, self.value(value))
            case lir.Accumulate():
                self.add_to(stmt.var, self.value(stmt.index), stmt.op, self.value(stmt.value))
            case lir.If():
                self.if_(stmt)
            case lir.For():
                self.for_(stmt)
            case lir.While():
                self.while_(stmt)
            case lir.Block(label, body):
                end = self.labels[label.number] = self.w.fresh(label.name)
                self.body(body)
                self.w.branch(end)
                self.w.start(end)
            case lir.Leave(label):
                self.w.branch(self.labels[label.number])
                self.w.start(self.w.fresh("dead"))
            case lir.RowLoop():
                self.row_loop(stmt)
            case lir.Barrier():
                self.barrier()
            case lir.Fail(site, position, payload):
                self.fail(site, position, payload)
            case lir.Print():
                self.print(stmt)

    def declare(self, var: lir.Var) -> None:
        """Makes ``var``."""
        t = ops.llvm_type(var.type)
        if var.number not in self.vars:
            self.vars[var.number] = self.w.allocate(f"[{var.size} x {t}]")
        self.w.do(f"store [{var.size} x {t}] zeroinitializer, ptr {self.vars[var.number]}")

    def store_var(self, var: lir.Var, index: str, value: str) -> None:
        """Stores a component of a variable."""
        self.w.do(f"store {ops.llvm_type(var.type)} {value}, ptr {self.component(var, index)}")

    def store(self, slot: lir.Slot, index: str, stored: str) -> None:
        """Stores an element of a slot."""
        memory = ops.memory_type(slot.type)
        if memory != ops.llvm_type(slot.type):
            stored = self.w.emit(f"zext i1 {stored} to i8")
        self.w.do(f"store {memory} {stored}, ptr{self.memory} {self.element(slot, index)}{self.group()}")

    def add_to(self, place: lir.Slot | lir.Var, index: str, op: str, value: str) -> None:
        """``place[index] = place[index] op value``, in any grouping of the values that are added."""
        match place:
            case lir.Slot():
                after = ops.binary(self.w, op, place.type, self.load(place, index), value, self.sum_flags)
                self.store(place, index, after)
            case lir.Var():
                after = ops.binary(self.w, op, place.type, self.load_var(place, index), value, self.sum_flags)
                self.store_var(place, index, after)

    def if_(self, stmt: lir.If) -> None:
        """One of two bodies."""
        then, orelse, end = (self.w.fresh(stem) for stem in ("then", "else", "end"))
        self.w.branch_if(self.value(stmt.condition), then, orelse if stmt.orelse else end)
        self.w.start(then)
        self.body(stmt.then)
        self.w.branch(end)
        if stmt.orelse:
            self.w.start(orelse)
            self.body(stmt.orelse)
            self.w.branch(end)
        self.w.start(end)

    def while_(self, stmt: lir.While) -> None:
        """A loop whose turns are not counted."""
        head, turn, done = (self.w.fresh(stem) for stem in ("head", "turn", "done"))
        self.w.branch(head)
        self.w.start(head)
        self.body(stmt.head)
        self.w.branch_if(self.value(stmt.condition), turn, done)
        self.w.start(turn)
        self.body(stmt.body)
        notes = self.loop_notes(NO_VECTORS) if self.must_not_be_vectors((*stmt.head, *stmt.body)) else ""
        self.w.do(f"br label %{head}{notes}")
        self.w.start(done)

    def for_(self, stmt: lir.For) -> None:
        """In registers where the order of the turns means nothing, the target is for it, and the body is fit."""
        plan = None
        if stmt.turns is lir.Turns.ANY_ORDER and self.module.hooks.strips is Strips.MASKED:
            products = plan_products(stmt)
            if products is not None:
                emit_products(self, stmt, products, self.loop_notes(*AS_IT_IS))
                return
            plan = plan_strips(stmt, self.variable_reads, self.module.hooks.vector_math)
        if plan is None:
            notes = [FULLY] if self.module.hooks.groups is None and is_unrolled(stmt) else []
            if self.must_not_be_vectors(stmt.body, stmt.counter):
                notes.append(NO_VECTORS)
            metadata = self.loop_notes(*notes) if notes else ""
            self.count(stmt.counter, self.value(stmt.start), self.value(stmt.stop), stmt.body, metadata)
            return
        emit_strips(self, stmt, plan, Flags(self.flags, self.sum_flags), self.loop_notes(*AS_IT_IS))

    def must_not_be_vectors(self, body: lir.Body, *counters: lir.Temp) -> bool:
        """Whether LLVM must be kept from making vectors of the turns of a loop; on groups it never does."""
        return self.module.hooks.groups is None and meets_itself(body, counters)

    def loop_notes(self, *notes: str) -> str:
        """What says so of a loop, at its end."""
        named = ", ".join(self.module.note(f"!{{{{{note}}}}}") for note in notes)
        return f", !llvm.loop {self.module.note(f'distinct !{{{{{{self}}, {named}}}}}')}"

    def count(self, counter: lir.Temp, start: str, stop: str, body: lir.Body, metadata: str = "") -> None:
        """A loop whose turns are counted, with ``metadata`` at its end."""
        with self.w.loop(start, stop, metadata=metadata, type_=counter.type) as turn:
            self.temps[counter.number] = turn.counter
            self.body(body)

    # ---- What threads and groups do each in their own way ----

    @abstractmethod
    def row_loop(self, stmt: lir.RowLoop) -> None:
        """Runs the body for the rows of the thread."""

    @abstractmethod
    def fail(self, site: int, position: lir.Value, payload: Sequence[lir.Value]) -> None:
        """Tells that the launch has failed, and ends the row."""

    @abstractmethod
    def barrier(self) -> None:
        """Waits for the other threads of the group."""

    # ---- Prints ----

    def print(self, stmt: lir.Print) -> None:
        """Leaves a record, if there is room for it, and counts it."""
        words = [str(stmt.number), self.value(stmt.position)]
        counter = self.word(stmt.slot, str(lir.PRINT_COUNTER))
        record = self.w.emit(f"atomicrmw add {counter}, i64 1{atomics.scope(self.w)} monotonic")
        capacity = self.w.emit(f"load i64, {self.word(stmt.slot, str(lir.PRINT_CAPACITY))}")
        fits, end = self.w.fresh("fits"), self.w.fresh("end")
        self.w.branch_if(self.w.emit(f"icmp ult i64 {record}, {capacity}"), fits, end)
        self.w.start(fits)
        start = self.w.emit(f"mul i64 {record}, {lir.PRINT_HEADER + self.program.print_words}")
        first = self.w.emit(f"add i64 {start}, {lir.PRINT_RECORDS}")
        words += [ops.to_word(self.w, value.type, self.value(value)) for value in stmt.values]
        for number, word in enumerate(words):
            index = self.w.emit(f"add i64 {first}, {number}")
            self.w.do(f"store i64 {word}, {self.word(stmt.slot, index)}")
        self.w.branch(end)
        self.w.start(end)

    def word(self, slot: lir.Slot, index: str) -> str:
        """A pointer to a word of print records."""
        base = f"ptr{self.memory} %slot{slot.number}"
        return f"ptr{self.memory} {self.w.emit(f'getelementptr inbounds i64, {base}, i64 {index}')}"
