"""Functions of floats keep what the reference of the language says of their errors, wherever vectors compute them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ebb

MOST_ULPS = 4
"""What glibc says of libmvec, and the language reference of Ebb."""

FUNCTIONS = {
    "sin": (math.sin, np.sin, (-20, 20)),
    "cos": (math.cos, np.cos, (-20, 20)),
    "tan": (math.tan, np.tan, (-1.5, 1.5)),
    "asin": (math.asin, np.arcsin, (-1, 1)),
    "acos": (math.acos, np.arccos, (-1, 1)),
    "atan": (math.atan, np.arctan, (-50, 50)),
    "sinh": (math.sinh, np.sinh, (-20, 20)),
    "cosh": (math.cosh, np.cosh, (-20, 20)),
    "tanh": (math.tanh, np.tanh, (-5, 5)),
    "asinh": (math.asinh, np.arcsinh, (-50, 50)),
    "acosh": (math.acosh, np.arccosh, (1, 50)),
    "atanh": (math.atanh, np.arctanh, (-0.99, 0.99)),
    "exp": (math.exp, np.exp, (-50, 50)),
    "exp2": (math.exp2, np.exp2, (-50, 50)),
    "expm1": (math.expm1, np.expm1, (-5, 5)),
    "log": (math.log, np.log, (1e-3, 1e3)),
    "log2": (math.log2, np.log2, (1e-3, 1e3)),
    "log10": (math.log10, np.log10, (1e-3, 1e3)),
    "log1p": (math.log1p, np.log1p, (-0.9, 10)),
    "cbrt": (math.cbrt, np.cbrt, (-1e3, 1e3)),
}
"""What a kernel calls, the same in NumPy, and where."""

COUNT = 5003


def ulps(found, exact, dtype):
    """The distance in units in the last place of the exact value."""
    unit = np.spacing(np.abs(exact).astype(dtype)).astype(exact.dtype)
    return float(np.max(np.abs(found.astype(exact.dtype) - exact) / unit))


def exact_type(scalar):
    """A type with enough digits more; NumPy's long double is one on some machines only."""
    wide = np.float64 if scalar is ebb.float32 else np.longdouble
    if np.finfo(wide).nmant <= np.finfo(scalar.dtype).nmant:
        pytest.skip("there is no wider type to compare with")
    return wide


@pytest.mark.parametrize("scalar", [ebb.float32, ebb.float64], ids=repr)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_one_float(name, scalar):
    function, expected, (low, high) = FUNCTIONS[name]
    wide = exact_type(scalar)
    rows = ebb.Relation("rows", size=COUNT)
    rows.new_field("x", scalar, init=np.random.default_rng(3).uniform(low, high, COUNT).astype(scalar.dtype))
    rows.new_field("y", scalar)

    @ebb.kernel
    def apply(r: rows):
        r.y = function(r.x)

    apply(rows)
    exact = expected(rows.x.to_numpy().astype(wide))
    assert ulps(rows.y.to_numpy(), exact, scalar.dtype) <= MOST_ULPS


@pytest.mark.parametrize("scalar", [ebb.float32, ebb.float64], ids=repr)
def test_functions_of_two_floats(scalar):
    wide = exact_type(scalar)
    rng = np.random.default_rng(4)
    rows = ebb.Relation("rows", size=COUNT)
    rows.new_field("x", scalar, init=rng.uniform(0.1, 20, COUNT).astype(scalar.dtype))
    rows.new_field("y", scalar, init=rng.uniform(-5, 5, COUNT).astype(scalar.dtype))
    for name in ("power", "angle", "length"):
        rows.new_field(name, scalar)

    @ebb.kernel
    def apply(r: rows):
        r.power = r.x**r.y
        r.angle = math.atan2(r.y, r.x)
        r.length = math.hypot(r.x, r.y)

    apply(rows)
    x, y = rows.x.to_numpy().astype(wide), rows.y.to_numpy().astype(wide)
    for field, exact in ((rows.power, x**y), (rows.angle, np.arctan2(y, x)), (rows.length, np.hypot(x, y))):
        assert ulps(field.to_numpy(), exact, scalar.dtype) <= MOST_ULPS
