"""Copies of a kernel's body for another place: with other locals, some values replaced, some effects left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from ebb.compiler import kir
from ebb.compiler.kir_walk import expressions, map_children, map_operands, statements
from ebb.records import record, replace

Effect = kir.WriteField | kir.ReduceField | kir.ReduceGlobal | kir.Assert | kir.Print | kir.Breakpoint

_EFFECTS = (kir.WriteField, kir.ReduceField, kir.ReduceGlobal, kir.Assert, kir.Print, kir.Breakpoint)


def first_free_uid(kernel: kir.Kernel) -> int:
    """A number above those of all locals and labels of ``kernel``."""
    return 1 + max(_uids(kernel))


def _uids(kernel: kir.Kernel) -> Iterator[int]:
    yield kernel.row.uid
    for stmt in statements(kernel.body):
        match stmt:
            case kir.Assign(local) | kir.ForRange(local) | kir.ForQuery(local):
                yield local.uid
            case kir.Block(label) | kir.Leave(label):
                yield label.uid
            case _:
                pass
    for expr in expressions(kernel.body):
        if isinstance(expr, kir.ReadLocal):
            yield expr.local.uid


@record(eq=False)
class Copier:
    """Copies statements.

    Attributes:
        shift: what is added to the numbers of locals and labels, so that the copy has its own.
        substitute: the expression that takes the place of an expression of the original, or None where none does.
        effect: the statements that take the place of one that has an effect; its operands are those of the original.
    """

    shift: int
    substitute: Callable[[kir.Expr], kir.Expr | None]
    effect: Callable[[Effect], tuple[kir.Stmt, ...]]

    def local(self, local: kir.Local) -> kir.Local:
        """The local that stands for ``local`` in the copy."""
        return replace(local, uid=local.uid + self.shift)

    def expr(self, expr: kir.Expr) -> kir.Expr:
        """A copy of ``expr``."""
        found = self.substitute(expr)
        if found is not None:
            return found
        if isinstance(expr, kir.ReadLocal):
            return replace(expr, local=self.local(expr.local))
        return map_children(expr, self.expr)

    def body(self, body: kir.Body) -> kir.Body:
        """A copy of ``body``. Conditions and loops in which nothing is left are left out."""
        return tuple(copied for stmt in body for copied in self.statement(stmt))

    def statement(self, stmt: kir.Stmt) -> tuple[kir.Stmt, ...]:
        """What ``stmt`` becomes."""
        if isinstance(stmt, _EFFECTS):
            return tuple(self.operands(copied) for copied in self.effect(stmt))
        match stmt:
            case kir.If(_, then, orelse):
                stmt = replace(stmt, then=self.body(then), orelse=self.body(orelse))
                return (self.operands(stmt),) if stmt.then or stmt.orelse else ()
            case kir.ForRange() | kir.ForQuery():
                inner = self.body(stmt.body)
                copied = replace(stmt, local=self.local(stmt.local), body=inner)
                return (self.operands(copied),) if inner else ()
            case kir.While():
                return (self.operands(replace(stmt, body=self.body(stmt.body))),)
            case kir.Block(label, body):
                return (replace(stmt, label=self.label(label), body=self.body(body)),)
            case kir.Leave(label):
                return (replace(stmt, label=self.label(label)),)
            case kir.Assign(local):
                return (self.operands(replace(stmt, local=self.local(local))),)
            case kir.Break() | kir.Continue():
                return (stmt,)

    def label(self, label: kir.Label) -> kir.Label:
        """The label that stands for ``label`` in the copy."""
        return replace(label, uid=label.uid + self.shift)

    def operands(self, stmt: kir.Stmt) -> kir.Stmt:
        """``stmt`` with copies of its own expressions."""
        return map_operands(stmt, self.expr)
