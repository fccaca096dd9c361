"""Scalars, vectors, matrices and keys: storage, coercion, weak Python numbers and casts."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import SIZES, assert_close, evaluate, evaluate_each, kernel_of, rejects, rows_with

EXTREMES = {
    ebb.bool_: [False, True, True],
    ebb.int32: [-(2**31), 0, 2**31 - 1],
    ebb.int64: [-(2**63), -1, 2**63 - 1],
    ebb.uint32: [0, 1, 2**32 - 1],
    ebb.uint64: [0, 2**63, 2**64 - 1],
    ebb.float32: [np.finfo(np.float32).max, -0.0, 1e-45],
    ebb.float64: [np.finfo(np.float64).max, np.inf, 5e-324],
}

SHAPED = [
    ebb.vec2f,
    ebb.vec3d,
    ebb.vec4i,
    ebb.vec3b,
    ebb.vector(ebb.uint32, 1),
    ebb.vector(ebb.int64, 7),
    ebb.mat2f,
    ebb.mat3d,
    ebb.mat4i,
    ebb.mat2x3f,
    ebb.mat3x4d,
    ebb.matrix(ebb.float64, 1, 1),
    ebb.matrix(ebb.float32, 5, 2),
    ebb.matrix(ebb.uint64, 1, 6),
]


def sample(field_type, size):
    """Values for ``size`` rows of ``field_type``, all different where the type allows."""
    values = np.arange(size * field_type.size).reshape(size, *field_type.shape)
    return (values % 2 if field_type.dtype == bool else values).astype(field_type.dtype)


@pytest.mark.parametrize("field_type", EXTREMES, ids=repr)
def test_a_kernel_copies_the_extremes_of_a_scalar(backend, field_type):
    copied = evaluate("r.a", field_type, a=(field_type, EXTREMES[field_type]))
    assert copied.dtype == field_type.dtype
    assert copied.tobytes() == np.array(EXTREMES[field_type], field_type.dtype).tobytes()


@pytest.mark.parametrize("field_type", SHAPED, ids=repr)
def test_a_kernel_copies_vectors_and_matrices(backend, field_type):
    for size in SIZES:
        values = sample(field_type, size)
        copied = evaluate("r.a", field_type, a=(field_type, values))
        assert copied.dtype == field_type.dtype
        np.testing.assert_array_equal(copied, values)


def test_aliases_are_the_constructed_types():
    assert ebb.vec3f == ebb.vector(ebb.float32, 3)
    assert ebb.vec2d == ebb.vector(ebb.float64, 2)
    assert ebb.vec4i == ebb.vector(ebb.int32, 4)
    assert ebb.mat3f == ebb.matrix(ebb.float32, 3, 3)
    assert ebb.mat2x3i == ebb.matrix(ebb.int32, 2, 3)
    assert ebb.mat4x3d == ebb.matrix(ebb.float64, 4, 3)
    assert ebb.vec3f != ebb.vec3d


def test_a_relation_stands_for_its_key_type():
    cells = ebb.Relation("cells", size=3)
    edges = ebb.Relation("edges", size=2)
    assert edges.new_field("a", cells).type == ebb.key(cells)
    assert edges.new_field("b", ebb.vector(cells, 2)).type == ebb.vector(ebb.key(cells), 2)
    assert ebb.key(cells) != ebb.key(edges)


def test_matrices_are_row_major(backend):
    out = evaluate("[[1, 2, 3], [4, 5, 6]]", ebb.mat2x3i)
    np.testing.assert_array_equal(out, [[[1, 2, 3], [4, 5, 6]]])


def test_components_of_a_long_vector(backend):
    rows = ebb.Relation("rows", size=2)
    rows.new_field("stencil", ebb.vector(ebb.float64, 19), init=0.0)

    @ebb.kernel
    def fill(r: rows):
        for i in range(19):
            r.stencil[i] = i * i

    fill(rows)
    np.testing.assert_array_equal(rows.stencil.to_numpy(), [np.arange(19.0) ** 2] * 2)


def test_vectors_and_matrices_of_keys_are_followed(backend):
    vertices = ebb.Relation("vertices", size=4)
    quads = ebb.Relation("quads", size=1)
    vertices.new_field("x", ebb.float64, init=[1.0, 10.0, 100.0, 1000.0])
    quads.new_field("v", ebb.vector(vertices, 4), init=[[3, 2, 1, 0]])
    quads.new_field("m", ebb.matrix(vertices, 2, 2), init=[[[0, 1], [2, 3]]])
    quads.new_field("first", ebb.float64)
    quads.new_field("corner", ebb.float64)
    quads.new_field("total", ebb.float64, init=0.0)

    @ebb.kernel
    def gather(q: quads):
        q.first = q.v[0].x
        q.corner = q.m[1, 0].x
        for i in range(4):
            q.total += q.v[i].x

    gather(quads)
    assert (quads.first.to_numpy()[0], quads.corner.to_numpy()[0], quads.total.to_numpy()[0]) == (1000, 100, 1111)


# ---- Coercion: what may be stored where, and in which precision an operator works. ----

WIDENING = [
    ("r.i + r.l", ebb.int64, 2**31 - 1 + 2**40),
    ("r.i * r.l", ebb.int64, (2**31 - 1) * 2**40 % 2**64 - 2**64),
    ("r.i + r.f", ebb.float32, np.float32(2**31 - 1) + np.float32(0.1)),
    ("r.i + r.d", ebb.float64, 2**31 - 1 + 0.1),
    ("r.l + r.d", ebb.float64, 2**40 + 0.1),
    ("r.f + r.d", ebb.float64, float(np.float32(0.1)) + 0.1),
    ("r.d * r.f", ebb.float64, float(np.float32(0.1)) * 0.1),
    ("r.i", ebb.int64, 2**31 - 1),
    ("r.i", ebb.float64, 2.0**31 - 1),
    ("r.f", ebb.float64, float(np.float32(0.1))),
    ("r.u", ebb.uint64, 2**32 - 1),
    ("r.u + r.d", ebb.float64, 2**32 - 1 + 0.1),
]
NARROWING = [
    ("r.d", ebb.float32),
    ("r.d", ebb.int32),
    ("r.f", ebb.int32),
    ("r.l", ebb.int32),
    ("r.f + r.d", ebb.float32),
    ("r.f * 2.0 + r.d", ebb.float32),
    ("r.i / r.i", ebb.int32),
    ("r.b", ebb.int32),
    ("r.b", ebb.float32),
    ("r.i", ebb.bool_),
    ("r.f > 0", ebb.float32),
    ("1.5", ebb.int32),
    ("True", ebb.int32),
    ("1", ebb.bool_),
]


def one_of_each():
    return rows_with(
        b=(ebb.bool_, [True]),
        i=(ebb.int32, [2**31 - 1]),
        l=(ebb.int64, [2**40]),
        u=(ebb.uint32, [2**32 - 1]),
        f=(ebb.float32, [0.1]),
        d=(ebb.float64, [0.1]),
    )


@pytest.mark.parametrize(("expression", "result", "expected"), WIDENING, ids=lambda v: v if isinstance(v, str) else "")
def test_numbers_widen(backend, expression, result, expected):
    rows = one_of_each()
    rows.new_field("out", result)
    kernel_of(f"r.out = {expression}", rows=rows)(rows)
    assert rows.out.to_numpy()[0] == expected


@pytest.mark.parametrize(("expression", "result"), NARROWING, ids=lambda v: v if isinstance(v, str) else repr(v))
def test_numbers_do_not_narrow(expression, result):
    rows = one_of_each()
    rows.new_field("out", result)
    kernel = kernel_of(f"r.out = {expression}", rows=rows)
    rejects(ebb.KernelTypeError, "E2", lambda: kernel(rows))


def test_int32_with_float32_works_in_float32(backend):
    out = evaluate("r.a + r.b", ebb.float64, a=(ebb.int32, [2**24 + 1]), b=(ebb.float32, [0.0]))
    assert out[0] == 2**24


def test_vectors_widen_elementwise(backend):
    out = evaluate("r.a + r.b", ebb.vec3d, a=(ebb.vec3i, [[1, 2, 3]]), b=(ebb.vec3d, [[0.5, 0.25, 0.125]]))
    np.testing.assert_array_equal(out, [[1.5, 2.25, 3.125]])


def test_a_float64_vector_does_not_fit_a_float32_field():
    rows = rows_with(a=(ebb.vec3d, [[1, 2, 3]]), out=(ebb.vec3f, [[0, 0, 0]]))
    rejects(ebb.KernelTypeError, "E2", lambda: kernel_of("r.out = r.a", rows=rows)(rows))
    np.testing.assert_array_equal(rows.out.to_numpy(), [[0, 0, 0]])


# ---- Python numbers are weak. ----


def test_a_python_float_takes_the_precision_of_its_partner(backend):
    x = np.array([0.3, 7.7, -1e-3], np.float32)
    out = evaluate("0.1 * r.x", ebb.float32, x=(ebb.float32, x))
    assert (out == np.float32(0.1) * x).all()


def test_python_arithmetic_on_python_numbers_stays_in_python(backend):
    x = np.array([3.0], np.float32)
    out = evaluate("r.x * (1 / 3) * 2 ** 0.5", ebb.float64, x=(ebb.float32, x))
    assert_close(out, x * np.float32(1 / 3) * np.float32(2**0.5), np.float32)


def test_a_captured_python_float_is_weak_too(backend):
    dt = 1e-4
    rows = rows_with(v=(ebb.vec3f, [[1, 2, 3]]))

    @ebb.kernel
    def step(r: rows):
        r.v += 0.5 * r.v * dt * dt

    step(rows)
    assert_close(rows.v.to_numpy(), [[1, 2, 3]], np.float32)


def test_alone_a_python_float_is_float64(backend):
    rows = rows_with(out=(ebb.float64, [0]))

    @ebb.kernel
    def third(r: rows):
        x = 1 / 3
        x += 1e-12
        r.out = x

    third(rows)
    assert rows.out.to_numpy()[0] == 1 / 3 + 1e-12


def test_alone_a_float_does_not_fit_float32():
    rows = rows_with(out=(ebb.float32, [0]))
    rejects(ebb.KernelTypeError, "E2", lambda: kernel_of("x = 0.5\nr.out = x", rows=rows)(rows))


def test_alone_a_python_int_is_int32_or_int64_where_it_must(backend):
    rows = rows_with(small=(ebb.int32, [0]), large=(ebb.int64, [0]))

    @ebb.kernel
    def count(r: rows):
        n = 7
        big = 3_000_000_000
        r.small = n
        r.large = big + n

    count(rows)
    assert (rows.small.to_numpy()[0], rows.large.to_numpy()[0]) == (7, 3_000_000_007)


def test_an_int_literal_fits_a_float_field(backend):
    np.testing.assert_array_equal(evaluate("1", ebb.float32), [1.0])
    np.testing.assert_array_equal(evaluate("[1, 2, 3]", ebb.vec3f), [[1, 2, 3]])


def test_an_int_that_does_not_fit_its_field_is_an_error():
    rows = rows_with(out=(ebb.int32, [0]))
    rejects(ebb.KernelTypeError, "E2", lambda: kernel_of("r.out = 3_000_000_000", rows=rows)(rows))


def test_a_constant_fixes_the_type(backend):
    K = ebb.constant(0.1, ebb.float32)
    out = evaluate("K * r.x", ebb.float64, {"K": K}, x=(ebb.float64, [1.0]))
    assert out[0] == float(np.float32(0.1))


def test_a_float64_constant_makes_the_product_float64():
    K = ebb.constant(1.0, ebb.float64)
    rows = rows_with(x=(ebb.float32, [1.0]))
    rejects(ebb.KernelTypeError, "E2", lambda: kernel_of("r.x = K * r.x", rows=rows, K=K)(rows))


# ---- Casts. ----

CASTS = [
    ("ebb.int32(r.d)", ebb.int32, [-2, 2, 0]),
    ("ebb.int64(r.d)", ebb.int64, [-2, 2, 0]),
    ("ebb.float32(r.d)", ebb.float32, np.array([-2.7, 2.7, 0], np.float32)),
    ("ebb.float64(r.i)", ebb.float64, [-1, 0, 7]),
    ("ebb.float32(r.i) / 2", ebb.float32, [-0.5, 0, 3.5]),
    ("ebb.uint32(r.i)", ebb.uint32, [2**32 - 1, 0, 7]),
    ("ebb.int32(r.l)", ebb.int32, [1, -1, 0]),
    ("ebb.bool_(r.i)", ebb.bool_, [True, False, True]),
    ("ebb.bool_(r.d)", ebb.bool_, [True, True, False]),
    ("ebb.int32(r.i > 0)", ebb.int32, [0, 0, 1]),
    ("ebb.vec3f(r.v)", ebb.vec3f, np.full((3, 3), 0.1, np.float32)),
    ("ebb.vec3i(r.v * 25)", ebb.vec3i, np.full((3, 3), 2)),
    ("ebb.vec3d(r.w)", ebb.vec3d, [[1, 2, 3]] * 3),
    ("ebb.vec3f(r.d, r.i, 1)[0]", ebb.float32, np.array([-2.7, 2.7, 0], np.float32)),
    ("ebb.vec3f(0)", ebb.vec3f, np.zeros((3, 3))),
    ("ebb.mat2f([[r.d, 1], [2, 3]])[0, 0]", ebb.float32, np.array([-2.7, 2.7, 0], np.float32)),
]


def test_casts(backend):
    outs = evaluate_each(
        {expression: result for expression, result, _ in CASTS},
        d=(ebb.float64, [-2.7, 2.7, 0.0]),
        i=(ebb.int32, [-1, 0, 7]),
        l=(ebb.int64, [2**32 + 1, -1, 2**40]),
        v=(ebb.vec3d, np.full((3, 3), 0.1)),
        w=(ebb.vec3i, [[1, 2, 3]] * 3),
    )
    for expression, _, expected in CASTS:
        np.testing.assert_array_equal(outs[expression], expected, err_msg=expression)


def test_a_cast_makes_the_narrowing_store_legal(backend):
    rows = rows_with(x=(ebb.float32, [0.0]), y=(ebb.float64, [0.1]))

    @ebb.kernel
    def store(r: rows):
        r.x = ebb.float32(r.y)

    store(rows)
    assert rows.x.to_numpy()[0] == np.float32(0.1)


@pytest.mark.parametrize(
    "expression",
    ["ebb.vec2f(r.v)", "ebb.vec3f(r.s)[5]", "ebb.mat2d(r.v)", "ebb.float32(r.v)", "ebb.vec3f(r.k)"],
)
def test_casts_across_shapes_are_errors(expression):
    rows = rows_with(v=(ebb.vec3d, [[1, 2, 3]]), s=(ebb.float64, [1.0]))
    rows.new_field("k", ebb.vector(rows, 3), init=[[0, 0, 0]])
    rejects(ebb.KernelTypeError, "E", lambda: kernel_of(f"x = {expression}", rows=rows)(rows))


def test_types_called_on_the_host_convert_as_in_numpy():
    assert ebb.int32(2.7) == 2
    assert ebb.float32(0.1).dtype == np.float32
    np.testing.assert_array_equal(ebb.vec3f(1, 2, 3), np.array([1, 2, 3], np.float32))
    np.testing.assert_array_equal(ebb.vec2i([4, 5]), [4, 5])


@pytest.mark.parametrize("bad", [(ebb.float32, 0), (ebb.float32, -1), (ebb.float32, 2.5), (ebb.vec3f, 2), ("f4", 3)])
def test_what_makes_no_vector(bad):
    with pytest.raises((TypeError, ebb.EbbError)):
        ebb.vector(*bad)
