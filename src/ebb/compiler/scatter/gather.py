"""A reduction into other rows as a gather: each target looks up the rows that refer to it and takes what they give.

A kernel over ``R`` that reduces into ``r.key.f`` becomes one over the target: for each row of ``R`` whose ``key`` is
the target, the body of the kernel, computed again. What else it does is left for a kernel of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias, cast

from ebb.compiler import kir
from ebb.compiler.kir_walk import draws, statements
from ebb.compiler.phases.centered import Centered, find_centered, single_assignments
from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.table import PhaseKind, PhaseTable
from ebb.compiler.scatter.keys import certain_locals
from ebb.compiler.scatter.rewrite import Copier, Effect, first_free_uid
from ebb.compiler.scatter.step import Step
from ebb.records import record, replace
from ebb.relations.field import Field
from ebb.relations.relation import Relation

Route: TypeAlias = "tuple[Field, tuple[int, ...]] | None"
"""How a row refers to its target: a component of a key field; None where the target is the row itself."""


@record(eq=False)
class Routes:
    """The reductions of a kernel into other rows, each with the route to its target.

    Attributes:
        of: the route of each reduction.
        centered: the locals that hold the kernel's own row.
    """

    of: Mapping[kir.ReduceField, Route]
    centered: Centered

    @property
    def targets(self) -> tuple[Relation, ...]:
        """The relations that are reduced into."""
        return tuple(dict.fromkeys(stmt.field.relation for stmt in self.of))

    def into(self, target: Relation) -> tuple[Route, ...]:
        """The routes to the rows of ``target``."""
        return tuple(dict.fromkeys(route for stmt, route in self.of.items() if stmt.field.relation is target))

    @property
    def all(self) -> tuple[Route, ...]:
        """All routes, those to one target after those to another."""
        return tuple(route for target in self.targets for route in self.into(target))


def find_routes(kernel: kir.Kernel, phases: PhaseTable) -> Routes | None:
    """The routes of the reductions of ``kernel`` into other rows; None where values cannot be computed again."""
    if not _may_run_again(kernel, phases):
        return None
    certain = certain_locals(kernel)
    values = {uid: value for uid, value in single_assignments(kernel).items() if uid in certain}
    centered = find_centered(kernel)
    found: dict[kir.ReduceField, Route] = {}
    for stmt in statements(kernel.body):
        if isinstance(stmt, kir.ReduceField) and phases.fields[stmt.field].kind is PhaseKind.REDUCE:
            route = None if centered.is_centered(stmt.key) else _route(stmt.key, centered, values)
            if route is None and not centered.is_centered(stmt.key):
                return None
            found[stmt] = route
    return Routes(found, centered)


def gather(
    kernel: kir.Kernel, routes: Routes, indexes: Mapping[Route, Field], unchecked: Sequence[kir.Affine]
) -> list[Step]:
    """The kernels that do what ``kernel`` does, one after the other.

    Args:
        kernel: the kernel over the rows that refer to the targets.
        routes: of its reductions into other rows.
        indexes: for each route through a key field, the field whose grouping finds the rows by their target.
        unchecked: the affine accesses of ``kernel`` that are known to stay within their grids.
    """
    steps = [_gather_into(kernel, target, routes, indexes, unchecked) for target in routes.targets]
    rest = Copier(0, lambda _: None, lambda stmt: () if stmt in routes.of else (stmt,)).body(kernel.body)
    if any(isinstance(stmt, kir.WriteField | kir.ReduceField | kir.ReduceGlobal) for stmt in statements(rest)):
        left = kir.Kernel(kernel.name, kernel.relation, kernel.row, kernel.uniforms, rest, kernel.span)
        steps.append(Step(left, check_phases(left), tuple(unchecked)))
    return steps


def _may_run_again(kernel: kir.Kernel, phases: PhaseTable) -> bool:
    """Whether the body can be run for each of its reductions, and in another order than it is written in."""
    return not draws(kernel) and not any(phase.changed and phase.read for phase in phases.fields.values())


def _route(key: kir.Expr, centered: Centered, values: Mapping[int, kir.Expr], index: tuple[int, ...] = ()) -> Route:
    """The route to the row ``key``, where it is a component of a key field of the own row; else None."""
    match key:
        case kir.ReadLocal(local) if local.uid in values:
            return _route(values[local.uid], centered, values, index)
        case kir.Component(operand, indices):
            numbers = [part.value for part in indices if isinstance(part, kir.Const)]
            return _route(operand, centered, values, (*numbers, *index)) if len(numbers) == len(indices) else None
        case kir.ReadField(field, base) if centered.is_centered(base) and len(index) == len(field.type.shape):
            return (field, index)
        case _:
            return None


def _gather_into(
    kernel: kir.Kernel,
    target: Relation,
    routes: Routes,
    indexes: Mapping[Route, Field],
    unchecked: Sequence[kir.Affine],
) -> Step:
    free = first_free_uid(kernel)
    row = kir.Local("target", 0, target.key_type)
    own = kir.ReadLocal(row, row.type, kernel.span)
    body: list[kir.Stmt] = []
    known: list[kir.Affine] = []
    for number, route in enumerate(routes.into(target)):
        part = _Part(routes, route, target, own)
        copier = Copier((number + 1) * free, part.substitute, part.effect)
        inner = copier.body(kernel.body)
        known += [cast("kir.Affine", copier.expr(node)) for node in unchecked]
        member = copier.local(kernel.row)
        if route is None:
            body += [kir.Assign(member, (), own, kernel.span), *inner]
        else:
            body.append(kir.ForQuery(member, indexes[route], own, inner, kernel.span))
    made = kir.Kernel(kernel.name, target, row, kernel.uniforms, tuple(body), kernel.span)
    return Step(made, check_phases(made), tuple(known))


@record(eq=False)
class _Part:
    """What the body becomes where it gathers along one route into one target, whose row is ``own``."""

    routes: Routes
    route: Route
    target: Relation
    own: kir.ReadLocal

    def substitute(self, expr: kir.Expr) -> kir.Expr | None:
        """The target, where the body reads the key by which the row was found."""
        if expr is self.own:
            return expr
        return self.own if self.route is not None and _reads(expr, self.route, self.routes.centered) else None

    def effect(self, stmt: Effect) -> tuple[kir.Stmt, ...]:
        """Only the reductions along the route are left, into the target itself."""
        if not isinstance(stmt, kir.ReduceField) or stmt not in self.routes.of:
            return ()
        mine = self.routes.of[stmt] == self.route and stmt.field.relation is self.target
        return (replace(stmt, key=self.own),) if mine else ()


def _reads(expr: kir.Expr, route: tuple[Field, tuple[int, ...]], centered: Centered) -> bool:
    """Whether ``expr`` is the key of the own row that ``route`` goes by."""
    field, index = route
    match expr:
        case kir.ReadField(source, key):
            return source is field and not index and centered.is_centered(key)
        case kir.Component(kir.ReadField(source, key), indices) if source is field:
            numbers = tuple(part.value if isinstance(part, kir.Const) else None for part in indices)
            return numbers == index and centered.is_centered(key)
        case _:
            return False
