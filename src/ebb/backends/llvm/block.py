"""The functions of a thread that takes blocks of rows: one for a block, one that finishes the launch.

They get each slot as a ``noalias`` pointer, since no two slots overlap, and the loop over independent rows says so to
LLVM's vectoriser by access groups.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ebb.backends.llvm import ops
from ebb.backends.llvm.ahead import Ahead, emit_ahead, plan_ahead
from ebb.backends.llvm.entry import BLOCK_FUNCTION, FINISH_FUNCTION, write_entries
from ebb.backends.llvm.statements import StatementEmitter
from ebb.backends.llvm.strides import is_unit
from ebb.backends.llvm.writer import ModuleWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import statements
from ebb.runtime.cpu import PAYLOAD_START

_WHOLE = '!{{!"llvm.loop.vectorize.predicate.enable", i1 true}}'
"""What makes LLVM mask the rows beyond the last whole vector instead of running them one by one."""


def write_block(program: lir.Program, module: ModuleWriter) -> None:
    """Adds the two functions of ``program`` to ``module``, and the entries of ``write_entries``."""
    block = _BlockEmitter(program, module)
    block.body(program.block)
    block.finish(BLOCK_FUNCTION)
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

    def finish(self, name: str) -> None:
        """Adds the function to the module."""
        self.w.do("ret i64 0")
        if self.fails:
            self.w.start("failed")
            self.w.do("ret i64 1")
        signature = ", ".join(f"{type_} {parameter}" for type_, parameter in parameters(self.program))
        self.w.finish(f"define internal i64 @{name}({signature}) noinline {self.module.hooks.attributes}")

    def statement(self, stmt: lir.Stmt) -> None:
        """Emits ``stmt``, and asks for what the same key of a later row leads to."""
        super().statement(stmt)
        if isinstance(stmt, lir.Let) and stmt.temp.number in self.ahead:
            emit_ahead(self, self.ahead[stmt.temp.number], "%high0")

    # ---- Rows ----

    def row_loop(self, stmt: lir.RowLoop) -> None:
        self.ahead = plan_ahead(stmt)
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
