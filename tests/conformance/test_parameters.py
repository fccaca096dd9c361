"""The further parameters of a kernel: uniform values and the names of fields."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import rejects, rows_with

# ---- Parameters ----


def test_uniform_parameters(backend):
    rows = rows_with(x=(ebb.float32, [1, 2]), n=(ebb.int32, [0, 0]))

    @ebb.kernel
    def program(r: rows, dt: ebb.float32, n: ebb.int32, flag: ebb.bool_):
        if flag:
            r.x += dt
        r.n += n

    program(rows, 0.5, 3, True)
    program(rows, 1, 4, False)
    program(rows, dt=np.float32(0.25), n=np.int32(1), flag=np.bool_(True))
    np.testing.assert_array_equal(rows.x.to_numpy(), [1.75, 2.75])
    np.testing.assert_array_equal(rows.n.to_numpy(), [8, 8])


def test_vector_and_matrix_parameters(backend):
    rows = rows_with(v=(ebb.vec3d, [[1, 2, 3]]))

    @ebb.kernel
    def transform(r: rows, m: ebb.mat3d, t: ebb.vec3d):
        r.v = m @ r.v + t

    transform(rows, np.diag([1.0, 2.0, 3.0]), [1, 0, 0])
    np.testing.assert_array_equal(rows.v.to_numpy(), [[2, 4, 9]])


def test_bare_parameters_take_the_type_of_their_argument(backend):
    rows = rows_with(x=(ebb.float64, [0]), v=(ebb.vec2d, [[0, 0]]))

    @ebb.kernel
    def add(r: rows, a, b=1):
        r.x += ebb.length(r.v * a) * b + 1
        r.v += a

    add(rows, 2.0)
    add(rows, 3, 2.5)
    add(rows, np.array([3.0, 4.0]))
    np.testing.assert_array_equal(rows.v.to_numpy(), [[8, 9]])
    assert rows.x.to_numpy()[0] == pytest.approx(3 + 2.5 * np.hypot(6, 6) + np.hypot(15, 20))


def test_a_bare_float_is_float64():
    rows = rows_with(x=(ebb.float32, [0]))

    @ebb.kernel
    def add(r: rows, a):
        r.x += a

    rejects(ebb.KernelTypeError, "E2", lambda: add(rows, 0.5))
    add(rows, np.float32(0.5))
    add(rows, 1)
    assert rows.x.to_numpy()[0] == 1.5


def test_field_names_as_parameters(backend):
    rows = rows_with(a=(ebb.float64, [1, 2]), b=(ebb.float64, [5, 6]), v=(ebb.vec2f, [[1, 2], [3, 4]]))
    rows.new_field("w", ebb.vec2f)

    @ebb.kernel
    def copy(c: rows, dst: str, src: str):
        c[dst] = c[src]

    copy(rows, "b", "a")
    copy(rows, "w", "v")
    np.testing.assert_array_equal(rows.b.to_numpy(), [1, 2])
    np.testing.assert_array_equal(rows.w.to_numpy(), [[1, 2], [3, 4]])
    rejects(ebb.KernelTypeError, "E", lambda: copy(rows, "a", "v"))
    error = rejects(ebb.KernelTypeError, "E", lambda: copy(rows, "a", "bb"))
    assert "bb" in str(error)
    rejects(ebb.KernelTypeError, "E2", lambda: copy(rows, "a", 5))
    np.testing.assert_array_equal(rows.a.to_numpy(), [1, 2])


def test_field_names_go_through_a_func(backend):
    rows = rows_with(a=(ebb.float64, [1, 2]), b=(ebb.float64, [5, 6]), c=(ebb.float64, [0, 0]))

    @ebb.func
    def copy_field(row, dst, src):
        row[dst] = row[src]

    @ebb.kernel
    def copy(r: rows, dst: str, src: str):
        copy_field(r, dst, src)

    copy(rows, "b", "a")
    copy(rows, dst="c", src="b")
    np.testing.assert_array_equal(rows.c.to_numpy(), [1, 2])


def test_bare_field_names(backend):
    rows = rows_with(a=(ebb.float64, [1, 2]), b=(ebb.float64, [5, 6]))

    @ebb.kernel
    def axpy(r, alpha, x, y):
        r[y] += alpha * r[x]

    axpy(rows, 10, "a", "b")
    np.testing.assert_array_equal(rows.b.to_numpy(), [15, 26])


WRONG_ARGUMENTS = {
    "too few": lambda k, r: k(r),
    "too many": lambda k, r: k(r, 1.0, 2.0),
    "an unknown name": lambda k, r: k(r, dx=1.0),
    "twice": lambda k, r: k(r, 1.0, dt=1.0),
    "a vector for a scalar": lambda k, r: k(r, [1.0, 2.0]),
    "text": lambda k, r: k(r, "1.0"),
    "None": lambda k, r: k(r, None),
    "a relation": lambda k, r: k(r, r),
    "a field": lambda k, r: k(r, r.x),
    "complex": lambda k, r: k(r, 1j),
    "no rows but a number": lambda k, r: k(1.0, 1.0),
    "no rows but a field": lambda k, r: k(r.x, 1.0),
    "no rows but a name": lambda k, r: k("rows", 1.0),
}


@pytest.mark.parametrize("case", WRONG_ARGUMENTS)
def test_wrong_arguments(case):
    rows = rows_with(x=(ebb.float64, [1]))

    @ebb.kernel
    def add(r: rows, dt: ebb.float64):
        r.x += dt

    rejects(ebb.KernelTypeError, "E26", lambda: WRONG_ARGUMENTS[case](add, rows))
    assert rows.x.to_numpy()[0] == 1


def test_a_float_for_an_integer_parameter():
    rows = rows_with(n=(ebb.int32, [1]))

    @ebb.kernel
    def add(r: rows, n: ebb.int32):
        r.n += n

    rejects(ebb.KernelTypeError, "E263", lambda: add(rows, 1.5))
    rejects(ebb.KernelTypeError, "E26", lambda: add(rows, 2**31))
    rejects(ebb.KernelTypeError, "E263", lambda: add(rows, True))
    add(rows, 5)
    assert rows.n.to_numpy()[0] == 6
