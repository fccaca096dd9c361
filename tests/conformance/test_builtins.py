"""The builtin functions, against NumPy and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ebb

from .harness import assert_close, evaluate, evaluate_each, kernel_of, rejects, rows_with

X = np.array([0.1, 0.5, 0.9, 1.0, 1e-3, 0.7071])
SIGNED = np.array([-2.5, -1.0, -0.3, 0.0, 0.5, 1.5, 2.5, 7.9])
REAL = {
    "ebb.sqrt(r.x)": np.sqrt(X),
    "ebb.cbrt(r.x)": np.cbrt(X),
    "ebb.cbrt(-r.x)": -np.cbrt(X),
    "ebb.exp(r.x)": np.exp(X),
    "ebb.log(r.x)": np.log(X),
    "ebb.pow(r.x, 2.5)": X**2.5,
    "ebb.sin(r.x)": np.sin(X),
    "ebb.cos(r.x * 10)": np.cos(X * 10),
    "ebb.tan(r.x)": np.tan(X),
    "ebb.asin(r.x)": np.arcsin(X),
    "ebb.acos(r.x)": np.arccos(X),
    "ebb.atan(r.x * 5)": np.arctan(X * 5),
    "ebb.atan2(r.x, -0.5)": np.arctan2(X, -0.5),
    "ebb.sinh(r.x)": np.sinh(X),
    "ebb.cosh(r.x)": np.cosh(X),
    "ebb.tanh(r.x)": np.tanh(X),
    "math.sqrt(r.x)": np.sqrt(X),
    "math.sin(r.x) ** 2 + math.cos(r.x) ** 2": np.ones(6),
    "math.exp(-r.x)": np.exp(-X),
    "math.log(r.x)": np.log(X),
    "math.atan2(r.x, r.x)": np.full(6, math.pi / 4),
    "math.pow(r.x, 3)": X**3,
    "math.fabs(-r.x)": X,
    "math.hypot(r.x, 2 * r.x)": X * math.sqrt(5),
    "math.pi * r.x + math.e": math.pi * X + math.e,
    "math.log(r.x, 10)": np.log10(X),
    "math.log(8, 2) * math.log(2, 2 + r.x)": 3 * np.log(2) / np.log(2 + X),
    "math.erf(r.x)": [math.erf(x) for x in X],
    "math.erfc(5 * r.x)": [math.erfc(5 * x) for x in X],
    "math.gamma(r.x - 0.2)": [math.gamma(x - 0.2) for x in X],
    "math.lgamma(30 * r.x)": [math.lgamma(30 * x) for x in X],
    "math.radians(180 * r.x)": math.pi * X,
    "sqrt(r.x)": np.sqrt(X),
}
ROUNDING = {
    "abs(r.x)": np.abs(SIGNED),
    "ebb.floor(r.x)": np.floor(SIGNED),
    "ebb.ceil(r.x)": np.ceil(SIGNED),
    "round(r.x)": np.rint(SIGNED),
    "ebb.sign(r.x)": np.sign(SIGNED),
    "ebb.fmod(r.x, 2.0)": np.fmod(SIGNED, 2.0),
    "math.fmod(r.x, -2.0)": np.fmod(SIGNED, -2.0),
    "ebb.clamp(r.x, -1, 2)": np.clip(SIGNED, -1, 2),
    "min(r.x, 1)": np.minimum(SIGNED, 1),
    "max(r.x, -1, 0.25)": np.maximum(SIGNED, 0.25),
    "min(max(r.x, -1), 1)": np.clip(SIGNED, -1, 1),
    "min(r.x, 0) + max(r.x, 0)": SIGNED,
    "ebb.select(r.x > 0, r.x, -2 * r.x)": np.where(SIGNED > 0, SIGNED, -2 * SIGNED),
}


NAMES = {"math": math, "sqrt": math.sqrt}


@pytest.mark.parametrize("expression", REAL)
def test_real_functions(backend, expression):
    assert_close(evaluate(expression, ebb.float64, NAMES, x=(ebb.float64, X)), REAL[expression])


def test_real_functions_in_float32(backend):
    outs = evaluate_each(dict.fromkeys(REAL, ebb.float32), NAMES, x=(ebb.float32, X))
    for expression, out in outs.items():
        if "acos" in expression:
            np.testing.assert_allclose(out, REAL[expression], atol=1e-3)  # acos is steep at 1
        else:
            assert_close(out, REAL[expression], np.float32, expression)


@pytest.mark.parametrize("expression", ROUNDING)
def test_rounding_and_choice(backend, expression):
    assert_close(evaluate(expression, ebb.float64, NAMES, x=(ebb.float64, SIGNED)), ROUNDING[expression])


def test_rounding_and_choice_in_float32(backend):
    outs = evaluate_each(dict.fromkeys(ROUNDING, ebb.float32), NAMES, x=(ebb.float32, SIGNED))
    for expression, out in outs.items():
        assert_close(out, ROUNDING[expression], np.float32, expression)


def test_functions_of_real_numbers_keep_float32(backend):
    """The stores would be errors if one of them promoted its argument to double."""
    rows = rows_with(v=(ebb.vec3f, [[3, 4, 12]]), x=(ebb.float32, [2.0]))

    @ebb.kernel
    def single(r: rows):
        r.x = ebb.sqrt(r.x) * math.sin(r.x) + abs(r.x) ** 0.5 + ebb.clamp(r.x, 0.0, 1.0)
        r.v = ebb.normalize(r.v) * ebb.length(r.v) / math.pi

    single(rows)
    assert_close(rows.v.to_numpy(), np.array([[3, 4, 12]]) / math.pi, np.float32)
    assert_close(rows.x.to_numpy(), [math.sqrt(2) * math.sin(2) + math.sqrt(2) + 1], np.float32)


def test_functions_of_real_numbers_take_integers(backend):
    assert_close(evaluate("ebb.sqrt(r.i)", ebb.float64, i=(ebb.int32, [2, 9])), [math.sqrt(2), 3])


def test_functions_work_by_component(backend):
    v = np.array([[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]])
    fields = {"v": (ebb.vec3d, v), "m": (ebb.mat2d, np.arange(8.0).reshape(2, 2, 2))}
    assert_close(evaluate("ebb.exp(r.v)", ebb.vec3d, **fields), np.exp(v))
    assert_close(evaluate("ebb.atan2(r.v, 2)", ebb.vec3d, **fields), np.arctan2(v, 2))
    assert_close(evaluate("ebb.clamp(r.v, 0.2, 2)", ebb.vec3d, **fields), np.clip(v, 0.2, 2))
    assert_close(evaluate("ebb.sqrt(r.m)", ebb.mat2d, **fields), np.sqrt(fields["m"][1]))
    assert_close(evaluate("ebb.select(r.v > 0.2, r.v, 0)", ebb.vec3d, **fields), np.where(v > 0.2, v, 0))
    assert_close(evaluate("max(r.v, [0.2, 0.2, 0.2])", ebb.vec3d, **fields), np.maximum(v, 0.2))


def test_integer_min_max_abs(backend):
    i = np.array([-5, 3, 2**31 - 1])
    fields = {"i": (ebb.int32, i)}
    np.testing.assert_array_equal(evaluate("min(r.i, 4)", ebb.int32, **fields), np.minimum(i, 4))
    np.testing.assert_array_equal(evaluate("max(abs(r.i), 4)", ebb.int32, **fields), np.maximum(abs(i), 4))
    np.testing.assert_array_equal(evaluate("ebb.sign(r.i)", ebb.int32, **fields), np.sign(i))
    np.testing.assert_array_equal(evaluate("ebb.clamp(r.i, 0, 10)", ebb.int32, **fields), np.clip(i, 0, 10))


def test_min_and_max_propagate_nan(backend):
    fields = {"x": (ebb.float64, [math.nan, 1.0]), "y": (ebb.float64, [1.0, math.nan])}
    assert np.isnan(evaluate("min(r.x, r.y)", ebb.float64, **fields)).all()
    assert np.isnan(evaluate("max(r.x, r.y)", ebb.float64, **fields)).all()


# ---- Vectors ----

MIXED = [
    (ebb.vec3f, ebb.vec3f, ebb.vec3f),
    (ebb.vec3i, ebb.vec3i, ebb.vec3i),
    (ebb.vec3i, ebb.vec3f, ebb.vec3f),
    (ebb.vec3d, ebb.vec3i, ebb.vec3d),
    (ebb.vec3f, ebb.vec3d, ebb.vec3d),
]


@pytest.mark.parametrize(("first", "second", "result"), MIXED, ids=repr)
def test_cross_of_floats_integers_and_mixed(backend, first, second, result):
    out = evaluate("ebb.cross(r.a, r.b)", result, a=(first, [[3, -1, 1]]), b=(second, [[1, 2, 3]]))
    np.testing.assert_array_equal(out, [np.cross([3, -1, 1], [1, 2, 3])])


def test_cross_of_the_paper(backend):
    out = evaluate("ebb.cross(r.a, r.b)", ebb.vec3i, a=(ebb.vec3i, [[1, 2, 3]]), b=(ebb.vec3i, [[2, 1, 2]]))
    np.testing.assert_array_equal(out, [[1, 4, -3]])


DOTS = [([2, 3, 4], [5, 6, 6], 52), ([1, 2, 3], [3, 1, 3], 14), ([0, 1, 0], [1, 0, 1], 0), ([4, 5, 6], [6, 6, 2], 66)]


@pytest.mark.parametrize(("a", "b", "expected"), DOTS)
def test_dot(backend, a, b, expected):
    assert evaluate("ebb.dot(r.a, r.b)", ebb.int32, a=(ebb.vec3i, [a]), b=(ebb.vec3i, [b]))[0] == expected
    assert evaluate("ebb.dot(r.a, r.b)", ebb.float32, a=(ebb.vec3i, [a]), b=(ebb.vec3f, [b]))[0] == expected


def test_length_of_integers_is_a_float(backend):
    assert_close(evaluate("ebb.length(r.a)", ebb.float64, a=(ebb.vec3i, [[1, 2, 3]])), [math.sqrt(14)])
    assert_close(evaluate("ebb.length(r.a)", ebb.float64, a=(ebb.vector(ebb.float64, 5), [[1, 1, 1, 1, 0]])), [2])


def test_normalize(backend):
    v = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, -2.0]])
    assert_close(evaluate("ebb.normalize(r.v)", ebb.vec3d, v=(ebb.vec3d, v)), [[0.6, 0.8, 0], [0, 0, -1]])
    assert_close(evaluate("ebb.length(ebb.normalize(r.v))", ebb.float32, v=(ebb.vec3f, v)), [1, 1], np.float32)


def test_outer(backend):
    out = evaluate("ebb.outer(r.a, r.b)", ebb.mat2x3d, a=(ebb.vec2d, [[1, 2]]), b=(ebb.vec3d, [[3, 4, 5]]))
    np.testing.assert_array_equal(out, [np.outer([1, 2], [3, 4, 5])])


def test_all_and_any(backend):
    fields = {"p": (ebb.vec3b, [[True, True, True], [True, False, True], [False, False, False]])}
    np.testing.assert_array_equal(evaluate("ebb.all(r.p)", ebb.bool_, **fields), [True, False, False])
    np.testing.assert_array_equal(evaluate("ebb.any(r.p)", ebb.bool_, **fields), [True, True, False])


# ---- Matrices ----

GENERATOR = np.random.default_rng(7)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_det_inverse_trace_transpose(backend, n):
    m = GENERATOR.random((9, n, n)) + 2 * np.eye(n)
    for scalar in (ebb.float32, ebb.float64):
        square, stored = ebb.matrix(scalar, n, n), m.astype(scalar.dtype)
        results = {"ebb.det(r.m)": scalar, "ebb.trace(r.m)": scalar}
        results |= {"ebb.inverse(r.m)": square, "ebb.transpose(r.m)": square}
        outs = evaluate_each(results, m=(square, stored))
        exact = stored.astype(np.float64)
        assert_close(outs["ebb.det(r.m)"], np.linalg.det(exact), scalar.dtype)
        assert_close(outs["ebb.inverse(r.m)"], np.linalg.inv(exact), scalar.dtype)
        assert_close(outs["ebb.trace(r.m)"], np.trace(exact, axis1=1, axis2=2), scalar.dtype)
        np.testing.assert_array_equal(outs["ebb.transpose(r.m)"], stored.swapaxes(1, 2))


def test_inverse_times_the_matrix_is_the_identity(backend):
    m = GENERATOR.random((5, 3, 3)) + np.eye(3)
    out = evaluate("ebb.inverse(r.m) @ r.m - ebb.identity(3)", ebb.mat3d, m=(ebb.mat3d, m))
    np.testing.assert_allclose(out, 0, atol=1e-12)


def test_identity_and_zeros(backend):
    np.testing.assert_array_equal(evaluate("ebb.identity(3)", ebb.mat3d), [np.eye(3)])
    np.testing.assert_array_equal(evaluate("2 * ebb.identity(ebb.mat2f)", ebb.mat2f), [2 * np.eye(2)])
    np.testing.assert_array_equal(evaluate("ebb.zeros(ebb.vec3f)", ebb.vec3f), [[0, 0, 0]])
    np.testing.assert_array_equal(evaluate("ebb.zeros(ebb.mat2x3i) + 1", ebb.mat2x3i), np.ones((1, 2, 3)))


def test_green_strain(backend):
    """A deformation gradient as finite elements use it: E = (F^T F - I) / 2."""
    f = GENERATOR.random((4, 3, 3))
    rows = rows_with(F=(ebb.mat3d, f), E=(ebb.mat3d, f), energy=(ebb.float64, np.zeros(4)))
    mu, lam = 0.7, 1.3

    @ebb.kernel
    def strain(r: rows):
        E = 0.5 * (r.F.T @ r.F - ebb.identity(3))
        r.E = E
        r.energy = mu * ebb.trace(E @ E.T) + 0.5 * lam * ebb.trace(E) ** 2

    strain(rows)
    e = 0.5 * (f.swapaxes(1, 2) @ f - np.eye(3))
    assert_close(rows.E.to_numpy(), e)
    assert_close(rows.energy.to_numpy(), mu * (e**2).sum((1, 2)) + 0.5 * lam * np.trace(e, axis1=1, axis2=2) ** 2)


# ---- Rows ----


def test_id_is_the_number_of_the_row(backend):
    rows = rows_with(out=(ebb.int64, np.zeros(65)))
    kernel_of("r.out = ebb.id(r) * 2", rows=rows)(rows)
    np.testing.assert_array_equal(rows.out.to_numpy(), 2 * np.arange(65))


def test_id_of_a_key(backend):
    vertices = ebb.Relation("vertices", size=5)
    edges = ebb.Relation("edges", size=3)
    edges.new_field("head", vertices, init=[4, 0, 2])
    edges.new_field("out", ebb.int64)

    @ebb.kernel
    def number(e: edges):
        e.out = ebb.id(e.head)

    number(edges)
    np.testing.assert_array_equal(edges.out.to_numpy(), [4, 0, 2])


def test_coords_of_a_grid_row(backend):
    cells = ebb.Relation("cells", shape=(3, 4, 5))
    cells.new_field("ijk", ebb.vec3i)
    cells.new_field("number", ebb.int64)

    @ebb.kernel
    def where_am_i(c: cells):
        c.ijk = ebb.coords(c)
        c.number = ebb.id(c)

    where_am_i(cells)
    np.testing.assert_array_equal(cells.ijk.to_numpy(), np.moveaxis(np.indices((3, 4, 5)), 0, -1))
    np.testing.assert_array_equal(cells.number.to_numpy(), np.arange(60).reshape(3, 4, 5))


def test_builtins_on_the_host():
    assert ebb.sqrt(4.0) == 2
    np.testing.assert_array_equal(ebb.cross([1, 2, 3], [2, 1, 2]), [1, 4, -3])
    assert ebb.length(np.array([3.0, 4.0], np.float32)).dtype == np.float32


WRONG = [
    "ebb.length(r.keys)",
    "ebb.length(r.x)",
    "ebb.length(r.m)",
    "ebb.dot(r.v, r.u)",
    "ebb.dot(r.b, r.b)",
    "ebb.dot(r.x, r.x)",
    "ebb.cross(r.u, r.u)",
    "ebb.cross(r.v, r.x)",
    "ebb.normalize(r.b)",
    "ebb.sqrt(r.p)",
    "ebb.sqrt(r.k)",
    "ebb.sqrt()",
    "ebb.sqrt(r.x, r.x)",
    "ebb.atan2(r.v, r.u)",
    "ebb.clamp(r.x, 1)",
    "ebb.select(r.x, 1, 2)",
    "ebb.select(r.p, r.v, r.u)",
    "ebb.trace(r.q)",
    "ebb.det(r.q)",
    "ebb.det(r.v)",
    "ebb.inverse(r.x)",
    "ebb.transpose(r.v)",
    "ebb.all(r.v)",
    "ebb.any(r.x)",
    "ebb.id(r.x)",
    "ebb.id(3)",
    "ebb.coords(r)",
    "ebb.coords(r.x)",
    "min(r.x)",
    "min(r.v, r.u)",
    "max(r.p, r.p)",
    "abs(r.p)",
    "abs(r.k)",
]


@pytest.mark.parametrize("call", WRONG)
def test_arguments_that_do_not_fit(call):
    rows = rows_with(
        x=(ebb.float64, [1]),
        p=(ebb.bool_, [True]),
        u=(ebb.vec2d, [[1, 2]]),
        v=(ebb.vec3d, [[1, 2, 3]]),
        b=(ebb.vec3b, [[True, False, True]]),
        m=(ebb.mat3d, np.eye(3)[None]),
        q=(ebb.mat2x3d, np.zeros((1, 2, 3))),
    )
    rows.new_field("k", rows, init=[0])
    rows.new_field("keys", ebb.vector(rows, 3), init=[[0, 0, 0]])
    rejects(ebb.KernelTypeError, "E2", lambda: kernel_of(f"y = {call}", rows=rows)(rows))


SPECIAL = [0.0, -0.0, -1.0, -2.5, 172.5, 1e308, np.inf, -np.inf, np.nan]


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        ("gamma", [np.inf, -np.inf, np.nan, math.gamma(-2.5), np.inf, np.inf, np.inf, np.nan, np.nan]),
        ("lgamma", [np.inf, np.inf, np.inf, math.lgamma(-2.5), math.lgamma(172.5), np.inf, np.inf, np.inf, np.nan]),
        ("erf", [0.0, -0.0, math.erf(-1), -0.9995930479825550, 1.0, 1.0, 1.0, -1.0, np.nan]),
        ("erfc", [1.0, 1.0, math.erfc(-1), math.erfc(-2.5), 0.0, 0.0, 0.0, 2.0, np.nan]),
    ],
)
def test_functions_of_c_at_poles_and_infinities(backend, function, expected):
    out = evaluate(f"math.{function}(r.x)", ebb.float64, {"math": math}, x=(ebb.float64, SPECIAL))
    np.testing.assert_allclose(out, expected, rtol=1e-14)
