"""The functions of a thread that takes blocks of rows: one for a block, one that finishes the launch.

They get each slot as a ``noalias`` pointer, since no two slots overlap, and the loop over independent rows says so to
LLVM's vectoriser by access groups.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ebb.backends.llvm import ops
from ebb.backends.llvm.ahead import Ahead, emit_ahead, plan_ahead
from ebb.backends.llvm.entry import BLOCK_FUNCTION, FINISH_FUNCTION, write_entries
from ebb.backends.llvm.hooks import Strips
from ebb.backends.llvm.joined import Joined, emit_joined, plan_joined
from ebb.backends.llvm.lanes import Flags
from ebb.backends.llvm.lines import emit_line, emit_streaming, streams
from ebb.backends.llvm.rare import emit_rare, plan_rare
from ebb.backends.llvm.row_plan import RowPlan, plan_rows, plan_runs
from ebb.backends.llvm.row_runs import emit_runs
from ebb.backends.llvm.row_skips import leaves_out
from ebb.backends.llvm.row_strips import emit_row_strips
from ebb.backends.llvm.statements import AS_IT_IS, NO_VECTORS, StatementEmitter
from ebb.backends.llvm.strides import is_unit
from ebb.backends.llvm.writer import ModuleWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import statements
from ebb.runtime.cpu import PAYLOAD_START

_WHOLE = '!"llvm.loop.vectorize.predicate.enable", i1 true'
"""What makes LLVM mask the rows beyond the last whole vector instead of running them one by one."""

_ONE_AT_A_TIME = '!"llvm.loop.interleave.count", i32 1'
"""What makes LLVM take one register at a time: whole ones are all that there are."""


def write_block(program: lir.Program, module: ModuleWriter) -> None:
    """Adds the functions of ``program`` to ``module``, and the entries of ``write_entries``."""
    block = _BlockEmitter(program, module)
    block.body(program.block)
    block.finish(BLOCK_FUNCTION)
    if program.finish:
        finish = _BlockEmitter(program, module)
        finish.body(program.finish)
        finish.finish(FINISH_FUNCTION)
    write_entries(program, module)


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


class _BlockEmitter(StatementEmitter):
    """Emits one of the two functions."""

    def __init__(self, program: lir.Program, module: ModuleWriter) -> None:
        super().__init__(program, module)
        self.fails = False
        self.ahead: Mapping[int, Ahead] = {}
        self.buffers: dict[int, tuple[str, str]] = {}

    def finish(self, name: str) -> None:
        """Adds the function to the module."""
        self.w.do("ret i64 0")
        if self.fails:
            self.w.start("failed")
            self.w.do("ret i64 1")
        signature = ", ".join(f"{type_} {parameter}" for type_, parameter in parameters(self.program))
        self.w.finish(f"define internal i64 @{name}({signature}) noinline {self.module.hooks.attributes}")

    def element(self, slot: lir.Slot, index: str) -> str:
        if slot.number not in self.buffers:
            return super().element(slot, index)
        buffer, first = self.buffers[slot.number]
        place = self.w.emit(f"sub i64 {index}, {first}")
        return self.w.emit(f"getelementptr inbounds {ops.memory_type(slot.type)}, ptr {buffer}, i64 {place}")

    def statement(self, stmt: lir.Stmt) -> None:
        """Emits ``stmt``, and asks for what the same key of a later row leads to."""
        super().statement(stmt)
        if isinstance(stmt, lir.Let) and stmt.temp.number in self.ahead:
            emit_ahead(self, self.ahead[stmt.temp.number], "%high0")

    # ---- Rows ----

    def row_loop(self, stmt: lir.RowLoop) -> None:
        self.ahead = plan_ahead(stmt)
        streaming = streams(stmt)
        joined = plan_joined(stmt) if streaming else None
        metadata = ""
        if stmt.rows is lir.Rows.INDEPENDENT:
            self.access_group = self.module.note("distinct !{{}}")
            notes = [f'!"llvm.loop.parallel_accesses", {self.access_group}']
            if self.vector_math(stmt):
                notes.append(_WHOLE)
            if streaming:
                notes.append(_ONE_AT_A_TIME)
            metadata = self.loop_notes(*notes)
        elif self.must_not_be_vectors(stmt.body, stmt.index[-1]):
            metadata = self.loop_notes(NO_VECTORS)
            self.module.is_serial = stmt.inside is None and self.is_only_loop(stmt)
        self.row_nest(stmt, 0, metadata, joined or streaming)
        self.access_group = None

    def is_only_loop(self, loop: lir.RowLoop) -> bool:
        """Whether the program has no loop but ``loop``."""
        inner = statements((*self.program.block, *self.program.finish))
        return all(stmt is loop for stmt in inner if isinstance(stmt, lir.RowLoop | lir.For | lir.While))

    def vector_math(self, loop: lir.RowLoop) -> bool:
        """Whether the rows of ``loop`` beyond the last whole vector are masked, as functions with vector forms want it.

        Otherwise scalar functions run there, which may round otherwise; random numbers must not depend on that.
        """
        body = loop.body if loop.inside is None else loop.inside.body
        whole = is_unit(body, loop.index[-1])
        draws = any(isinstance(argument.binding, lir.RandomWord) for argument in self.program.arguments)
        self.forms = self.module.hooks.vector_math if (whole and loop.inside is None) or not draws else {}
        called = (
            (stmt.operation.function, stmt.temp.type.bits) in self.forms
            for stmt in statements(body)
            if isinstance(stmt, lir.Let) and isinstance(stmt.operation, lir.Math)
        )
        return whole and any(called)

    def strips_of(self, loop: lir.RowLoop) -> RowPlan | None:
        """How the rows run in strips, where the target is for them and they are fit."""
        if self.module.hooks.strips is not Strips.MASKED:
            return None
        if is_unit(loop.body, loop.index[-1]) and not leaves_out(loop):
            return None  # LLVM does it as well
        return plan_rows(loop, self.module.hooks.vector_math)

    def runs_of(self, loop: lir.RowLoop) -> tuple[lir.RowLoop, RowPlan] | None:
        """How the rows of a list run in strips."""
        if self.module.hooks.strips is not Strips.MASKED:
            return None
        return plan_runs(loop, self.module.hooks.vector_math)

    def bounds(self, d: int) -> tuple[str, str]:
        """The first index of a dimension, and the one behind the last."""
        return f"%low{d}", f"%high{d}"

    def row_nest(self, loop: lir.RowLoop, d: int, metadata: str, streaming: Joined | bool) -> None:
        """The loops over the dimensions from ``d`` on; the innermost one has the metadata."""
        index = loop.index
        if isinstance(streaming, Joined) and d == len(index) - streaming.dimensions:
            emit_joined(self, loop, streaming)
            return
        if d == len(index) - 1:
            if streaming:
                emit_streaming(self, loop, metadata)
            elif loop.inside is not None:
                emit_line(self, loop, metadata)
            elif (runs := self.runs_of(loop)) is not None:
                self.module.is_vectors = True
                emit_runs(self, loop, runs, Flags(self.flags, self.sum_flags), self.bounds(d), metadata)
            elif (strips := self.strips_of(loop)) is not None:
                self.module.is_vectors = True
                notes = self.loop_notes(*AS_IT_IS), self.loop_notes(NO_VECTORS)
                emit_row_strips(self, loop, strips, Flags(self.flags, self.sum_flags), self.bounds(d), notes)
            elif (plan := plan_rare(loop)) is not None:
                emit_rare(self, loop, plan, self.bounds(d))
            else:
                self.count(index[d], *self.bounds(d), loop.body, metadata)
            return
        with self.w.loop(*self.bounds(d)) as turn:
            self.temps[index[d].number] = turn.counter
            self.row_nest(loop, d + 1, metadata, streaming)

    # ---- Failures ----

    def fail(self, site: int, position: lir.Value, payload: Sequence[lir.Value]) -> None:
        self.fails = True
        words = [str(site + 1), "%block", self.value(position), *map(self.value, payload)]
        assert len(words) == PAYLOAD_START + len(payload)
        for number, word in enumerate(words):
            place = self.w.emit(f"getelementptr inbounds i64, ptr %failure, i64 {number}")
            self.w.do(f"store i64 {word}, ptr {place}")
        self.w.branch("failed")
        self.w.start(self.w.fresh("dead"))

    def barrier(self) -> None:
        raise AssertionError("a thread that has a block to itself waits for nobody")
