from __future__ import annotations

import numpy as np

import ebb
from ebb.compiler.cost import cost_of
from ebb.compiler.elaborate.elaborate import elaborate


def mesh():
    """A ring of 4 vertices, each edge in both directions, grouped by ``tail``."""
    vertices, edges = ebb.Relation("vertices", size=4), ebb.Relation("edges", size=8)
    around = np.arange(4)
    edges.new_field("tail", vertices, init=np.concatenate((around, (around + 1) % 4)))
    edges.new_field("head", vertices, init=np.concatenate(((around + 1) % 4, around)))
    edges.group_by("tail")
    vertices.new_field("q", ebb.vec3f, init=0.0)
    vertices.new_field("force", ebb.vec3f, init=0.0)
    vertices.new_field("mass", ebb.float64, init=1.0)
    return vertices, edges


def cost(kernel, relation):
    return cost_of(elaborate(kernel.source, relation, (), ()).kernel)


def lines(text):
    return [" ".join(line.split()) for line in text.splitlines()]


def test_explain_says_phases_reductions_layout_and_cost():
    vertices, edges = mesh()
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def gather(v: vertices):
        for e in ebb.where(edges.tail, v):
            v.force += e.head.q - v.q
        total.value += v.mass

    text = lines(gather.explain(vertices))
    assert text[0] == "kernel gather on vertices (4 rows)"
    assert "edges.tail READ read, queried; any row key(vertices) 4 bytes a row" in text
    assert "vertices.force EXCLUSIVE reduced; own row vector(float32, 3) 12 bytes a row, in rows" in text
    assert "total.value REDUCE(+) reduced float64" in text
    assert any(line.endswith("own row: no other row touches it") for line in text)
    assert any("one partial result a block of rows" in line for line in text)
    assert "edges by tail: a range of stored rows, 2 on average" in text
    assert "any: blocks of rows run on all threads" in text
    assert "edges: rows stored permuted; grouped by edges.tail" in text
    # Own row: q and force once a turn, mass once. Others: 2 offsets, and key and q of the head in each turn.
    assert "120 bytes: 56 read from the own row, 40 from other rows, 24 written" in text
    assert "13 operations, 0.11 a byte" in text


def test_explain_says_where_rows_run_in_order_and_what_the_stencil_is():
    cells = ebb.Relation("cells", shape=(4, 4), periodic=(True, True))
    cells.new_field("t", ebb.float64)
    cells.new_field("flux", ebb.float64)

    @ebb.kernel
    def spread(c: cells):
        ebb.affine(cells, [[1, 0, 1], [0, 1, 0]], c).flux += c.t

    text = lines(spread.explain(cells))
    assert "cells.flux REDUCE(+) reduced; any row float64 8 bytes a row" in text
    assert any(line.endswith("into other rows: row after row in storage order, on one thread") for line in text)
    assert any(line.startswith("one after the other, so that sums in other rows") for line in text)
    assert any(line.endswith("offset (1, 0) into cells checked before the launch") for line in text)
    assert "cells: grid 4 x 4, the last index is contiguous" in text


def test_the_cost_of_a_query_loop_is_that_of_an_average_group():
    vertices, edges = mesh()

    @ebb.kernel
    def gather(v: vertices):
        for e in ebb.where(edges.tail, v):
            v.force += e.head.q - v.q

    found = cost(gather, vertices)
    assert found.written_bytes == 2 * 12
    assert found.own_bytes == 2 * (12 + 12)
    assert found.other_bytes == 2 * 4 + 2 * (4 + 12)
    assert found.operations == 2 * (3 + 3)


def test_a_place_is_read_once():
    vertices, _ = mesh()

    @ebb.kernel
    def halve(v: vertices):
        v.mass = v.mass * v.mass + v.mass

    found = cost(halve, vertices)
    assert (found.own_bytes, found.written_bytes, found.other_bytes, found.operations) == (8, 8, 0, 2)


def test_the_longer_branch_and_the_turns_of_loops_count():
    vertices, _ = mesh()

    @ebb.kernel
    def branch(v: vertices):
        if v.mass > 1.0:
            v.force = v.q
        else:
            v.mass = 1.0

    found = cost(branch, vertices)
    assert (found.own_bytes, found.written_bytes, found.operations) == (8 + 12, 12, 1)

    @ebb.kernel
    def turns(v: vertices):
        for _ in range(5):
            v.mass *= 2.0
        n = 0
        while n < 3:
            n += 1
            v.mass *= 2.0

    found = cost(turns, vertices)
    assert found.written_bytes == 6 * 8
    assert found.uncounted == 1
