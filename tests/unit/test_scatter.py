"""How reductions into other rows are done: what is chosen, and that any number of threads gives the same bits."""

from __future__ import annotations

import gc

import numpy as np
import pytest

import ebb
from ebb.compiler.scatter.staged import Stage

SIZE = 100_003
"""Rows: 98 blocks, the last one not whole."""

THREADS = (1, 2, 3, 7)


def same_bits(kernel, rows, *fields):
    """What ``fields`` hold after a launch that starts from zeros, which is the same for any number of threads."""
    results = []
    for threads in THREADS:
        with ebb.backend("cpu", threads=threads, reorder=False):
            for field in fields:
                field.fill(field.type.dtype.type(0))
            kernel(rows)
            results.append([field.to_numpy() for field in fields])
    for found in results[1:]:
        for first, other in zip(results[0], found, strict=True):
            assert first.tobytes() == other.tobytes()
    return results[0]


def said(kernel, rows):
    """What ``explain`` says of the reductions into other rows."""
    with ebb.backend("cpu", reorder=False):
        lines = kernel.explain(rows).splitlines()
    return next(line.split("into other rows", 1)[1].lstrip(":, ") for line in lines if "into other rows" in line)


@pytest.fixture
def chain():
    """Points in a row, and links between neighbours, in order."""
    points, links = ebb.Relation("points", size=SIZE + 1), ebb.Relation("links", size=SIZE)
    links.new_field("a", points, init=np.arange(SIZE))
    links.new_field("b", points, init=np.arange(SIZE) + 1)
    return filled(points, links)


@pytest.fixture
def tangle():
    """Points and links between any two of them."""
    random = np.random.default_rng(3)
    points, links = ebb.Relation("points", size=7_000), ebb.Relation("links", size=SIZE)
    links.new_field("a", points, init=random.integers(0, 7_000, SIZE))
    links.new_field("b", points, init=random.integers(0, 7_000, SIZE))
    return filled(points, links)


def filled(points, links):
    random = np.random.default_rng(1)
    links.new_field("x", ebb.float32, init=random.normal(size=SIZE).astype(np.float32))
    links.new_field("n", ebb.int32, init=random.integers(-9, 9, SIZE))
    links.new_field("out", ebb.float32)
    points.new_field("sum", ebb.float32)
    points.new_field("count", ebb.int64)
    points.new_field("vec", ebb.vec3d)
    return points, links


def added(links, points, *pairs):
    """The sums of ``(key field, values)`` by point, in float64."""
    total = np.zeros(points.size)
    for key, values in pairs:
        np.add.at(total, key.to_numpy(), np.asarray(values, dtype=np.float64))
    return total


def test_a_grouped_key_is_gathered_through(tangle):
    points, links = tangle
    links.group_by("a")

    @ebb.kernel
    def scatter(k: links):
        k.a.sum += 2.0 * k.x

    (found,) = same_bits(scatter, links, points.sum)
    np.testing.assert_allclose(found, 2 * added(links, points, (links.a, links.x)), atol=1e-4)
    assert said(scatter, links) == "gathered through the inverse of links.a: its groups are ranges"


def test_what_else_the_kernel_does_is_done_too(tangle):
    points, links = tangle
    links.group_by("a")
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def scatter(k: links):
        where = k.a
        if k.n > 0:
            where.sum += k.x
            k.out = k.x + 1.0
        total.value += k.x

    found, out = same_bits(scatter, links, points.sum, links.out)
    x, some = links.x.to_numpy(), links.n.to_numpy() > 0
    np.testing.assert_allclose(found, added(links, points, (links.a, x * some)), atol=1e-4)
    np.testing.assert_array_equal(out, np.where(some, x + np.float32(1), 0))
    assert total.value == pytest.approx(len(THREADS) * float(x.sum(dtype=np.float64)))
    assert "gathered" in said(scatter, links)


def test_neighbours_are_coloured(chain):
    points, links = chain
    points.new_field("pos", ebb.vec3d, init=np.random.default_rng(4).normal(size=(points.size, 3)))

    @ebb.kernel
    def scatter(k: links):
        pull = ebb.length(k.b.pos - k.a.pos) * ebb.normalize(k.b.pos - k.a.pos)
        assert ebb.length(pull) < 100.0
        k.a.vec += pull
        k.b.vec -= pull
        k.b.count += 1

    found, count = same_bits(scatter, links, points.vec, points.count)
    pull = np.diff(points.pos.to_numpy(), axis=0)
    np.testing.assert_allclose(found, np.diff(np.pad(pull, ((1, 1), (0, 0))), axis=0), atol=1e-12)
    np.testing.assert_array_equal(count, added(links, points, (links.b, np.ones(SIZE))))
    assert said(scatter, links) == "coloured: 2 waves of 25 and 24 chunks of 2,048 rows"


def test_a_tangle_of_one_key_is_gathered_through_an_index_of_its_own(tangle):
    points, links = tangle

    @ebb.kernel
    def scatter(k: links):
        k.a.vec += [1.0, 2.0, 3.0] * k.x

    (found,) = same_bits(scatter, links, points.vec)
    expected = added(links, points, (links.a, links.x))
    np.testing.assert_allclose(found, np.outer(expected, [1, 2, 3]), atol=1e-4)
    assert said(scatter, links).startswith("gathered through the inverse of links.a: each value is computed")
    assert links.a.grouping is None and set(links.fields) == {"a", "b", "x", "n", "out"}


def test_stages_that_were_only_weighed_are_let_go():
    nodes, links = ebb.Relation("nodes", size=20_000), ebb.Relation("links", size=40_000)
    nodes.new_field("sum", ebb.float32)
    near = np.arange(40_000) // 2
    for name, keys in (("a", near), ("b", np.minimum(near + 1, 19_999))):
        links.new_field(name, nodes, init=keys)

    @ebb.kernel
    def scatter(e: links):
        e.a.sum += 1
        e.b.sum += 1

    for _ in range(2):
        scatter(links)
    assert "staged" not in said(scatter, links)
    gc.collect()
    made = [each for each in gc.get_objects() if isinstance(each, Stage)]
    assert not [each for each in made if each.field is nodes.sum]


def test_a_tangle_whose_rows_may_fail_is_staged(tangle):
    points, links = tangle

    @ebb.kernel
    def scatter(k: links):
        assert k.x < 100.0
        k.a.sum += k.x
        if k.n > 2:
            k.b.sum += k.x
        k.a.vec[1] += k.x

    found, vec = same_bits(scatter, links, points.sum, points.vec)
    some = links.x.to_numpy() * (links.n.to_numpy() > 2)
    np.testing.assert_allclose(found, added(links, points, (links.a, links.x), (links.b, some)), atol=1e-4)
    np.testing.assert_allclose(vec[:, 1], added(links, points, (links.a, links.x)), atol=1e-4)
    assert not vec[:, [0, 2]].any()
    assert said(scatter, links) == "staged: each row writes what it gives, and each target gathers it"


def test_a_place_that_depends_on_values_is_reached_in_order(tangle):
    points, links = tangle

    @ebb.kernel
    def scatter(k: links):
        end = k.a
        if k.n > 0:
            end = k.b
        end.sum += k.x

    (found,) = same_bits(scatter, links, points.sum)
    some = links.n.to_numpy() > 0
    x = links.x.to_numpy()
    np.testing.assert_allclose(found, added(links, points, (links.a, x * ~some), (links.b, x * some)), atol=1e-4)
    assert said(scatter, links).startswith("row after row")
    with ebb.backend("cpu"):
        assert "the places depend on the value of 'end'" in scatter.explain(links)


OPERATORS = {
    "+": np.add, "*": np.multiply, "min": np.minimum, "max": np.maximum,
    "&": np.bitwise_and, "|": np.bitwise_or, "^": np.bitwise_xor,
}  # fmt: skip


@pytest.mark.parametrize("graph", ["chain", "tangle"])
@pytest.mark.parametrize("op", OPERATORS)
@pytest.mark.parametrize("type_", [ebb.int32, ebb.int64, ebb.uint32, ebb.uint64, ebb.bool_], ids=repr)
def test_integers_are_exact_in_every_operator(request, graph, op, type_):
    if type_ is ebb.bool_ and op not in "&|^":
        pytest.skip("bools have no numbers")
    points, links = request.getfixturevalue(graph)
    random = np.random.default_rng(5)
    links.new_field("w", type_, init=random.integers(0, 2 if type_ is ebb.bool_ else 50, SIZE).astype(type_.dtype))
    points.new_field("r", type_)

    if op in ("min", "max"):
        text = f"k.a.r = {op}(k.a.r, k.w); k.b.r = {op}(k.b.r, k.w)"
    else:
        text = f"k.a.r {op}= k.w; k.b.r {op}= k.w"
    source = f"@ebb.kernel(source=TEXT)\ndef scatter(k: links):\n    {text}\n"
    names = {"ebb": ebb, "links": links, "TEXT": source}
    exec(source, names)
    (found,) = same_bits(names["scatter"], links, points.r)
    expected = np.zeros(points.size, type_.dtype)
    for key in (links.a, links.b):
        OPERATORS[op].at(expected, key.to_numpy(), links.w.to_numpy())
    np.testing.assert_array_equal(found, expected)
    assert not said(names["scatter"], links).startswith("row after row")


def test_key_vectors_are_followed_by_component(chain):
    points, _ = chain
    cells = ebb.Relation("cells", size=SIZE)
    corners = np.arange(SIZE)[:, None] + np.arange(4)
    cells.new_field("v", ebb.vector(points, 4), init=np.minimum(corners, SIZE))
    cells.new_field("w", ebb.float64, init=np.random.default_rng(2).normal(size=SIZE))

    @ebb.kernel
    def scatter(c: cells):
        for i in range(4):
            c.v[i].vec += [c.w, ebb.float64(i), 1.0]

    (found,) = same_bits(scatter, cells, points.vec)
    expected = np.zeros((points.size, 3))
    for i in range(4):
        np.add.at(expected, cells.v.to_numpy()[:, i], np.stack((cells.w, np.full(SIZE, i), np.ones(SIZE)), axis=1))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert "coloured" in said(scatter, cells)


def test_query_loops_are_followed(chain):
    points, links = chain
    links.group_by("a")

    @ebb.kernel
    def scatter(p: points):
        p.count += 1
        for k in ebb.where(links.a, p):
            k.b.count += 10

    (found,) = same_bits(scatter, points, points.count)
    np.testing.assert_array_equal(found, 1 + 10 * added(links, points, (links.b, np.ones(SIZE))))
    assert "coloured" in said(scatter, points)


def test_keys_that_a_condition_keeps_rows_from_are_no_places(chain):
    points, links = chain
    links.new_field("v", ebb.vector(points, 3), init=np.minimum(np.arange(SIZE)[:, None] + np.arange(3), SIZE))
    cells = ebb.Relation("cells", shape=(40, 50))
    links.new_field("cell", cells, init=np.stack((np.arange(SIZE) % 40, np.arange(SIZE) % 50), axis=1))
    points.new_field("in_cell", cells, init=np.stack(np.unravel_index(np.arange(SIZE + 1) % 2000, (40, 50)), axis=1))
    points.group_by("in_cell")

    @ebb.kernel
    def components(k: links):
        for i in range(5):
            if i < 3:
                k.v[i].count += 1 + i

    (found,) = same_bits(components, links, points.count)
    expected = np.zeros(SIZE + 1)
    for i in range(3):
        np.add.at(expected, links.v.to_numpy()[:, i], 1 + i)
    np.testing.assert_array_equal(found, expected)
    assert not said(components, links).startswith("row after row")

    some = links.new_subset("some", np.arange(5_000))

    @ebb.kernel
    def groups(k: links):
        if ebb.coords(k.cell)[0] < 39:
            for p in ebb.where(points.in_cell, ebb.affine(cells, [[1, 0, 1], [0, 1, 0]], k.cell)):
                p.count += 1

    (found,) = same_bits(groups, some, points.count)
    inner = links.cell.to_numpy()[:5_000]
    inner = inner[inner[:, 0] < 39] + [1, 0]
    times = np.zeros((40, 50))
    np.add.at(times, tuple(inner.T), 1)
    np.testing.assert_array_equal(found, times[tuple(points.in_cell.to_numpy().T)])


def test_loop_variables_that_change_are_not_followed(chain):
    points, links = chain
    links.new_field("v", ebb.vector(points, 4), init=np.minimum(np.arange(SIZE)[:, None] + np.arange(4), SIZE))

    @ebb.kernel
    def ahead(k: links):
        for i in range(3):
            i = i + 1
            k.v[i].count += 1

    @ebb.kernel
    def last(k: links):
        for i in range(3):
            k.out = i
        end = k.v[i]
        for i in range(2):
            end.count += i

    for kernel, columns in ((ahead, (1, 2, 3)), (last, (2,))):
        (found,) = same_bits(kernel, links, points.count)
        expected = np.zeros(SIZE + 1)
        for column in columns:
            np.add.at(expected, links.v.to_numpy()[:, column], 1)
        np.testing.assert_array_equal(found, expected)
        assert said(kernel, links).startswith("row after row")


@pytest.mark.parametrize("periodic", [False, True])
def test_offsets_on_a_grid_are_coloured(periodic):
    cells = ebb.Relation("cells", shape=(301, 330), periodic=periodic)
    cells.new_field("x", ebb.float64, init=np.random.default_rng(0).normal(size=(301, 330)))
    cells.new_field("y", ebb.float64)
    rows = cells if periodic else cells.new_subset("inner", np.s_[1:-1, 1:-1])

    @ebb.kernel
    def scatter(c: cells):
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            ebb.affine(cells, [[1, 0, di], [0, 1, dj]], c).y += 0.25 * c.x

    (found,) = same_bits(scatter, rows, cells.y)
    x = cells.x.to_numpy()
    if not periodic:
        x = np.pad(x[1:-1, 1:-1], 1)
    expected = 0.25 * sum(np.roll(x, shift, axis) for axis in (0, 1) for shift in (1, -1))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert "coloured" in said(scatter, rows)


@pytest.mark.parametrize("graph", ["chain", "tangle"])
def test_subsets(request, graph):
    points, links = request.getfixturevalue(graph)
    chosen = np.flatnonzero(np.random.default_rng(9).random(SIZE) < 0.7)
    some = links.new_subset("some", chosen)

    @ebb.kernel
    def scatter(k: links):
        k.a.count += k.n
        k.b.count -= 1

    (found,) = same_bits(scatter, some, points.count)
    expected = np.zeros(points.size, np.int64)
    np.add.at(expected, links.a.to_numpy()[chosen], links.n.to_numpy()[chosen])
    np.add.at(expected, links.b.to_numpy()[chosen], -1)
    np.testing.assert_array_equal(found, expected)
    assert not said(scatter, some).startswith("row after row")


def test_rows_that_are_reached_by_two_relations(chain):
    points, links = chain
    links.new_field("other", links, init=(np.arange(SIZE) + 1) % SIZE)

    @ebb.kernel
    def scatter(k: links):
        k.a.count += 1
        k.other.a.count += 1
        k.other.b.count += k.n

    (found,) = same_bits(scatter, links, points.count)
    a, b, other = (field.to_numpy() for field in (links.a, links.b, links.other))
    expected = np.zeros(points.size, np.int64)
    np.add.at(expected, a, 1)
    np.add.at(expected, a[other], 1)
    np.add.at(expected, b[other], links.n.to_numpy())
    np.testing.assert_array_equal(found, expected)


# ---- What changes between launches ----


def test_new_keys_are_planned_for(chain):
    points, links = chain

    @ebb.kernel
    def scatter(k: links):
        k.a.count += 1
        k.b.count += 1

    for seed in range(3):
        for _ in range(2):
            (found,) = same_bits(scatter, links, points.count)
            np.testing.assert_array_equal(
                found, added(links, points, (links.a, np.ones(SIZE)), (links.b, np.ones(SIZE)))
            )
        links.b.load(np.random.default_rng(seed).integers(0, points.size, SIZE))
    links.permute(np.random.default_rng(7).permutation(SIZE))
    points.permute(np.random.default_rng(8).permutation(points.size))
    (found,) = same_bits(scatter, links, points.count)
    np.testing.assert_array_equal(found, added(links, points, (links.a, np.ones(SIZE)), (links.b, np.ones(SIZE))))


def test_rows_that_a_plan_moves_are_listed_where_they_are_then(tangle):
    points, links = tangle
    links.group_by("a")

    @ebb.kernel
    def scatter(k: links):
        x = k.x
        for _ in range(40):
            x = 0.5 * x + ebb.sin(x) * ebb.cos(x)
        k.b.vec += [x, k.x, 1.0]
        k.a.count += 1

    for seed in (8, 9):
        links.a.load(np.random.default_rng(seed).integers(0, 7_000, SIZE))
        vec, count = same_bits(scatter, links, points.vec, points.count)
        np.testing.assert_allclose(vec[:, 1], added(links, points, (links.b, links.x)), atol=1e-4)
        np.testing.assert_array_equal(vec[:, 2], added(links, points, (links.b, np.ones(SIZE))))
        np.testing.assert_array_equal(count, added(links, points, (links.a, np.ones(SIZE))))
    assert said(scatter, links).startswith("staged")


def test_a_gather_is_given_up_once_its_rows_may_fail(tangle):
    points, links = tangle
    links.group_by("a")
    points.new_field("x", ebb.float32, init=1.0)

    @ebb.kernel
    def scatter(k: links):
        k.a.sum += k.b.x

    (found,) = same_bits(scatter, links, points.sum)
    np.testing.assert_array_equal(found, added(links, points, (links.a, np.ones(SIZE))))
    assert said(scatter, links).startswith("gathered")
    keys = np.ma.masked_array(links.b.to_numpy(), np.arange(SIZE) == 5_000)
    links.b.load(keys)
    with ebb.backend("cpu", reorder=False), pytest.raises(ebb.RelationError, match=r"row links\[5000\]"):
        scatter(links)


def test_keys_that_change_before_every_launch_get_no_index(chain):
    points, links = chain

    @ebb.kernel
    def scatter(k: links):
        k.a.count += 1

    heard = []
    with ebb.backend("cpu", threads=2, reorder=False):
        for step in range(15):
            links.a.load((np.arange(SIZE) + step) % points.size)
            points.count.fill(0)
            scatter(links)
            np.testing.assert_array_equal(points.count.to_numpy(), added(links, points, (links.a, np.ones(SIZE))))
        for _ in range(2):
            scatter(links)
            heard.append("row after row" in scatter.explain(links))
    assert heard[-1] is False


# ---- Failures ----


@pytest.mark.parametrize("graph", ["chain", "tangle"])
@pytest.mark.parametrize("bad", [(8_500, 17), (90_000, 40_000, 39_999, 10_240), (1_023,)])
def test_the_first_failing_row_is_named_in_whatever_order_rows_run(request, graph, bad):
    _, links = request.getfixturevalue(graph)
    x = links.x.to_numpy()
    x[list(bad)] = 1e3
    links.x.load(x)

    @ebb.kernel
    def scatter(k: links):
        assert k.x < 100.0
        k.a.sum += k.x
        k.b.sum += k.x

    for threads in THREADS:
        with (
            ebb.backend("cpu", threads=threads, reorder=False),
            pytest.raises(ebb.KernelAssertionError, match=rf"links\[{min(bad)}\]"),
        ):
            scatter(links)
    assert not said(scatter, links).startswith("row after row")


def test_an_unset_key_is_an_error(chain):
    points, links = chain
    keys = np.ma.masked_array(np.arange(SIZE), np.arange(SIZE) == 5_000)
    links.a.load(keys)

    @ebb.kernel
    def scatter(k: links):
        k.a.count += 1

    for threads in THREADS:
        with ebb.backend("cpu", threads=threads, reorder=False), pytest.raises(ebb.RelationError, match="5000"):
            scatter(links)
    fine = links.new_subset("fine", np.arange(5_000))
    points.count.fill(0)
    scatter(fine)
    assert points.count.to_numpy().sum() == 5_000


def test_keys_of_staged_values_are_checked(tangle):
    _, links = tangle
    keys = np.ma.masked_array(links.a.to_numpy(), np.arange(SIZE) == 5_000)
    links.a.load(keys)
    cells = ebb.Relation("cells", shape=(100, 100))
    cells.new_field("sum", ebb.float32)
    at = np.random.default_rng(4).integers(0, 99, (SIZE, 2))
    at[[7_000, 70_000], 0] = 99
    links.new_field("cell", cells, init=at)

    @ebb.kernel
    def unset(k: links):
        k.a.sum += k.x

    @ebb.kernel
    def outside(k: links):
        ebb.affine(cells, [[1, 0, 1], [0, 1, 0]], k.cell).sum += k.x

    for threads in THREADS:
        with ebb.backend("cpu", threads=threads, reorder=False):
            with pytest.raises(ebb.RelationError, match=r"links\[5000\]"):
                unset(links)
            with pytest.raises(ebb.BoundsError, match=r"links\[7000\]"):
                outside(links)
    assert said(unset, links).startswith("staged") and said(outside, links).startswith("staged")


def test_no_rows():
    points, links = ebb.Relation("points", size=0), ebb.Relation("links", size=0)
    links.new_field("a", points)
    points.new_field("count", ebb.int64)

    @ebb.kernel
    def scatter(k: links):
        k.a.count += 1

    scatter(links)
    assert "row after row" in scatter.explain(links)


# ---- Atomic updates ----


@pytest.mark.parametrize("op", OPERATORS)
@pytest.mark.parametrize(
    "type_", [ebb.int32, ebb.int64, ebb.uint32, ebb.uint64, ebb.bool_, ebb.float32, ebb.float64], ids=repr
)
def test_atomic_updates(tangle, op, type_):
    if (type_ is ebb.bool_ and op not in "&|^") or (type_.dtype.kind == "f" and op in "&|^"):
        pytest.skip("there is no such reduction")
    points, links = tangle
    whole = np.random.default_rng(5).integers(0, 2 if type_ is ebb.bool_ else 3, SIZE)
    links.new_field("w", type_, init=whole.astype(type_.dtype))
    points.new_field("r", type_, init=type_.dtype.type(1))
    change = f"= {op}(k.a.r, k.w)" if op in ("min", "max") else f"{op}= k.w"
    text = f"def scatter(k: links):\n    k.a.r {change}\n"
    names = {"ebb": ebb, "links": links}
    exec(f"@ebb.kernel(source={text!r})\n{text}", names)
    with ebb.backend("cpu", threads=3, atomics=True):
        names["scatter"](links)
        assert "atomically, in any order: the bits depend on the threads" in names["scatter"].explain(links)
    expected = np.full(points.size, 1, type_.dtype)
    OPERATORS[op].at(expected, links.a.to_numpy(), links.w.to_numpy())
    np.testing.assert_array_equal(points.r.to_numpy(), expected)


def test_atomic_minima_keep_nan(tangle):
    points, links = tangle
    links.x.load(np.where(np.arange(SIZE) == 77, np.float32(np.nan), links.x.to_numpy()))

    @ebb.kernel
    def scatter(k: links):
        k.a.sum = min(k.a.sum, k.x)

    with ebb.backend("cpu", threads=2, atomics=True):
        scatter(links)
    assert np.flatnonzero(np.isnan(points.sum.to_numpy())).tolist() == [links.a.to_numpy()[77]]


def test_atomics_are_on_or_off():
    with pytest.raises(ebb.BackendError, match="atomics"):
        ebb.set_backend("cpu", atomics="yes")
