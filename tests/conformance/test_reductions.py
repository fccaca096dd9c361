"""Reductions into own rows, other rows and globals: all operators and types, whole and by component."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import LARGE, kernel_of, sizes_for

THREADS = (1, 2, 3, 7)


def graph(vertex_count, edge_count, seed=0):
    """Random edges between random vertices, with int weights, so that sums are exact."""
    generator = np.random.default_rng(seed)
    vertices = ebb.Relation("vertices", size=vertex_count)
    edges = ebb.Relation("edges", size=edge_count)
    ends = generator.integers(0, max(vertex_count, 1), (edge_count, 2))
    edges.new_field("tail", vertices, init=ends[:, 0])
    edges.new_field("head", vertices, init=ends[:, 1])
    weight = generator.integers(-50, 50, edge_count)
    edges.new_field("w", ebb.int32, init=weight)
    edges.new_field("x", ebb.float64, init=weight / 8)
    return vertices, edges, ends, weight


# ---- Into other rows ----


def test_scatter_to_both_ends_equals_the_query_loops(backend):
    for size in sizes_for(backend):
        vertices, edges, ends, weight = graph(max(size // 3, 1), size)
        for name in ("scattered", "gathered"):
            vertices.new_field(name, ebb.float64, init=0.0)
        edges.group_by("tail")
        edges.group_by("head")

        @ebb.kernel
        def scatter(e: edges):
            e.head.scattered += e.x
            e.tail.scattered -= 2 * e.x

        @ebb.kernel
        def gather(v: vertices):
            for e in ebb.where(edges.head, v):
                v.gathered += e.x
            for e in ebb.where(edges.tail, v):
                v.gathered -= 2 * e.x

        scatter(edges)
        gather(vertices)
        expected = np.zeros(vertices.size)
        np.add.at(expected, ends[:, 1], weight / 8)
        np.add.at(expected, ends[:, 0], -weight / 4)
        np.testing.assert_array_equal(vertices.scattered.to_numpy(), expected)
        np.testing.assert_array_equal(vertices.gathered.to_numpy(), expected)


#: operator: statement, NumPy function, types
OPERATORS = {
    "+": ("{place} += {value}", np.add, "iulwfd"),
    "-": ("{place} -= {value}", np.subtract, "iulwfd"),
    "*": ("{place} *= {value}", np.multiply, "iulwfd"),
    "min": ("{place} = min({place}, {value})", np.minimum, "iulwfd"),
    "max": ("{place} = max({place}, {value})", np.maximum, "iulwfd"),
    "&": ("{place} &= {value}", np.bitwise_and, "iulwb"),
    "|": ("{place} |= {value}", np.bitwise_or, "iulwb"),
    "^": ("{place} ^= {value}", np.bitwise_xor, "iulwb"),
}
SCALARS = {
    "i": ebb.int32,
    "l": ebb.int64,
    "u": ebb.uint32,
    "w": ebb.uint64,
    "f": ebb.float32,
    "d": ebb.float64,
    "b": ebb.bool_,
}
CASES = [(op, letter) for op, (_, _, letters) in OPERATORS.items() for letter in letters]


def values_of(scalar, shape, seed, op):
    generator = np.random.default_rng(seed)
    if scalar is ebb.bool_:
        return generator.integers(0, 2, shape).astype(bool)
    low, high = (1, 3) if op == "*" else (0 if scalar in (ebb.uint32, ebb.uint64) else -20, 20)
    return generator.integers(low, high, shape).astype(scalar.dtype)


@pytest.mark.parametrize(("op", "letter"), CASES)
def test_every_operator_and_scalar_type(backend, op, letter):
    """Own rows, other rows and a global, in one program of three kernels."""
    statement, function, _ = OPERATORS[op]
    scalar, n = SCALARS[letter], 130
    start, value = values_of(scalar, n, 1, op), values_of(scalar, n, 2, op)
    to = np.random.default_rng(3).integers(0, 20, n)
    rows, others = ebb.Relation("rows", size=n), ebb.Relation("others", size=20)
    rows.new_field("own", scalar, init=start)
    rows.new_field("value", scalar, init=value)
    rows.new_field("k", others, init=to)
    others.new_field("sum", scalar, init=start[:20])
    total = ebb.Global(scalar, start[0].item())
    for place in ("r.own", "r.k.sum", "total.value"):
        kernel_of(statement.format(place=place, value="r.value"), rows=rows, total=total)(rows)
    by_key, over_all = start[:20].copy(), start[0]
    with np.errstate(over="ignore"):
        function.at(by_key, to, value)
        for one in value:
            over_all = function(over_all, one)
        np.testing.assert_array_equal(rows.own.to_numpy(), function(start, value))
    np.testing.assert_array_equal(others.sum.to_numpy(), by_key)
    np.testing.assert_allclose(total.value, over_all, rtol=1e-5 if letter == "f" else 1e-12)


@pytest.mark.parametrize("op", OPERATORS)
@pytest.mark.parametrize("shaped", [ebb.vec3i, ebb.mat2x3i], ids=repr)
def test_every_operator_on_vectors_and_matrices(backend, op, shaped):
    statement, function, _ = OPERATORS[op]
    n = 70
    start = values_of(ebb.int32, (n, *shaped.shape), 1, op)
    value = values_of(ebb.int32, (n, *shaped.shape), 2, op)
    to = np.random.default_rng(3).integers(0, 9, n)
    rows, others = ebb.Relation("rows", size=n), ebb.Relation("others", size=9)
    rows.new_field("own", shaped, init=start)
    rows.new_field("value", shaped, init=value)
    rows.new_field("k", others, init=to)
    others.new_field("sum", shaped, init=start[:9])
    total = ebb.Global(shaped, start[0])
    for place in ("r.own", "r.k.sum", "total.value"):
        kernel_of(statement.format(place=place, value="r.value"), rows=rows, total=total)(rows)
    by_key, over_all = start[:9].copy(), start[0]
    function.at(by_key, to, value)
    with np.errstate(over="ignore"):
        for one in value:
            over_all = function(over_all, one)
    np.testing.assert_array_equal(rows.own.to_numpy(), function(start, value))
    np.testing.assert_array_equal(others.sum.to_numpy(), by_key)
    np.testing.assert_array_equal(total.value, over_all)


def test_reductions_by_component(backend):
    vertices, edges, ends, weight = graph(9, 65)
    vertices.new_field("v", ebb.vec3i, init=1)
    vertices.new_field("m", ebb.mat2i, init=0)

    @ebb.kernel
    def program(e: edges):
        e.head.v[0] += e.w
        e.head.v.z -= e.w
        for i in range(2):
            for j in range(2):
                e.tail.m[i, j] += (2 * i + j) * e.w

    program(edges)
    into_head = np.bincount(ends[:, 1], weight, 9)
    into_tail = np.bincount(ends[:, 0], weight, 9)
    np.testing.assert_array_equal(vertices.v.to_numpy(), np.stack([1 + into_head, np.ones(9), 1 - into_head], axis=1))
    np.testing.assert_array_equal(vertices.m.to_numpy(), into_tail[:, None, None] * np.array([[0, 1], [2, 3]]))


def test_reductions_by_a_component_that_differs_between_rows(backend):
    vertices, edges, ends, weight = graph(9, 65)
    vertices.new_field("count", ebb.vector(ebb.int32, 4), init=0)

    @ebb.kernel
    def histogram(e: edges):
        e.head.count[e.w % 4] += 1

    histogram(edges)
    expected = np.zeros((9, 4))
    np.add.at(expected, (ends[:, 1], weight % 4), 1)
    np.testing.assert_array_equal(vertices.count.to_numpy(), expected)


def test_assembly_of_a_stiffness_matrix_through_keys(backend):
    """``t.e[i, j].K += ...`` with loop indices, as finite elements assemble."""
    count, points = 12, 6
    generator = np.random.default_rng(5)
    v = np.stack([generator.permutation(points)[:4] for _ in range(count)])
    vertices = ebb.Relation("vertices", size=points)
    edges = ebb.Relation("edges", size=points * points)
    tets = ebb.Relation("tets", size=count)
    tets.new_field("v", ebb.vector(vertices, 4), init=v)
    tets.new_field("e", ebb.matrix(edges, 4, 4), init=v[:, :, None] * points + v[:, None, :])
    local = generator.integers(-9, 9, (count, 4, 4))
    tets.new_field("k", ebb.mat4d, init=local)
    edges.new_field("K", ebb.mat3d, init=0.0)
    edges.new_field("K_by_component", ebb.mat3d, init=0.0)
    vertices.new_field("lumped", ebb.vec3d, init=0.0)

    @ebb.kernel
    def assemble(t: tets):
        for i in range(4):
            t.v[i].lumped += [t.k[i, 0], t.k[i, 1], t.k[i, 2]]
            for j in range(4):
                t.e[i, j].K += t.k[i, j] * ebb.identity(3)
                for axis in range(3):
                    t.e[i][j].K_by_component[axis, axis] += t.k[i, j]

    assemble(tets)
    expected = np.zeros((points * points, 3, 3))
    for t in range(count):
        for i in range(4):
            for j in range(4):
                expected[v[t, i] * points + v[t, j]] += local[t, i, j] * np.eye(3)
    np.testing.assert_array_equal(edges.K.to_numpy(), expected)
    np.testing.assert_array_equal(edges.K_by_component.to_numpy(), expected)
    lumped = np.zeros((points, 3))
    np.add.at(lumped, v.ravel(), local[:, :, :3].reshape(-1, 3))
    np.testing.assert_array_equal(vertices.lumped.to_numpy(), lumped)


def test_a_reduction_through_a_chain_of_keys(backend):
    vertices, edges, ends, _weight = graph(9, 30)
    corners = ebb.Relation("corners", size=65)
    edge = np.arange(65) * 7 % 30
    corners.new_field("edge", edges, init=edge)
    vertices.new_field("n", ebb.int32, init=0)

    @ebb.kernel
    def count(c: corners):
        c.edge.head.n += 1

    count(corners)
    np.testing.assert_array_equal(vertices.n.to_numpy(), np.bincount(ends[edge, 1], minlength=9))


def test_a_reduction_in_branches_and_loops(backend):
    vertices, edges, ends, weight = graph(9, 65)
    vertices.new_field("n", ebb.int32, init=0)

    @ebb.kernel
    def program(e: edges):
        if e.w > 0:
            for _ in range(3):
                e.head.n += e.w
        elif e.w < -40:
            return
        else:
            e.tail.n -= 1

    program(edges)
    expected = np.zeros(9, int)
    np.add.at(expected, ends[weight > 0, 1], 3 * weight[weight > 0])
    rest = (weight <= 0) & (weight >= -40)
    np.add.at(expected, ends[rest, 0], -1)
    np.testing.assert_array_equal(vertices.n.to_numpy(), expected)


def test_two_fields_reduced_with_different_operators(backend):
    vertices, edges, ends, weight = graph(9, 65)
    vertices.new_field("low", ebb.int32, init=1000)
    vertices.new_field("sum", ebb.int32, init=0)
    vertices.new_field("high", ebb.vec2i, init=-1000)

    @ebb.kernel
    def program(e: edges):
        e.head.low = min(e.head.low, e.w)
        e.head.sum += e.w
        e.head.high = max([e.w, -e.w], e.head.high)

    program(edges)
    low, high = np.full(9, 1000), np.full((9, 2), -1000)
    np.minimum.at(low, ends[:, 1], weight)
    np.maximum.at(high, ends[:, 1], np.stack([weight, -weight], axis=1))
    np.testing.assert_array_equal(vertices.low.to_numpy(), low)
    np.testing.assert_array_equal(vertices.high.to_numpy(), high)
    np.testing.assert_array_equal(vertices.sum.to_numpy(), np.bincount(ends[:, 1], weight, 9))


def test_reductions_into_a_field_of_the_own_relation(backend):
    rows = ebb.Relation("rows", size=65)
    parent = np.arange(65) // 2
    rows.new_field("parent", rows, init=parent)
    rows.new_field("children", ebb.int32, init=0)

    @ebb.kernel
    def count(r: rows):
        r.parent.children += 1

    count(rows)
    np.testing.assert_array_equal(rows.children.to_numpy(), np.bincount(parent, minlength=65))


def test_a_grouped_relation_is_reduced_into_by_its_row_numbers(backend):
    """Grouping moves the storage of the edges; a reduction still finds the right row."""
    _vertices, edges, _ends, _weight = graph(9, 65)
    edges.new_field("hits", ebb.int32, init=0)
    edges.group_by("tail")
    pointers = ebb.Relation("pointers", size=65)
    target = np.random.default_rng(1).integers(0, 65, 65)
    pointers.new_field("edge", edges, init=target)

    @ebb.kernel
    def hit(p: pointers):
        p.edge.hits += 1

    hit(pointers)
    np.testing.assert_array_equal(edges.hits.to_numpy(), np.bincount(target, minlength=65))


# ---- Into globals ----


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


def test_a_million_rows_sum_exactly():
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
    for name, scalar in SCALARS.items():
        if name in "ilfd":
            rows.new_field(name, scalar, init=-np.arange(1, 66))
            others.new_field(name, scalar, init=-1000)
    rows.new_field("k", others, init=np.zeros(65, int))
    tops = {name: ebb.Global(SCALARS[name], -1000) for name in "ilfd"}
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


def bits_of_sums(threads):
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

    with ebb.backend("cpu", threads=threads):
        measure(rows)
    results = (double, single, vector, product, others.x, others.v)
    np.testing.assert_allclose(double.value, x.sum(), rtol=1e-9)
    return [np.asarray(result).tobytes() for result in results]


def test_float_sums_have_the_same_bits_for_any_number_of_threads():
    first, *others = [bits_of_sums(threads) for threads in THREADS]
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


def test_five_thousand_launches():
    rows = ebb.Relation("rows", size=10_000)
    rows.new_field("x", ebb.float64, init=0.5)
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def add(r: rows):
        total.value += r.x

    for _ in range(5000):
        add(rows)
    assert total.value == 5000 * 10_000 / 2
