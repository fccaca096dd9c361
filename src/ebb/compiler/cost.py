"""A cost model of kernels: the bytes that a row moves and the operations that it does, counted on KIR.

It counts what the program asks for, before any cache: each place that a row reads once, and again in each turn of a
loop; the longer branch of a condition; a query loop as many times as a group has rows on average.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

from ebb.compiler import kir
from ebb.compiler.kir_walk import children
from ebb.compiler.phases.centered import Centered, find_centered
from ebb.records import field, record, replace
from ebb.relations.field import Field
from ebb.types.types import Type

Place: TypeAlias = "tuple[Any, ...]"


@record
class Cost:
    """What one row costs, on average over the relation.

    Attributes:
        own_bytes: read from the kernel's own row.
        other_bytes: read from other rows, and from the index of queries.
        written_bytes: written or reduced; a reduction also counts as a read.
        operations: on scalars: arithmetic, comparisons, builtins.
        uncounted: loops of unknown length, counted as one turn.
        series: those of the operations that take tens of others: sines, powers, random numbers.
    """

    own_bytes: float = 0.0
    other_bytes: float = 0.0
    written_bytes: float = 0.0
    operations: float = 0.0
    uncounted: int = 0
    series: float = 0.0

    @property
    def bytes(self) -> float:
        """All bytes moved."""
        return self.own_bytes + self.other_bytes + self.written_bytes

    @property
    def nanoseconds(self) -> float:
        """About what a row takes on one thread, from the nearer caches: good to a factor of three or so."""
        near, far = self.own_bytes + self.written_bytes, self.other_bytes
        return 0.01 * near + 0.05 * far + 0.04 * self.operations + 0.5 * self.series

    def plus(self, other: Cost, times: float = 1.0) -> Cost:
        """The cost of this, and ``times`` turns of ``other``."""
        if other is _NOTHING:
            return self
        return Cost(
            self.own_bytes + times * other.own_bytes,
            self.other_bytes + times * other.other_bytes,
            self.written_bytes + times * other.written_bytes,
            self.operations + times * other.operations,
            self.uncounted + other.uncounted,
            self.series + times * other.series,
        )


_NOTHING = Cost()
_FREE = (kir.Const, kir.Uniform, kir.ReadLocal, kir.ReadGlobal)


def cost_of(kernel: kir.Kernel) -> Cost:
    """The cost of one row of ``kernel`` on the data that its relations hold now."""
    return _Counter(find_centered(kernel)).body(kernel.body)


def group_size(index: Field) -> float:
    """The rows that a query by ``index`` finds on average."""
    target = index.target
    assert target is not None, "the index of a query holds keys"
    return index.relation.size / target.size if target.size else 0.0


@record
class _Counter:
    """Counts the code of one loop. ``read`` are the places that have been read in this turn, or before the loop."""

    centered: Centered
    read: set[Place] = field(default_factory=set[Place])

    def body(self, body: kir.Body) -> Cost:
        total = Cost()
        for stmt in body:
            total = total.plus(self._stmt(stmt))
        return total

    def _loop(self, body: kir.Body) -> Cost:
        return _Counter(self.centered, set(self.read)).body(body)

    def _stmt(self, stmt: kir.Stmt) -> Cost:
        match stmt:
            case kir.Assign(_, indices, value):
                return self._all((*indices, value))
            case kir.WriteField() | kir.ReduceField():
                return self._all((stmt.key, *stmt.indices, stmt.value)).plus(self._change(stmt))
            case kir.ReduceGlobal(_, indices, value=value):
                return self._all((*indices, value)).plus(Cost(operations=value.type.size))
            case kir.Assert(condition):
                return self._expr(condition)
            case kir.Print(parts):
                return self._all(part[0] for part in parts if not isinstance(part, str))
            case kir.If(condition, then, orelse):
                branches = (self._loop(then), self._loop(orelse))
                return self._expr(condition).plus(max(branches, key=lambda cost: (cost.bytes, cost.operations)))
            case kir.Break() | kir.Continue() | kir.Leave() | kir.Breakpoint():
                return Cost()
            case _:
                return self._nested(stmt)

    def _nested(self, stmt: kir.Block | kir.While | kir.ForRange | kir.ForQuery) -> Cost:
        match stmt:
            case kir.Block(_, body):
                return self.body(body)
            case kir.While(condition, body):
                return self._expr(condition).plus(_unknown(self._loop(body)))
            case kir.ForRange(_, start, stop, step, body):
                head = self._all((start, stop, step))
                match start, stop, step:
                    case kir.Const(first), kir.Const(last), kir.Const(by) if by:
                        return head.plus(self._loop(body), len(range(first, last, by)))
                    case _:
                        return head.plus(_unknown(self._loop(body)))
            case kir.ForQuery(_, index, key, body):
                turns = group_size(index)
                indirect = index.grouping is not None and index.grouping.rows is not None
                entries = 2 + (turns if indirect else 0)
                return self._expr(key).plus(Cost(other_bytes=_entry(index) * entries)).plus(self._loop(body), turns)

    def _change(self, stmt: kir.WriteField | kir.ReduceField) -> Cost:
        size = stmt.value.type.size
        cost = Cost(written_bytes=size * _scalar_bytes(stmt.field.type))
        if isinstance(stmt, kir.ReduceField):
            cost = cost.plus(Cost(operations=size)).plus(self._read(stmt.field, stmt.key, stmt.indices, size))
        return cost

    def _all(self, exprs: Iterable[kir.Expr]) -> Cost:
        total = _NOTHING
        for expr in exprs:
            if not isinstance(expr, _FREE):
                total = total.plus(self._expr(expr))
        return total

    def _expr(self, expr: kir.Expr) -> Cost:
        match expr:
            case kir.Component(kir.ReadField(of, key), indices):
                return self._all((key, *indices)).plus(self._read(of, key, indices, expr.type.size))
            case kir.ReadField(of, key):
                return self._expr(key).plus(self._read(of, key, (), expr.type.size))
            case kir.QuerySize(index, key):
                return self._expr(key).plus(Cost(other_bytes=2 * _entry(index), operations=1))
            case kir.Choose(condition, then, other):
                arms = (self._expr(then), self._expr(other))
                return self._expr(condition).plus(max(arms, key=lambda cost: (cost.bytes, cost.operations)))
            case _:
                operations = _operations(expr)
                if not operations:
                    return self._all(children(expr))
                own = Cost(operations=operations, series=operations if _is_series(expr) else 0.0)
                return self._all(children(expr)).plus(own)

    def _read(self, of: Field, key: kir.Expr, indices: tuple[kir.Expr, ...], size: int) -> Cost:
        place = (of, _name(key), *map(_name, indices))
        if place in self.read or place[:2] in self.read:
            return _NOTHING
        self.read.add(place)
        count = size * _scalar_bytes(of.type)
        return Cost(own_bytes=count) if self.centered.is_centered(key) else Cost(other_bytes=count)


def _entry(index: Field) -> int:
    """The bytes of one entry of the offsets or the rows of a grouping."""
    return index.relation.key_dtype.itemsize


def _unknown(turn: Cost) -> Cost:
    return replace(turn, uncounted=turn.uncounted + 1)


def _name(expr: kir.Expr) -> Any:
    """What two expressions have in common when they are the same value, as far as is easily seen."""
    match expr:
        case kir.ReadLocal(local):
            return local.uid
        case kir.Const(value):
            return ("constant", value)
        case kir.ReadField(of, key):
            return (of, _name(key))
        case kir.Affine(matrix, key):
            return (expr.type, matrix, _name(key))
        case kir.RowAt(coordinates):
            return (expr.type, _name(coordinates))
        case kir.Component(operand, indices):
            return (_name(operand), *map(_name, indices))
        case _:
            return id(expr)


def _scalar_bytes(type_: Type) -> int:
    return type_.dtype.itemsize


def _operations(expr: kir.Expr) -> float:
    """The operations on scalars that ``expr`` itself does."""
    match expr:
        case kir.Unary() | kir.Binary() | kir.Compare():
            return max(expr.type.size, *(child.type.size for child in children(expr)))
        case kir.Logic() | kir.Random():
            return 1
        case kir.Call(builtin, arguments) if builtin in _CALLS:
            return _CALLS[builtin](expr.type, arguments[0].type)
        case kir.Call(_, arguments):
            return max((expr.type.size, *(argument.type.size for argument in arguments)))
        case _:
            return 0


def _is_series(expr: kir.Expr) -> bool:
    match expr:
        case kir.Random():
            return True
        case kir.Call(builtin):
            return builtin in _SERIES
        case kir.Binary(op):
            return op == "**"
        case _:
            return False


_SERIES = frozenset((
    "cbrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "sin", "cos", "tan", "asin", "acos", "atan",
    "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "hypot", "fmod", "erf", "erfc", "gamma", "lgamma",
))  # fmt: skip
"""Builtins that libraries compute by series or by bits."""

_CALLS: Mapping[str, Callable[[Type, Type], float]] = {
    "dot": lambda result, first: 2 * first.size - 1,
    "cross": lambda result, first: 9,
    "length": lambda result, first: 2 * first.size,
    "normalize": lambda result, first: 3 * first.size,
    "matmul": lambda result, first: result.size * (2 * first.shape[-1] - 1),
    "det": lambda result, first: first.shape[0] ** 3,
    "inverse": lambda result, first: 2 * first.shape[0] ** 3,
    "trace": lambda result, first: first.shape[0] - 1,
    "transpose": lambda result, first: 0,
}
"""The operations of the builtins that do not do one an element, by the types of the result and the first argument.

Determinants and inverses are by cofactors up to 4 x 4; the cube of their extent is near enough.
"""
