"""Signed zeros, infinities, NaN, subnormal and huge numbers through every operator, against NumPy."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import ebb

from .harness import evaluate, evaluate_each, rows_with

FLOATS = {
    ebb.float32: [0.0, -0.0, 1.0, -1.0, 2.5, -2.5, 3.0, 1e-40, 3e38, np.inf, -np.inf, np.nan],
    ebb.float64: [0.0, -0.0, 1.0, -1.0, 2.5, -2.5, 3.0, 5e-324, 1.7e308, np.inf, -np.inf, np.nan],
}
INTEGERS = {
    ebb.int32: [0, 1, -1, 2, -3, 7, 2**31 - 1, -(2**31)],
    ebb.int64: [0, 1, -1, 2, -3, 7, 2**63 - 1, -(2**63)],
    ebb.uint32: [0, 1, 2, 3, 7, 2**31, 2**32 - 1],
    ebb.uint64: [0, 1, 2, 3, 7, 2**63, 2**64 - 1],
}
OPERATORS = {
    "r.x + r.y": np.add,
    "r.x - r.y": np.subtract,
    "r.x * r.y": np.multiply,
    "r.x // r.y": np.floor_divide,
    "r.x % r.y": np.remainder,
    "min(r.x, r.y)": np.minimum,
    "max(r.x, r.y)": np.maximum,
    "r.x < r.y": np.less,
    "r.x <= r.y": np.less_equal,
    "r.x == r.y": np.equal,
    "r.x != r.y": np.not_equal,
}
OF_FLOATS = {
    **OPERATORS,
    "r.x / r.y": np.divide,
    "ebb.fmod(r.x, r.y)": np.fmod,
    "ebb.atan2(r.x, r.y)": np.arctan2,
}
OF_INTEGERS = {
    **OPERATORS,
    "r.x & r.y": np.bitwise_and,
    "r.x | r.y": np.bitwise_or,
    "r.x ^ r.y": np.bitwise_xor,
    "r.x / r.y": np.divide,
}
UNARY = {
    "-r.x": np.negative,
    "abs(r.x)": np.abs,
    "ebb.sign(r.x)": np.sign,
    "ebb.sqrt(r.x)": np.sqrt,
    "ebb.cbrt(r.x)": np.cbrt,
    "ebb.floor(r.x)": np.floor,
    "ebb.ceil(r.x)": np.ceil,
    "ebb.exp(r.x)": np.exp,
    "ebb.log(r.x)": np.log,
    "ebb.tanh(r.x)": np.tanh,
    "ebb.atan(r.x)": np.arctan,
    "r.x ** 2": np.square,
    "r.x + 0": lambda x: x + x.dtype.type(0),
    "r.x * 1": lambda x: x,
    "r.x - r.x": lambda x: x - x,
    "0 * r.x": lambda x: x * x.dtype.type(0),
}


def pairs(values, dtype):
    x, y = zip(*itertools.product(values, values), strict=True)
    return np.array(x, dtype), np.array(y, dtype)


def assert_same(expression, actual, expected, x, y=None, exact=True):
    """The same numbers, and zeros of the same sign; a NaN is a NaN."""
    for position, (found, wanted) in enumerate(zip(actual.tolist(), expected.tolist(), strict=True)):
        where = f"{expression} for x = {x[position]}" + ("" if y is None else f", y = {y[position]}")
        if isinstance(wanted, float):
            close = found == wanted or (not exact and math.isclose(found, wanted, rel_tol=1e-6))
            agrees = (math.isnan(found) and math.isnan(wanted)) or (
                close and math.copysign(1, found) == math.copysign(1, wanted)
            )
        else:
            agrees = found == wanted
        assert agrees, f"{where}: {found} instead of {wanted}"


def numpy_of(table, *values):
    """By expression what NumPy gives, and the type to store it in."""
    with np.errstate(all="ignore"):
        expected = {expression: function(*values) for expression, function in table.items()}
    return expected, {expression: RESULTS[array.dtype] for expression, array in expected.items()}


RESULTS = {np.dtype(each.dtype): each for each in (ebb.bool_, *FLOATS, *INTEGERS)}


@pytest.mark.parametrize("scalar", FLOATS, ids=repr)
def test_float_operators(backend, scalar):
    x, y = pairs(FLOATS[scalar], scalar.dtype)
    expected, results = numpy_of(OF_FLOATS, x, y)
    for expression, actual in evaluate_each(results, x=(scalar, x), y=(scalar, y)).items():
        assert_same(expression, actual, expected[expression], x, y, exact="atan2" not in expression)


@pytest.mark.parametrize("scalar", INTEGERS, ids=repr)
def test_integer_operators(backend, scalar):
    x, y = pairs(INTEGERS[scalar], scalar.dtype)
    expected, results = numpy_of(OF_INTEGERS, x, y)
    for expression, actual in evaluate_each(results, x=(scalar, x), y=(scalar, y)).items():
        assert_same(expression, actual, expected[expression], x, y)


@pytest.mark.parametrize("scalar", FLOATS, ids=repr)
def test_functions_of_one_float(backend, scalar):
    x = np.array(FLOATS[scalar], scalar.dtype)
    expected, results = numpy_of(UNARY, x)
    for expression, actual in evaluate_each(results, x=(scalar, x)).items():
        assert_same(expression, actual, expected[expression], x, exact=False)


@pytest.mark.parametrize("expression", ["r.x ** r.y", "ebb.pow(r.x, r.y)"])
def test_powers_of_floats(backend, expression):
    x, y = pairs([0.0, -0.0, 1.0, -1.0, 0.5, -2.0, -8.0, np.inf, -np.inf, np.nan, 1 / 3, 3.0], np.float64)
    with np.errstate(all="ignore"):
        expected = np.power(x, y)
    actual = evaluate(expression, ebb.float64, x=(ebb.float64, x), y=(ebb.float64, y))
    assert_same(expression, actual, expected, x, y, exact=False)


def test_powers_of_integers_wrap_and_negative_ones_truncate(backend):
    x, y = pairs([0, 1, -1, 2, -3, 46341, 2**31 - 1], np.int32)
    expected = [pow(int(a), int(b), 2**32) if b >= 0 else 0 for a, b in zip(x, y, strict=True)]
    expected = np.array(expected, np.int64).astype(np.uint32).astype(np.int32)
    out = evaluate("r.x ** r.y", ebb.int32, x=(ebb.int32, x), y=(ebb.int32, y))
    positive = y >= 0
    np.testing.assert_array_equal(out[positive], expected[positive])
    ones = (y < 0) & (abs(x) == 1)
    np.testing.assert_array_equal(out[ones], np.where(y[ones] % 2 == 0, 1, x[ones]))
    np.testing.assert_array_equal(out[(y < 0) & (abs(x) > 1)], 0)


@pytest.mark.parametrize("source", [*FLOATS, *INTEGERS], ids=repr)
def test_conversions_between_all_numbers(backend, source):
    values = {**FLOATS, **INTEGERS}[source]
    x = np.array([v for v in values if np.isfinite(v) and abs(v) < 2**31], source.dtype)
    results = {f"ebb.{target!r}(r.x)": target for target in (*FLOATS, *INTEGERS)}
    for expression, out in evaluate_each(results, x=(source, x)).items():
        target = results[expression]
        expected = x.astype(np.float64).astype(np.int64).astype(target.dtype)
        if target in FLOATS:
            expected = x.astype(target.dtype)
        elif source in FLOATS and target in (ebb.uint32, ebb.uint64):
            expected = np.maximum(x, 0).astype(target.dtype)
        np.testing.assert_array_equal(out, expected, err_msg=f"{source!r} to {target!r}")


def test_large_integers_become_the_nearest_float(backend):
    values = [2**24 + 1, 2**53 + 1, 2**62 + 2**38, -(2**53) - 1]
    out = evaluate("ebb.float32(r.x)", ebb.float32, x=(ebb.int64, values))
    np.testing.assert_array_equal(out, np.array(values, np.int64).astype(np.float32))
    out = evaluate("ebb.float64(r.x)", ebb.float64, x=(ebb.uint64, [2**64 - 1, 2**63 + 1025]))
    np.testing.assert_array_equal(out, np.array([2**64 - 1, 2**63 + 1025], np.uint64).astype(np.float64))


def test_rounding_to_integers(backend):
    x = [0.5, 1.5, 2.5, -0.5, -1.5, 2.4999, 1e18, -1e300, np.nan, np.inf]
    out = evaluate("round(r.x)", ebb.int64, x=(ebb.float64, x))
    np.testing.assert_array_equal(out, [0, 2, 2, 0, -2, 2, 10**18, -(2**63), 0, 2**63 - 1])
    out = evaluate(
        "math.floor(r.x) * 10 + math.ceil(r.x)", ebb.int64, {"math": math}, x=(ebb.float32, [1.5, -1.5, 2.0])
    )
    np.testing.assert_array_equal(out, [12, -21, 22])


@pytest.mark.parametrize("dtype", [ebb.float32, ebb.float64], ids=str)
@pytest.mark.parametrize("fastmath", [False, True])
def test_no_precision_loses_nan_and_infinity(backend, fastmath, dtype):
    rows = rows_with(u=(dtype, [1.0, np.nan, np.inf, -np.inf]))
    rows.new_field("nan", ebb.bool_)
    rows.new_field("inf", ebb.bool_)
    rows.new_field("least", dtype)

    @ebb.kernel(fastmath=fastmath)
    def look(r: rows):
        x = r.u * 2 - 1
        r.nan = math.isnan(x)
        r.inf = math.isinf(x)
        r.least = min(x, 5.0)

    look(rows)
    assert rows.nan.to_numpy().tolist() == [False, True, False, False]
    assert rows.inf.to_numpy().tolist() == [False, False, True, True]
    np.testing.assert_array_equal(rows.least.to_numpy(), [1.0, np.nan, 5.0, -np.inf])
