"""Relations that are permuted for locality: by themselves at the first launches, or when asked; nobody can tell."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from backends import require

from .harness import kernel_of, rejects

SIDE = 256


def lattice(side=SIDE, seed=1, *, grouped=True, shuffle=True, directed=True, **options):
    """The vertices of a square lattice, numbered at random, and its edges, in both directions if ``directed``."""
    generator = np.random.default_rng(seed)
    number = (generator.permutation(side * side) if shuffle else np.arange(side * side)).reshape(side, side)
    pairs = np.concatenate(
        [
            np.stack((number[1:].ravel(), number[:-1].ravel())),
            np.stack((number[:, 1:].ravel(), number[:, :-1].ravel())),
        ],
        axis=1,
    )
    if directed:
        pairs = np.concatenate((pairs, pairs[::-1]), axis=1)
    pairs = pairs[:, generator.permutation(pairs.shape[1])]
    vertices = ebb.Relation("vertices", size=side * side, **options)
    edges = ebb.Relation("edges", size=pairs.shape[1])
    edges.new_field("tail", vertices, init=pairs[0])
    edges.new_field("head", vertices, init=pairs[1])
    edges.new_field("length", ebb.float32, init=generator.random(pairs.shape[1]))
    vertices.new_field("q", ebb.vec3f, init=generator.random((vertices.size, 3)))
    vertices.new_field("force", ebb.vec3f, init=0.0)
    if grouped:
        edges.group_by("tail")
    return vertices, edges


def gathering(vertices, edges):
    return kernel_of(
        """
        for e in ebb.where(edges.tail, v):
            dq = e.head.q - v.q
            v.force += e.length * ebb.normalize(dq) - dq
        """,
        "v: vertices",
        vertices=vertices,
        edges=edges,
    )


def along(vertices, edges):
    """A kernel on edges that reaches vertices by both ends."""
    return kernel_of("e.length = ebb.length(e.head.q - e.tail.q)", "e: edges", vertices=vertices, edges=edges)


def launched(kernel, rows, times=4):
    for _ in range(times):
        kernel(rows)


def is_permuted(*relations):
    return [relation.storage.order is not None for relation in relations]


def values(*relations):
    return [field.to_numpy() for relation in relations for field in relation.fields.values()]


def assert_same(found, expected):
    for left, right in zip(found, expected, strict=True):
        np.testing.assert_array_equal(left, right)


def assert_near(found, expected):
    """Equal but for the order in which floats were added."""
    for left, right in zip(found, expected, strict=True):
        np.testing.assert_allclose(left, right, rtol=1e-5, atol=1e-5)


# ---- When it is done ----


def test_a_shuffled_mesh_is_permuted_at_the_third_launch():
    with ebb.backend("cpu"):
        vertices, edges = lattice()
        gather = gathering(vertices, edges)
        launched(gather, vertices, 2)
        assert is_permuted(vertices) == [False]
        gather(vertices)
        assert is_permuted(vertices) == [True]
        version = vertices.storage.version
        launched(gather, vertices, 10)
        assert vertices.storage.version == version == 1
        assert edges.tail.grouping.rows is None
        distances = np.abs(edges.tail.data - edges.head.data)
        assert distances.max() <= 1.2 * SIDE


@pytest.mark.parametrize("how", ["backend", "relation", "natural", "viewed", "edges viewed", "small", "part"])
def test_rows_stay_where_they_are(how):
    side = 40 if how == "small" else SIDE
    with ebb.backend("cpu", reorder=how != "backend"):
        options = {"reorder": False} if how == "relation" else {}
        vertices, edges = lattice(side, shuffle=how != "natural", **options)
        if how == "viewed":
            vertices.q.view()
        if how == "edges viewed":
            edges.length.view()
        rows = vertices.new_subset("part", np.arange(100)) if how == "part" else vertices
        launched(gathering(vertices, edges), rows, 12)
        assert is_permuted(vertices) == [False]


def test_what_a_view_of_keys_shows_stays():
    with ebb.backend("cpu"):
        vertices, edges = lattice(grouped=False)
        tails = edges.tail.view()
        launched(along(vertices, edges), edges, 6)
        np.testing.assert_array_equal(vertices.q.view()[tails], vertices.q.to_numpy()[edges.tail.to_numpy()])


def test_the_reference_permutes_nothing_by_itself():
    vertices, edges = lattice()
    few = vertices.new_subset("few", [0])
    with ebb.backend("reference"):
        launched(gathering(vertices, edges), few)
    assert is_permuted(vertices) == [False]


def test_keys_that_change_each_step_are_left_alone():
    with ebb.backend("cpu"):
        vertices, edges = lattice(grouped=False)
        measure, ends = along(vertices, edges), edges.head.to_numpy()
        turn = kernel_of("e.tail, e.head = e.head, e.tail", "e: edges", edges=edges)
        for _ in range(8):
            measure(edges)
            turn(edges)
        assert is_permuted(vertices, edges) == [False, False]
        launched(measure, edges, 30)
        assert is_permuted(vertices, edges) == [False, False]
        np.testing.assert_array_equal(edges.head.to_numpy(), ends)


def test_keys_that_have_changed_once_are_looked_at():
    with ebb.backend("cpu"):
        vertices, edges = lattice(grouped=False)
        measure = along(vertices, edges)
        measure(edges)
        kernel_of("e.tail, e.head = e.head, e.tail", "e: edges", edges=edges)(edges)
        launched(measure, edges, 4)
        assert is_permuted(vertices, edges) == [False, False]
        launched(measure, edges, 4)
        assert is_permuted(vertices, edges) == [True, True]


def test_keys_that_are_loaded_later_are_looked_at_again():
    with ebb.backend("cpu"):
        vertices, edges = lattice(shuffle=False)
        gather = gathering(vertices, edges)
        launched(gather, vertices, 20)
        assert is_permuted(vertices) == [False]
        _, others = lattice(seed=5)
        edges.tail.load(others.tail.to_numpy())
        edges.head.load(others.head.to_numpy())
        launched(gather, vertices, 20)
        assert is_permuted(vertices) == [True]


# ---- Which relation moves ----


def test_rows_are_sorted_by_their_keys_where_that_is_enough():
    with ebb.backend("cpu"):
        vertices, edges = lattice(grouped=False, shuffle=False, directed=False)
        launched(along(vertices, edges), edges)
        assert is_permuted(vertices, edges) == [False, True]
        least = np.minimum(edges.tail.data, edges.head.data)
        assert (np.diff(least) >= 0).all()


def test_rows_are_sorted_by_keys_into_a_grid():
    with ebb.backend("cpu"):
        cells = ebb.Relation("cells", shape=(300, 300))
        cells.new_field("v", ebb.vec2d, init=1.5)
        particles = ebb.Relation("particles", size=200_000)
        found = np.random.default_rng(3).integers(0, 300, (200_000, 2))
        particles.new_field("cell", cells, init=found)
        particles.new_field("v", ebb.vec2d, init=0.0)
        launched(kernel_of("p.v += p.cell.v", "p: particles", particles=particles), particles)
        assert is_permuted(cells, particles) == [False, True]
        assert (np.diff(particles.cell.data) >= 0).all()
        np.testing.assert_array_equal(particles.cell.to_numpy(), found)
        np.testing.assert_array_equal(particles.v.to_numpy(), np.full((200_000, 2), 6.0))


def test_what_decides_the_order_of_a_grouped_relation_is_permuted():
    with ebb.backend("cpu"):
        vertices, edges = lattice()
        pairs = ebb.Relation("pairs", size=edges.size)
        pairs.new_field("e", edges, init=np.argsort(edges.tail.to_numpy(), kind="stable"))
        pairs.new_field("x", ebb.float32)
        before = pairs.e.to_numpy()
        launched(kernel_of("p.x += p.e.head.q[0]", "p: pairs", pairs=pairs), pairs, 6)
        assert is_permuted(vertices) == [True]
        np.testing.assert_array_equal(pairs.e.to_numpy(), before)
        np.testing.assert_allclose(
            pairs.x.to_numpy(), 6 * vertices.q.to_numpy()[edges.head.to_numpy()[before], 0], 1e-5
        )


def test_rows_are_put_into_the_order_in_which_they_are_reached():
    with ebb.backend("cpu"):
        corners, cells = ebb.Relation("corners", size=200_000), ebb.Relation("cells", size=100_000)
        owner = ebb.Relation("owner", size=50_000)
        corners.new_field("owner", owner, init=np.repeat(np.arange(50_000), 4))
        corners.group_by("owner")
        corners.new_field("cell", cells, init=np.random.default_rng(0).permutation(100_000).repeat(2))
        cells.new_field("x", ebb.float32, init=np.arange(100_000))
        owner.new_field("x", ebb.float32)
        body = "r.x = 0\nfor c in ebb.where(corners.owner, r):\n    r.x += c.cell.x"
        launched(kernel_of(body, "r: owner", owner=owner, corners=corners), owner)
        assert is_permuted(owner, corners, cells) == [False, False, True]
        assert corners.cell.data.tolist() == np.arange(100_000).repeat(2).tolist()
        expected = corners.cell.to_numpy().astype(np.float32).reshape(-1, 4).sum(axis=1)
        np.testing.assert_array_equal(owner.x.to_numpy(), expected)


def test_what_refers_to_a_permuted_relation_follows_it():
    with ebb.backend("cpu"):
        vertices, edges = lattice()
        marks = ebb.Relation("marks", size=2 * vertices.size)
        marks.new_field("at", ebb.vector(vertices, 2), init=np.arange(2 * vertices.size).repeat(2).reshape(-1, 2) // 2)
        labels = ebb.Relation("labels", size=marks.size)
        labels.new_field("mark", marks, init=np.arange(marks.size)[::-1])
        of_edges = ebb.Relation("of_edges", size=edges.size)
        of_edges.new_field("edge", edges, init=np.arange(edges.size))
        loops = ebb.Relation("loops", size=3)
        loops.new_field("self", loops, init=[1, 2, 0])
        before = values(vertices, edges, marks, labels, of_edges, loops)
        launched(gathering(vertices, edges), vertices)
        vertices.force.fill(0)
        for relation, key in ((marks, "at"), (labels, "mark"), (of_edges, "edge")):
            keys = relation.fields[key].data.reshape(relation.size, -1)
            assert (np.diff(keys.min(axis=1)) >= 0).all(), relation.name
            assert "to follow" in relation.storage.reason
        assert is_permuted(loops) == [False]
        assert_same(values(vertices, edges, marks, labels, of_edges, loops), before)


# ---- Results ----


def results(backend, reorder, **options):
    """All values of a program after five steps: queries, members, numbers of rows, random numbers, a subset."""
    with ebb.backend(backend, reorder=reorder is True, **options):
        vertices, edges = lattice()
        vertices.new_field("n", ebb.int64)
        vertices.new_field("r", ebb.float64)
        edges.new_field("opposite", edges, init=np.arange(edges.size)[::-1])
        border = vertices.new_subset("border", np.arange(0, vertices.size, 3))
        count = ebb.Global(ebb.int64, 0)

        @vertices.member
        def edges_of(v):
            return ebb.where(edges.tail, v)

        @ebb.kernel
        def step(v: vertices):
            for e in v.edges_of:
                v.force += e.length * ebb.normalize(e.head.q - v.q) * e.opposite.length
                v.n += ebb.id(e.head) * ebb.id(e)
            v.r = ebb.rand(ebb.float64)
            count.value += ebb.int64(v.r * 100)

        @ebb.kernel
        def mark(v: vertices):
            v.n = -ebb.id(v)

        ebb.seed(4)
        for index in range(5):
            if reorder == "asked" and index == 1:
                vertices.reorder()
            step(vertices)
        mark(border)
        assert is_permuted(vertices) == [reorder is not False]
        return [*values(vertices, edges), count.value]


@pytest.fixture(scope="module")
def as_created():
    return results("cpu", reorder=False, threads=1)


@pytest.mark.parametrize(("threads", "reorder"), [(1, True), (2, True), (3, True), (7, True), (2, "asked"), (3, False)])
def test_results_are_the_same_bits_in_any_order(as_created, threads, reorder):
    assert_same(results("cpu", reorder, threads=threads), as_created)


def test_results_on_opencl_are_the_same_bits_in_any_order():
    require("opencl")
    expected = results("opencl", reorder=False)
    for reorder in (True, "asked"):
        assert_same(results("opencl", reorder), expected)


def scattered(backend, reorder, **options):
    """What edges add to both of their ends, in four launches, before and after the rows have moved."""
    with ebb.backend(backend, reorder=reorder, **options):
        vertices, edges = lattice(grouped=False)
        vertices.new_field("n", ebb.int32)
        scatter = kernel_of(
            """
            dq = e.head.q - e.tail.q
            e.head.force -= e.length * dq
            e.tail.force += e.length * dq
            e.tail.n += 1
            e.head.n += 2
            """,
            "e: edges",
            edges=edges,
        )
        launched(scatter, edges)
        assert is_permuted(vertices, edges) == [reorder, reorder]
        return values(vertices)


def test_scattered_sums_are_the_same_bits_for_any_number_of_threads():
    one = scattered("cpu", reorder=True, threads=1)
    for threads in (2, 3, 7):
        assert_same(scattered("cpu", reorder=True, threads=threads), one)
    assert_near(one, scattered("cpu", reorder=False, threads=2))


def test_scattered_sums_on_opencl():
    require("opencl")
    one = scattered("opencl", reorder=True, deterministic=True)
    assert_same(scattered("opencl", reorder=True, deterministic=True), one)
    for options in ({"reorder": True}, {"reorder": False}, {"reorder": False, "deterministic": True}):
        assert_near(scattered("opencl", **options), one)


# ---- When it is asked for ----


def small(backend_seed=0):
    generator = np.random.default_rng(backend_seed)
    vertices, edges = ebb.Relation("vertices", size=40), ebb.Relation("edges", size=90)
    ends = np.ma.masked_less(generator.integers(-1, 40, (2, 90)), 0)
    edges.new_field("tail", vertices, init=ends[0])
    edges.new_field("head", vertices, init=ends[1])
    edges.new_field("x", ebb.float64, init=np.arange(90))
    vertices.new_field("next", vertices, init=np.roll(np.arange(40), 7))
    vertices.new_field("out", ebb.float64, init=-1)
    return vertices, edges


@pytest.mark.parametrize("first", ["vertices", "edges", "grouped edges"])
def test_reordering_keeps_all_values_and_groups(backend, first):
    vertices, edges = small()
    if first == "grouped edges":
        edges.group_by("tail")
    before = values(vertices, edges)
    (vertices if first == "vertices" else edges).reorder()
    assert is_permuted(vertices, edges) == [first != "edges", True]
    assert_same(values(vertices, edges), before)
    if first != "grouped edges":
        edges.group_by("tail")
    edges.group_by("head")
    total = kernel_of(
        "v.out = 0\nfor e in ebb.where(edges.head, v):\n    v.out = 2 * v.out + e.x\nv.out += ebb.id(v.next)",
        "v: vertices",
        vertices=vertices,
        edges=edges,
    )
    total(vertices)
    expected = np.zeros(40)
    for edge, head in enumerate(edges.head.to_numpy()):
        if head >= 0:
            expected[head] = 2 * expected[head] + edge
    np.testing.assert_array_equal(vertices.out.to_numpy(), expected + vertices.next.to_numpy())


def test_reordering_follows_what_is_loaded_later(backend):
    vertices, edges = small()
    vertices.reorder()
    edges.head.load(np.arange(90) % 40)
    copied = kernel_of("e.x = ebb.id(e.head)", "e: edges", edges=edges)
    copied(edges)
    np.testing.assert_array_equal(edges.x.to_numpy(), np.arange(90) % 40)


def test_a_relation_without_keys_is_put_into_the_order_in_which_it_is_referred_to():
    vertices, colours = ebb.Relation("vertices", size=5), ebb.Relation("colours", size=4)
    vertices.new_field("colour", colours, init=[3, 1, 3, 0, 1])
    colours.new_field("x", ebb.int32, init=[10, 11, 12, 13])
    colours.reorder()
    assert colours.storage.order.tolist() == [3, 1, 0, 2]
    assert colours.x.to_numpy().tolist() == [10, 11, 12, 13]
    assert vertices.colour.to_numpy().tolist() == [3, 1, 3, 0, 1]


@pytest.mark.parametrize("size", [0, 1, 3])
def test_nothing_to_order_by_is_no_error(size):
    rows = ebb.Relation("rows", size=size)
    rows.new_field("x", ebb.float64, init=np.arange(size))
    rows.reorder()
    rows.new_field("key", rows)
    rows.reorder()
    cells = ebb.Relation("cells", shape=(2, 2))
    rows.new_field("cell", cells, init=np.zeros((size, 2), dtype=int))
    rows.group_by("cell")
    rows.reorder()
    assert rows.x.to_numpy().tolist() == list(range(size))


def test_an_open_view_of_what_must_move_stops_it():
    vertices, edges = small()
    edges.group_by("tail")
    before = is_permuted(vertices, edges), vertices.storage.version, edges.storage.version
    for field in (vertices.out, edges.x):
        with field.view(write=True):
            rejects(ebb.RelationError, "E512", vertices.reorder)
    assert (is_permuted(vertices, edges), vertices.storage.version, edges.storage.version) == before
    vertices.reorder()


def test_an_open_view_of_what_need_not_move_does_not():
    vertices, edges = small()
    with edges.x.view(write=True) as array:
        vertices.reorder()
        array[0] = 7
    assert is_permuted(vertices, edges) == [True, False]
    assert edges.x.to_numpy()[0] == 7


def test_explain_says_why_rows_lie_where_they_do(capsys):
    with ebb.backend("cpu"):
        vertices, edges = lattice()
        gather = gathering(vertices, edges)
        launched(gather, vertices)
        text = gather.explain(vertices)
        assert "vertices: rows stored permuted, for locality: 32," in text
        assert "edges: rows stored permuted; grouped by edges.tail" in text
        vertices.reorder()
        assert "vertices: rows stored for locality, as asked" in gather.explain(vertices)


# ---- Captured steps ----


def test_a_captured_step_is_ordered_before_it_runs():
    with ebb.backend("cpu"):
        vertices, edges = lattice()
        plain, others = lattice(reorder=False)
        gather, plainly = gathering(vertices, edges), gathering(plain, others)
        with ebb.capture() as step:
            gather(vertices)
            vertices.swap("q", "force")
        step.run(3)
        assert is_permuted(vertices) == [True]
        for _ in range(3):
            plainly(plain)
            plain.swap("q", "force")
        assert_same(values(vertices, edges), values(plain, others))


def test_keys_that_a_captured_step_changes_are_left_alone():
    with ebb.backend("cpu"):
        vertices, edges = lattice(grouped=False)
        measure = along(vertices, edges)
        turn = kernel_of("e.tail, e.head = e.head, e.tail", "e: edges", edges=edges)
        with ebb.capture() as step:
            measure(edges)
            turn(edges)
        for _ in range(4):
            step.run(2)
        assert is_permuted(vertices, edges) == [False, False]
