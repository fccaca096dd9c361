"""Globals and constants on the host and in kernels."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import kernel_of, rejects, rows_with


@pytest.mark.parametrize(
    ("scalar", "value"),
    [
        (ebb.bool_, True),
        (ebb.int32, -7),
        (ebb.int64, 2**40),
        (ebb.uint32, 2**32 - 1),
        (ebb.uint64, 2**64 - 1),
        (ebb.float32, 0.5),
        (ebb.float64, 1 / 3),
    ],
    ids=repr,
)
def test_a_scalar_global_is_a_python_number(backend, scalar, value):
    g = ebb.Global(scalar, value)
    assert g.value == value
    assert type(g.value) is type(value)
    rows = rows_with(x=(scalar, [0, 0]))
    kernel_of("r.x = g.value", rows=rows, g=g)(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [value, value])


@pytest.mark.parametrize("shaped", [ebb.vec3f, ebb.mat2x3i, ebb.vec2b], ids=repr)
def test_a_shaped_global_is_an_array(backend, shaped):
    values = (np.arange(shaped.size).reshape(shaped.shape) % 2).astype(shaped.dtype)
    g = ebb.Global(shaped, values)
    assert g.value.dtype == shaped.dtype
    np.testing.assert_array_equal(g.value, values)
    rows = rows_with(x=(shaped, np.zeros((2, *shaped.shape))))
    kernel_of("r.x = g", rows=rows, g=g)(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [values, values])


def test_the_array_of_a_global_is_a_copy():
    g = ebb.Global(ebb.vec3d, [1, 2, 3])
    g.value[0] = 99
    np.testing.assert_array_equal(g.value, [1, 2, 3])
    g.value = 5
    np.testing.assert_array_equal(g.value, [5, 5, 5])


def test_a_global_set_between_launches_is_seen(backend):
    g = ebb.Global(ebb.float32, 1.0)
    rows = rows_with(x=(ebb.float32, [0.0]))
    add = kernel_of("r.x += g.value", rows=rows, g=g)
    add(rows)
    g.value = 10
    add(rows)
    g.value = 0.5
    add(rows)
    assert rows.x.to_numpy()[0] == 11.5


def test_expressions_of_globals(backend):
    dt, g = ebb.Global(ebb.float32, 0.5), ebb.Global(ebb.vec3f, [0, -10, 0])
    rows = rows_with(v=(ebb.vec3f, [[1, 1, 1]]), out=(ebb.float32, [0]))

    @ebb.kernel
    def integrate(r: rows):
        r.v += g * dt
        r.out = g.value[1] * dt.value + g.y

    integrate(rows)
    np.testing.assert_array_equal(rows.v.to_numpy(), [[1, -4, 1]])
    assert rows.out.to_numpy()[0] == -15


def test_a_kernel_reduces_what_the_next_reads(backend):
    rows = rows_with(x=(ebb.float64, [3.0, 4.0]))
    norm2 = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def measure(r: rows):
        norm2.value += r.x * r.x

    @ebb.kernel
    def scale(r: rows):
        r.x /= ebb.sqrt(norm2.value)

    measure(rows)
    scale(rows)
    np.testing.assert_allclose(rows.x.to_numpy(), [0.6, 0.8])


def test_conjugate_gradients(backend):
    """The dot products of a solver: globals reduced by one kernel and read by the next."""
    n = 20
    rows = ebb.Relation("rows", shape=(n,), periodic=(True,))
    for name in ("x", "r", "p", "Ap"):
        rows.new_field(name, ebb.float64, init=0.0)
    b = np.random.default_rng(3).standard_normal(n)
    rows.r.load(b)
    rows.p.load(b)
    rr, pAp, alpha, beta = (ebb.Global(ebb.float64, 0.0) for _ in range(4))

    @ebb.kernel
    def apply(c: rows):
        left, right = ebb.affine(rows, [[1, -1]], c), ebb.affine(rows, [[1, 1]], c)
        c.Ap = 2.5 * c.p - left.p - right.p
        pAp.value += c.p * (2.5 * c.p - left.p - right.p)

    @ebb.kernel
    def advance(c: rows):
        c.x += alpha * c.p
        c.r -= alpha * c.Ap
        rr.value += c.r * c.r

    @ebb.kernel
    def turn(c: rows):
        c.p = c.r + beta * c.p

    old = b @ b
    for _ in range(n):
        pAp.value = rr.value = 0
        apply(rows)
        alpha.value = old / pAp.value
        advance(rows)
        beta.value = rr.value / old
        turn(rows)
        old = rr.value
        if old < 1e-24:
            break
    matrix = 2.5 * np.eye(n) - np.roll(np.eye(n), 1, 0) - np.roll(np.eye(n), -1, 0)
    np.testing.assert_allclose(rows.x.to_numpy(), np.linalg.solve(matrix, b), atol=1e-10)


@pytest.mark.parametrize(
    ("value_type", "value"),
    [
        (ebb.int32, 0.5),
        (ebb.int32, 2**31),
        (ebb.uint32, -1),
        (ebb.vec3f, [1, 2]),
        (ebb.float64, [1.0, 2.0]),
        (ebb.float64, "1"),
        (ebb.float64, None),
        (ebb.bool_, 0.5),
    ],
)
def test_what_a_global_does_not_take(value_type, value):
    rejects(ebb.RelationError, "E5", lambda: ebb.Global(value_type, value))
    g = ebb.Global(value_type, 1 if value_type is not ebb.bool_ else True)
    before = np.array(g.value)

    def assign():
        g.value = value

    rejects(ebb.RelationError, "E5", assign)
    np.testing.assert_array_equal(g.value, before)


def test_globals_and_constants_of_keys():
    rows = ebb.Relation("rows", size=3)
    rejects(ebb.RelationError, "E517", lambda: ebb.Global(rows, 0))
    rejects(ebb.RelationError, "E517", lambda: ebb.constant(0, ebb.vector(rows, 2)))


def test_types_of_reductions_into_globals():
    rows = rows_with(x=(ebb.float64, [1.0]), v=(ebb.vec3d, [[1, 2, 3]]), b=(ebb.bool_, [True]))
    captured = {"i": ebb.Global(ebb.int32, 0), "f": ebb.Global(ebb.float32, 0), "w": ebb.Global(ebb.vec2d, 0)}
    for body in ("i.value += r.x", "f.value += r.x", "w.value += r.v", "i.value += r.b", "f.value &= r.x"):
        rejects(ebb.KernelTypeError, "E2", lambda: kernel_of(body, rows=rows, **captured)(rows))
    assert (captured["i"].value, captured["f"].value) == (0, 0)


def test_vector_and_matrix_constants(backend):
    rows = rows_with(v=(ebb.vec3f, [[1, 2, 3]]))
    gravity = ebb.constant([0, -9.81, 0], ebb.vec3f)
    mirror = ebb.constant(np.diag([1.0, -1.0, 1.0]), ebb.mat3f)
    kernel_of("r.v = mirror @ (r.v + gravity)", rows=rows, gravity=gravity, mirror=mirror)(rows)
    np.testing.assert_array_equal(rows.v.to_numpy(), [[1, -(np.float32(2) + np.float32(-9.81)), 3]])


def test_constants_that_do_not_fit():
    rejects(ebb.RelationError, "E5", lambda: ebb.constant(0.5, ebb.int32))
    rejects(ebb.RelationError, "E5", lambda: ebb.constant([1, 2], ebb.vec3f))
