"""How each builtin is computed: a table by the names in ``ebb.types.builtins``.

A row gets the components of the arguments, which have exactly the types of the builtin's signature.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce

from ebb.compiler import lir
from ebb.compiler.lower.builder import Builder, Values, number, zero
from ebb.records import record
from ebb.types.small_matrix import adjugate, determinant
from ebb.types.types import Kind, Type, int64

Lowering = Callable[[Builder, tuple[Values, ...], tuple[Type, ...], Type], Values]
_Component = Callable[..., lir.Value]


@record
class _Number:
    """A value with the operators that the formulas of ``small_matrix`` use."""

    build: Builder
    value: lir.Value

    def __add__(self, other: _Number) -> _Number:
        return _Number(self.build, self.build.binary("+", self.value, other.value))

    def __sub__(self, other: _Number) -> _Number:
        return _Number(self.build, self.build.binary("-", self.value, other.value))

    def __mul__(self, other: _Number) -> _Number:
        return _Number(self.build, self.build.binary("*", self.value, other.value))

    def __neg__(self) -> _Number:
        return _Number(self.build, self.build.unary("-", self.value))


# ---- By component ----


def _by_component(compute: _Component) -> Lowering:
    """A builtin that works by component; an argument that is a scalar goes with every component."""

    def lowering(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
        del types
        spread = [values * result.size if len(values) == 1 else values for values in arguments]
        return tuple(compute(b, *values) for values in zip(*spread, strict=True))

    return lowering


def _function(name: str) -> Lowering:
    def call(b: Builder, *values: lir.Value) -> lir.Value:
        return b.math(name, *values)

    return _by_component(call)


def _fold(op: str) -> Lowering:
    def fold(b: Builder, *values: lir.Value) -> lir.Value:
        return reduce(lambda x, y: b.binary(op, x, y), values)

    return _by_component(fold)


def _abs(b: Builder, x: lir.Value) -> lir.Value:
    match x.type.kind:
        case Kind.FLOAT:
            return b.math("abs", x)
        case Kind.SIGNED:
            return b.select(b.compare("<", x, zero(x.type)), b.unary("-", x), x)
        case _:
            return x


def _sign(b: Builder, x: lir.Value) -> lir.Value:
    """1, -1, or 0; what is none of these, NaN, stays."""
    nothing, one = zero(x.type), number(1, x.type)
    rest = b.select(b.compare("==", x, nothing), nothing, x)
    if x.type.kind is not Kind.UNSIGNED:
        rest = b.select(b.compare("<", x, nothing), number(-1, x.type), rest)
    return b.select(b.compare(">", x, nothing), one, rest)


def _clamp(b: Builder, x: lir.Value, low: lir.Value, high: lir.Value) -> lir.Value:
    return b.binary("min", b.binary("max", x, low), high)


def _to_int64(function: str) -> Lowering:
    def rounded(b: Builder, x: lir.Value) -> lir.Value:
        return b.convert(b.math(function, x), int64) if x.type.kind is Kind.FLOAT else x

    return _by_component(rounded)


def _times(factor: float) -> Lowering:
    def scale(b: Builder, x: lir.Value) -> lir.Value:
        return b.binary("*", x, number(factor, x.type))

    return _by_component(scale)


def _select(b: Builder, condition: lir.Value, then: lir.Value, other: lir.Value) -> lir.Value:
    return b.select(condition, then, other)


def _is_nan(b: Builder, x: lir.Value) -> lir.Value:
    return b.compare("!=", x, x)


def _is_infinite(b: Builder, x: lir.Value) -> lir.Value:
    return b.compare("==", b.math("abs", x), number(math.inf, x.type))


def _is_finite(b: Builder, x: lir.Value) -> lir.Value:
    return b.compare("<", b.math("abs", x), number(math.inf, x.type))


# ---- Vectors and matrices ----


def _sum_of_products(b: Builder, left: Sequence[lir.Value], right: Sequence[lir.Value]) -> lir.Value:
    products = [b.binary("*", x, y) for x, y in zip(left, right, strict=True)]
    return reduce(lambda x, y: b.binary("+", x, y), products)


def _dot(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del types, result
    return (_sum_of_products(b, *arguments),)


def _cross(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del types, result
    x, y = arguments

    def minor(i: int, j: int) -> lir.Value:
        return b.binary("-", b.binary("*", x[i], y[j]), b.binary("*", x[j], y[i]))

    return (minor(1, 2), minor(2, 0), minor(0, 1))


def _length(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del types, result
    return (b.math("sqrt", _sum_of_products(b, arguments[0], arguments[0])),)


def _normalize(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    (norm,) = _length(b, arguments, types, result)
    nothing = zero(norm.type)
    # One division: the components are multiplied by the inverse, as the builtin's row says.
    inverse = b.select(b.compare("==", norm, nothing), nothing, b.binary("/", number(1, norm.type), norm))
    return tuple(b.binary("*", x, inverse) for x in arguments[0])


def _outer(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del types, result
    return tuple(b.binary("*", x, y) for x in arguments[0] for y in arguments[1])


def _rows(values: Values, type_: Type) -> list[Values]:
    columns = type_.shape[-1]
    return [values[start : start + columns] for start in range(0, len(values), columns)]


def _transpose(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del b, result
    return tuple(value for column in zip(*_rows(arguments[0], types[0]), strict=True) for value in column)


def _trace(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del result
    diagonal = [row[k] for k, row in enumerate(_rows(arguments[0], types[0]))]
    return (reduce(lambda x, y: b.binary("+", x, y), diagonal),)


def _matmul(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del result
    left = _rows(arguments[0], types[0])
    right = _rows(arguments[1], types[1]) if len(types[1].shape) == 2 else [(value,) for value in arguments[1]]
    columns = list(zip(*right, strict=True))
    return tuple(_sum_of_products(b, row, column) for row in left for column in columns)


def _numbers(b: Builder, values: Values, type_: Type) -> list[list[_Number]]:
    return [[_Number(b, value) for value in row] for row in _rows(values, type_)]


def _determinant(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del result
    return (determinant(_numbers(b, arguments[0], types[0])).value,)


def _inverse(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
    del result
    m = _numbers(b, arguments[0], types[0])
    if len(m) == 1:
        return (b.binary("/", number(1, m[0][0].value.type), m[0][0].value),)
    divisor = determinant(m).value
    return tuple(b.binary("/", entry.value, divisor) for row in adjugate(m) for entry in row)


def _combined(op: str) -> Lowering:
    """All components of one argument under ``op``."""

    def lowering(b: Builder, arguments: tuple[Values, ...], types: tuple[Type, ...], result: Type) -> Values:
        del types, result
        return (reduce(lambda x, y: b.binary(op, x, y), arguments[0]),)

    return lowering


# ---- The rows ----

_FUNCTIONS = (
    "sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "sin", "cos", "tan", "asin",
    "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "hypot", "fmod", "copysign",
    "floor", "ceil", "trunc", "erf", "erfc", "gamma", "lgamma",
)  # fmt: skip

LOWERING: Mapping[str, Lowering] = {name: _function(name) for name in _FUNCTIONS} | {
    "abs": _by_component(_abs),
    "fabs": _function("abs"),
    "min": _fold("min"),
    "max": _fold("max"),
    "clamp": _by_component(_clamp),
    "sign": _by_component(_sign),
    "select": _by_component(_select),
    "round": _to_int64("round"),
    "math.floor": _to_int64("floor"),
    "math.ceil": _to_int64("ceil"),
    "math.trunc": _to_int64("trunc"),
    "degrees": _times(180.0 / math.pi),
    "radians": _times(math.pi / 180.0),
    "isnan": _by_component(_is_nan),
    "isinf": _by_component(_is_infinite),
    "isfinite": _by_component(_is_finite),
    "dot": _dot,
    "cross": _cross,
    "length": _length,
    "normalize": _normalize,
    "outer": _outer,
    "transpose": _transpose,
    "trace": _trace,
    "matmul": _matmul,
    "det": _determinant,
    "inverse": _inverse,
    "all": _combined("&"),
    "any": _combined("|"),
}
