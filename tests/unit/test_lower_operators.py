from __future__ import annotations

import numpy as np
import pytest
from both_backends import assert_agree, checked
from kir_forms import HERE, OnRows, binary, call, cast, compare, const, read, write

from ebb.backends.cpu import cpu_backend
from ebb.compiler import kir
from ebb.compiler.lower.builtins import LOWERING
from ebb.relations.relation import Relation
from ebb.types.builtins import BUILTINS
from ebb.types.types import (
    SCALARS,
    Kind,
    bool_,
    float32,
    float64,
    int32,
    int64,
    matrix,
    uint32,
    uint64,
    vector,
)

ROWS = 200
NUMBERS = [scalar for scalar in SCALARS if scalar.kind is not Kind.BOOL]
INTEGERS = [scalar for scalar in NUMBERS if scalar.kind is not Kind.FLOAT]
FLOATS = [float32, float64]


def values_of(scalar, seed, shape=(ROWS,)):
    """Values with every edge of the type among them."""
    rng = np.random.default_rng(seed)
    if scalar.kind is Kind.BOOL:
        return rng.random(shape) < 0.5
    if scalar.kind is Kind.FLOAT:
        edges = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.0, np.inf, -np.inf, np.nan, 1e30, -1e-30, 7.0, -7.0]
        values = rng.normal(scale=4.0, size=shape)
    else:
        info = np.iinfo(scalar.dtype)
        edges = [info.min, info.max, 0, 1, 2, 3, 5, 31, 32, 33, 63, 64, 7, info.max - 1]
        edges += [-1, -7] if info.min < 0 else []
        values = rng.integers(info.min, info.max, size=shape, dtype=scalar.dtype, endpoint=True)
    picked = rng.choice(np.array(edges, dtype=scalar.dtype), size=shape)
    return np.where(rng.random(shape) < 0.6, picked, values).astype(scalar.dtype)


def table(**columns):
    relation = Relation("rows", size=ROWS)
    for seed, (name, type_) in enumerate(columns.items()):
        data = values_of(type_.scalar, seed, (ROWS, *type_.shape))
        relation.new_field(name, type_, init=data)
    return relation, OnRows(relation)


def results(relation, on, *expressions):
    """A kernel that writes each expression to a field of its own."""
    stores = []
    for number, expr in enumerate(expressions):
        field = relation.new_field(f"out{number}", expr.type)
        stores.append(write(field, on.row, expr))
    return on.kernel(*stores)


@pytest.mark.parametrize("scalar", NUMBERS, ids=repr)
def test_arithmetic_is_that_of_numpy(scalar):
    relation, on = table(a=scalar, b=scalar)
    a, b = read(relation.a, on.row), read(relation.b, on.row)
    operators = ["+", "-", "*", "//", "%", "min", "max"]
    if scalar.kind is Kind.FLOAT:
        operators.append("/")
    else:
        operators += ["&", "|", "^", "<<", ">>"]
    expressions = [binary(op, a, b) for op in operators]
    expressions += [compare(op, a, b) for op in ("==", "!=", "<", "<=", ">", ">=")]
    expressions.append(kir.Unary("-", a, scalar, HERE))
    assert_agree(results(relation, on, *expressions))


@pytest.mark.parametrize("scalar", INTEGERS, ids=repr)
def test_integer_powers_are_exact_and_wrap(scalar):
    relation, on = table(a=scalar)
    small = relation.new_field("e", scalar, init=np.arange(ROWS) % 9 - (3 if scalar.kind is Kind.SIGNED else 0))
    power = binary("**", read(relation.a, on.row), read(small, on.row))
    assert_agree(results(relation, on, power))


@pytest.mark.parametrize("scalar", INTEGERS, ids=repr)
def test_division_by_literals(scalar):
    relation, on = table(a=scalar)
    a = read(relation.a, on.row)
    divisors = [0, 1, 2, 3, 7] + ([-1, -4] if scalar.kind is Kind.SIGNED else [])
    expressions = [binary(op, a, const(d, scalar)) for op in ("//", "%") for d in divisors]
    assert_agree(results(relation, on, *expressions))


def test_bools():
    relation, on = table(a=bool_, b=bool_)
    a, b = read(relation.a, on.row), read(relation.b, on.row)
    expressions = [kir.Binary(op, a, b, bool_, HERE) for op in ("&", "|", "^")]
    expressions += [kir.Logic(op, a, b, bool_, HERE) for op in ("and", "or")]
    expressions.append(kir.Unary("not", a, bool_, HERE))
    expressions += [compare(op, a, b) for op in ("==", "!=")]
    assert_agree(results(relation, on, *expressions))


@pytest.mark.parametrize("source", SCALARS, ids=repr)
def test_casts_wrap_saturate_and_truncate(source):
    relation, on = table(a=source)
    assert_agree(results(relation, on, *(cast(read(relation.a, on.row), target) for target in SCALARS)))


def test_elementwise_on_matrices():
    mat = matrix(int32, 2, 3)
    relation, on = table(a=mat, b=mat)
    a, b = read(relation.a, on.row), read(relation.b, on.row)
    splat = kir.Splat(const(3, int32), mat, HERE)
    assert_agree(results(relation, on, binary("+", a, b), binary("*", a, splat), compare("<", a, b)))


REAL_FUNCTIONS = [
    "sqrt", "cbrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan", "asin", "acos",
    "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "fabs", "floor", "ceil", "trunc", "degrees", "radians",
    "abs", "sign", "round", "math.floor", "math.ceil", "math.trunc", "isnan", "isinf", "isfinite",
    "erf", "erfc", "gamma", "lgamma",
]  # fmt: skip
BINARY_FUNCTIONS = ["pow", "atan2", "hypot", "fmod", "copysign"]


@pytest.mark.parametrize("scalar", FLOATS, ids=repr)
def test_functions_of_floats(scalar):
    relation, on = table(a=scalar, b=scalar, c=scalar)
    a, b, c = (read(relation.attribute(name), on.row) for name in "abc")
    expressions = [call(name, a) for name in REAL_FUNCTIONS] + [call(name, a, b) for name in BINARY_FUNCTIONS]
    expressions += [call("clamp", a, b, c), call("select", compare("<", a, b), b, c)]
    assert_agree(results(relation, on, *expressions), rtol=1e-5 if scalar == float32 else 1e-13)


@pytest.mark.parametrize("scalar", [int32, int64, uint32, uint64], ids=repr)
def test_functions_of_integers(scalar):
    relation, on = table(a=scalar, b=scalar, c=scalar)
    a, b, c = (read(relation.attribute(name), on.row) for name in "abc")
    expressions = [call(name, a) for name in ("abs", "sign", "round")] + [call("clamp", a, b, c)]
    assert_agree(results(relation, on, *expressions))


@pytest.mark.parametrize("scalar", FLOATS, ids=repr)
def test_vectors_and_matrices(scalar):
    rng = np.random.default_rng(7)
    relation = Relation("rows", size=ROWS)
    shapes = {
        "u": vector(scalar, 3), "v": vector(scalar, 3), "m1": matrix(scalar, 1, 1), "m2": matrix(scalar, 2, 2),
        "m3": matrix(scalar, 3, 3), "m4": matrix(scalar, 4, 4), "n": matrix(scalar, 3, 4),
    }  # fmt: skip
    for name, type_ in shapes.items():
        relation.new_field(name, type_, init=rng.normal(size=(ROWS, *type_.shape)).astype(scalar.dtype))
    on = OnRows(relation)
    at = {name: read(relation.attribute(name), on.row) for name in shapes}
    expressions = [call(name, at["u"], at["v"]) for name in ("dot", "cross", "outer")]
    expressions += [call(name, at["u"]) for name in ("length", "normalize")]
    expressions += [call(name, at[m]) for m in ("m1", "m2", "m3", "m4") for name in ("det", "inverse", "trace")]
    expressions += [call("transpose", at["n"]), call("matmul", at["m3"], at["n"]), call("matmul", at["m3"], at["u"])]
    expressions += [call("matmul", at["u"], at["n"])]
    tolerance = 2e-2 if scalar == float32 else 1e-9  # an inverse loses what the condition of the matrix costs
    assert_agree(results(relation, on, *expressions), rtol=tolerance)


def test_integer_products_are_exact():
    relation, on = table(u=vector(int32, 3), m=matrix(int32, 3, 3), b=vector(bool_, 3))
    u, m, b = (read(relation.attribute(name), on.row) for name in ("u", "m", "b"))
    expressions = [call("dot", u, u), call("cross", u, u), call("matmul", m, u), call("trace", m), call("transpose", m)]
    assert_agree(results(relation, on, *expressions, call("all", b), call("any", b)))


def test_normalize_of_zero_is_zero():
    relation = Relation("rows", size=3)
    relation.new_field("v", vector(float64, 2), init=0.0)
    on = OnRows(relation)
    assert_agree(results(relation, on, call("normalize", read(relation.v, on.row))))
    assert relation.out0.to_numpy().tolist() == [[0.0, 0.0]] * 3


def test_every_builtin_is_lowered():
    static = {name for name, row in BUILTINS.items() if row.static is not None}
    assert set(LOWERING) == set(BUILTINS) - static


def test_fastmath_still_knows_nan_and_infinity():
    relation = Relation("rows", size=3)
    relation.new_field("x", float64, init=[np.nan, np.inf, 1.0])
    on = OnRows(relation)
    kernel = results(relation, on, call("isnan", read(relation.x, on.row)), call("isinf", read(relation.x, on.row)))
    cpu_backend(1).prepare(checked(kernel, fastmath=True)).bind(relation).run(())
    assert relation.out0.to_numpy().tolist() == [True, False, False]
    assert relation.out1.to_numpy().tolist() == [False, True, False]
