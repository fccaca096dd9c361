"""Nothing that a kernel does can crash the process or go unnoticed: bounds, unset keys, asserts, odd numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ebb

from .harness import LARGE, evaluate, kernel_of, names_row, rejects, rows_with, sizes_for


def test_a_dynamic_index_out_of_range_names_kernel_line_and_row(backend):
    rows = rows_with(i=(ebb.int32, [0, 2, 3, 1]), v=(ebb.vec3d, [[1, 2, 3]] * 4), out=(ebb.float64, [0] * 4))

    @ebb.kernel
    def pick(r: rows):
        r.out = r.v[r.i]

    error = rejects(ebb.BoundsError, "E402", lambda: pick(rows))
    text = str(error)
    assert "pick" in text and names_row(error, 2) and "r.v[r.i]" in text and "3" in text
    rows.i.load([0, 2, 1, 1])
    pick(rows)
    np.testing.assert_array_equal(rows.out.to_numpy(), [1, 3, 2, 2])


@pytest.mark.parametrize("index", [-1, 3, 100, 2**31 - 1, -(2**31)])
def test_no_index_reaches_memory_that_is_not_its_own(backend, index):
    for body in (
        "r.out = r.v[r.i]",
        "r.v[r.i] = 5",
        "r.v[r.i] += 5",
        "w = r.v\nw[r.i] = 1\nr.v = w",
        "r.out = r.m[0, r.i]",
    ):
        rows = rows_with(
            i=(ebb.int32, [index]), v=(ebb.vec3d, [[1, 2, 3]]), m=(ebb.mat3d, np.eye(3)[None]), out=(ebb.float64, [7])
        )
        rejects(ebb.BoundsError, "E402", lambda: kernel_of(body, rows=rows)(rows))
        np.testing.assert_array_equal(rows.v.to_numpy(), [[1, 2, 3]])


def test_a_dynamic_index_into_a_vector_of_keys_and_a_global(backend):
    rows = rows_with(i=(ebb.int32, [5]), x=(ebb.float64, [1]))
    rows.new_field("k", ebb.vector(rows, 2), init=[[0, 0]])
    rows.new_field("out", ebb.float64)
    g = ebb.Global(ebb.vec3d, 0.0)
    rejects(ebb.BoundsError, "E402", lambda: kernel_of("r.out = r.k[r.i].x", rows=rows)(rows))
    rejects(ebb.BoundsError, "E402", lambda: kernel_of("g.value[r.i] += r.x", rows=rows, g=g)(rows))
    np.testing.assert_array_equal(g.value, [0, 0, 0])


def test_indices_within_range_may_be_any_integer_type(backend):
    rows = rows_with(i=(ebb.int64, [2]), u=(ebb.uint32, [1]), v=(ebb.vec3d, [[1, 2, 3]]), out=(ebb.float64, [0]))
    kernel_of("r.out = r.v[r.i] * 10 + r.v[r.u]", rows=rows)(rows)
    assert rows.out.to_numpy()[0] == 32


def test_a_huge_int64_index_does_not_wrap_into_range(backend):
    rows = rows_with(i=(ebb.int64, [2**32]), v=(ebb.vec3d, [[1, 2, 3]]), out=(ebb.float64, [0]))
    rejects(ebb.BoundsError, "E402", lambda: kernel_of("r.out = r.v[r.i]", rows=rows)(rows))


# ---- Unset keys ----


def test_following_an_unset_key_is_an_error(backend):
    vertices, edges = ebb.Relation("vertices", size=3), ebb.Relation("edges", size=4)
    vertices.new_field("x", ebb.float64, init=1.0)
    edges.new_field("head", vertices)
    edges.new_field("x", ebb.float64, init=0.0)

    @ebb.kernel
    def read(e: edges):
        e.x = e.head.x

    @ebb.kernel
    def reduce(e: edges):
        e.head.x += 1

    for kernel in (read, reduce):
        error = rejects(ebb.RelationError, "E404", lambda: kernel(edges))
        assert kernel.__name__ in str(error) and names_row(error, 0)
    np.testing.assert_array_equal(vertices.x.to_numpy(), [1, 1, 1])
    edges.head.fill(2)
    reduce(edges)
    read(edges)
    np.testing.assert_array_equal(edges.x.to_numpy(), [5, 5, 5, 5])


def test_a_key_that_is_set_for_some_rows(backend):
    vertices, edges = ebb.Relation("vertices", size=3), ebb.Relation("edges", size=4)
    vertices.new_field("x", ebb.float64, init=1.0)
    edges.new_field("head", vertices)
    edges.new_field("target", vertices, init=2)
    edges.new_field("good", ebb.bool_, init=[True, True, False, True])
    edges.new_field("x", ebb.float64, init=0.0)

    @ebb.kernel
    def link(e: edges):
        if e.good:
            e.head = e.target

    @ebb.kernel
    def read_good(e: edges):
        if e.good:
            e.x = e.head.x

    @ebb.kernel
    def read_all(e: edges):
        e.x = e.head.x

    link(edges)
    read_good(edges)
    np.testing.assert_array_equal(edges.x.to_numpy(), [1, 1, 0, 1])
    error = rejects(ebb.RelationError, "E404", lambda: read_all(edges))
    assert names_row(error, 2)


def test_keys_that_become_unset_after_the_first_launch(backend):
    vertices, edges = ebb.Relation("vertices", size=4), ebb.Relation("edges", size=4)
    vertices.new_field("x", ebb.float64, init=[1, 2, 3, 4])
    edges.new_field("head", vertices, init=[3, 2, 1, 0])
    edges.new_field("x", ebb.float64, init=0.0)

    @ebb.kernel
    def read(e: edges):
        e.x = e.head.x

    read(edges)
    edges.head.load(np.ma.masked_less([3, -1, 1, 0], 0))
    error = rejects(ebb.RelationError, "E404", lambda: read(edges))
    assert names_row(error, 1)
    edges.head.load([0, 1, 2, 3])
    read(edges)
    np.testing.assert_array_equal(edges.x.to_numpy(), [1, 2, 3, 4])


def test_unset_keys_dump_as_minus_one():
    vertices, edges = ebb.Relation("vertices", size=3), ebb.Relation("edges", size=2)
    edges.new_field("head", vertices)
    np.testing.assert_array_equal(edges.head.to_numpy(), [-1, -1])


# ---- Asserts ----


def test_an_assert_names_kernel_line_and_row(backend):
    rows = rows_with(x=(ebb.float64, [1, 2, -3, 4]))

    @ebb.kernel
    def positive(r: rows):
        assert r.x > 0, "x must be positive"

    error = rejects(ebb.KernelAssertionError, "E401", lambda: positive(rows))
    text = str(error)
    assert "positive" in text and "x must be positive" in text and names_row(error, 2) and "r.x > 0" in text
    assert "test_safety.py" in text
    rows.x.fill(1.0)
    positive(rows)


def test_an_assert_without_text(backend):
    rows = rows_with(x=(ebb.int32, [1, 0]))
    error = rejects(ebb.KernelAssertionError, "E401", lambda: kernel_of("assert r.x == 1", rows=rows)(rows))
    assert names_row(error, 1)


def test_an_assert_in_a_func_and_a_loop(backend):
    rows = rows_with(x=(ebb.int32, [2, 5]))

    @ebb.func
    def checked(n):
        for i in range(n):
            assert i < 4, "too many turns"
        return n

    @ebb.kernel
    def program(r: rows):
        r.x = checked(r.x)

    error = rejects(ebb.KernelAssertionError, "E401", lambda: program(rows))
    assert "too many turns" in str(error) and names_row(error, 1)


def test_the_row_of_a_failure_is_its_number_when_it_was_created(backend):
    others, rows = ebb.Relation("others", size=3), ebb.Relation("rows", size=9)
    rows.new_field("k", others, init=[2, 1, 0, 2, 1, 0, 2, 1, 0])
    rows.new_field("x", ebb.int32, init=np.arange(9))
    rows.group_by("k")
    error = rejects(ebb.KernelAssertionError, "E401", lambda: kernel_of("assert r.x != 4", rows=rows)(rows))
    assert names_row(error, 4)


def test_the_row_of_a_failure_on_a_grid_and_in_a_subset(backend):
    cells = ebb.Relation("cells", shape=(4, 5))
    cells.new_field("x", ebb.int32, init=np.arange(20).reshape(4, 5))
    cells.new_subset("s", np.s_[1:, 1:])
    kernel = kernel_of("assert c.x != 13", "c: cells", cells=cells)
    for launched in (cells, cells.s):
        error = rejects(ebb.KernelAssertionError, "E401", lambda: kernel(launched))
        assert names_row(error, 2, 3)


def test_a_failure_among_many_rows():
    rows = ebb.Relation("rows", size=LARGE)
    rows.new_field("x", ebb.int32, init=np.arange(LARGE))
    kernel = kernel_of("assert r.x < 90_000", rows=rows)
    for threads in (1, 2, 7):
        with ebb.backend("cpu", threads=threads):
            error = rejects(ebb.KernelAssertionError, "E401", lambda: kernel(rows))
        assert names_row(error, 90000)


@pytest.mark.parametrize("least", [0, 1, 63, 64, 90_000, LARGE - 1])
def test_the_first_of_many_rows_that_fail(compiled, least):
    rows = ebb.Relation("rows", size=LARGE)
    rows.new_field("x", ebb.int32, init=np.arange(LARGE))
    kernel = kernel_of("assert r.x < least", "r: rows, least: ebb.int32", rows=rows)
    for _ in range(3):
        assert names_row(rejects(ebb.KernelAssertionError, "E401", lambda: kernel(rows, least)), least)


def test_no_row_no_failure(backend):
    rows = rows_with(x=(ebb.float64, []))
    kernel_of("assert r.x > 0", rows=rows)(rows)


# ---- Numbers ----


def test_integer_division_by_zero_is_zero(backend):
    for int_type in (ebb.int32, ebb.int64, ebb.uint32):
        fields = {"a": (int_type, [7, 0, 5]), "b": (int_type, [0, 0, 2])}
        np.testing.assert_array_equal(evaluate("r.a // r.b", int_type, **fields), [0, 0, 2])
        np.testing.assert_array_equal(evaluate("r.a % r.b", int_type, **fields), [0, 0, 1])


def test_the_smallest_integer_by_minus_one(backend):
    for int_type, bits in ((ebb.int32, 31), (ebb.int64, 63)):
        fields = {"a": (int_type, [-(2**bits)]), "b": (int_type, [-1])}
        assert evaluate("r.a // r.b", int_type, **fields)[0] == -(2**bits)
        assert evaluate("r.a % r.b", int_type, **fields)[0] == 0
        assert evaluate("-r.a", int_type, **fields)[0] == -(2**bits)
        assert evaluate("abs(r.a)", int_type, **fields)[0] == -(2**bits)


def test_shifts_by_any_amount(backend):
    fields = {"a": (ebb.int32, [5, 5, 5, -5, -5]), "n": (ebb.int32, [31, 32, -1, 100, -7])}
    np.testing.assert_array_equal(evaluate("r.a << r.n", ebb.int32, **fields), [-(2**31), 0, 0, 0, 0])
    np.testing.assert_array_equal(evaluate("r.a >> r.n", ebb.int32, **fields), [0, 0, 0, -1, -1])


def test_floats_that_no_integer_holds_saturate(backend):
    x = [math.nan, math.inf, -math.inf, 1e300, -1e300, 3e9, 1.9]
    np.testing.assert_array_equal(
        evaluate("ebb.int32(r.x)", ebb.int32, x=(ebb.float64, x)),
        [0, 2**31 - 1, -(2**31), 2**31 - 1, -(2**31), 2**31 - 1, 1],
    )
    np.testing.assert_array_equal(
        evaluate("ebb.int64(r.x)", ebb.int64, x=(ebb.float64, x)),
        np.array([0, 2**63 - 1, -(2**63), 2**63 - 1, -(2**63), 3_000_000_000, 1]),
    )
    np.testing.assert_array_equal(
        evaluate("ebb.uint32(r.x)", ebb.uint32, x=(ebb.float64, x)), [0, 2**32 - 1, 0, 2**32 - 1, 0, 3_000_000_000, 1]
    )


def test_integer_powers(backend):
    fields = {"a": (ebb.int32, [2, -3, 0, 7]), "n": (ebb.int32, [10, 3, 0, 1])}
    np.testing.assert_array_equal(evaluate("r.a ** r.n", ebb.int32, **fields), [1024, -27, 1, 7])


def test_domain_errors_are_nan_or_infinite(backend):
    x = {"x": (ebb.float64, [-1.0, 0.0])}
    np.testing.assert_array_equal(evaluate("ebb.sqrt(r.x)", ebb.float64, **x), [math.nan, 0])
    np.testing.assert_array_equal(evaluate("ebb.log(r.x)", ebb.float64, **x), [math.nan, -math.inf])
    np.testing.assert_array_equal(evaluate("ebb.asin(r.x * 2)", ebb.float64, **x), [math.nan, 0])
    np.testing.assert_array_equal(evaluate("1 / r.x", ebb.float64, **x), [-1, math.inf])
    np.testing.assert_array_equal(evaluate("r.x ** 0.5", ebb.float64, **x), [math.nan, 0])


def test_a_singular_matrix_has_no_finite_inverse(backend):
    out = evaluate("ebb.inverse(r.m)", ebb.mat2d, m=(ebb.mat2d, [[[1, 2], [2, 4]]]))
    assert not np.isfinite(out).any()


def test_the_normal_of_nothing_is_finite(backend):
    np.testing.assert_array_equal(evaluate("ebb.normalize(r.v)", ebb.vec3f, v=(ebb.vec3f, [[0, 0, 0]])), [[0, 0, 0]])


def test_a_step_of_zero_is_an_error(backend):
    rows = rows_with(n=(ebb.int32, [1, 0]), x=(ebb.int32, [0, 0]))
    with pytest.raises(ebb.EbbError) as caught:
        kernel_of("for i in range(0, 10, r.n):\n    r.x += 1", rows=rows)(rows)
    assert "E405" in caught.value.codes


def test_a_range_up_to_the_largest_integer_ends(backend):
    rows = rows_with(n=(ebb.int32, [2**31 - 1]), x=(ebb.int32, [0]))
    kernel_of("for i in range(r.n - 3, r.n, 2):\n    r.x += 1", rows=rows)(rows)
    assert rows.x.to_numpy()[0] == 2


# ---- print ----


def test_print_is_captured(backend, capfd):
    rows = rows_with(x=(ebb.float64, [0.5]), n=(ebb.int32, [7]), v=(ebb.vec3d, [[1, 2, 3]]), b=(ebb.bool_, [True]))

    @ebb.kernel
    def show(r: rows):
        print("x is", r.x, "and n is", r.n)
        print(f"n = {r.n}, x = {r.x:.3f}")
        print(r.b)
        print(r.v)

    show(rows)
    lines = capfd.readouterr().out.splitlines()
    assert lines[:3] == ["x is 0.5 and n is 7", "n = 7, x = 0.500", "True"]
    assert [float(part.strip(",")) for part in lines[3].strip("[]() ").split()] == [1, 2, 3]


def test_print_of_every_row(backend, capfd):
    for size in (s for s in sizes_for(backend) if s < 100):
        rows = rows_with(n=(ebb.int32, np.arange(size)))
        kernel_of("if r.n % 2 == 0:\n    print('row', r.n)", rows=rows)(rows)
        lines = capfd.readouterr().out.splitlines()
        assert sorted(lines) == sorted(f"row {n}" for n in range(0, size, 2))


def test_print_before_a_failure_comes_out(backend, capfd):
    rows = rows_with(n=(ebb.int32, [1]))
    kernel = kernel_of("print('before', r.n)\nassert r.n == 0", rows=rows)
    rejects(ebb.KernelAssertionError, "E401", lambda: kernel(rows))
    assert "before 1" in capfd.readouterr().out
