"""The text of ``kernel.explain(rel)``: phases, reductions, layout and cost of a kernel, for people to read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from ebb.compiler import kir
from ebb.compiler.cost import Cost, cost_of, group_size
from ebb.compiler.kir_walk import queried_fields, statements
from ebb.compiler.phases.centered import find_centered
from ebb.compiler.phases.stencil import Access, collect_stencil, describe_move, target_of, written_at
from ebb.compiler.phases.table import FieldPhase, PhaseKind, PhaseTable
from ebb.compiler.phases.uses import collect_uses
from ebb.diagnostics.span import Span
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.relation import Relation


def explain(kernel: kir.Kernel, phases: PhaseTable, scattered: str, totals: str, order: str) -> str:
    """How ``kernel`` runs on the data that its relations hold now.

    Args:
        kernel: a kernel after the passes.
        phases: of its fields and globals.
        scattered: how the backend does reductions into other rows.
        totals: how it does those into globals.
        order: in which order it runs the rows.
    """
    sections = (
        ("fields", _columns(_field_row(field, phase) for field, phase in phases.fields.items())),
        ("globals", _columns(_global_rows(kernel, phases))),
        ("reductions", _columns(_reduction_rows(kernel, phases, scattered, totals))),
        ("queries", [_query_line(index) for index in queried_fields(kernel)]),
        ("stencil", _columns(_stencil_row(access) for access in collect_stencil(kernel))),
        ("order of rows", [order]),
        ("storage", [_storage_line(relation) for relation in _relations(kernel, phases)]),
        ("cost of a row", _cost_lines(cost_of(kernel))),
    )
    relation = kernel.relation
    lines = [f"kernel {kernel.name} on {relation.name} ({relation.size:,} row{'' if relation.size == 1 else 's'})"]
    for title, rows in sections:
        if rows:
            lines += ["", title, *(f"  {row}" for row in rows)]
    return "\n".join(lines)


def _field_row(field: Field, phase: FieldPhase) -> tuple[str, ...]:
    does = [verb for verb, holds in _verbs(phase) if holds]
    where = "own row" if phase.centered_only else "any row"
    return (field.path, str(phase), f"{', '.join(does)}; {where}", repr(field.type), _layout(field))


def _layout(field: Field) -> str:
    size = f"{field.type.size * field.type.dtype.itemsize} bytes a row"
    return size if field.type.size == 1 else f"{size}, in {field.buffer.layout.value}"


def _verbs(phase: FieldPhase) -> Iterator[tuple[str, bool]]:
    yield "read", phase.read and not phase.queried
    yield "read, queried", phase.queried
    yield "written", phase.written
    yield "reduced", phase.reduced


def _global_rows(kernel: kir.Kernel, phases: PhaseTable) -> Iterator[tuple[str, ...]]:
    uses = collect_uses(kernel, find_centered(kernel)).globals
    for globl, phase in phases.globals.items():
        spans = [use.span for use in uses.get(globl, ())]
        yield _global_text(spans), str(phase), "reduced" if phase.reduced else "read", repr(globl.type)


def _global_text(spans: Sequence[Span]) -> str:
    """The global as the kernel writes it."""
    return next((span.text for span in spans), "unused")


def _reduction_rows(kernel: kir.Kernel, phases: PhaseTable, scattered: str, totals: str) -> Iterator[tuple[str, ...]]:
    """One row for each reduced field and global: what is reduced, where, and how it is done."""
    found: dict[tuple[Field | Global, str], list[Span]] = {}
    for stmt in statements(kernel.body):
        match stmt:
            case kir.ReduceField(place) | kir.ReduceGlobal(place):
                found.setdefault((place, stmt.op.value), []).append(stmt.span)
            case _:
                pass
    for (place, op), spans in found.items():
        lines = ", ".join(map(str, sorted({_kernel_line(span) for span in spans})))
        name = place.path if isinstance(place, Field) else _global_text(spans)
        yield f"{name} {op}", f"line {lines}", _strategy(place, phases, scattered, totals)


def _strategy(place: Field | Global, phases: PhaseTable, scattered: str, totals: str) -> str:
    if isinstance(place, Global):
        return totals
    if phases.fields[place].kind is PhaseKind.REDUCE:
        return scattered
    return "own row: no other row touches it"


def _kernel_line(span: Span) -> int:
    while span.caller is not None:
        span = span.caller
    return span.line


def _query_line(index: Field) -> str:
    grouping = index.grouping
    rows = "a list of rows" if grouping is not None and grouping.rows is not None else "a range of stored rows"
    return f"{index.relation.name} by {index.name}: {rows}, {group_size(index):.4g} on average"


def _stencil_row(access: Access) -> tuple[str, ...]:
    how = "clamped" if access.node.edge is kir.Edge.CLAMP else "checked before the launch"
    return written_at(access.node.span).text, f"{describe_move(access)} into {target_of(access.node).name}", how


def _storage_line(relation: Relation) -> str:
    if relation.is_grid:
        return f"{relation.name}: grid {' x '.join(map(str, relation.shape))}, the last index is contiguous"
    grouped = [field.path for field in relation.fields.values() if field.grouping is not None]
    order = "as created" if relation.storage.order is None else relation.storage.reason or "permuted"
    return f"{relation.name}: rows stored {order}" + (f"; grouped by {', '.join(grouped)}" if grouped else "")


def _relations(kernel: kir.Kernel, phases: PhaseTable) -> Iterable[Relation]:
    return dict.fromkeys((kernel.relation, *(field.relation for field in phases.fields)))


def _cost_lines(cost: Cost) -> list[str]:
    lines = [
        f"{cost.bytes:.4g} bytes: {cost.own_bytes:.4g} read from the own row, {cost.other_bytes:.4g} from other rows, "
        f"{cost.written_bytes:.4g} written",
        f"{cost.operations:.4g} operations",
    ]
    if cost.bytes:
        lines[1] += f", {cost.operations / cost.bytes:.2g} a byte"
    if cost.uncounted:
        lines.append(f"{cost.uncounted} loop{'' if cost.uncounted == 1 else 's'} of unknown length counted as one turn")
    return lines


def _columns(rows: Iterable[tuple[str, ...]]) -> list[str]:
    """``rows`` as lines, each column as wide as its longest entry."""
    table = list(rows)
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]
