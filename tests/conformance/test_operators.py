"""Arithmetic, comparison and logic, which mean what they mean in Python, with NumPy's meaning on small arrays."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ebb

from .harness import assert_close, evaluate, evaluate_each, kernel_of, rejects, rows_with

A = np.array([7, -7, 7, -7, 0, 1])
B = np.array([3, 3, -3, -3, 5, 2])
X = np.array([0.5, -1.75, 3.0, 1e-3, -8.0, 2.0])
Y = np.array([2.0, 0.5, -4.0, 3.0, 1.5, 2.0])

INTEGER = {
    "r.a + r.b": A + B,
    "r.a - r.b": A - B,
    "r.a * r.b": A * B,
    "r.a // r.b": A // B,
    "r.a % r.b": A % B,
    "-r.a": -A,
    "+r.a": A,
    "~r.a": ~A,
    "r.a & r.b": A & B,
    "r.a | r.b": A | B,
    "r.a ^ r.b": A ^ B,
    "r.a << 3": A << 3,
    "r.a >> 1": A >> 1,
    "abs(r.a)": abs(A),
    "min(r.a, r.b)": np.minimum(A, B),
    "max(r.a, r.b)": np.maximum(A, B),
    "r.a ** 2": A**2,
    "r.a + -(6*3)": A - 18,
    "-r.a % 3": -A % 3,
    "r.a // 2 * 2 + r.a % 2": A,
    "2 * r.a - 3 * r.b + 1": 2 * A - 3 * B + 1,
    "(r.a if r.a > r.b else r.b)": np.maximum(A, B),
}
FLOAT = {
    "r.x + r.y": X + Y,
    "r.x - r.y": X - Y,
    "r.x * r.y": X * Y,
    "r.x / r.y": X / Y,
    "r.x // r.y": X // Y,
    "r.x % r.y": X % Y,
    "-r.x": -X,
    "abs(r.x)": abs(X),
    "abs(r.x) ** r.y": abs(X) ** Y,
    "r.x ** 2": X**2,
    "r.x ** 3": X**3,
    "2.0 ** r.x": 2.0**X,
    "r.x ** -1": 1 / X,
    "1 / r.x": 1 / X,
    "r.x - r.y - 1": X - Y - 1,
    "r.x / r.y / 2": X / Y / 2,
    "r.x + r.y * 2 - (r.x - 1) / 4": X + Y * 2 - (X - 1) / 4,
    "min(r.x, r.y) + max(r.x, 0)": np.minimum(X, Y) + np.maximum(X, 0),
    "(1 if r.x > 0 else -1) * r.y": np.where(X > 0, 1, -1) * Y,
}
BOOLEAN = {
    "r.x < r.y": X < Y,
    "r.x <= r.y": X <= Y,
    "r.x > r.y": X > Y,
    "r.x >= r.y": X >= Y,
    "r.x == r.y": X == Y,
    "r.x != r.y": X != Y,
    "r.a == r.b + 4": A == B + 4,
    "r.a < r.x": A < X,
    "-2 < r.x < 2.5": (X > -2) & (X < 2.5),
    "-8 < r.a <= r.b < 5": (A > -8) & (A <= B) & (B < 5),
    "0 < r.x > -1": (X > 0) & (X > -1),
    "not r.p": ~(A > 0),
    "r.p and r.x > 1": (A > 0) & (X > 1),
    "r.p or r.x > 1": (A > 0) | (X > 1),
    "not r.p or r.x > 0": ~(A > 0) | (X > 0),
    "r.p == (r.x > 0)": (A > 0) == (X > 0),
    "r.p & (r.x > 0)": (A > 0) & (X > 0),
    "r.p | (r.x > 0)": (A > 0) | (X > 0),
    "r.p ^ (r.x > 0)": (A > 0) ^ (X > 0),
    "True and r.p": A > 0,
    "r.p if r.x > 0 else False": np.where(X > 0, A > 0, False),
}


@pytest.mark.parametrize("expression", INTEGER)
def test_integer_operators(backend, expression):
    out = evaluate(expression, ebb.int32, a=(ebb.int32, A), b=(ebb.int32, B))
    np.testing.assert_array_equal(out, INTEGER[expression])


def test_operators_of_long_integers(backend):
    outs = evaluate_each(dict.fromkeys(INTEGER, ebb.int64), a=(ebb.int64, A), b=(ebb.int64, B))
    for expression, out in outs.items():
        np.testing.assert_array_equal(out, INTEGER[expression], err_msg=expression)


@pytest.mark.parametrize("expression", FLOAT)
def test_float_operators(backend, expression):
    out = evaluate(expression, ebb.float32, x=(ebb.float32, X), y=(ebb.float32, Y))
    assert_close(out, FLOAT[expression], np.float32)


def test_operators_of_doubles(backend):
    outs = evaluate_each(dict.fromkeys(FLOAT, ebb.float64), x=(ebb.float64, X), y=(ebb.float64, Y))
    for expression, out in outs.items():
        assert_close(out, FLOAT[expression], what=expression)


def test_comparisons_and_logic(backend):
    fields = {"a": (ebb.int32, A), "b": (ebb.int32, B), "x": (ebb.float64, X), "y": (ebb.float64, Y)}
    outs = evaluate_each(dict.fromkeys(BOOLEAN, ebb.bool_), p=(ebb.bool_, A > 0), **fields)
    for expression, out in outs.items():
        assert out.dtype == bool
        np.testing.assert_array_equal(out, BOOLEAN[expression], err_msg=expression)


def test_literal_arithmetic_is_python_s(backend):
    assert_close(evaluate("1/6", ebb.float64), [1 / 6])
    assert evaluate("1//6", ebb.int32)[0] == 0
    assert evaluate("-7 % 3", ebb.int32)[0] == 2
    assert evaluate("-7 // 3", ebb.int32)[0] == -3
    assert evaluate("2 ** 10", ebb.int32)[0] == 1024
    assert evaluate("7 // 2 * 2.0", ebb.float64)[0] == 6.0


def test_true_division_of_integers_is_float64(backend):
    out = evaluate("r.a / r.b", ebb.float64, a=(ebb.int32, A), b=(ebb.int32, B))
    assert_close(out, A / B)


def test_integers_wrap(backend):
    out = evaluate("r.a + 1", ebb.int32, a=(ebb.int32, [2**31 - 1, 5]))
    np.testing.assert_array_equal(out, [-(2**31), 6])
    out = evaluate("r.a - 1", ebb.uint32, a=(ebb.uint32, [0, 5]))
    np.testing.assert_array_equal(out, [2**32 - 1, 4])


WORDS = np.array([0, 1, 3, 2**16 - 1, 2**16, 2**31, 2**32 - 2, 2**32 - 1], dtype=np.uint32)
OTHERS = WORDS[[7, 0, 3, 4, 4, 1, 2, 7]]
OVERFLOWS = {
    "r.u * ebb.uint32(10) // ebb.uint32(10) != r.u": WORDS * np.uint32(10) // np.uint32(10) != WORDS,
    "ebb.uint64(r.u) * ebb.uint64(r.v) > ebb.uint64(4294967295)": WORDS.astype(np.uint64) * OTHERS > 2**32 - 1,
    "r.u + r.v < r.u": WORDS + OTHERS < WORDS,
    "r.u - r.v > r.u": WORDS - OTHERS > WORDS,
    "ebb.uint64(ebb.int64(r.s) + ebb.int64(r.t) + 2147483648) > ebb.uint64(4294967295)": (
        abs(WORDS.astype(np.int32).astype(np.int64) + OTHERS.astype(np.int32) + 0.5) > 2**31
    ),
}


def test_tests_for_overflow(backend):
    fields = {"u": (ebb.uint32, WORDS), "v": (ebb.uint32, OTHERS)}
    fields |= {"s": (ebb.int32, WORDS.astype(np.int32)), "t": (ebb.int32, OTHERS.astype(np.int32))}
    found = evaluate_each(dict.fromkeys(OVERFLOWS, ebb.bool_), **fields)
    for expression, expected in OVERFLOWS.items():
        np.testing.assert_array_equal(found[expression], expected, err_msg=expression)


def test_six_bytes_are_turned_round(backend):
    numbers = np.array([0, 1, 0x0102030405060708, 2**63 - 1], dtype=np.uint64)
    moved = [f"((r.n >> ebb.uint64({8 * k}) & ebb.uint64(255)) << ebb.uint64({40 - 8 * k}))" for k in range(6)]
    found = evaluate(" | ".join(moved), ebb.uint64, n=(ebb.uint64, numbers))
    np.testing.assert_array_equal(found, numbers.byteswap() >> np.uint64(16))


def test_unsigned_division_and_shift(backend):
    out = evaluate("r.a // 2 + (r.a >> 31)", ebb.uint32, a=(ebb.uint32, [2**32 - 1, 6]))
    np.testing.assert_array_equal(out, [2**31 - 1 + 1, 3])


def test_float_division_by_zero_is_infinite_or_nan(backend):
    out = evaluate("r.x / r.y", ebb.float64, x=(ebb.float64, [1, -1, 0]), y=(ebb.float64, [0, 0, 0]))
    np.testing.assert_array_equal(out, [math.inf, -math.inf, math.nan])


def test_nan_compares_as_in_python(backend):
    nan = {"x": (ebb.float64, [math.nan])}
    assert not evaluate("r.x == r.x", ebb.bool_, **nan)[0]
    assert evaluate("r.x != r.x", ebb.bool_, **nan)[0]
    assert not evaluate("r.x < 1", ebb.bool_, **nan)[0]
    assert not evaluate("r.x >= 1", ebb.bool_, **nan)[0]


def test_floored_remainder_has_the_sign_of_the_divisor(backend):
    x, y = np.array([5.5, -5.5, 5.5, -5.5]), np.array([2.0, 2.0, -2.0, -2.0])
    out = evaluate("r.x % r.y", ebb.float32, x=(ebb.float32, x), y=(ebb.float32, y))
    np.testing.assert_array_equal(out, x % y)


def test_and_or_evaluate_only_what_they_need(backend):
    rows = rows_with(i=(ebb.int32, [0, 2, 9]), v=(ebb.vec3f, [[1, 2, 3]] * 3), out=(ebb.bool_, [False] * 3))

    @ebb.kernel
    def guarded(r: rows):
        r.out = r.i < 3 and r.v[r.i] > 1.5

    guarded(rows)
    np.testing.assert_array_equal(rows.out.to_numpy(), [False, True, False])


def test_a_conditional_evaluates_only_its_branch(backend):
    rows = rows_with(i=(ebb.int32, [0, 2, 9]), v=(ebb.vec3f, [[1, 2, 3]] * 3), out=(ebb.float32, [0] * 3))

    @ebb.kernel
    def guarded(r: rows):
        r.out = r.v[r.i] if r.i < 3 else -1

    guarded(rows)
    np.testing.assert_array_equal(rows.out.to_numpy(), [1, 3, -1])


def test_a_chained_comparison_evaluates_its_middle_once(backend):
    count = ebb.Global(ebb.int32, 0)
    rows = rows_with(x=(ebb.float64, [0.5, 2.0]), out=(ebb.bool_, [False, False]))

    @ebb.func
    def counted(x):
        count.value += 1
        return x

    @ebb.kernel
    def between(r: rows):
        r.out = 0 < counted(r.x) < 1

    between(rows)
    np.testing.assert_array_equal(rows.out.to_numpy(), [True, False])
    assert count.value == 2


# ---- Vectors and matrices. ----

U = np.array([[1.0, 2.0, 3.0], [-0.5, 0.25, 4.0]])
V = np.array([[4.0, 5.0, 6.0], [2.0, -8.0, 0.5]])
S = np.array([2.0, -4.0])
M = np.array([[[2.0, 1, 0], [1, 3, 1], [0, 1, 4]], [[1, 2, 3], [0, 1, 4], [5, 6, 0]]])
N = np.array([[[1.0, 0, 2], [0, 1, 0], [3, 0, 1]], [[2, 0, 0], [0, 2, 0], [0, 0, 2]]])
P = np.arange(24.0).reshape(2, 3, 4)
Q = np.arange(24.0).reshape(2, 4, 3)[:, ::-1]
OPERANDS = {"u": U, "v": V, "s": S, "m": M, "n": N, "p": P, "q": Q}
ARRAYS = {
    "r.u + r.v": U + V,
    "r.u - r.v": U - V,
    "r.u * r.v": U * V,
    "r.u / r.v": U / V,
    "r.u + 4.0": U + 4,
    "4 - r.u": 4 - U,
    "r.s * r.u": S[:, None] * U,
    "r.u / r.s": U / S[:, None],
    "-r.u + r.v * 2": -U + V * 2,
    "r.u ** 2": U**2,
    "abs(r.u)": abs(U),
    "r.u // r.v": U // V,
    "r.u % r.v": U % V,
    "min(r.u, r.v)": np.minimum(U, V),
    "max(r.u, r.v)": np.maximum(U, V),
    "max(r.u, 0)": np.maximum(U, 0),
    "r.m @ r.u": np.einsum("nij,nj->ni", M, U),
    "r.u @ r.m": np.einsum("ni,nij->nj", U, M),
    "r.u @ r.v": np.einsum("ni,ni->n", U, V),
    "r.m @ r.n": M @ N,
    "r.m.T": M.swapaxes(1, 2),
    "r.m.T @ r.n.T": M.swapaxes(1, 2) @ N.swapaxes(1, 2),
    "r.m + r.n": M + N,
    "r.m * r.n": M * N,
    "r.s * r.m - 1": S[:, None, None] * M - 1,
    "r.p @ r.q": P @ Q,
    "r.q @ r.p": Q @ P,
    "r.q @ r.u": np.einsum("nij,nj->ni", Q, U),
    "r.p.T": P.swapaxes(1, 2),
    "r.m[1]": M[:, 1],
    "r.m[1][2]": M[:, 1, 2],
    "r.m[2, 0] * r.u[1]": M[:, 2, 0] * U[:, 1],
    "r.m[-1, -1]": M[:, 2, 2],
    "r.u[-1]": U[:, 2],
    "r.u.x + r.u.y * r.u.z": U[:, 0] + U[:, 1] * U[:, 2],
    "[r.u.z, r.u.x, r.u.y]": U[:, [2, 0, 1]],
    "(r.u + r.v)[1]": U[:, 1] + V[:, 1],
    "(r.m @ r.u).y": np.einsum("nj,nj->n", M[:, 1], U),
    "(r.u if r.s > 0 else r.v)": np.where(S[:, None] > 0, U, V),
}


def shaped(scalar, shape):
    if not shape:
        return scalar
    return ebb.vector(scalar, *shape) if len(shape) == 1 else ebb.matrix(scalar, *shape)


@pytest.mark.parametrize("expression", ARRAYS)
def test_vector_and_matrix_operators(backend, expression):
    expected = ARRAYS[expression]
    used = {name: values for name, values in OPERANDS.items() if f"r.{name}" in expression}
    fields = {name: (shaped(ebb.float32, values.shape[1:]), values) for name, values in used.items()}
    assert_close(evaluate(expression, shaped(ebb.float32, expected.shape[1:]), **fields), expected, np.float32)


def test_vector_and_matrix_operators_in_double(backend):
    fields = {name: (shaped(ebb.float64, values.shape[1:]), values) for name, values in OPERANDS.items()}
    results = {expression: shaped(ebb.float64, expected.shape[1:]) for expression, expected in ARRAYS.items()}
    for expression, out in evaluate_each(results, **fields).items():
        assert_close(out, ARRAYS[expression], what=expression)


def test_integer_vectors(backend):
    fields = {"a": (ebb.vec3i, [[7, -7, 1]]), "b": (ebb.vec3i, [[3, 3, -2]])}
    np.testing.assert_array_equal(evaluate("r.a // r.b", ebb.vec3i, **fields), [[2, -3, -1]])
    np.testing.assert_array_equal(evaluate("r.a % r.b", ebb.vec3i, **fields), [[1, 2, -1]])
    np.testing.assert_array_equal(evaluate("r.a & r.b | 4", ebb.vec3i, **fields), [[7, 5, 4]])
    np.testing.assert_allclose(evaluate("r.a / r.b", ebb.vec3d, **fields), [[7 / 3, -7 / 3, -0.5]])


def test_vectors_compare_elementwise(backend):
    fields = {"u": (ebb.vec3f, U), "v": (ebb.vec3f, V)}
    np.testing.assert_array_equal(evaluate("r.u < r.v", ebb.vec3b, **fields), U < V)
    np.testing.assert_array_equal(evaluate("r.u == r.u", ebb.vec3b, **fields), U == U)
    np.testing.assert_array_equal(evaluate("r.u > 1", ebb.vec3b, **fields), U > 1)
    np.testing.assert_array_equal(evaluate("ebb.all(r.u < r.v)", ebb.bool_, **fields), (U < V).all(axis=1))
    np.testing.assert_array_equal(evaluate("ebb.any(r.u > r.v)", ebb.bool_, **fields), (U > V).any(axis=1))


def test_keys_of_one_relation_compare(backend):
    vertices = ebb.Relation("vertices", size=3)
    edges = ebb.Relation("edges", size=3)
    edges.new_field("head", vertices, init=[0, 1, 2])
    edges.new_field("tail", vertices, init=[0, 2, 2])
    edges.new_field("loop", ebb.bool_)
    edges.new_field("proper", ebb.bool_)

    @ebb.kernel
    def classify(e: edges):
        e.loop = e.head == e.tail
        e.proper = e.head != e.tail

    classify(edges)
    np.testing.assert_array_equal(edges.loop.to_numpy(), [True, False, True])
    np.testing.assert_array_equal(edges.proper.to_numpy(), [False, True, False])


AUGMENTED = """
n = 10
n += 5
n -= 1
n *= 3
n //= 4
n %= 7
n <<= 4
n |= 1
n ^= 3
n &= 0xFE
n >>= 1
n **= 2
"""


def test_augmented_assignment_of_locals(backend):
    in_python = {}
    exec(AUGMENTED, in_python)
    rows = rows_with(out=(ebb.int32, [0]))
    kernel_of(AUGMENTED + "r.out = n", rows=rows)(rows)
    assert rows.out.to_numpy()[0] == in_python["n"] != 0


def test_matrix_components_are_updated_in_place(backend):
    rows = rows_with(k=(ebb.mat3d, np.zeros((2, 3, 3))))

    @ebb.kernel
    def assemble(r: rows):
        for i in range(3):
            for j in range(3):
                r.k[i, j] += i * 3 + j
        r.k[0, 0] -= 1
        r.k[2][1] *= 10
        r.k[1] = [7, 8, 9]

    assemble(rows)
    np.testing.assert_array_equal(rows.k.to_numpy(), [[[-1, 1, 2], [7, 8, 9], [6, 70, 8]]] * 2)


def test_local_matrices_are_built_by_component(backend):
    rows = rows_with(v=(ebb.vec3d, U), out=(ebb.mat3d, np.zeros((2, 3, 3))))

    @ebb.kernel
    def skew(r: rows):
        w = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
        w[0, 1] = -r.v.z
        w[0, 2] = r.v.y
        w[1, 2] = -r.v.x
        r.out = w - w.T

    skew(rows)
    for v, m in zip(U, rows.out.to_numpy(), strict=True):
        np.testing.assert_array_equal(m @ V[0], np.cross(v, V[0]))


# ---- What is no operation. ----

FIELDS = {
    "i": (ebb.int32, [1]),
    "x": (ebb.float64, [1]),
    "p": (ebb.bool_, [True]),
    "u": (ebb.vec2d, [[1, 2]]),
    "v": (ebb.vec3d, [[1, 2, 3]]),
    "m": (ebb.mat3d, np.eye(3)[None]),
    "q": (ebb.mat2x3d, np.zeros((1, 2, 3))),
}
WRONG = [
    "[1, 2, 3] + [1, 2]",
    "r.u + r.v",
    "r.m + r.q",
    "r.m * r.v",
    "r.v + r.m",
    "5 < True",
    "r.x < r.p",
    "r.p + r.p",
    "r.p + 1",
    "-r.p",
    "r.x and r.p",
    "not r.x",
    "r.i or r.p",
    "r.x & r.x",
    "r.x << 1",
    "~r.x",
    "r.x % r.p",
    "r.q @ r.q",
    "r.v @ r.q",
    "r.m @ r.u",
    "r.x @ r.x",
    "r.v[3]",
    "r.v[-4]",
    "r.v[3.5]",
    "r.v[r.x]",
    "r.v[0, 1]",
    "r.m[0, 3]",
    "r.m[3]",
    "r.m[0, 0, 0]",
    "r.x[0]",
    "r.u.z",
    "r.v.w",
    "r.v.q",
    "r.x.x",
    "r.k + 1",
    "r.k + r.k",
    "-r.k",
    "r.k < r.k",
    "r.k == r.o",
    "r.k == 0",
    "r.p if r.x else r.p",
    "1 if r.v else 2",
    "r.v if r.p else r.x",
    "r.u == r.v",
]


@pytest.mark.parametrize("expression", WRONG)
def test_operands_that_do_not_fit(expression):
    rows, others = rows_with(**FIELDS), ebb.Relation("others", size=1)
    rows.new_field("k", rows, init=[0])
    rows.new_field("o", others, init=[0])
    rejects(ebb.KernelTypeError, "E", lambda: kernel_of(f"x = {expression}", rows=rows)(rows))


@pytest.mark.parametrize(
    "body",
    [
        "if r.x:\n    r.x = 1",
        "if r.v:\n    r.x = 1",
        "if r.v > 0:\n    r.x = 1",
        "while r.i:\n    r.i -= 1",
        "assert r.v > 0",
        "assert r.i",
        "x = 1.0\nx = True",
        "x = 1\nx = 2.5",
        "x = r.v\nx = r.u",
        "x = r.x\nx = r.k",
        "r.v = r.u",
        "r.v[0] = r.v",
        "r.i += 0.5",
        "r.p += True",
        "r.x &= 1",
        "for i in range(2.5):\n    r.x = 1",
        "for i in 3:\n    r.x = 1",
    ],
)
def test_statements_whose_types_do_not_fit(body):
    rows = rows_with(**FIELDS)
    rows.new_field("k", rows, init=[0])
    rejects(ebb.KernelTypeError, "E2", lambda: kernel_of(body, rows=rows)(rows))


def test_complements_behind_a_loop(backend):
    rows = rows_with(i=(ebb.int32, [6, -6, 2, 3]))
    rows.new_field("out", ebb.int32)
    most = 3

    @ebb.kernel
    def program(r: rows):
        for _ in range(3, 0, -1):
            pass
        r.out = ~min(r.i, most)

    program(rows)
    assert rows.out.to_numpy().tolist() == [-4, 5, -3, -4]
