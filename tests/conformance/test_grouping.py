"""``group_by`` and query loops, and keys that keep their meaning when storage moves."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import kernel_of, rejects, sizes_for


def star(edge_count, vertex_count=7, seed=0):
    """Edges in no order, with a value each that tells which row it is."""
    generator = np.random.default_rng(seed)
    vertices, edges = ebb.Relation("vertices", size=vertex_count), ebb.Relation("edges", size=edge_count)
    tail, head = generator.integers(0, vertex_count, (2, edge_count))
    edges.new_field("tail", vertices, init=tail)
    edges.new_field("head", vertices, init=head)
    edges.new_field("x", ebb.float64, init=np.arange(edge_count))
    vertices.new_field("y", ebb.float64, init=10.0 ** np.arange(vertex_count))
    vertices.new_field("out", ebb.float64, init=0.0)
    return vertices, edges, tail, head


def total_by(field, relation):
    """A kernel that adds the ``x`` of the rows of a group."""
    return kernel_of(
        "v.out = 0\nfor e in ebb.where(index, v):\n    v.out += e.x", "v: vertices", vertices=relation, index=field
    )


def test_query_loops_at_every_size(backend):
    for size in sizes_for(backend):
        vertices, edges, tail, _ = star(size)
        edges.group_by("tail")
        total_by(edges.tail, vertices)(vertices)
        np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, np.arange(size), 7))


def test_rows_with_no_match_loop_zero_times(backend):
    vertices, edges = ebb.Relation("vertices", size=5), ebb.Relation("edges", size=3)
    edges.new_field("tail", vertices, init=[3, 1, 3])
    edges.group_by("tail")
    vertices.new_field("n", ebb.int32, init=-1)

    @ebb.kernel
    def count(v: vertices):
        v.n = 0
        for _e in ebb.where(edges.tail, v):
            v.n += 1

    count(vertices)
    np.testing.assert_array_equal(vertices.n.to_numpy(), [0, 1, 0, 2, 0])


def test_a_query_projects(backend):
    vertices, edges, tail, head = star(30)
    edges.group_by("tail")

    @ebb.kernel
    def gather(v: vertices):
        for u in ebb.where(edges.tail, v).head:
            v.out += u.y

    gather(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, 10.0**head, 7))


def test_a_query_projects_by_a_name(backend):
    vertices, edges, tail, head = star(30)
    edges.group_by("tail")
    end = "head"

    @ebb.kernel
    def gather(v: vertices, value: str):
        for u in ebb.where(edges.tail, v)[end]:
            v.out += u[value]

    gather(vertices, "y")
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, 10.0**head, 7))


def test_a_query_of_another_row(backend):
    _vertices, edges, tail, head = star(30)
    edges.group_by("tail")
    edges.new_field("n", ebb.int32, init=0)

    @ebb.kernel
    def count(e: edges):
        for _f in ebb.where(edges.tail, e.head):
            e.n += 1

    count(edges)
    np.testing.assert_array_equal(edges.n.to_numpy(), np.bincount(tail, minlength=7)[head])


def test_nested_queries(backend):
    vertices, edges, tail, head = star(30)
    edges.group_by("tail")

    @ebb.kernel
    def two_steps(v: vertices):
        for e in ebb.where(edges.tail, v):
            for u in ebb.where(edges.tail, e.head).head:
                v.out += u.y

    two_steps(vertices)
    steps = np.zeros((7, 7))
    np.add.at(steps, (tail, head), 1)
    np.testing.assert_allclose(vertices.out.to_numpy(), steps @ steps @ 10.0 ** np.arange(7))


def test_break_and_continue_in_a_query(backend):
    vertices, edges = ebb.Relation("vertices", size=2), ebb.Relation("edges", size=8)
    edges.new_field("tail", vertices, init=[0, 1, 0, 1, 0, 1, 0, 1])
    edges.new_field("x", ebb.int32, init=np.arange(8))
    vertices.new_field("s", ebb.int32, init=0)
    edges.group_by("tail")

    @ebb.kernel
    def some(v: vertices):
        for e in ebb.where(edges.tail, v):
            if e.x < 2:
                continue
            if e.x > 5:
                break
            v.s += e.x

    some(vertices)
    np.testing.assert_array_equal(vertices.s.to_numpy(), [6, 8])


def test_a_group_comes_in_the_order_of_creation(backend):
    vertices, edges, tail, _ = star(40)
    edges.group_by("tail")
    vertices.new_field("last", ebb.int64, init=-1)
    vertices.new_field("ordered", ebb.bool_, init=True)

    @ebb.kernel
    def verify(v: vertices):
        last = ebb.int64(-1)
        for e in ebb.where(edges.tail, v):
            if ebb.id(e) <= last:
                v.ordered = False
            last = ebb.id(e)
        v.last = last

    verify(vertices)
    assert vertices.ordered.to_numpy().all()
    np.testing.assert_array_equal(
        vertices.last.to_numpy(), [max(np.flatnonzero(tail == v), default=-1) for v in range(7)]
    )


def test_a_matrix_of_small_groups(backend):
    """A query in a func, with a vector reduced inside."""
    vertices, edges, tail, head = star(30)
    vertices.new_field("pos", ebb.vec3d, init=np.arange(21.0).reshape(7, 3))
    vertices.new_field("laplacian", ebb.vec3d, init=0.0)
    edges.group_by("tail")

    @ebb.func
    def umbrella(v):
        s = ebb.zeros(ebb.vec3d)
        for e in ebb.where(edges.tail, v):
            s += e.head.pos - v.pos
        return s

    @ebb.kernel
    def smooth(v: vertices):
        v.laplacian = umbrella(v)

    smooth(vertices)
    expected = np.zeros((7, 3))
    pos = np.arange(21.0).reshape(7, 3)
    np.add.at(expected, tail, pos[head] - pos[tail])
    np.testing.assert_array_equal(vertices.laplacian.to_numpy(), expected)


# ---- Identity and storage ----


def test_grouping_does_not_change_what_a_program_sees(backend):
    _vertices, edges, tail, head = star(65)
    edges.new_field("number", ebb.int64)
    edges.group_by("tail")
    kernel_of("e.number = ebb.id(e)", "e: edges", edges=edges)(edges)
    np.testing.assert_array_equal(edges.number.to_numpy(), np.arange(65))
    np.testing.assert_array_equal(edges.tail.to_numpy(), tail)
    np.testing.assert_array_equal(edges.head.to_numpy(), head)
    np.testing.assert_array_equal(edges.x.to_numpy(), np.arange(65))
    edges.x.load(np.arange(65)[::-1])
    np.testing.assert_array_equal(edges.x.to_numpy(), np.arange(65)[::-1])
    edges.new_field("late", ebb.int32, init=lambda i: i)
    np.testing.assert_array_equal(edges.late.to_numpy(), np.arange(65))


def test_grouping_after_the_kernels_were_compiled(backend):
    _vertices, edges, _, head = star(65)
    edges.new_field("number", ebb.int64, init=0)
    edges.new_field("next", edges, init=(np.arange(65) * 7 + 3) % 65)
    edges.new_subset("some", np.arange(0, 65, 9))

    @ebb.kernel
    def program(e: edges):
        e.x = e.head.y + ebb.id(e.next)
        e.number += ebb.id(e)

    @ebb.kernel
    def mark(e: edges):
        e.number += 1000

    def run():
        program(edges)
        mark(edges.some)
        return edges.x.to_numpy()

    first = run()
    edges.group_by("tail")
    np.testing.assert_array_equal(run(), first)
    np.testing.assert_array_equal(first, 10.0**head + (np.arange(65) * 7 + 3) % 65)
    np.testing.assert_array_equal(edges.number.to_numpy(), 2 * np.arange(65) + 2000 * (np.arange(65) % 9 == 0))


def test_keys_of_others_into_a_sorted_relation_still_mean_the_same_rows(backend):
    _vertices, edges, _tail, _ = star(65)
    pointers = ebb.Relation("pointers", size=30)
    target = np.random.default_rng(5).integers(0, 65, 30)
    pointers.new_field("edge", edges, init=target)
    pointers.new_field("pair", ebb.vector(edges, 2), init=np.stack([target, 64 - target], axis=1))
    pointers.new_field("x", ebb.float64)
    edges.group_by("tail")

    @ebb.kernel
    def read(p: pointers):
        p.x = p.edge.x + 1000 * p.pair[1].x

    read(pointers)
    np.testing.assert_array_equal(pointers.x.to_numpy(), target + 1000 * (64 - target))
    np.testing.assert_array_equal(pointers.edge.to_numpy(), target)
    np.testing.assert_array_equal(pointers.pair.to_numpy()[:, 1], 64 - target)
    pointers.edge.load(target[::-1])
    read(pointers)
    np.testing.assert_array_equal(pointers.x.to_numpy(), target[::-1] + 1000 * (64 - target))


def test_a_relation_that_points_into_itself_is_grouped(backend):
    n = 33
    parent = np.maximum(np.arange(n) // 2 - 1, 0)[np.random.default_rng(1).permutation(n)]
    nodes = ebb.Relation("nodes", size=n)
    nodes.new_field("parent", nodes, init=parent)
    nodes.new_field("children", ebb.int32, init=0)
    nodes.new_field("sum", ebb.int64, init=0)
    nodes.group_by("parent")

    @ebb.kernel
    def count(v: nodes):
        for child in ebb.where(nodes.parent, v):
            v.children += 1
            v.sum += ebb.id(child)

    count(nodes)
    np.testing.assert_array_equal(nodes.parent.to_numpy(), parent)
    np.testing.assert_array_equal(nodes.children.to_numpy(), np.bincount(parent, minlength=n))
    np.testing.assert_array_equal(nodes.sum.to_numpy(), np.bincount(parent, np.arange(n), n))


def test_two_groupings_of_one_relation(backend):
    vertices, edges, tail, head = star(65)
    edges.group_by("tail")
    edges.group_by("head")

    @ebb.kernel
    def balance(v: vertices):
        for e in ebb.where(edges.tail, v):
            v.out += e.x
        for e in ebb.where(edges.head, v):
            v.out -= e.x

    balance(vertices)
    x = np.arange(65)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, x, 7) - np.bincount(head, x, 7))


def test_both_ends_of_a_chain_are_grouped(backend):
    """Sorting the vertices after the edges moves the groups of the edges too."""
    regions = ebb.Relation("regions", size=3)
    vertices, edges, tail, _ = star(65)
    region = np.array([2, 0, 1, 0, 2, 1, 0])
    vertices.new_field("region", regions, init=region)
    edges.group_by("tail")
    vertices.group_by("region")
    regions.new_field("total", ebb.float64, init=0.0)

    @ebb.kernel
    def collect(r: regions):
        for v in ebb.where(vertices.region, r):
            for e in ebb.where(edges.tail, v):
                r.total += e.x

    collect(regions)
    np.testing.assert_array_equal(regions.total.to_numpy(), np.bincount(region[tail], np.arange(65), 3))
    total_by(edges.tail, vertices)(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, np.arange(65), 7))


# ---- The index is always valid ----


def test_loading_the_grouped_field_makes_new_groups(backend):
    vertices, edges, _tail, head = star(65)
    edges.group_by("tail")
    total = total_by(edges.tail, vertices)
    total(vertices)
    edges.tail.load(head)
    total(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(head, np.arange(65), 7))
    np.testing.assert_array_equal(edges.x.to_numpy(), np.arange(65))
    np.testing.assert_array_equal(edges.tail.to_numpy(), head)


@pytest.mark.parametrize("groupings", [("tail",), ("head", "tail"), ("tail", "head")])
def test_writing_the_grouped_field_makes_new_groups(backend, groupings):
    vertices, edges, tail, head = star(65)
    for name in groupings:
        edges.group_by(name)

    @ebb.kernel
    def turn(e: edges):
        if e.x < 40:
            e.tail = e.head

    total = total_by(edges.tail, vertices)
    total(vertices)
    turn(edges)
    total(vertices)
    expected = np.where(np.arange(65) < 40, head, tail)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(expected, np.arange(65), 7))
    np.testing.assert_array_equal(edges.tail.to_numpy(), expected)
    np.testing.assert_array_equal(edges.x.to_numpy(), np.arange(65))


def test_swapping_and_copying_the_grouped_field_makes_new_groups(backend):
    vertices, edges, tail, head = star(65)
    edges.group_by("tail")
    total = total_by(edges.tail, vertices)
    total(vertices)
    edges.swap("tail", "head")
    total(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(head, np.arange(65), 7))
    edges.copy("head", "tail")
    total(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, np.arange(65), 7))


def test_unset_keys_are_in_no_group(backend):
    vertices, edges = ebb.Relation("vertices", size=2), ebb.Relation("edges", size=4)
    edges.new_field("tail", vertices)
    edges.new_field("x", ebb.float64, init=[1, 2, 4, 8])
    vertices.new_field("out", ebb.float64, init=-1.0)
    edges.new_field("other", vertices, init=[0, 1, 1, 0])
    edges.group_by("tail")
    total = total_by(edges.tail, vertices)
    total(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), [0, 0])

    @ebb.kernel
    def link_some(e: edges):
        if e.x > 1:
            e.tail = e.other

    link_some(edges)
    total(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), [8, 6])


def test_where_on_an_ungrouped_field_says_what_to_add():
    vertices, edges, _, _ = star(10)
    error = rejects(ebb.KernelTypeError, "E226", lambda: total_by(edges.head, vertices)(vertices))
    assert "group_by" in str(error)
    edges.group_by("head")
    total_by(edges.head, vertices)(vertices)


def test_a_kernel_that_failed_runs_once_the_field_is_grouped(backend):
    vertices, edges, tail, _ = star(10)
    total = total_by(edges.tail, vertices)
    rejects(ebb.KernelTypeError, "E226", lambda: total(vertices))
    edges.group_by("tail")
    total(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, np.arange(10), 7))


@pytest.mark.parametrize(
    "query", ["ebb.where(edges.x, v)", "ebb.where(v, edges.tail)", "ebb.where(edges.tail)", "ebb.where(edges.tail, 3)"]
)
def test_queries_that_are_none(query):
    vertices, edges, _, _ = star(10)
    edges.group_by("tail")
    kernel = kernel_of(f"for e in {query}:\n    v.out += 1", "v: vertices", vertices=vertices, edges=edges)
    rejects(ebb.KernelTypeError, "E2", lambda: kernel(vertices))


def test_a_query_is_no_value():
    vertices, edges, _, _ = star(10)
    edges.group_by("tail")
    for body in ("x = ebb.where(edges.tail, v) + 1", "v.out = ebb.where(edges.tail, v).x"):
        kernel = kernel_of(body, "v: vertices", vertices=vertices, edges=edges)
        rejects(ebb.KernelTypeError, "E", lambda: kernel(vertices))


def test_fields_that_cannot_be_grouped():
    vertices, edges, _, _ = star(10)
    edges.new_field("both", ebb.vector(vertices, 2), init=0)
    rejects(ebb.RelationError, "E511", lambda: edges.group_by("x"))
    rejects(ebb.RelationError, "E511", lambda: edges.group_by("both"))
    rejects(ebb.RelationError, "E503", lambda: edges.group_by("tial"))
