"""The kernels of groups of threads: one for a block, one that finishes the launch.

A launch of the first covers one box; a launch of rows in several boxes takes several. ``parameters`` says what both
kernels take, in order.
"""

from __future__ import annotations

from collections.abc import Sequence

from ebb.backends.llvm import ops
from ebb.backends.llvm.hooks import Call, Groups
from ebb.backends.llvm.statements import StatementEmitter
from ebb.backends.llvm.writer import FunctionWriter, ModuleWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import statements
from ebb.runtime.buffer import ALIGNMENT
from ebb.runtime.device import (
    FAILURE_CAPACITY,
    FAILURE_CHUNK,
    FAILURE_COUNT,
    FAILURE_LOWEST,
    FAILURE_START,
    FAILURE_WORDS,
)
from ebb.types.types import ScalarType

FAILURES, FIRST_BLOCK, FIRST_ROW = "failures", "first_block", "first_row"


def parameters(program: lir.Program) -> list[tuple[str, str]]:
    """The name, and LLVM's type, of each parameter of the kernels; ``ptr`` is memory of the device.

    ``failures`` is the memory that tells of rows that failed. ``first_block`` is how many groups, ``first_row`` how
    many rows the launch has in boxes before this one. The box is ``low <= coordinate < high`` in each dimension; on a
    line ``low0`` is 0 and ``high0`` the number of rows. Bools are bytes.
    """
    result = [(FAILURES, "ptr"), (FIRST_BLOCK, "i64"), (FIRST_ROW, "i64")]
    for d in range(program.dimensions):
        result += [(f"low{d}", "i64"), (f"high{d}", "i64")]
    result += [(f"slot{slot.number}", "ptr") for slot in program.slots]
    return result + [(f"argument{argument.number}", ops.memory_type(argument.type)) for argument in program.arguments]


def write_kernels(program: lir.Program, module: ModuleWriter) -> None:
    """Adds the kernels ``program.entries`` to ``module``."""
    assert module.hooks.groups is not None, "the target runs no groups"
    for entry, body in zip(program.entries, (program.block, program.finish), strict=False):
        kernel = _KernelEmitter(program, module, module.hooks.groups)
        kernel.body(body)
        kernel.finish(entry, loops=any(isinstance(stmt, lir.For | lir.While) for stmt in statements(body)))
    for name, note in module.hooks.groups.module_notes.items():
        module.metadata.append(f"!{name} = !{{{module.note(note)}}}")


class _KernelEmitter(StatementEmitter):
    """Emits one kernel."""

    def __init__(self, program: lir.Program, module: ModuleWriter, groups: Groups) -> None:
        super().__init__(program, module, groups.global_memory)
        self.groups = groups
        self.row = ""
        self.rows_end = ""
        w = self.w
        self.number("thread", groups.thread)
        self.number("group", groups.group)
        w.do(f"%block = add i64 %{FIRST_BLOCK}, %group")

    def number(self, name: str, call: Call) -> None:
        """Defines ``%name``, an i64."""
        result = _call(self.w, call)
        self.w.do(
            f"%{name} = zext {call.type} {result} to i64" if call.type != "i64" else f"%{name} = add i64 {result}, 0"
        )

    def finish(self, name: str, *, loops: bool) -> None:
        """Adds the kernel to the module; ``loops`` says whether there are loops in it, but for that over rows."""
        self.w.do("ret void")
        access = {slot.number: slot.access for slot in self.program.slots}
        signature: list[str] = []
        for parameter, type_ in parameters(self.program):
            if type_ == "ptr":
                number = parameter.removeprefix("slot")
                reads = number != parameter and access[int(number)] is lir.Access.READ
                # Aligned, so that the components of a row are loaded together where they fill 8 or 16 bytes.
                type_ = f"ptr{self.memory} noalias align {ALIGNMENT}{' readonly' if reads else ''}"
            signature.append(f"{type_} %{parameter}")
        size = {"group_size": self.program.group_size}
        kinds = {**self.groups.notes, **(self.groups.loop_notes if loops else {})}
        notes = [f"!{kind} {self.module.note(note.format(**size))}" for kind, note in kinds.items()]
        attributes = self.module.hooks.attributes.format(**size)
        header = f"define {self.groups.kernel} void @{name}({', '.join(signature)}) {attributes}"
        self.w.finish(" ".join((header, *notes)))

    # ---- Variables ----

    def declare(self, var: lir.Var) -> None:
        if var.memory is lir.Memory.PRIVATE:
            super().declare(var)
            return
        name = self.vars[var.number] = f"@ebb.var.{var.number}"
        array = f"[{var.size} x {ops.memory_type(var.type)}]"
        self.w.define(name, f"{name} = internal{self.groups.group_memory} global {array} undef, align 8")

    def load_var(self, var: lir.Var, index: str) -> str:
        if var.memory is lir.Memory.PRIVATE:
            return super().load_var(var, index)
        loaded = self.w.emit(f"load {ops.memory_type(var.type)}, {self.shared(var, index)}")
        return loaded if not _is_byte(var.type) else self.w.emit(f"icmp ne i8 {loaded}, 0")

    def store_var(self, var: lir.Var, index: str, value: str) -> None:
        if var.memory is lir.Memory.PRIVATE:
            super().store_var(var, index, value)
            return
        stored = value if not _is_byte(var.type) else self.w.emit(f"zext i1 {value} to i8")
        self.w.do(f"store {ops.memory_type(var.type)} {stored}, {self.shared(var, index)}")

    def shared(self, var: lir.Var, index: str) -> str:
        """A pointer to a component of a variable of the group."""
        pointer = f"ptr{self.groups.group_memory}"
        place = f"{pointer} {self.vars[var.number]}, i64 {index}"
        return f"{pointer} {self.w.emit(f'getelementptr inbounds {ops.memory_type(var.type)}, {place}')}"

    def barrier(self) -> None:
        _call(self.w, self.groups.barrier)

    # ---- Rows ----

    def row_loop(self, stmt: lir.RowLoop) -> None:
        """The rows of the thread, by their numbers within the box."""
        w, size = self.w, self.program.group_size
        extents, rows = list[str](), "%high0"
        if self.program.space is lir.Space.BOX:
            extents = [w.emit(f"sub i64 %high{d}, %low{d}") for d in range(self.program.dimensions)]
            rows = extents[0]
            for extent in extents[1:]:
                rows = w.emit(f"mul i64 {rows}, {extent}")
        first = w.emit(f"add i64 {w.emit(f'mul i64 %group, {size}')}, %thread")
        row, self.rows_end = w.fresh("row"), w.fresh("rows.end")
        match self.program.coverage:
            case lir.Coverage.ONE:
                w.branch_if(w.emit(f"icmp ult i64 {first}, {rows}"), row, self.rows_end)
                w.start(row)
                self.one_row(stmt, first, extents)
                w.branch(self.rows_end)
            case lir.Coverage.STRIDED:
                self.number("groups", self.groups.groups)
                stride = w.emit(f"mul i64 %groups, {size}")
                before, head, following = w.label, w.fresh("head"), f"%{w.fresh('next')}"
                latch = w.fresh("latch")
                w.branch(head)
                w.start(head)
                number = w.emit(f"phi i64 [ {first}, %{before} ], [ {following}, %{latch} ]")
                w.branch_if(w.emit(f"icmp ult i64 {number}, {rows}"), row, self.rows_end)
                w.start(row)
                self.one_row(stmt, number, extents)
                w.branch(latch)
                w.start(latch)
                w.do(f"{following} = add i64 {number}, {stride}")
                w.branch(head)
        w.start(self.rows_end)

    def one_row(self, stmt: lir.RowLoop, number: str, extents: Sequence[str]) -> None:
        """The body of ``stmt`` for the row ``number`` of the box."""
        w = self.w
        self.row = w.emit(f"add i64 %{FIRST_ROW}, {number}")
        if self.program.space is lir.Space.LINE:
            self.temps[stmt.index[0].number] = number
            self.body(stmt.body)
            return
        rest = number
        for d in range(self.program.dimensions - 1, -1, -1):
            coordinate = rest
            if d > 0:
                rest = _quotient(w, coordinate, extents[d])
                coordinate = w.emit(f"sub i64 {coordinate}, {w.emit(f'mul i64 {rest}, {extents[d]}')}")
            self.temps[stmt.index[d].number] = w.emit(f"add i64 {coordinate}, %low{d}")
        self.body(stmt.body)

    # ---- Failures ----

    def fail(self, site: int, position: lir.Value, payload: Sequence[lir.Value]) -> None:
        """Leaves a record if no lower chunk has failed yet, in place of an old one if there is no room, and the rows.

        What is left to this thread comes behind this row, so it has no say in which row failed first.
        """
        w = self.w
        words = [self.row, self.value(position), str(site + 1), *map(self.value, payload)]
        assert len(words) <= FAILURE_WORDS
        chunk = w.emit(f"trunc i64 {w.emit(f'udiv i64 {self.row}, {FAILURE_CHUNK}')} to i32")
        lowest = self.counted("umin", FAILURE_LOWEST, chunk)
        record = w.fresh("record")
        w.branch_if(w.emit(f"icmp ule i32 {chunk}, {lowest}"), record, self.rows_end)
        w.start(record)
        number = w.emit(f"urem i32 {self.counted('add', FAILURE_COUNT, '1')}, {FAILURE_CAPACITY}")
        start = w.emit(f"mul i64 {w.emit(f'zext i32 {number} to i64')}, {8 * FAILURE_WORDS}")
        first = self.failure("i8", w.emit(f"add i64 {start}, {FAILURE_START}"))
        for k, word in enumerate(words):
            place = w.emit(f"getelementptr inbounds i64, {first}, i64 {k}")
            w.do(f"store i64 {word}, ptr{self.memory} {place}")
        w.branch(self.rows_end)
        w.start(w.fresh("dead"))

    def counted(self, instruction: str, word: int, value: str) -> str:
        """What a 32-bit word before the records was before ``instruction`` changed it."""
        place = self.failure("i32", str(word))
        return self.w.emit(f"atomicrmw {instruction} {place}, i32 {value}{self.groups.scope} monotonic")

    def failure(self, unit: str, index: str) -> str:
        """A pointer into the memory that tells of failures."""
        base = f"ptr{self.memory} %{FAILURES}"
        return f"ptr{self.memory} {self.w.emit(f'getelementptr inbounds {unit}, {base}, i64 {index}')}"


def _is_byte(scalar: ScalarType) -> bool:
    return ops.memory_type(scalar) != ops.llvm_type(scalar)


def _call(w: FunctionWriter, call: Call) -> str:
    convention = "" if call.name.startswith("llvm.") else w.hooks.convention
    operands = call.operands.partition(" ")[0]
    w.declare(f"{convention}{call.type} @{call.name}({operands}){call.attributes}")
    instruction = f"call {convention}{call.type} @{call.name}({call.operands})"
    if call.type == "void":
        w.do(instruction)
        return ""
    return w.emit(instruction)


_QUOTIENT = """\
define internal {convention}i64 @ebb.quotient(i64 %a, i64 %b) alwaysinline nounwind willreturn memory(none) {{
entry:
  %both = or i64 %a, %b
  %high = lshr i64 %both, 32
  %small = icmp eq i64 %high, 0
  br i1 %small, label %narrow, label %wide
narrow:
  %a.low = trunc i64 %a to i32
  %b.low = trunc i64 %b to i32
  %quotient.low = udiv i32 %a.low, %b.low
  %quotient = zext i32 %quotient.low to i64
  ret i64 %quotient
wide:
  %quotient.wide = udiv i64 %a, %b
  ret i64 %quotient.wide
}}
"""


def _quotient(w: FunctionWriter, a: str, b: str) -> str:
    """``a // b`` of two positive numbers, by 32 bits where they have no more: by 64 it takes several times as long."""
    w.define("ebb.quotient", _QUOTIENT.format(convention=w.hooks.convention))
    return w.emit(f"call {w.hooks.convention}i64 @ebb.quotient(i64 {a}, i64 {b})")
