"""Each use of a field or global in a kernel: what it does and through which key."""

from __future__ import annotations

from enum import Enum
from typing import TypeVar

from ebb.compiler import kir
from ebb.compiler.kir_walk import expressions_in, statements
from ebb.compiler.phases.centered import Centered
from ebb.diagnostics.span import Span
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.globals import Global

_Place = TypeVar("_Place", Field, Global)


class Mode(Enum):
    """What a use does to the place."""

    READ = "READ"
    WRITE = "WRITE"
    REDUCE = "REDUCE"


@record
class Use:
    """One use of a field or a global.

    Attributes:
        mode: read, write or reduction; a component counts as the whole.
        op: the operator of a reduction, else None.
        centered: whether the key is the kernel's own row; a global has none and is never centered.
        span: the source of the use.
        query: whether it is a query loop or a query's size, which reads the grouping.
    """

    mode: Mode
    op: kir.ReduceOp | None
    centered: bool
    span: Span
    query: bool = False

    @property
    def phase(self) -> str:
        """The phase that the use asks for, as messages say it."""
        return self.mode.value if self.op is None else f"{self.mode.value}({self.op.value})"


@record
class Uses:
    """All uses in a kernel, each list in source order."""

    fields: dict[Field, list[Use]]
    globals: dict[Global, list[Use]]


_USING = (kir.ReadField, kir.QuerySize, kir.ReadGlobal)


def collect_uses(kernel: kir.Kernel, centered: Centered) -> Uses:
    """Every use of a field or global in ``kernel``, whatever the branches."""
    uses = Uses({}, {})
    for stmt in statements(kernel.body):
        for expr in expressions_in(stmt):
            if isinstance(expr, _USING):
                _collect_expr(expr, centered, uses)
        _collect_stmt(stmt, centered, uses)
    return uses


def _collect_expr(expr: kir.Expr, centered: Centered, uses: Uses) -> None:
    match expr:
        case kir.ReadField(field, key):
            _add(uses.fields, field, Use(Mode.READ, None, centered.is_centered(key), expr.span))
        case kir.QuerySize(index):
            _add(uses.fields, index, Use(Mode.READ, None, False, expr.span, query=True))
        case kir.ReadGlobal(globl):
            _add(uses.globals, globl, Use(Mode.READ, None, False, expr.span))
        case _:
            pass


def _collect_stmt(stmt: kir.Stmt, centered: Centered, uses: Uses) -> None:
    match stmt:
        case kir.WriteField(field, key):
            _add(uses.fields, field, Use(Mode.WRITE, None, centered.is_centered(key), stmt.span))
        case kir.ReduceField(field, key, op=op):
            _add(uses.fields, field, Use(Mode.REDUCE, op, centered.is_centered(key), stmt.span))
        case kir.ReduceGlobal(globl, op=op):
            _add(uses.globals, globl, Use(Mode.REDUCE, op, False, stmt.span))
        case kir.ForQuery(index=index):
            _add(uses.fields, index, Use(Mode.READ, None, False, stmt.key.span, query=True))
        case _:
            pass


def _add(uses: dict[_Place, list[Use]], place: _Place, use: Use) -> None:
    uses.setdefault(place, []).append(use)
