"""Members: functions of a key that stand where a field stands."""

from __future__ import annotations

import numpy as np

import ebb

from .harness import rejects


def triangle_fan(size=5):
    """A wheel: vertex 0 in the middle, and edges from it to all others and around."""
    vertices = ebb.Relation("vertices", size=size)
    rim = np.arange(1, size)
    tail = np.concatenate([np.zeros(size - 1, int), rim, rim])
    head = np.concatenate([rim, np.zeros(size - 1, int), np.roll(rim, -1)])
    edges = ebb.Relation("edges", size=len(tail))
    edges.new_field("tail", vertices, init=tail)
    edges.new_field("head", vertices, init=head)
    edges.group_by("tail")
    vertices.new_field("x", ebb.float64, init=np.arange(size) ** 2.0)
    vertices.new_field("out", ebb.float64, init=0.0)
    return vertices, edges, tail, head


def test_a_member_as_a_value(backend):
    _vertices, edges, tail, head = triangle_fan()
    edges.new_field("out", ebb.float64)

    @edges.member
    def rise(e):
        return e.head.x - e.tail.x

    @ebb.kernel
    def slope(e: edges):
        e.out = e.rise * 2

    slope(edges)
    np.testing.assert_array_equal(edges.out.to_numpy(), 2.0 * (head**2 - tail**2))


def test_a_member_as_a_key(backend):
    _vertices, edges, _tail, head = triangle_fan()
    edges.new_field("out", ebb.float64)

    @edges.member
    def target(e):
        return e.head

    @ebb.kernel
    def read(e: edges):
        e.out = e.target.x

    read(edges)
    np.testing.assert_array_equal(edges.out.to_numpy(), head**2.0)


def test_a_member_as_a_query(backend):
    vertices, mesh_edges, tail, head = triangle_fan()

    @vertices.member
    def edges(v):
        return ebb.where(mesh_edges.tail, v)

    @ebb.kernel
    def laplacian(v: vertices):
        for e in v.edges:
            v.out += e.head.x - v.x

    laplacian(vertices)
    x = np.arange(5) ** 2.0
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, x[head] - x[tail]))


def test_a_member_as_a_projected_query(backend):
    vertices, mesh_edges, tail, head = triangle_fan()

    @vertices.member
    def neighbors(v):
        return ebb.where(mesh_edges.tail, v).head

    @ebb.kernel
    def gather(v: vertices):
        for u in v.neighbors:
            v.out += u.x

    gather(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), np.bincount(tail, (head**2.0)))


def test_members_use_members(backend):
    vertices, mesh_edges, tail, _head = triangle_fan()

    @vertices.member
    def edges(v):
        return ebb.where(mesh_edges.tail, v)

    @vertices.member
    def degree(v):
        n = 0
        for _ in v.edges:
            n += 1
        return n

    @ebb.kernel
    def count(v: vertices):
        v.out = v.degree * 10

    count(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), 10 * np.bincount(tail))


def test_a_member_with_parameters_is_called(backend):
    vertices, _, _, _ = triangle_fan()

    @vertices.member
    def scaled(v, factor, offset):
        return v.x * factor + offset

    @ebb.kernel
    def program(v: vertices):
        v.out = v.scaled(2, 1) + v.scaled(0.5, 0)

    program(vertices)
    np.testing.assert_array_equal(vertices.out.to_numpy(), 2.5 * np.arange(5) ** 2 + 1)


def test_a_call_member_offsets_on_a_grid(backend):
    cells = ebb.Relation("cells", shape=(4, 6), periodic=(True, True))
    cells.new_field("t", ebb.float64, init=lambda i, j: 10 * i + j)
    cells.new_field("out", ebb.float64, init=0.0)

    @cells.member("__call__")
    def offset(c, di, dj):
        return ebb.affine(cells, [[1, 0, di], [0, 1, dj]], c)

    @ebb.kernel
    def laplace(c: cells):
        c.out = c(1, 0).t + c(-1, 0).t + c(0, 1).t + c(0, -1).t - 4 * c(0, 0).t

    laplace(cells)
    t = 10.0 * np.arange(4)[:, None] + np.arange(6)
    rolled = sum(np.roll(t, shift, axis) for axis in (0, 1) for shift in (-1, 1))
    np.testing.assert_array_equal(cells.out.to_numpy(), rolled - 4 * t)


def test_a_member_with_a_setter_and_a_reducer(backend):
    particles = ebb.Relation("particles", size=3)
    particles.new_field("mass", ebb.float64, init=[1, 2, 4])
    particles.new_field("velocity", ebb.vec3d, init=1.0)

    @particles.member
    def momentum(p):
        return p.mass * p.velocity

    @momentum.setter
    def set_momentum(p, value):
        p.velocity = value / p.mass

    @momentum.reducer("+")
    def add_momentum(p, value):
        p.velocity += value / p.mass

    @ebb.kernel
    def kick(p: particles):
        p.momentum += [4, 0, 0]
        p.momentum -= [0, 4, 0]

    @ebb.kernel
    def stop(p: particles):
        p.momentum = [8, 8, 8]

    kick(particles)
    np.testing.assert_array_equal(particles.velocity.to_numpy(), [[5, -3, 1], [3, -1, 1], [2, 0, 1]])
    stop(particles)
    np.testing.assert_array_equal(particles.velocity.to_numpy(), [[8, 8, 8], [4, 4, 4], [2, 2, 2]])


def test_min_and_max_reducers(backend):
    cells = ebb.Relation("cells", size=3)
    cells.new_field("stored", ebb.float64, init=[1, 5, 9])

    @cells.member
    def level(c):
        return c.stored

    @level.reducer("max")
    def raise_level(c, value):
        c.stored = max(c.stored, value)

    @ebb.kernel
    def flood(c: cells):
        c.level = max(c.level, 5.5)

    flood(cells)
    np.testing.assert_array_equal(cells.stored.to_numpy(), [5.5, 5.5, 9])


def test_a_reducer_scatters_through_a_key(backend):
    vertices, edges, tail, head = triangle_fan()

    @vertices.member
    def inflow(v):
        return v.out

    @inflow.reducer("+")
    def add(v, value):
        v.out += 2 * value

    @ebb.kernel
    def push(e: edges):
        e.head.inflow += e.tail.x

    push(edges)
    np.testing.assert_array_equal(vertices.out.to_numpy(), 2 * np.bincount(head, tail**2.0))


def test_a_member_takes_the_name_of_a_field(backend):
    vertices, edges, _tail, head = triangle_fan()
    edges.new_field("out", ebb.float64)

    @vertices.member("twice")
    def twice_field(v, name):
        return 2 * v[name]

    @ebb.kernel
    def program(e: edges):
        e.out = e.head.twice("x") + e.tail.twice("out")

    program(edges)
    np.testing.assert_array_equal(edges.out.to_numpy(), 2 * head**2.0)


def test_a_member_that_is_not_there_suggests_the_nearest():
    vertices, _, _, _ = triangle_fan()

    @vertices.member
    def neighbors(v):
        return v.x

    @ebb.kernel
    def program(v: vertices):
        v.out = v.neighbours

    error = rejects(ebb.KernelTypeError, "E1", lambda: program(vertices))
    assert "neighbors" in str(error)


def test_assigning_a_member_without_setter_is_an_error():
    vertices, _, _, _ = triangle_fan()

    @vertices.member
    def height(v):
        return v.x

    @ebb.kernel
    def assign(v: vertices):
        v.height = 1.0

    @ebb.kernel
    def reduce(v: vertices):
        v.height += 1.0

    rejects(ebb.KernelTypeError, "E", lambda: assign(vertices))
    rejects(ebb.KernelTypeError, "E", lambda: reduce(vertices))
    np.testing.assert_array_equal(vertices.x.to_numpy(), np.arange(5) ** 2)


def test_names_of_members_and_fields_clash():
    vertices, _, _, _ = triangle_fan()

    def x(v):
        return 1

    rejects(ebb.RelationError, "E5", lambda: vertices.member(x))
    rejects(ebb.RelationError, "E5", lambda: vertices.member("not a name")(x))


def test_a_member_that_is_a_key_and_can_be_set_leads_to_the_fields_of_its_row(backend):
    rows = ebb.Relation("rows", size=4)
    rows.new_field("next", rows, init=[1, 2, 3, 0])
    rows.new_field("x", ebb.float64, init=0.0)

    @rows.member
    def mate(r):
        return r.next

    @mate.setter
    def set_mate(r, other):
        r.next = other

    @ebb.kernel
    def give(r: rows):
        r.mate.x += 1.0 + ebb.float64(ebb.id(r))

    give(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [4.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(rows.next.to_numpy(), [1, 2, 3, 0])


def test_a_component_of_a_member_with_a_setter(backend):
    points = ebb.Relation("points", size=2)
    points.new_field("mass", ebb.float64, init=2.0)
    points.new_field("velocity", ebb.vec3d, init=lambda i: [i, 1, 2])
    points.new_field("column", ebb.vec2d, init=0.0)

    @points.member
    def momentum(p):
        return p.mass * p.velocity

    @momentum.setter
    def set_momentum(p, value):
        p.velocity = value / p.mass

    @points.member
    def frame(p):
        return [[p.mass, p.column.x], [0.0, p.column.y]]

    @frame.setter
    def set_frame(p, value):
        p.column = [value[0, 1], value[1, 1]]

    @ebb.kernel
    def push(p: points):
        p.momentum.x = 10
        p.momentum[1] += p.momentum.x
        p.momentum.z, p.frame[0, 1] = 7.0, 3.0
        p.frame[1][1] -= 4
        p.momentum.y = max(p.momentum.y, 50.0)

    push(points)
    np.testing.assert_array_equal(points.velocity.to_numpy(), [[5, 25, 3.5]] * 2)
    np.testing.assert_array_equal(points.column.to_numpy(), [[3, -4]] * 2)
