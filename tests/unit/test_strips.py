"""Query loops that run several turns at once give what the reference gives, whatever their bodies do."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.backends.llvm import strips
from ebb.backends.llvm.hooks import Strips
from ebb.backends.target import host

GROUPS = [0, 1, 2, 7, 8, 9, 15, 16, 17, 40, 0, 3]
"""The sizes of the groups: none, some of a strip, whole strips, and one more or less."""


@pytest.fixture(autouse=True)
def however_light(monkeypatch):
    """Loops run in strips that are too light to gain by it."""
    monkeypatch.setattr(strips, "WORK_OF_A_SUM", 0)
    monkeypatch.setattr(strips, "WORK_OF_A_LOAD", 0)


class Graph:
    """Rows that refer to nodes, some nodes to many; the numbers are small, so that float sums are exact."""

    def __init__(self, scalar) -> None:
        rng = np.random.default_rng(7)
        n, m = len(GROUPS), sum(GROUPS)
        self.nodes = ebb.Relation("nodes", size=n)
        self.links = ebb.Relation("links", size=m)
        small = {"float": 8, "int": 5, "uint": 5, "bool": 2}[str(np.dtype(scalar.dtype)).rstrip("0123456789_")]
        draw = lambda *shape: rng.integers(0, small, shape).astype(scalar.dtype)  # noqa: E731
        self.nodes.new_field("x", scalar, init=draw(n))
        self.nodes.new_field("p", ebb.vector(scalar, 3), init=draw(n, 3))
        self.nodes.new_field("two", ebb.vector(scalar, 2), init=draw(n, 2))
        self.nodes.new_field("y", scalar, init=draw(n))
        self.nodes.new_field("f", ebb.vector(scalar, 3), init=draw(n, 3))
        self.links.new_field("tail", self.nodes, init=rng.permutation(np.repeat(np.arange(n), GROUPS)))
        self.links.new_field("head", self.nodes, init=rng.integers(0, n, m))
        self.links.new_field("w", scalar, init=draw(m))
        self.links.new_field("on", ebb.bool_, init=rng.integers(0, 2, m).astype(bool))
        self.links.new_field("k", ebb.matrix(scalar, 3, 3), init=draw(m, 3, 3))
        self.links.group_by("tail")
        links = self.links

        @self.nodes.member
        def out(v):
            return ebb.where(links.tail, v)


def both(kernel, graph, *names):
    """The fields after a launch on ``cpu``, which has run in strips, and after one on the reference."""
    found = same(kernel, graph, *names)
    if host().hooks.strips is not Strips.NONE:
        assert in_strips(kernel, graph)
    return found


def same(kernel, graph, *names):
    """The fields after a launch on ``cpu`` and after one on the reference, which are the same."""
    before = {name: getattr(graph.nodes, name).to_numpy().copy() for name in names}
    results = []
    for backend in ("cpu", "reference"):
        for name in names:
            getattr(graph.nodes, name).load(before[name])
        with ebb.backend(backend):
            kernel(graph.nodes)
        results.append({name: getattr(graph.nodes, name).to_numpy().copy() for name in names})
    for name in names:
        np.testing.assert_array_equal(results[0][name], results[1][name])
    return results[0]


def in_strips(kernel, graph):
    """Whether some loop of ``kernel`` runs in strips."""
    with ebb.backend("cpu"):
        return "strip" in kernel.inspect(graph.nodes, "llvm")


@pytest.fixture(params=[ebb.float32, ebb.float64, ebb.int32, ebb.int64, ebb.uint32], ids=repr)
def graph(request):
    return Graph(request.param)


def test_sums_of_rows_elsewhere(graph):
    nodes = graph.nodes

    @ebb.kernel
    def gather(v: nodes):
        for e in v.out:
            v.f += e.w * (e.head.p + v.p)
            v.y += e.head.x

    both(gather, graph, "f", "y")


def test_two_columns_and_single_components(graph):
    nodes = graph.nodes

    @ebb.kernel
    def gather(v: nodes):
        for e in v.out:
            v.y += e.head.two[0] * e.head.two[1] + e.head.p[1]

    both(gather, graph, "y")


def test_matrices_of_the_links(graph):
    nodes = graph.nodes

    @ebb.kernel
    def multiply(v: nodes):
        for e in v.out:
            v.f += e.k @ e.head.p

    both(multiply, graph, "f")


def test_conditions_become_masks(graph):
    nodes = graph.nodes

    @ebb.kernel
    def gather(v: nodes):
        for e in v.out:
            if e.on:
                v.f += e.head.p
                if e.w > v.x:
                    v.y += v.p[0]
                else:
                    v.y += e.head.x
            elif e.head != v:
                v.y += e.w

    both(gather, graph, "f", "y")


def test_locals_of_a_turn_and_sums_in_locals(graph):
    nodes = graph.nodes

    @ebb.kernel
    def gather(v: nodes):
        total = v.x
        count = 0
        for e in v.out:
            k = e.head
            if e.on:
                k = v
                weight = e.w
            else:
                weight = k.x
            total += weight * k.x
            count += 1
        if count > 0:
            v.y = total

    both(gather, graph, "y")


def test_least_and_greatest(graph):
    nodes = graph.nodes

    @ebb.kernel
    def gather(v: nodes):
        low = v.x
        for e in v.out:
            low = min(low, e.head.x)
            v.f = max(v.f, e.head.p)
        v.y = low

    both(gather, graph, "f", "y")


def test_sums_into_globals(graph):
    nodes, scalar = graph.nodes, graph.nodes.x.type
    total = ebb.Global(scalar, 0)

    @ebb.kernel
    def gather(v: nodes):
        for e in v.out:
            if e.on:
                total.value += e.head.x

    gather(nodes)
    expected = graph.nodes.x.to_numpy()[graph.links.head.to_numpy()][graph.links.on.to_numpy()].sum()
    assert total.value == expected


def test_bits_and_bools():
    graph = Graph(ebb.int32)
    nodes = graph.nodes
    nodes.new_field("any", ebb.bool_)
    nodes.new_field("every", ebb.bool_, init=True)

    @ebb.kernel
    def gather(v: nodes):
        for e in v.out:
            v.any |= e.on
            v.every &= e.on or e.w > 0
            v.y ^= e.head.x

    both(gather, graph, "any", "every", "y")


def test_nans_and_lengths_of_zero_stay_in_their_lanes():
    graph = Graph(ebb.float32)
    nodes = graph.nodes
    nodes.p.load(np.where(np.arange(len(GROUPS))[:, None] == 3, np.nan, nodes.p.to_numpy()))

    @ebb.kernel
    def gather(v: nodes):
        for e in v.out:
            v.f += ebb.floor(4.0 * ebb.normalize(e.head.p - v.p))

    both(gather, graph, "f")


def test_a_failure_names_the_turn_that_fails_first():
    graph = Graph(ebb.float32)
    nodes, links = graph.nodes, graph.links
    heads = np.ma.masked_array(links.head.to_numpy(), mask=np.arange(links.size) == 60)
    links.head.load(heads)

    @ebb.kernel
    def gather(v: nodes):
        for e in v.out:
            v.y += e.head.x

    @ebb.kernel
    def checked(v: nodes):
        for e in v.out:
            assert e.w < 7.0, "too heavy"
            v.y += e.w

    for kernel, error in ((gather, ebb.RelationError), (checked, ebb.KernelAssertionError)):
        messages = []
        for backend in ("cpu", "reference"):
            with ebb.backend(backend), pytest.raises(error) as caught:
                kernel(nodes)
            messages.append(str(caught.value))
        assert messages[0] == messages[1]


@pytest.mark.parametrize("other", ["v.f = max(v.f, 3 * e.head.p)", "v.f[1] = min(v.f[1], e.w)", "v.f[v.k] *= e.w"])
def test_two_operators_on_one_place_take_turns(other):
    graph = Graph(ebb.float64)
    nodes = graph.nodes
    nodes.new_field("k", ebb.int32, init=np.arange(len(GROUPS)) % 3)
    source = f"@ebb.kernel(source=TEXT)\ndef gather(v: nodes):\n    for e in v.out:\n        v.f += e.head.p; {other}\n"
    names = {"ebb": ebb, "nodes": nodes, "TEXT": source}
    exec(source, names)
    same(names["gather"], graph, "f")
    assert not in_strips(names["gather"], graph)


def test_extremes_of_the_components_of_one_row():
    graph = Graph(ebb.float64)
    nodes = graph.nodes

    @ebb.kernel
    def gather(v: nodes):
        s = v.p
        for e in v.out:
            v.two[0] = min(v.two[0], e.w)
            v.two[1] = max(v.two[1], e.w)
            s[0] += e.w
            s[1] = max(s[1], e.w)
        v.f = s

    both(gather, graph, "two", "f")


def test_no_turn_no_place():
    graph = Graph(ebb.float64)
    nodes = graph.nodes
    empty = np.array(GROUPS) == 0
    nodes.new_field("part", ebb.int32, init=np.where(empty, 100_000_000, np.arange(len(GROUPS)) % 3))

    @ebb.kernel
    def gather(v: nodes):
        part = v.part
        for e in v.out:
            v.p[part] += e.w

    @ebb.kernel
    def asked(v: nodes):
        part = v.part + 2
        for e in v.out:
            if part < 3:
                v.p[part] += e.w

    both(gather, graph, "p")
    same(asked, graph, "p")


def test_what_is_behind_a_check_is_loaded_behind_it():
    nodes, links = ebb.Relation("nodes", size=10), ebb.Relation("links", size=100)
    line = ebb.Relation("line", shape=(60_000,))
    line.new_field("x", ebb.float64, init=1.0)
    nodes.new_field("y", ebb.float64)
    links.new_field("tail", nodes, init=np.arange(100) // 10)
    links.new_field("cell", line, init=np.arange(100)[:, None])
    links.group_by("tail")

    @ebb.kernel
    def gather(v: nodes):
        for e in ebb.where(links.tail, v):
            near = ebb.affine(line, [[1, 1]], e.cell)
            far = ebb.affine(line, [[1, 1_000_000_000]], near)
            v.y += near.x * far.x

    for backend in ("cpu", "reference"):
        with ebb.backend(backend), pytest.raises(ebb.BoundsError, match="1000000001"):
            gather(nodes)


def test_the_order_of_a_range_is_kept():
    graph = Graph(ebb.float32)
    nodes = graph.nodes

    @ebb.kernel
    def in_order(v: nodes):
        for k in range(20):
            v.y += v.x * k

    @ebb.kernel
    def last(v: nodes):
        for e in v.out:
            v.y = e.w

    for kernel in (in_order, last):
        kernel(nodes)
        assert "strip" not in kernel.inspect(nodes, "llvm")
