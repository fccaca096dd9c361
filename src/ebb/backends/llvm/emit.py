"""LIR to LLVM IR: the function of one block of rows and the function that finishes a launch.

The function of a block gets each slot as a ``noalias`` pointer, since no two slots overlap, and its loop over
independent rows says so to LLVM's vectoriser by access groups.
"""

from __future__ import annotations

from collections.abc import Sequence

from ebb.backends.llvm import atomics, ops
from ebb.backends.llvm.entry import BLOCK_FUNCTION, FINISH_FUNCTION, write_entries
from ebb.backends.llvm.hooks import Hooks, Strips
from ebb.backends.llvm.lanes import Flags, emit_strips
from ebb.backends.llvm.strides import is_unit
from ebb.backends.llvm.strips import plan_strips
from ebb.backends.llvm.vector_math import VectorForms
from ebb.backends.llvm.writer import FunctionWriter, ModuleWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import statements, variable_reads
from ebb.runtime.cpu import PAYLOAD_START

_FLAGS = {
    lir.Precision.CONTRACT: " contract",
    lir.Precision.FAST: " reassoc nsz arcp contract afn",
}
_SUM_FLAGS = {
    lir.Precision.CONTRACT: " reassoc nsz contract",
    lir.Precision.FAST: _FLAGS[lir.Precision.FAST],
}

_AS_IT_IS = ('!"llvm.loop.isvectorized", i32 1', '!"llvm.loop.unroll.disable"')
"""What tells LLVM to leave a loop alone: that it is vectorised, and that it is not to be unrolled."""

_WHOLE = '!{{!"llvm.loop.vectorize.predicate.enable", i1 true}}'
"""What makes LLVM mask the rows beyond the last whole vector instead of running them one by one."""


def emit(program: lir.Program, hooks: Hooks) -> str:
    """The LLVM module of ``program`` for the target of ``hooks``, as text.

    Its entries are those of ``write_entries``.
    """
    module = ModuleWriter(hooks)
    block = _Emitter(program, module)
    block.body(program.block)
    block.finish(BLOCK_FUNCTION)
    finish = _Emitter(program, module)
    finish.body(program.finish)
    finish.finish(FINISH_FUNCTION)
    write_entries(program, module)
    return module.text()


def parameters(program: lir.Program) -> list[tuple[str, str]]:
    """The type with attributes, and the name, of each parameter of the two functions."""
    result = [("ptr noalias", "%failure"), ("i64", "%block")]
    for d in range(program.dimensions):
        result += [("i64", f"%low{d}"), ("i64", f"%high{d}")]
    for slot in program.slots:
        access = " readonly" if slot.access is lir.Access.READ else ""
        result.append((f"ptr noalias{access}", f"%slot{slot.number}"))
    for argument in program.arguments:
        result.append((ops.memory_type(argument.type), f"%argument{argument.number}"))
    return result


class _Emitter:
    """Emits the statements of one function."""

    def __init__(self, program: lir.Program, module: ModuleWriter) -> None:
        self.program = program
        self.module = module
        self.w = FunctionWriter(module)
        self.flags = _FLAGS[program.precision]
        self.sum_flags = _SUM_FLAGS[program.precision]
        self.forms: VectorForms = {}
        self.variable_reads = variable_reads((*program.block, *program.finish))
        self.temps: dict[int, str] = {program.block_number.number: "%block"}
        self.vars: dict[int, str] = {}
        self.labels: dict[int, str] = {}
        self.access_group: str | None = None
        self.fails = False

    def finish(self, name: str) -> None:
        self.w.do("ret i64 0")
        if self.fails:
            self.w.start("failed")
            self.w.do("ret i64 1")
        signature = ", ".join(f"{type_} {parameter}" for type_, parameter in parameters(self.program))
        self.w.finish(f"define internal i64 @{name}({signature}) noinline {self.module.hooks.attributes}")

    def value(self, value: lir.Value) -> str:
        match value:
            case lir.Temp(number, _):
                return self.temps[number]
            case lir.Literal(literal, scalar):
                return ops.literal(literal, scalar)

    # ---- Operations ----

    def operation(self, operation: lir.Operation, result: lir.Temp) -> str:
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
                return w.emit(f"load {ops.llvm_type(var.type)}, ptr {self.component(var, value(index))}")
            case lir.LoadArgument(argument):
                name = f"%argument{argument.number}"
                is_bool = ops.memory_type(argument.type) != ops.llvm_type(argument.type)
                return w.emit(f"icmp ne i8 {name}, 0") if is_bool else name

    def load(self, slot: lir.Slot, index: str) -> str:
        memory = ops.memory_type(slot.type)
        loaded = self.w.emit(f"load {memory}, ptr {self.element(slot, index)}{self.group()}")
        return loaded if memory == ops.llvm_type(slot.type) else self.w.emit(f"icmp ne i8 {loaded}, 0")

    def element(self, slot: lir.Slot, index: str) -> str:
        return self.w.emit(f"getelementptr inbounds {ops.memory_type(slot.type)}, ptr %slot{slot.number}, i64 {index}")

    def component(self, var: lir.Var, index: str) -> str:
        return self.w.emit(
            f"getelementptr inbounds {ops.llvm_type(var.type)}, ptr {self.vars[var.number]}, i64 {index}"
        )

    def group(self) -> str:
        return f", !llvm.access.group {self.access_group}" if self.access_group else ""

    # ---- Statements ----

    def body(self, body: lir.Body) -> None:
        for stmt in body:
            self.statement(stmt)

    def statement(self, stmt: lir.Stmt) -> None:  # noqa: C901 - one case a kind of statement
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
                atomics.update(self.w, op, slot.type, self.element(slot, self.value(index)), self.value(value))
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
            case lir.Fail(site, position, payload):
                self.fail(site, position, payload)
            case lir.Print():
                self.print(stmt)

    def declare(self, var: lir.Var) -> None:
        t = ops.llvm_type(var.type)
        if var.number not in self.vars:
            self.vars[var.number] = self.w.allocate(f"[{var.size} x {t}]")
        self.w.do(f"store [{var.size} x {t}] zeroinitializer, ptr {self.vars[var.number]}")

    def store_var(self, var: lir.Var, index: str, value: str) -> None:
        self.w.do(f"store {ops.llvm_type(var.type)} {value}, ptr {self.component(var, index)}")

    def store(self, slot: lir.Slot, index: str, stored: str) -> None:
        memory = ops.memory_type(slot.type)
        if memory != ops.llvm_type(slot.type):
            stored = self.w.emit(f"zext i1 {stored} to i8")
        self.w.do(f"store {memory} {stored}, ptr {self.element(slot, index)}{self.group()}")

    def add_to(self, place: lir.Slot | lir.Var, index: str, op: str, value: str) -> None:
        """``place[index] = place[index] op value``, in any grouping of the values that are added."""
        match place:
            case lir.Slot():
                after = ops.binary(self.w, op, place.type, self.load(place, index), value, self.sum_flags)
                self.store(place, index, after)
            case lir.Var():
                before = self.w.emit(f"load {ops.llvm_type(place.type)}, ptr {self.component(place, index)}")
                self.store_var(place, index, ops.binary(self.w, op, place.type, before, value, self.sum_flags))

    def if_(self, stmt: lir.If) -> None:
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
        head, turn, done = (self.w.fresh(stem) for stem in ("head", "turn", "done"))
        self.w.branch(head)
        self.w.start(head)
        self.body(stmt.head)
        self.w.branch_if(self.value(stmt.condition), turn, done)
        self.w.start(turn)
        self.body(stmt.body)
        self.w.branch(head)
        self.w.start(done)

    def for_(self, stmt: lir.For) -> None:
        """In strips where the order of the turns means nothing, the target is for it, and the body is fit."""
        plan = None
        if stmt.turns is lir.Turns.ANY_ORDER and self.module.hooks.strips is Strips.MASKED:
            plan = plan_strips(stmt, self.variable_reads, self.module.hooks.vector_math)
        if plan is None:
            self.count(stmt.counter, self.value(stmt.start), self.value(stmt.stop), stmt.body)
            return
        notes = [self.module.note(f"!{{{{{note}}}}}") for note in _AS_IT_IS]
        metadata = self.module.note(f"distinct !{{{{{{self}}, {', '.join(notes)}}}}}")
        emit_strips(self, stmt, plan, Flags(self.flags, self.sum_flags), f", !llvm.loop {metadata}")

    def count(self, counter: lir.Temp, start: str, stop: str, body: lir.Body, metadata: str = "") -> None:
        head, turn, latch, done = (self.w.fresh(stem) for stem in ("head", "turn", "latch", "done"))
        t, before, following = ops.llvm_type(counter.type), self.w.label, f"%{self.w.fresh('next')}"
        self.w.branch(head)
        self.w.start(head)
        name = self.w.emit(f"phi {t} [ {start}, %{before} ], [ {following}, %{latch} ]")
        self.temps[counter.number] = name
        self.w.branch_if(ops.compare(self.w, "<", counter.type, name, stop), turn, done)
        self.w.start(turn)
        self.body(body)
        self.w.branch(latch)
        self.w.start(latch)
        # It is below stop here, so that one more does not overflow.
        self.w.do(f"{following} = add {'nsw' if counter.type.name.startswith('i') else 'nuw'} {t} {name}, 1")
        self.w.do(f"br label %{head}{metadata}")
        self.w.start(done)

    # ---- Rows ----

    def row_loop(self, stmt: lir.RowLoop) -> None:
        metadata = ""
        if stmt.rows is lir.Rows.INDEPENDENT:
            self.access_group = self.module.note("distinct !{{}}")
            parallel = self.module.note(f'!{{{{!"llvm.loop.parallel_accesses", {self.access_group}}}}}')
            folded = f", {self.module.note(_WHOLE)}" if self.vector_math(stmt) else ""
            metadata = f", !llvm.loop {self.module.note(f'distinct !{{{{{{self}}, {parallel}{folded}}}}}')}"
        self.row_nest(stmt.index, 0, stmt.body, metadata)
        self.access_group = None

    def vector_math(self, loop: lir.RowLoop) -> bool:
        """Whether the rows of ``loop`` beyond the last whole vector are masked, as functions with vector forms want it.

        Otherwise scalar functions run there, which may round otherwise; random numbers must not depend on that.
        """
        whole = is_unit(loop)
        draws = any(isinstance(argument.binding, lir.RandomWord) for argument in self.program.arguments)
        self.forms = self.module.hooks.vector_math if whole or not draws else {}
        called = (
            (stmt.operation.function, stmt.temp.type.bits) in self.forms
            for stmt in statements(loop.body)
            if isinstance(stmt, lir.Let) and isinstance(stmt.operation, lir.Math)
        )
        return whole and any(called)

    def row_nest(self, index: Sequence[lir.Temp], d: int, body: lir.Body, metadata: str) -> None:
        """The loops over the dimensions from ``d`` on; the innermost one has the metadata."""
        if d == len(index) - 1:
            self.count(index[d], f"%low{d}", f"%high{d}", body, metadata)
            return
        head, turn, done = (self.w.fresh(stem) for stem in ("head", "line", "done"))
        before, following = self.w.label, f"%{self.w.fresh('next')}"
        latch = self.w.fresh("latch")
        self.w.branch(head)
        self.w.start(head)
        name = self.temps[index[d].number] = self.w.emit(f"phi i64 [ %low{d}, %{before} ], [ {following}, %{latch} ]")
        self.w.branch_if(self.w.emit(f"icmp slt i64 {name}, %high{d}"), turn, done)
        self.w.start(turn)
        self.row_nest(index, d + 1, body, metadata)
        self.w.branch(latch)
        self.w.start(latch)
        self.w.do(f"{following} = add nsw i64 {name}, 1")
        self.w.branch(head)
        self.w.start(done)

    # ---- Failures and prints ----

    def fail(self, site: int, position: lir.Value, payload: Sequence[lir.Value]) -> None:
        self.fails = True
        words = [str(site + 1), "%block", self.value(position), *map(self.value, payload)]
        assert len(words) == PAYLOAD_START + len(payload)
        for number, word in enumerate(words):
            place = self.w.emit(f"getelementptr inbounds i64, ptr %failure, i64 {number}")
            self.w.do(f"store i64 {word}, ptr {place}")
        self.w.branch("failed")
        self.w.start(self.w.fresh("dead"))

    def print(self, stmt: lir.Print) -> None:
        base = f"%slot{stmt.slot.number}"
        counter = self.w.emit(f"getelementptr inbounds i64, ptr {base}, i64 {lir.PRINT_COUNTER}")
        record = self.w.emit(f"atomicrmw add ptr {counter}, i64 1 monotonic")
        place = self.w.emit(f"getelementptr inbounds i64, ptr {base}, i64 {lir.PRINT_CAPACITY}")
        capacity = self.w.emit(f"load i64, ptr {place}")
        fits, end = self.w.fresh("fits"), self.w.fresh("end")
        self.w.branch_if(self.w.emit(f"icmp ult i64 {record}, {capacity}"), fits, end)
        self.w.start(fits)
        start = self.w.emit(f"mul i64 {record}, {lir.PRINT_HEADER + self.program.print_words}")
        first = self.w.emit(f"add i64 {start}, {lir.PRINT_RECORDS}")
        words = [str(stmt.number), self.value(stmt.position)]
        words += [ops.to_word(self.w, value.type, self.value(value)) for value in stmt.values]
        for number, word in enumerate(words):
            index = self.w.emit(f"add i64 {first}, {number}")
            self.w.do(f"store i64 {word}, ptr {self.w.emit(f'getelementptr inbounds i64, ptr {base}, i64 {index}')}")
        self.w.branch(end)
        self.w.start(end)
