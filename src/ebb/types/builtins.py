"""The builtins: a row a function, with its signature and what it computes on NumPy values.

A row is the object that ``ebb.sqrt`` is. In a kernel it becomes a ``kir.Call`` of the row's name, with its arguments
converted as the signature says; called on the host it computes the same on NumPy values. Functions of real numbers take
integers as float64 and keep float32. On vectors and matrices they work by component.
"""

from __future__ import annotations

import builtins
import math
import operator
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any, NoReturn

import numpy as np

from ebb.records import record
from ebb.types import arithmetic, signatures, small_matrix
from ebb.types.rules import lone_type, weak_element
from ebb.types.signatures import Complaint, Rule, Signature
from ebb.types.types import (
    Element,
    ScalarType,
    Type,
    as_type,
    float64,
    from_dtype,
    int64,
    is_type,
    matrix,
    shaped_type,
    vector,
)


@record
class StaticValue:
    """A value known when the kernel is compiled: a Python number, or nested tuples of them, and its type."""

    value: Any
    type: Type


@record(eq=False)
class Builtin:
    """A builtin function of kernels.

    Attributes:
        name: what ``kir.Call`` calls it.
        fewest: how few arguments it takes.
        most: how many at most, None for any number.
        rule: the signature, once the number of arguments is right.
        meaning: what it computes, on NumPy scalars and arrays of exactly the signature's types.
        doc: one sentence for the reference.
        operator: the ``kir.Binary`` operator that a call folds into instead of a ``kir.Call`` (``min``, ``max``).
        static: for builtins of types and sizes (``identity``, ``zeros``): the constant that a call stands for.
    """

    name: str
    fewest: int
    most: int | None
    rule: Rule
    meaning: Callable[..., Any]
    doc: str
    operator: str | None = None
    static: Callable[..., StaticValue | Complaint] | None = None

    def signature(self, types: tuple[Type, ...]) -> Signature | Complaint:
        """What the arguments are converted to and what comes out, or why ``types`` do not fit."""
        return self._count_complaint(len(types)) or self.rule(types)

    def constant(self, arguments: tuple[Any, ...]) -> StaticValue | Complaint:
        """The constant that a call on these types and sizes stands for; only where ``static`` is set."""
        if self.static is None:
            return Complaint("takes values")
        return self._count_complaint(len(arguments)) or self.static(*arguments)

    def _count_complaint(self, count: int) -> Complaint | None:
        if count >= self.fewest and (self.most is None or count <= self.most):
            return None
        if self.most is None:
            expected = f"at least {self.fewest}"
        else:
            expected = str(self.fewest) if self.fewest == self.most else f"{self.fewest} or {self.most}"
        return Complaint(f"takes {expected} argument{'' if expected == '1' else 's'}, not {count}")

    def __call__(self, *arguments: Any) -> Any:
        """The value on the host.

        Raises:
            TypeError: the arguments do not fit the signature.
        """
        if self.static is not None:
            constant = self.constant(arguments)
            if isinstance(constant, Complaint):
                raise TypeError(f"{self.name}() {constant.text}")
            return arithmetic.convert(constant.value, constant.type)
        types = _host_types(arguments)
        signature = self.signature(types)
        if isinstance(signature, Complaint):
            raise TypeError(f"{self.name}() {signature.text}")
        with np.errstate(all="ignore"):
            values = (arithmetic.convert(v, t) for v, t in zip(arguments, signature.arguments, strict=True))
            return self.meaning(*values)

    def __repr__(self) -> str:
        return f"<ebb builtin {self.name}>"


@record(eq=False)
class Form:
    """A builtin that needs a row, so that it works in kernels only: ``id``, ``coords``, ``rand``, ``randn``."""

    name: str
    parameters: int
    doc: str

    def __call__(self, *arguments: Any) -> NoReturn:
        """Raises TypeError: there is no row on the host."""
        raise TypeError(f"ebb.{self.name}() works in kernels only: it needs a row")

    def __repr__(self) -> str:
        return f"<ebb builtin {self.name}>"


_where: Any = np.where  # its stubs leave the result unknown

# ---- What the irregular rows compute ----


def _clamp(x: Any, low: Any, high: Any) -> Any:
    return np.minimum(np.maximum(x, low), high)


def _cross(a: Any, b: Any) -> Any:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _length(v: Any) -> Any:
    return np.sqrt(arithmetic.dot(v, v))


def _normalize(v: Any) -> Any:
    norm = _length(v)
    return np.zeros_like(v) if norm == 0 else v * (v.dtype.type(1) / norm)


def _select(condition: Any, then: Any, other: Any) -> Any:
    chosen: Any = _where(condition, then, other)
    return chosen[()]


def _transpose(m: Any) -> Any:
    return np.ascontiguousarray(m.T)


def _trace(m: Any) -> Any:
    diagonal: Any = np.diagonal(m)
    return reduce(operator.add, diagonal)


def _inverse(m: Any) -> Any:
    if len(m) == 1:
        return m.dtype.type(1) / m
    return np.array(small_matrix.adjugate(m), m.dtype) / small_matrix.determinant(m)


def _by_math(function: Callable[[float], float], elsewhere: Callable[[float], float]) -> Callable[[Any], Any]:
    """A function of ``math`` by component; ``elsewhere`` is what it is, as in C, where Python raises."""

    def of_number(x: float) -> float:
        try:
            return function(x)
        except (ValueError, OverflowError):
            return elsewhere(x)

    def meaning(x: Any) -> Any:
        return np.vectorize(of_number, otypes=[x.dtype])(x)[()]

    return meaning


def _gamma_at_pole(x: float) -> float:
    return math.nan if x < 0 else math.copysign(math.inf, x)


def _to_int64(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    def rounded(x: Any) -> Any:
        if x.dtype.kind != "f":
            return x
        return arithmetic.convert(function(x), shaped_type(int64, x.shape))

    return rounded


def _minimum(first: Any, *others: Any) -> Any:
    for other in others:
        first = np.minimum(first, other)
    return first


def _maximum(first: Any, *others: Any) -> Any:
    for other in others:
        first = np.maximum(first, other)
    return first


def _identity(shape: Any, element: Any = float64) -> StaticValue | Complaint:
    if is_type(shape):
        square = as_type(shape)
    elif _is_extent(shape) and isinstance(element, ScalarType):
        square = matrix(element, shape, shape)
    else:
        return Complaint("takes a number of rows, and optionally a scalar type, or a type of square matrices")
    if len(square.shape) != 2 or square.shape[0] != square.shape[1] or not isinstance(square.scalar, ScalarType):
        return Complaint(f"takes a type of square matrices of numbers, not {square!r}", 0)
    return _constant(np.eye(square.shape[0]), square)


def _zeros(shape: Any, element: Any = float64) -> StaticValue | Complaint:
    if is_type(shape):
        shaped = as_type(shape)
    elif _is_extent(shape) and isinstance(element, ScalarType):
        shaped = vector(element, shape)
    elif isinstance(shape, tuple) and _are_extents(shape) and isinstance(element, ScalarType):  # pyright: ignore[reportUnknownArgumentType]
        shaped = shaped_type(element, shape)  # pyright: ignore[reportUnknownArgumentType]
    else:
        return Complaint("takes a type, or a size or a tuple of at most two, and optionally a scalar type")
    if not isinstance(shaped.scalar, ScalarType):
        return Complaint(f"takes a type of numbers or bools: there is no zero key of {shaped!r}", 0)
    return _constant(np.zeros(shaped.shape), shaped)


def _constant(array: Any, shaped: Type) -> StaticValue:
    def frozen(value: Any) -> Any:
        return tuple(map(frozen, value)) if isinstance(value, list) else value  # pyright: ignore[reportUnknownVariableType,reportUnknownArgumentType]

    return StaticValue(frozen(array.astype(shaped.dtype).tolist()), shaped)


def _is_extent(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 1


def _are_extents(values: tuple[Any, ...]) -> bool:
    return len(values) in (1, 2) and builtins.all(map(_is_extent, values))


def _no_meaning(*arguments: Any) -> NoReturn:
    raise TypeError(f"there is nothing to compute on {arguments!r}")


# ---- The rows ----


def _real(name: str, meaning: Callable[..., Any], doc: str, count: int = 1) -> Builtin:
    return Builtin(name, count, count, signatures.reals, meaning, doc)


def _row(name: str, count: int, rule: Rule, meaning: Callable[..., Any], doc: str) -> Builtin:
    return Builtin(name, count, count, rule, meaning, doc)


def _static(name: str, constant: Callable[..., StaticValue | Complaint], doc: str) -> Builtin:
    return Builtin(name, 1, 2, signatures.constants_only, _no_meaning, doc, static=constant)


abs_ = _row("abs", 1, signatures.numbers, np.abs, "The magnitude, of the argument's type; the smallest integer wraps.")
min_ = Builtin("min", 2, None, signatures.numbers, _minimum, "The smallest; NaN if any is.", operator="min")
max_ = Builtin("max", 2, None, signatures.numbers, _maximum, "The largest; NaN if any is.", operator="max")
round_ = _row(
    "round", 1, signatures.to_integer, _to_int64(np.rint), "The nearest integer, halves to even, as an int64."
)
clamp = _row("clamp", 3, signatures.numbers, _clamp, "min(max(x, low), high).")
sign = _row("sign", 1, signatures.numbers, np.sign, "-1, 0 or 1, of the argument's type; NaN stays.")
select = _row(
    "select", 3, signatures.select, _select, "then where the condition holds, else other; both are evaluated."
)

sqrt = _real("sqrt", np.sqrt, "The square root; NaN below zero.")
cbrt = _real("cbrt", np.cbrt, "The cube root, also of negative numbers.")
exp = _real("exp", np.exp, "e to the power x.")
exp2 = _real("exp2", np.exp2, "2 to the power x.")
expm1 = _real("expm1", np.expm1, "exp(x) - 1, accurate near zero.")
log = _real("log", np.log, "The natural logarithm; -inf at zero, NaN below.")
log2 = _real("log2", np.log2, "The logarithm to base 2.")
log10 = _real("log10", np.log10, "The logarithm to base 10.")
log1p = _real("log1p", np.log1p, "log(1 + x), accurate near zero.")
pow_ = _real("pow", arithmetic.power, "x to the power y, in floats.", 2)
sin = _real("sin", np.sin, "The sine of an angle in radians.")
cos = _real("cos", np.cos, "The cosine of an angle in radians.")
tan = _real("tan", np.tan, "The tangent of an angle in radians.")
asin = _real("asin", np.arcsin, "The inverse sine, in [-pi/2, pi/2].")
acos = _real("acos", np.arccos, "The inverse cosine, in [0, pi].")
atan = _real("atan", np.arctan, "The inverse tangent, in [-pi/2, pi/2].")
atan2 = _real("atan2", np.arctan2, "The angle of the point (x, y), from atan2(y, x), in [-pi, pi].", 2)
sinh = _real("sinh", np.sinh, "The hyperbolic sine.")
cosh = _real("cosh", np.cosh, "The hyperbolic cosine.")
tanh = _real("tanh", np.tanh, "The hyperbolic tangent.")
asinh = _real("asinh", np.arcsinh, "The inverse hyperbolic sine.")
acosh = _real("acosh", np.arccosh, "The inverse hyperbolic cosine.")
atanh = _real("atanh", np.arctanh, "The inverse hyperbolic tangent.")
hypot = _real("hypot", np.hypot, "sqrt(x*x + y*y) without overflow.", 2)
fabs = _real("fabs", np.fabs, "The magnitude, as a float.")
fmod = _real("fmod", np.fmod, "The remainder with the sign of x, as in C.", 2)
copysign = _real("copysign", np.copysign, "The magnitude of x with the sign of y.", 2)
degrees = _real("degrees", np.degrees, "Radians to degrees.")
radians = _real("radians", np.radians, "Degrees to radians.")
erf = _real("erf", _by_math(math.erf, math.erf), "The error function.")
erfc = _real("erfc", _by_math(math.erfc, math.erfc), "1 - erf(x), accurate where that is near 0.")
gamma = _real("gamma", _by_math(math.gamma, _gamma_at_pole), "The gamma function; NaN at negative integers.")
lgamma = _real("lgamma", _by_math(math.lgamma, lambda x: math.inf), "The logarithm of the magnitude of gamma(x).")
floor = _real("floor", np.floor, "The largest whole number <= x, as a float.")
ceil = _real("ceil", np.ceil, "The smallest whole number >= x, as a float.")
trunc = _real("trunc", np.trunc, "x without its fraction, as a float.")
math_floor = _row("math.floor", 1, signatures.to_integer, _to_int64(np.floor), "floor(x) as an int64.")
math_ceil = _row("math.ceil", 1, signatures.to_integer, _to_int64(np.ceil), "ceil(x) as an int64.")
math_trunc = _row("math.trunc", 1, signatures.to_integer, _to_int64(np.trunc), "trunc(x) as an int64.")
isnan = _row("isnan", 1, signatures.predicate, np.isnan, "Whether x is not a number.")
isinf = _row("isinf", 1, signatures.predicate, np.isinf, "Whether x is infinite.")
isfinite = _row("isfinite", 1, signatures.predicate, np.isfinite, "Whether x is neither infinite nor NaN.")

dot = _row("dot", 2, signatures.dot, arithmetic.dot, "The sum of the products of the components.")
cross = _row("cross", 2, signatures.cross, _cross, "The cross product of two vectors of 3 components.")
length = _row("length", 1, signatures.length, _length, "sqrt(dot(v, v)), a float also for integers.")
normalize = _row("normalize", 1, signatures.normalize, _normalize, "v * (1 / length(v)), and 0 where the length is 0.")
outer = _row("outer", 2, signatures.outer, np.multiply.outer, "The matrix of all products a[i] * b[j].")
transpose = _row("transpose", 1, signatures.transpose, _transpose, "Rows and columns exchanged.")
trace = _row("trace", 1, signatures.trace, _trace, "The sum of the diagonal.")
det = _row("det", 1, signatures.determinant, small_matrix.determinant, "The determinant, up to 4 x 4, by cofactors.")
inverse = _row(
    "inverse", 1, signatures.inverse, _inverse, "adjugate / determinant, up to 4 x 4; not finite if singular."
)
matmul = _row("matmul", 2, signatures.matmul, arithmetic.matmul, "The operator @ on vectors and matrices.")
all_ = _row("all", 1, signatures.bools, np.all, "Whether every component is true.")
any_ = _row("any", 1, signatures.bools, np.any, "Whether some component is true.")
identity = _static(
    "identity", _identity, "The unit matrix: identity(3), identity(3, ebb.float32), identity(ebb.mat3f)."
)
zeros = _static("zeros", _zeros, "Zero in every component: zeros(ebb.vec3f), zeros(3), zeros((2, 3), ebb.float32).")

id_ = Form("id", 1, "The number of the row that a key refers to, as it was when it was created; an int64.")
coords = Form("coords", 1, "The coordinates of the grid row that a key refers to; a vector of int32.")
rand = Form("rand", 1, "The row's next random number, uniform in [0, 1); float64 unless a float type is given.")
randn = Form("randn", 1, "The row's next random number, standard normal; float64 unless a float type is given.")

BUILTINS: Mapping[str, Builtin] = {
    row.name: row
    for row in (
        abs_, min_, max_, round_, clamp, sign, select, sqrt, cbrt, exp, exp2, expm1, log, log2, log10, log1p, pow_,
        sin, cos, tan, asin, acos, atan, atan2, sinh, cosh, tanh, asinh, acosh, atanh, hypot, fabs, fmod, copysign,
        degrees, radians, erf, erfc, gamma, lgamma, floor, ceil, trunc,
        math_floor, math_ceil, math_trunc, isnan, isinf, isfinite, dot, cross,
        length, normalize, outer, transpose, trace, det, inverse, matmul, all_, any_, identity, zeros,
    )
}  # fmt: skip

_PYTHON: Mapping[Any, Builtin] = {
    builtins.abs: abs_,
    builtins.min: min_,
    builtins.max: max_,
    builtins.round: round_,
    builtins.pow: pow_,
    math.floor: math_floor,
    math.ceil: math_ceil,
    math.trunc: math_trunc,
} | {
    getattr(math, name): BUILTINS[name]
    for name in (
        "sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "sin", "cos", "tan", "asin",
        "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "hypot", "fabs", "fmod",
        "copysign", "degrees", "radians", "erf", "erfc", "gamma", "lgamma", "isnan", "isinf", "isfinite",
    )
}  # fmt: skip


def from_python(function: Any) -> Builtin | None:
    """The row that a function of Python or of ``math`` means in a kernel, or None."""
    try:
        return _PYTHON.get(function)
    except TypeError:  # unhashable, so none of ours
        return None


def _host_types(arguments: tuple[Any, ...]) -> tuple[Type, ...]:
    """The types of host values; Python numbers take theirs from the first value that has one."""
    strong = [None if _is_weak(value) else _host_type(value) for value in arguments]
    beside: Element | None = next((found.scalar for found in strong if found is not None), None)
    return tuple(
        found or (beside is not None and weak_element(value, beside)) or lone_type(value)
        for value, found in zip(arguments, strong, strict=True)
    )


def _is_weak(value: Any) -> bool:
    return isinstance(value, bool | int | float) and not isinstance(value, np.generic)


def _host_type(value: Any) -> Type:
    array = np.asarray(value)
    scalar = from_dtype(array.dtype)
    if scalar is None:
        raise TypeError(f"expected a number, a vector or a matrix, not {value!r}")
    return shaped_type(scalar, array.shape)
