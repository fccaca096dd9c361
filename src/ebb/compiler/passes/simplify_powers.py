"""Turns powers with small constant exponents into products, quotients and square roots.

NumPy does the same for -1, 0.5, 1 and 2 where the base is an array. Cubes and fourth powers as products are within one
and two units in the last place of ``pow``; of integers they are exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ebb.compiler import kir
from ebb.compiler.kir_walk import expressions, map_bodies, map_children, map_operands, statements
from ebb.records import field, record, replace
from ebb.types.types import Kind, ScalarType


def simplify_powers(kernel: kir.Kernel) -> kir.Kernel:
    """``kernel`` with powers of the exponents -1, 0.5, 1, 2, 3 and 4 as cheaper operators; of integers 1 to 4 only."""
    if not any([isinstance(expr, kir.Binary) and expr.op == "**" for expr in expressions(kernel.body)]):
        return kernel
    used = [stmt.local.uid for stmt in statements(kernel.body) if isinstance(stmt, _BINDS)]
    return replace(kernel, body=_Powers(max(used, default=0) + kernel.row.uid + 1).rewrite(kernel.body))


_BINDS = kir.Assign | kir.ForRange | kir.ForQuery
_INTEGER = (1, 2, 3, 4)
_FLOAT = (-1, 0.5, *_INTEGER)


@record(frozen=False)
class _Powers:
    """The rewriting of one kernel. A base that is more than a name is bound to a new local before the statement."""

    next_uid: int
    bindings: list[kir.Stmt] = field(default_factory=list[kir.Stmt])

    def rewrite(self, body: kir.Body) -> kir.Body:
        statements: list[kir.Stmt] = []
        for stmt in body:
            inner = map_bodies(stmt, self.rewrite)
            # The condition of a loop is evaluated again at each turn, so that nothing of it may move before the loop.
            change = self._within_condition if isinstance(stmt, kir.While) else self._expression
            changed = map_operands(inner, change)
            statements += [*self.bindings, changed]
            self.bindings = []
        unchanged = len(statements) == len(body) and all(a is b for a, b in zip(statements, body, strict=True))
        return body if unchanged else tuple(statements)

    def _expression(self, expr: kir.Expr) -> kir.Expr:
        match expr:
            case kir.Choose(condition, then, other):
                parts = (self._expression(condition), self._within_condition(then), self._within_condition(other))
                return _changed(expr, condition=parts[0], then=parts[1], other=parts[2])
            case kir.Logic(_, left, right):
                return _changed(expr, left=self._expression(left), right=self._within_condition(right))
            case _:
                return self._power(map_children(expr, self._expression), may_bind=True)

    def _within_condition(self, expr: kir.Expr) -> kir.Expr:
        """As ``_expression`` where the evaluation depends on a condition: nothing may be evaluated before it."""
        return self._power(map_children(expr, self._within_condition), may_bind=False)

    def _power(self, expr: kir.Expr, *, may_bind: bool) -> kir.Expr:
        if not isinstance(expr, kir.Binary) or expr.op != "**":
            return expr
        exponent = _constant_of(expr.right)
        if exponent not in _exponents(expr):
            return expr
        base = expr.left
        if exponent == 1:
            return base
        if exponent == 0.5:
            return kir.Call("sqrt", (base,), expr.type, expr.span)
        if exponent == -1:
            return kir.Binary("/", _one(expr), base, expr.type, expr.span)
        if not isinstance(base, kir.ReadLocal | kir.Uniform | kir.Const):
            if not may_bind:
                return expr
            base = self._bind(base)
        return self._product(base, exponent, may_bind)

    def _product(self, base: kir.Expr, exponent: int, may_bind: bool) -> kir.Expr:
        square = _times(base, base)
        if exponent == 2:
            return square
        if exponent == 3:
            return _times(square, base)
        return _times(*(self._bind(square),) * 2) if may_bind else _times(square, square)

    def _bind(self, value: kir.Expr) -> kir.ReadLocal:
        local = kir.Local("base", self.next_uid, value.type)
        self.next_uid += 1
        self.bindings.append(kir.Assign(local, (), value, value.span))
        return kir.ReadLocal(local, local.type, value.span)


def _exponents(power: kir.Binary) -> tuple[float, ...]:
    scalar = power.type.scalar
    return _FLOAT if isinstance(scalar, ScalarType) and scalar.kind is Kind.FLOAT else _INTEGER


def _constant_of(expr: kir.Expr) -> Any:
    """The number that ``expr`` is in every component, or None."""
    match expr:
        case kir.Splat(operand):
            return _constant_of(operand)
        case kir.Const(value):
            entries = np.ravel(np.asarray(value))
            return entries[0].item() if np.all(entries == entries[0]) else None
        case _:
            return None


def _one(power: kir.Binary) -> kir.Expr:
    one = kir.Const(1.0, power.type.scalar, power.span)
    return kir.Splat(one, power.type, power.span) if power.type.shape else one


def _times(left: kir.Expr, right: kir.Expr) -> kir.Expr:
    return kir.Binary("*", left, right, left.type, left.span)


def _changed(expr: Any, **parts: kir.Expr) -> Any:
    return expr if all(getattr(expr, name) is part for name, part in parts.items()) else replace(expr, **parts)
