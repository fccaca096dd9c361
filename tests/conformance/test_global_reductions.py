"""Reductions into globals, and bits that do not depend on the number of threads."""

from __future__ import annotations

import numpy as np

import ebb
from backends import require

from .harness import LARGE, graph, kernel_of, sizes_for

THREADS = (1, 2, 3, 7)
SIGNED = {"i": ebb.int32, "l": ebb.int64, "f": ebb.float32, "d": ebb.float64}


def test_global_sums_at_every_size(backend):
    for size in sizes_for(backend):
        rows = ebb.Relation("rows", size=size)
        x = np.arange(size) % 97 - 48
        rows.new_field("x", ebb.int64, init=x)
        total, low, high = ebb.Global(ebb.int64, 5), ebb.Global(ebb.int64, 1000), ebb.Global(ebb.int64, -1000)

        @ebb.kernel
        def measure(r: rows):
            total.value += r.x
            low.value = min(low.value, r.x)
            high.value = max(r.x, high.value)

        measure(rows)
        assert total.value == 5 + x.sum()
        assert (low.value, high.value) == ((x.min(), x.max()) if size else (1000, -1000))


def test_a_million_rows_sum_exactly(compiled):
    rows = ebb.Relation("rows", size=1_000_000)
    rows.new_field("x", ebb.int32, init=np.arange(1_000_000))
    small, large = ebb.Global(ebb.int32, 0), ebb.Global(ebb.int64, 0)

    @ebb.kernel
    def add(r: rows):
        small.value += r.x % 1000
        large.value += r.x

    add(rows)
    assert small.value == 999 * 500 * 1000
    assert large.value == 999_999 * 500_000


def test_vector_and_matrix_globals(backend):
    n = 65
    x = np.random.default_rng(0).integers(-9, 9, (n, 3))
    rows = ebb.Relation("rows", size=n)
    rows.new_field("x", ebb.vec3d, init=x)
    momentum = ebb.Global(ebb.vec3d, 0.0)
    inertia = ebb.Global(ebb.mat3d, np.zeros((3, 3)))
    low = ebb.Global(ebb.vec3d, np.inf)

    @ebb.kernel
    def measure(r: rows):
        momentum.value += r.x
        inertia.value += ebb.outer(r.x, r.x)
        low.value = min(low.value, r.x)

    measure(rows)
    np.testing.assert_array_equal(momentum.value, x.sum(axis=0))
    np.testing.assert_array_equal(inertia.value, x.T @ x)
    np.testing.assert_array_equal(low.value, x.min(axis=0))


def test_extrema_of_a_component_with_and_without_value(backend):
    rows = ebb.Relation("rows", size=5)
    rows.new_field("x", ebb.float64, init=[3, -1, 4, -1, 5])
    low = ebb.Global(ebb.vec3d, 0.0)

    @ebb.kernel
    def measure(r: rows):
        low.value[0] = min(low[0], r.x)
        low.y = min(-r.x, low.value.y)
        low[2] = min(low.value[2], 2 * r.x)

    measure(rows)
    np.testing.assert_array_equal(low.value, [-1, -5, -2])


def test_bool_globals(backend):
    rows = ebb.Relation("rows", size=65)
    rows.new_field("x", ebb.int32, init=np.arange(65))
    every, some, none = ebb.Global(ebb.bool_, True), ebb.Global(ebb.bool_, False), ebb.Global(ebb.bool_, False)

    @ebb.kernel
    def test(r: rows):
        every.value &= r.x >= 0
        some.value |= r.x == 64
        none.value |= r.x > 64

    test(rows)
    assert (every.value, some.value, none.value) == (True, True, False)


def test_all_negative_data_and_identities(backend):
    """An identity of 0 for min or max would show here."""
    rows = ebb.Relation("rows", size=65)
    others = ebb.Relation("others", size=2)
    for name, scalar in SIGNED.items():
        rows.new_field(name, scalar, init=-np.arange(1, 66))
        others.new_field(name, scalar, init=-1000)
    rows.new_field("k", others, init=np.zeros(65, int))
    tops = {name: ebb.Global(scalar, -1000) for name, scalar in SIGNED.items()}
    body = [f"{name}_top.value = max({name}_top.value, r.{name})" for name in tops]
    body += [f"r.k.{name} = max(r.k.{name}, r.{name})" for name in tops]
    kernel_of("\n".join(body), rows=rows, **{f"{name}_top": top for name, top in tops.items()})(rows)
    for name, top in tops.items():
        assert top.value == -1
        np.testing.assert_array_equal(others.fields[name].to_numpy(), [-1, -1000])


def test_all_positive_data_has_a_positive_minimum(backend):
    rows = ebb.Relation("rows", size=65)
    rows.new_field("u", ebb.uint32, init=np.arange(2**31, 2**31 + 65))
    rows.new_field("x", ebb.float32, init=np.arange(7, 72))
    low_u, low_x = ebb.Global(ebb.uint32, 2**32 - 1), ebb.Global(ebb.float32, np.inf)

    @ebb.kernel
    def measure(r: rows):
        low_u.value = min(low_u.value, r.u)
        low_x.value = min(low_x.value, r.x)

    measure(rows)
    assert (low_u.value, low_x.value) == (2**31, 7)


def test_nan_propagates_through_every_reduction(backend):
    n = 130
    x = np.arange(n, dtype=float)
    x[[7, 100]] = np.nan
    rows, others = ebb.Relation("rows", size=n), ebb.Relation("others", size=10)
    rows.new_field("x", ebb.float64, init=x)
    rows.new_field("k", others, init=np.arange(n) % 10)
    others.new_field("low", ebb.float64, init=1e9)
    others.new_field("high", ebb.float64, init=-1e9)
    low, high, total = ebb.Global(ebb.float64, 1e9), ebb.Global(ebb.float64, -1e9), ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def measure(r: rows):
        low.value = min(low.value, r.x)
        high.value = max(high.value, r.x)
        total.value += r.x
        r.k.low = min(r.k.low, r.x)
        r.k.high = max(r.k.high, r.x)

    measure(rows)
    assert np.isnan([low.value, high.value, total.value]).all()
    by_key = x.reshape(13, 10)
    np.testing.assert_array_equal(others.low.to_numpy(), np.minimum.reduce(by_key))
    np.testing.assert_array_equal(others.high.to_numpy(), np.maximum.reduce(by_key))


def test_a_global_keeps_what_it_held(backend):
    rows = ebb.Relation("rows", size=10)
    total = ebb.Global(ebb.float32, 100.0)

    @ebb.kernel
    def add(r: rows):
        total.value += 1

    add(rows)
    add(rows)
    assert total.value == 120
    total.value = 0
    add(rows)
    assert total.value == 10


# ---- Bits that do not depend on the threads ----


def bits_of_sums(backend, **options):
    """Sums of floats of very different sizes, into globals and through keys, as bytes."""
    generator = np.random.default_rng(11)
    rows, others = ebb.Relation("rows", size=LARGE), ebb.Relation("others", size=501)
    x = generator.standard_normal(LARGE) * 10.0 ** generator.integers(-6, 6, LARGE)
    rows.new_field("x", ebb.float64, init=x)
    rows.new_field("s", ebb.float32, init=x)
    rows.new_field("v", ebb.vec3f, init=np.stack([x, -2 * x, x * x], axis=1))
    rows.new_field("k", others, init=generator.integers(0, 501, LARGE))
    others.new_field("x", ebb.float64, init=0.0)
    others.new_field("v", ebb.vec3f, init=0.0)
    double, single, vector = ebb.Global(ebb.float64, 0), ebb.Global(ebb.float32, 0), ebb.Global(ebb.vec3f, 0)
    product = ebb.Global(ebb.float64, 1)

    @ebb.kernel
    def measure(r: rows):
        double.value += r.x
        single.value += r.s
        vector.value += r.v
        product.value *= 1 + 1e-9 * r.x
        r.k.x += r.x
        r.k.v += r.v

    with ebb.backend(backend, **options):
        measure(rows)
    results = (double, single, vector, product, others.x, others.v)
    np.testing.assert_allclose(double.value, x.sum(), rtol=1e-9)
    return [np.asarray(result).tobytes() for result in results]


def test_float_sums_have_the_same_bits_for_any_number_of_threads():
    first, *others = [bits_of_sums("cpu", threads=threads) for threads in THREADS]
    for other in others:
        assert other == first


def test_deterministic_float_sums_have_the_same_bits_each_time():
    require("opencl")
    first, *others = [bits_of_sums("opencl", deterministic=True) for _ in range(4)]
    for other in others:
        assert other == first


def test_float_sums_into_globals_have_the_same_bits_each_time():
    require("opencl")
    first, *others = [bits_of_sums("opencl")[:4] for _ in range(4)]
    for other in others:
        assert other == first


def test_float_sums_have_the_same_bits_on_a_grouped_relation_for_any_number_of_threads():
    def bits(threads):
        vertices, edges, _, _ = graph(1000, 20_011, seed=4)
        edges.x.load(np.random.default_rng(8).standard_normal(edges.size))
        edges.group_by("tail")
        vertices.new_field("sum", ebb.float64, init=0.0)
        total = ebb.Global(ebb.float64, 0.0)

        @ebb.kernel
        def scatter(e: edges):
            e.head.sum += e.x
            e.tail.sum += e.x
            total.value += e.x

        with ebb.backend("cpu", threads=threads):
            scatter(edges)
        return vertices.sum.to_numpy().tobytes(), total.value

    assert len({bits(threads) for threads in THREADS}) == 1


def test_five_thousand_launches(compiled):
    rows = ebb.Relation("rows", size=10_000)
    rows.new_field("x", ebb.float64, init=0.5)
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def add(r: rows):
        total.value += r.x

    for _ in range(5000):
        add(rows)
    assert total.value == 5000 * 10_000 / 2
