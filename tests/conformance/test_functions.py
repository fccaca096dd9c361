"""``@ebb.func``: typed by its arguments, inlined, with early returns, without recursion."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import define, kernel_of, rejects, rows_with


@ebb.func
def square(x):
    return x * x


@ebb.func
def lerp(a, b, t):
    return a + (b - a) * t


@ebb.func
def smoothstep(lo, hi, x):
    """A docstring is no statement that does nothing."""
    t = ebb.clamp((x - lo) / (hi - lo), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def test_one_func_with_two_type_signatures(backend):
    rows = rows_with(i=(ebb.int32, [3]), v=(ebb.vec3f, [[1, 2, 3]]), m=(ebb.mat2d, [[[1, 2], [3, 4]]]))

    @ebb.kernel
    def program(r: rows):
        r.i = square(r.i)
        r.v = square(r.v)
        r.m = square(r.m)

    program(rows)
    assert rows.i.to_numpy()[0] == 9
    np.testing.assert_array_equal(rows.v.to_numpy(), [[1, 4, 9]])
    np.testing.assert_array_equal(rows.m.to_numpy(), [[[1, 4], [9, 16]]])


def test_stacked_calls(backend):
    rows = rows_with(x=(ebb.float64, [1.5, 2.0]))

    @ebb.kernel
    def program(r: rows):
        r.x = square(square(square(r.x) + 1)) - lerp(square(r.x), 0, 0.5)

    program(rows)
    x = np.array([1.5, 2.0])
    np.testing.assert_allclose(rows.x.to_numpy(), (x * x + 1) ** 4 - x * x / 2)


def test_funcs_of_the_module_call_builtins(backend):
    rows = rows_with(x=(ebb.float32, [-1.0, 0.25, 0.5, 3.0]))

    @ebb.kernel
    def ramp(r: rows):
        r.x = smoothstep(0.0, 1.0, r.x)

    ramp(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [0, 0.15625, 0.5, 1])


def test_keyword_and_default_arguments(backend):
    @ebb.func
    def scaled(x, factor=2.0, offset=0.0):
        return x * factor + offset

    rows = rows_with(x=(ebb.float64, [1.0, 5.0]))

    @ebb.kernel
    def program(r: rows):
        r.x = scaled(r.x) + scaled(r.x, offset=100.0) + scaled(offset=1.0, x=r.x, factor=10.0)

    program(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [2 + 102 + 11, 10 + 110 + 51])


def test_early_returns(backend):
    @ebb.func
    def classify(x):
        if x < 0:
            return -1
        if x == 0:
            return 0
        return 1

    rows = rows_with(x=(ebb.float64, [-3, 0, 2]), out=(ebb.int32, [9, 9, 9]))
    kernel_of("r.out = classify(r.x)", rows=rows, classify=classify)(rows)
    np.testing.assert_array_equal(rows.out.to_numpy(), [-1, 0, 1])


def test_return_from_within_loops(backend):
    @ebb.func
    def first_divisor(n):
        for d in range(2, 1000):
            while n % d == 0:
                return d
        return n

    rows = rows_with(n=(ebb.int32, [2, 15, 49, 97]))
    kernel_of("r.n = first_divisor(r.n)", rows=rows, first_divisor=first_divisor)(rows)
    np.testing.assert_array_equal(rows.n.to_numpy(), [2, 3, 7, 97])


def test_a_func_without_a_value_does_its_effects(backend):
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.func
    def deposit(r, amount):
        if amount <= 0:
            return
        r.x += amount
        total.value += amount

    rows = rows_with(x=(ebb.float64, [1, 2, 3]))

    @ebb.kernel
    def program(r: rows):
        deposit(r, r.x - 1)

    program(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [1, 3, 5])
    assert total.value == 3


def test_a_func_takes_and_returns_keys(backend):
    vertices = ebb.Relation("vertices", size=3)
    edges = ebb.Relation("edges", size=2)
    vertices.new_field("x", ebb.float64, init=[5, 1, 3])
    edges.new_field("head", vertices, init=[0, 1])
    edges.new_field("tail", vertices, init=[2, 2])
    edges.new_field("low", ebb.float64)

    @ebb.func
    def lower_end(e):
        return e.head if e.head.x < e.tail.x else e.tail

    @ebb.kernel
    def program(e: edges):
        e.low = lower_end(e).x

    program(edges)
    np.testing.assert_array_equal(edges.low.to_numpy(), [3, 1])


def test_a_func_returns_a_tuple(backend):
    @ebb.func
    def minmax(a, b):
        return min(a, b), max(a, b)

    rows = rows_with(a=(ebb.float32, [1, 5]), b=(ebb.float32, [4, 2]))

    @ebb.kernel
    def sort(r: rows):
        lo, hi = minmax(r.a, r.b)
        r.a = lo
        r.b = hi

    sort(rows)
    np.testing.assert_array_equal(rows.a.to_numpy(), [1, 2])
    np.testing.assert_array_equal(rows.b.to_numpy(), [4, 5])


def test_a_func_has_its_own_names(backend):
    @ebb.func
    def f(x):
        y = x + 1
        x = y * 2
        return x

    rows = rows_with(x=(ebb.int32, [1]), y=(ebb.int32, [0]))

    @ebb.kernel
    def program(r: rows):
        y = 10
        x = f(y)
        r.x = x
        r.y = y

    program(rows)
    assert (rows.x.to_numpy()[0], rows.y.to_numpy()[0]) == (22, 10)


def test_a_func_captures_where_it_is_defined(backend):
    def make(scale):
        @ebb.func
        def scaled(x):
            return x * scale

        return scaled

    double, triple = make(2), make(3)
    rows = rows_with(x=(ebb.int32, [1, 2]))
    kernel_of("r.x = double(r.x) + 10 * triple(r.x)", rows=rows, double=double, triple=triple)(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [32, 64])


def test_a_func_takes_a_field_name(backend):
    @ebb.func
    def copy_field(c, dst, src):
        c[dst] = c[src]

    rows = rows_with(a=(ebb.float64, [1, 2]), b=(ebb.float64, [0, 0]), c=(ebb.float64, [0, 0]))

    @ebb.kernel
    def program(r: rows):
        copy_field(r, "b", "a")
        copy_field(r, "c", "b")

    program(rows)
    np.testing.assert_array_equal(rows.c.to_numpy(), [1, 2])


def test_a_func_takes_a_func(backend):
    @ebb.func
    def twice(f, x):
        return f(f(x))

    rows = rows_with(x=(ebb.int32, [2, 3]))
    kernel_of("r.x = twice(square, r.x)", rows=rows, twice=twice, square=square)(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [16, 81])


def test_annotations_of_parameters_convert_and_are_enforced(backend):
    @ebb.func
    def half(x: ebb.float64):
        return x / 2

    rows = rows_with(f=(ebb.float32, [3.0]), i=(ebb.int32, [3]), out=(ebb.float64, [0]), out2=(ebb.float64, [0]))

    @ebb.kernel
    def program(r: rows):
        r.out = half(r.f)
        r.out2 = half(r.i)

    program(rows)
    assert (rows.out.to_numpy()[0], rows.out2.to_numpy()[0]) == (1.5, 1.5)


@pytest.mark.parametrize("argument", ["r.d", "r.v", "r.p", "r", "1.5"])
def test_arguments_that_an_annotation_forbids(argument):
    @ebb.func
    def f(x: ebb.int32):
        return x

    rows = rows_with(d=(ebb.float64, [1]), v=(ebb.vec3i, [[1, 2, 3]]), p=(ebb.bool_, [True]))
    rejects(ebb.KernelTypeError, "E2", lambda: kernel_of(f"y = f({argument})", rows=rows, f=f)(rows))


def test_an_annotation_of_a_relation(backend):
    vertices = ebb.Relation("vertices", size=2)
    edges = ebb.Relation("edges", size=1)
    vertices.new_field("x", ebb.float64, init=[3, 4])
    edges.new_field("head", vertices, init=[1])
    edges.new_field("x", ebb.float64)

    @ebb.func
    def height(v: vertices):
        return v.x

    @ebb.kernel
    def right(e: edges):
        e.x = height(e.head)

    @ebb.kernel
    def wrong(e: edges):
        e.x = height(e)

    right(edges)
    assert edges.x.to_numpy()[0] == 4
    rejects(ebb.KernelTypeError, "E2", lambda: wrong(edges))


WRONG = {
    "a func that returns nothing used as a value": ("def f(x):\n    y = x", "y = f(r.x)"),
    "too few arguments": ("def f(x, y):\n    return x", "y = f(r.x)"),
    "too many arguments": ("def f(x):\n    return x", "y = f(r.x, r.x)"),
    "unknown keyword": ("def f(x):\n    return x", "y = f(r.x, z=1)"),
    "returns of two types": ("def f(x):\n    if x > 0:\n        return x\n    return True", "y = f(r.x)"),
    "a return missing on one path": ("def f(x):\n    if x > 0:\n        return x", "y = f(r.x)"),
    "its body does not fit this type": ("def f(x):\n    return x.z", "y = f(r.x)"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_calls(case):
    definition, body = WRONG[case]
    rows = rows_with(x=(ebb.float64, [1]))
    f = define(f"@ebb.func\n{definition}\n")["f"]
    rejects(ebb.KernelTypeError, "E", lambda: kernel_of(body, rows=rows, f=f)(rows))


def test_recursion_names_the_cycle():
    names = define("""
        @ebb.func
        def even(n):
            return odd(n - 1)

        @ebb.func
        def odd(n):
            return even(n - 1)
        """)
    rows = rows_with(x=(ebb.int32, [1]))
    kernel = kernel_of("r.x = even(r.x)", rows=rows, even=names["even"])
    error = rejects(ebb.KernelTypeError, "E", lambda: kernel(rows))
    assert "even" in str(error) and "odd" in str(error)


def test_a_plain_python_function_is_no_func():
    def plain(x):
        return x

    rows = rows_with(x=(ebb.float64, [1]))
    error = rejects(ebb.KernelTypeError, "E", lambda: kernel_of("r.x = plain(r.x)", rows=rows, plain=plain)(rows))
    assert "ebb.func" in str(error)
