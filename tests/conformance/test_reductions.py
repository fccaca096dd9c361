"""Reductions into own rows, other rows and globals: all operators and types, whole and by component."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import LARGE, graph, kernel_of, sizes_for

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


def values_of(scalar, shape, seed, op):
    generator = np.random.default_rng(seed)
    if scalar is ebb.bool_:
        return generator.integers(0, 2, shape).astype(bool)
    low, high = (1, 3) if op == "*" else (0 if scalar in (ebb.uint32, ebb.uint64) else -20, 20)
    return generator.integers(low, high, shape).astype(scalar.dtype)


def reduce_everywhere(op, types, rows_count=130, others_count=20):
    """Reduces values of ``types`` into own rows, other rows and globals, in one kernel; compares with NumPy."""
    statement, function, _ = OPERATORS[op]
    rows, others = ebb.Relation("rows", size=rows_count), ebb.Relation("others", size=others_count)
    to = np.random.default_rng(3).integers(0, others_count, rows_count)
    rows.new_field("k", others, init=to)
    totals, expected, body = {}, {}, []
    for number, shaped in enumerate(types):
        shape = (rows_count, *shaped.shape)
        start, value = (values_of(shaped.scalar, shape, seed + 2 * number, op) for seed in (1, 2))
        own, given, total = f"own{number}", f"value{number}", f"total{number}"
        rows.new_field(own, shaped, init=start)
        rows.new_field(given, shaped, init=value)
        others.new_field(own, shaped, init=start[:others_count])
        totals[total] = ebb.Global(shaped, start[0])
        for place in (f"r.{own}", f"r.k.{own}", f"{total}.value"):
            body.append(statement.format(place=place, value=f"r.{given}"))
        by_key, over_all = start[:others_count].copy(), start[0]
        with np.errstate(over="ignore"):
            function.at(by_key, to, value)
            for one in value:
                over_all = function(over_all, one)
            expected[number] = function(start, value), by_key, over_all
    kernel_of("\n".join(body), rows=rows, **totals)(rows)
    for number, shaped in enumerate(types):
        in_own, by_key, over_all = expected[number]
        np.testing.assert_array_equal(rows.fields[f"own{number}"].to_numpy(), in_own, err_msg=repr(shaped))
        np.testing.assert_array_equal(others.fields[f"own{number}"].to_numpy(), by_key, err_msg=repr(shaped))
        tolerance = 1e-5 if shaped.scalar == ebb.float32 else 1e-12
        np.testing.assert_allclose(totals[f"total{number}"].value, over_all, rtol=tolerance, err_msg=repr(shaped))


@pytest.mark.parametrize("op", OPERATORS)
def test_every_operator_on_every_scalar_type(backend, op):
    reduce_everywhere(op, [SCALARS[letter] for letter in OPERATORS[op][2]])


def many_values(random, scalar, op):
    """A value a row: so that a lost update shows, and floats come out exact in any order."""
    few, bits = random.random(LARGE) < 1e-4, 1 << random.integers(0, 8, LARGE)
    match op:
        case "&":
            values = ~few if scalar == ebb.bool_ else np.where(few, ~bits, -1)
        case "|":
            values = few if scalar == ebb.bool_ else np.where(few, bits, 0)
        case "*" if scalar.dtype.kind == "f":
            values = random.choice([-1, 1], LARGE)
        case _:
            values = random.integers(0, 2 if scalar == ebb.bool_ else 50, LARGE)
    return values.astype(scalar.dtype)


STARTS = {"*": 1, "min": 100, "&": -1}


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("op", OPERATORS)
def test_many_rows_reduce_into_few(compiled, op, count):
    """Updates that meet in one place: none may be lost, of numbers of any width."""
    random = np.random.default_rng(9)
    rows, others = ebb.Relation("rows", size=LARGE), ebb.Relation("others", size=count)
    to = random.integers(0, count, LARGE)
    rows.new_field("k", others, init=to)
    statement, function, letters = OPERATORS[op]
    expected, body = {}, []
    for letter in letters:
        values = many_values(random, SCALARS[letter], op)
        start = np.full(count, STARTS.get(op, 0)).astype(values.dtype)
        rows.new_field(letter, SCALARS[letter], init=values)
        others.new_field(letter, SCALARS[letter], init=start)
        body.append(statement.format(place=f"r.k.{letter}", value=f"r.{letter}"))
        with np.errstate(over="ignore"):
            function.at(start, to, values)
        expected[letter] = start
    kernel_of("\n".join(body), rows=rows)(rows)
    for letter, values in expected.items():
        np.testing.assert_array_equal(others.fields[letter].to_numpy(), values, err_msg=letter)


@pytest.mark.parametrize("op", OPERATORS)
def test_every_operator_on_vectors_and_matrices(backend, op):
    reduce_everywhere(op, [ebb.vec3i, ebb.mat2x3i], rows_count=70, others_count=9)


@pytest.mark.parametrize("op", ["+", "-", "*", "min", "max"])
def test_reductions_of_float_vectors_and_matrices(backend, op):
    reduce_everywhere(op, [ebb.vec3f, ebb.vec4d, ebb.mat3d, ebb.mat2f], rows_count=70, others_count=9)


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


def test_bools_of_a_group_are_cleared(backend):
    nodes = ebb.Relation("nodes", size=2)
    links = ebb.Relation("links", size=11)
    links.new_field("node", nodes, init=[0] * 5 + [1] * 6)
    links.new_field("on", ebb.bool_, init=True)
    links.group_by("node")

    @ebb.kernel
    def clear(n: nodes):
        for link in ebb.where(links.node, n):
            link.on &= False

    clear(nodes)
    assert not links.on.to_numpy().any()


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
