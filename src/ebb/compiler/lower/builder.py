"""Builds LIR bodies: fresh temporaries, nested bodies, and arithmetic with the trivial cases folded."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager

from ebb.compiler import lir
from ebb.types.types import Kind, ScalarType, bool_, int64, uint64

Values = tuple[lir.Value, ...]


def index(number: int) -> lir.Literal:
    """An int64 literal, as addresses and components are."""
    return lir.Literal(number, int64)


def zero(scalar: ScalarType) -> lir.Literal:
    """The zero of a scalar type; False for bools."""
    return number(0, scalar)


def number(value: float, scalar: ScalarType) -> lir.Literal:
    """``value`` as a literal of ``scalar``."""
    if scalar.kind is Kind.BOOL:
        return lir.Literal(bool(value), scalar)
    return lir.Literal(float(value) if scalar.kind is Kind.FLOAT else int(value), scalar)


class Builder:
    """Appends statements to the innermost open body.

    Attributes:
        private_bytes: the size of all variables so far.
    """

    def __init__(self) -> None:
        self._temps = self._vars = self._labels = 0
        self._bodies: list[list[lir.Stmt]] = []
        self.private_bytes = 0

    # ---- Bodies and names ----

    @contextmanager
    def body(self) -> Generator[list[lir.Stmt], None, None]:
        """Opens a body; what is built meanwhile goes into it."""
        self._bodies.append([])
        yield self._bodies[-1]
        self._bodies.pop()

    def add(self, stmt: lir.Stmt) -> None:
        self._bodies[-1].append(stmt)

    def extend(self, stmts: Sequence[lir.Stmt]) -> None:
        self._bodies[-1].extend(stmts)

    def temp(self, scalar: ScalarType) -> lir.Temp:
        self._temps += 1
        return lir.Temp(self._temps - 1, scalar)

    def label(self, name: str) -> lir.Label:
        self._labels += 1
        return lir.Label(self._labels - 1, name)

    def declare(
        self, name: str, scalar: ScalarType, size: int, memory: lir.Memory = lir.Memory.PRIVATE
    ) -> lir.Var:  # fmt: skip
        """A variable, declared here."""
        if memory is lir.Memory.PRIVATE:
            self.private_bytes += size * scalar.bits // 8
        var = lir.Var(self._vars, name, scalar, size, memory)
        self._vars += 1
        self.add(lir.Declare(var))
        return var

    # ---- Operations ----

    def let(self, operation: lir.Operation, scalar: ScalarType) -> lir.Temp:
        temp = lir.Temp(self._temps, scalar)
        self._temps += 1
        self._bodies[-1].append(lir.Let(temp, operation))
        return temp

    def binary(self, op: str, left: lir.Value, right: lir.Value) -> lir.Value:
        if (isinstance(left, lir.Literal) or isinstance(right, lir.Literal)) and left.type == int64:
            folded = _fold(op, left, right)
            if folded is not None:
                return folded
        return self.let(lir.Binary(op, left, right), left.type)

    def compare(self, op: str, left: lir.Value, right: lir.Value) -> lir.Value:
        return self.let(lir.Compare(op, left, right), bool_)

    def unary(self, op: str, operand: lir.Value) -> lir.Value:
        return self.let(lir.Unary(op, operand), operand.type)

    def select(self, condition: lir.Value, then: lir.Value, other: lir.Value) -> lir.Value:
        return self.let(lir.Select(condition, then, other), then.type)

    def math(self, function: str, *operands: lir.Value) -> lir.Value:
        return self.let(lir.Math(function, operands), operands[0].type)

    def convert(self, value: lir.Value, scalar: ScalarType) -> lir.Value:
        if value.type is scalar or value.type == scalar:
            return value
        if isinstance(value, lir.Literal) and value.type.kind is Kind.SIGNED and _widens(value.type, scalar):
            return number(value.value, scalar)
        return self.let(lir.Convert(value), scalar)

    def load(self, slot: lir.Slot, at: lir.Value) -> lir.Value:
        return self.let(lir.Load(slot, at), slot.type)

    def load_var(self, var: lir.Var, at: lir.Value | int = 0) -> lir.Value:
        return self.let(lir.LoadVar(var, index(at) if isinstance(at, int) else at), var.type)

    def store_var(self, var: lir.Var, at: lir.Value | int, value: lir.Value) -> None:
        self.add(lir.StoreVar(var, index(at) if isinstance(at, int) else at, value))

    def load_all(self, var: lir.Var) -> Values:
        return tuple(self.load_var(var, k) for k in range(var.size))

    def store_all(self, var: lir.Var, values: Sequence[lir.Value]) -> None:
        for k, value in enumerate(values):
            self.store_var(var, k, value)

    # ---- Index arithmetic ----

    def add_index(self, left: lir.Value, right: lir.Value | int) -> lir.Value:
        return self.binary("+", left, index(right) if isinstance(right, int) else right)

    def scale_index(self, left: lir.Value, factor: lir.Value | int) -> lir.Value:
        return self.binary("*", left, index(factor) if isinstance(factor, int) else factor)

    def outside(self, at: lir.Value, extent: lir.Value) -> lir.Value:
        """Whether not ``0 <= at < extent``, both int64; ``extent`` is not negative."""
        return self.compare(">=", self.convert(at, uint64), self.convert(extent, uint64))

    def any(self, conditions: Sequence[lir.Value]) -> lir.Value:
        result = conditions[0]
        for condition in conditions[1:]:
            result = self.binary("|", result, condition)
        return result

    # ---- Control ----

    def choose(self, condition: lir.Value, then: _Arm, other: _Arm) -> Values:
        """The values of the arm that ``condition`` chooses; the other is not run, unless that cannot be told."""
        if _cheap(then.body) and _cheap(other.body):
            self.extend(then.body)
            self.extend(other.body)
            return tuple(self.select(condition, a, b) for a, b in zip(then.values, other.values, strict=True))
        chosen = [self.declare("chosen", value.type, 1) for value in then.values]
        bodies = [
            (*arm.body, *(lir.StoreVar(var, index(0), value) for var, value in zip(chosen, arm.values, strict=True)))
            for arm in (then, other)
        ]
        self.add(lir.If(condition, bodies[0], bodies[1]))
        return tuple(self.load_var(var) for var in chosen)


class _Arm:
    """Statements and the values that they compute."""

    def __init__(self, body: lir.Body, values: Values) -> None:
        self.body = body
        self.values = values


def arm(body: Sequence[lir.Stmt], values: Values) -> _Arm:
    """One side of ``Builder.choose``."""
    return _Arm(tuple(body), values)


def _widens(source: ScalarType, target: ScalarType) -> bool:
    return target.kind is Kind.FLOAT or (target.kind is Kind.SIGNED and target.bits >= source.bits)


_MOST_SPECULATED = 16


def _cheap(body: lir.Body) -> bool:
    """Whether ``body`` may run where its values are not needed: a little arithmetic, and no memory."""
    return len(body) <= _MOST_SPECULATED and all(
        isinstance(stmt, lir.Let) and not isinstance(stmt.operation, lir.Load | lir.Math) for stmt in body
    )


def _fold(op: str, left: lir.Value, right: lir.Value) -> lir.Value | None:
    """The value of int64 arithmetic where a literal tells it."""
    match op, left, right:
        case "+", lir.Literal(a, _), lir.Literal(b, _):
            return index(a + b)
        case "*", lir.Literal(a, _), lir.Literal(b, _):
            return index(a * b)
        case (("+" | "-"), _, lir.Literal(0, _)):
            return left
        case "+", lir.Literal(0, _), _:
            return right
        case ("*", lir.Literal(0, _), _) | ("*", _, lir.Literal(0, _)):
            return index(0)
        case (("*" | "//"), _, lir.Literal(1, _)):
            return left
        case "*", lir.Literal(1, _), _:
            return right
        case _:
            return None
