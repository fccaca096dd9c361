"""A reduction into other rows in two steps: each row writes what it gives to a place of its own, each target adds up.

The places, the *stage*, are a hidden field of the relation, with a component for each of its reductions into one field.
The second kernel sees the same memory as the rows of a hidden relation of contributions, and finds those that are meant
for a target by a hidden index.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ebb.compiler import kir
from ebb.compiler.kir_walk import statements
from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.table import PhaseKind, PhaseTable
from ebb.compiler.scatter.rewrite import Copier, Effect, first_free_uid
from ebb.compiler.scatter.step import Step
from ebb.compiler.scatter.touched import Touched
from ebb.diagnostics.span import Span
from ebb.records import record, replace
from ebb.relations.field import Field
from ebb.relations.inverse import hidden_index, index_keys
from ebb.relations.relation import Relation
from ebb.runtime.buffer import Array, Buffer
from ebb.types.arithmetic import identity_of
from ebb.types.types import int32, matrix, vector


@record(eq=False)
class Stage:
    """The contributions to one field.

    Attributes:
        field: what they are reduced into.
        op: the operator.
        parts: the reductions of the kernel into the field.
        place: the stage as a field of the kernel's relation, with a component for each of ``parts``.
        contributions: the same memory as a field of the relation of contributions.
        index: finds the contributions to a row.
    """

    field: Field
    op: kir.ReduceOp
    parts: tuple[kir.ReduceField, ...]
    place: Field
    contributions: Field
    index: Field

    def refresh(self, places: Sequence[Touched], own: Array | None) -> None:
        """Makes the index valid.

        Args:
            places: where the reductions go.
            own: the positions of the launched rows, None for all in storage order.
        """
        by_stmt = {place.stmt: place.positions for place in places}
        keys = np.stack([by_stmt[part] for part in self.parts], axis=1)
        count = len(self.parts)
        rows = None if own is None else (own.astype(np.int64)[:, np.newaxis] * count + np.arange(count)).reshape(-1)
        index_keys(self.index, keys.reshape(-1), rows)


def staged_parts(kernel: kir.Kernel, phases: PhaseTable) -> dict[Field, tuple[kir.ReduceField, ...]] | None:
    """The reductions of ``kernel`` into other rows by field; None where they cannot be staged.

    They cannot where a row gives any number of values, where one reduction stands in several places, and where fields
    hold matrices or the component is computed.
    """
    found: dict[Field, list[kir.ReduceField]] = {}
    once = set(_outside_loops(kernel.body))
    for stmt in statements(kernel.body):
        if isinstance(stmt, kir.ReduceField) and phases.fields[stmt.field].kind is PhaseKind.REDUCE:
            simple = len(stmt.field.type.shape) <= 1 and all(isinstance(index, kir.Const) for index in stmt.indices)
            if stmt not in once or not simple:
                return None
            found.setdefault(stmt.field, []).append(stmt)
    if any(len(set(parts)) < len(parts) for parts in found.values()):
        return None
    return {field: tuple(parts) for field, parts in found.items()}


def make_stages(relation: Relation, parts: dict[Field, tuple[kir.ReduceField, ...]]) -> tuple[Stage, ...]:
    """The hidden fields, relations and indexes for ``parts``."""
    return tuple(_stage(relation, field, of_field) for field, of_field in parts.items())


def stage(kernel: kir.Kernel, stages: Sequence[Stage], unchecked: Sequence[kir.Affine]) -> list[Step]:
    """The kernels that do what ``kernel`` does, one after the other: it writes the stages, and each field gathers."""
    first = replace(kernel, body=_staged_body(kernel, stages))
    steps = [Step(first, check_phases(first), tuple(unchecked))]
    for each in stages:
        gathering = _gathering(kernel, each)
        steps.append(Step(gathering, check_phases(gathering), ()))
    return steps


def _outside_loops(body: kir.Body) -> list[kir.Stmt]:
    found: list[kir.Stmt] = []
    for stmt in body:
        found.append(stmt)
        match stmt:
            case kir.If(_, then, orelse):
                found += [*_outside_loops(then), *_outside_loops(orelse)]
            case kir.Block(_, inner):
                found += _outside_loops(inner)
            case _:
                pass
    return found


def _stage(relation: Relation, field: Field, parts: tuple[kir.ReduceField, ...]) -> Stage:
    count, shape, scalar = len(parts), field.type.shape, field.type.scalar
    of_all = matrix(scalar, count, *shape) if shape else vector(scalar, count)
    buffer = Buffer((relation.size, *of_all.shape), of_all.dtype)
    place = Field(relation, f"{field.name}_given", of_all, buffer)
    rows = Relation(f"{relation.name}_given", size=relation.size * count)
    contributions = Field(rows, field.name, field.type, buffer.reshaped((rows.size, *shape)))
    index = hidden_index(rows, "target", field.relation)
    return Stage(field, parts[0].op, parts, place, contributions, index)


def _staged_body(kernel: kir.Kernel, stages: Sequence[Stage]) -> kir.Body:
    places = {part: (each, number) for each in stages for number, part in enumerate(each.parts)}
    own = kir.ReadLocal(kernel.row, kernel.row.type, kernel.span)
    free = first_free_uid(kernel)
    number_of = {part: number for number, part in enumerate(places)}

    def effect(stmt: Effect) -> tuple[kir.Stmt, ...]:
        if not isinstance(stmt, kir.ReduceField) or stmt not in places:
            return (stmt,)
        each, number = places[stmt]
        indices = (kir.Const(number, int32, stmt.span), *stmt.indices)
        write = kir.WriteField(each.place, own, indices, stmt.value, stmt.span)
        # Nobody needs the key here, but to look at it may fail, and the index leaves out whatever is no row.
        target = kir.Local("target", free + number_of[stmt], stmt.key.type)
        return (kir.Assign(target, (), stmt.key, stmt.span), write)

    body = Copier(0, lambda _: None, effect).body(kernel.body)
    always = {stmt for stmt in kernel.body if isinstance(stmt, kir.ReduceField) and not stmt.indices}
    clear = [each for each in stages if not always.issuperset(each.parts)]
    return (*(_cleared(each, own, kernel.span) for each in clear), *body)


def _cleared(each: Stage, own: kir.ReadLocal, span: Span) -> kir.WriteField:
    """Sets a row of the stage to what changes nothing, for the values that the row may not give."""
    type_ = each.place.type
    identity = identity_of(each.op.value, type_.dtype).item()
    return kir.WriteField(each.place, own, (), kir.Const(_filled(identity, type_.shape), type_, span), span)


def _filled(value: object, shape: tuple[int, ...]) -> object:
    return tuple(_filled(value, shape[1:]) for _ in range(shape[0])) if shape else value


def _gathering(kernel: kir.Kernel, each: Stage) -> kir.Kernel:
    """For each target, the reduction of what has been staged for it."""
    target, span = each.field.relation, kernel.span
    row = kir.Local("target", 0, target.key_type)
    member = kir.Local("given", 1, each.contributions.relation.key_type)
    own = kir.ReadLocal(row, row.type, span)
    value = kir.ReadField(each.contributions, kir.ReadLocal(member, member.type, span), each.field.type, span)
    change = kir.ReduceField(each.field, own, (), each.op, value, span)
    body = (kir.ForQuery(member, each.index, own, (change,), span),)
    return kir.Kernel(kernel.name, target, row, kernel.uniforms, body, span)
