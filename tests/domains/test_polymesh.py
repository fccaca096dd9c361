"""Polygons and polyhedra: every incidence both ways against sets, areas and volumes, boundaries, generators."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import ebb
from ebb.domains import HexMesh, PolyMesh, TetMesh, TriMesh

KINDS = ("vertices", "edges", "faces", "cells")
SHAPES = {
    "triangle": lambda: PolyMesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]),
    "checkered": lambda: PolyMesh.grid(3, 4, split="checkered"),
    "globe": lambda: PolyMesh.globe(7, 5),
    "goldberg": lambda: PolyMesh.goldberg(1),
    "box": lambda: PolyMesh.box(2, 3, 2),
    "dual": lambda: PolyMesh.dual(TetMesh.box(2, 2, 2)),
    "shuffled dual": lambda: shuffled(PolyMesh.dual(TetMesh.ball(2))),
}


def lists(table, by, of):
    """For each row that ``by`` refers to, the rows that ``of`` refers to."""
    rows = [[] for _ in range(table.fields[by].target.size)]
    for key, value in zip(table.fields[by].to_numpy().tolist(), table.fields[of].to_numpy().tolist(), strict=True):
        rows[key].append(value)
    return rows


def arrays_of(mesh):
    """What a mesh is made from: points, corners of faces, faces of cells."""
    return (
        mesh.vertices.pos.to_numpy().astype(float),
        lists(mesh.corners, "face", "vertex"),
        lists(mesh.sides, "cell", "face"),
    )


def shuffled(mesh, seed=4):
    """The same mesh: points, faces and cells in another order, faces turned over and begun elsewhere."""
    rng = np.random.default_rng(seed)
    points, faces, cells = arrays_of(mesh)
    point, face = rng.permutation(len(points)), rng.permutation(len(faces))
    moved = np.empty_like(points)
    moved[point] = points
    placed = [[] for _ in faces]
    for number, corners in enumerate(faces):
        turned = np.roll(point[corners], rng.integers(5)).tolist()
        placed[face[number]] = turned[::-1] if rng.random() < 0.5 else turned
    rng.shuffle(cells)
    return PolyMesh.from_arrays(moved, placed, [rng.permutation(face[cell]).tolist() for cell in cells])


@pytest.fixture(params=SHAPES)
def mesh(request):
    return SHAPES[request.param]()


def incidences(mesh):
    """The pairs of each two kinds, by sets, from corners and faces alone: a definition to hold the tables against."""
    _, faces, cells = arrays_of(mesh)
    ends = list(zip(mesh.edges.tail.to_numpy().tolist(), mesh.edges.head.to_numpy().tolist(), strict=True))
    number = {frozenset(pair): row for row, pair in enumerate(ends)}
    around = [[number[frozenset(p)] for p in zip(f, f[1:] + f[:1], strict=True)] for f in faces]
    pairs = {
        ("edges", "vertices"): {(e, v) for e, pair in enumerate(ends) for v in pair},
        ("faces", "vertices"): {(f, v) for f, corners in enumerate(faces) for v in corners},
        ("faces", "edges"): {(f, e) for f, edges in enumerate(around) for e in edges},
        ("cells", "faces"): {(c, f) for c, own in enumerate(cells) for f in own},
        ("cells", "vertices"): {(c, v) for c, own in enumerate(cells) for f in own for v in faces[f]},
        ("cells", "edges"): {(c, e) for c, own in enumerate(cells) for f in own for e in around[f]},
    }
    return pairs | {(b, a): {(y, x) for x, y in rows} for (a, b), rows in pairs.items()}


def count_and_sum(relation, member):
    """How many elements a member has, and the sum of their numbers squared, by a kernel."""

    @ebb.kernel
    def visit(a: relation):
        for b in a[member]:
            a.found += 1
            a.total += ebb.id(b) * ebb.id(b)

    relation.found.fill(0)
    relation.total.fill(0)
    visit(relation)
    return relation.found.to_numpy(), relation.total.to_numpy()


def test_every_incidence_both_ways(mesh):
    for kind in KINDS:
        getattr(mesh, kind).new_field("found", ebb.int64, init=0)
        getattr(mesh, kind).new_field("total", ebb.int64, init=0)
    for (kind, other), pairs in incidences(mesh).items():
        relation = getattr(mesh, kind)
        found, total = count_and_sum(relation, other)
        first, second = np.array(sorted(pairs), dtype=int).reshape(-1, 2).T
        assert np.array_equal(found, np.bincount(first, minlength=relation.size)), (kind, other)
        assert np.array_equal(total, np.bincount(first, second**2, relation.size)), (kind, other)
    found, total = count_and_sum(mesh.vertices, "neighbors")
    tail, head = mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy()
    assert np.array_equal(found, np.bincount(np.concatenate([tail, head]), minlength=mesh.vertices.size))
    squares = np.concatenate([head, tail]).astype(float) ** 2
    assert np.array_equal(total, np.bincount(np.concatenate([tail, head]), squares, mesh.vertices.size))


def test_faces_go_around_in_order_and_joins_agree(mesh):
    mesh.faces.new_field("order", ebb.int64, init=0)
    mesh.faces.new_field("edge_order", ebb.int64, init=0)

    @ebb.kernel
    def walk(f: mesh.faces):
        place = 1
        for v in f.vertices:
            f.order += place * ebb.id(v)
            place += 1
        place = 1
        for e in f.edges:
            f.edge_order += place * ebb.id(e)
            place += 1
        for c in f.corners:
            assert c.face == f
            assert (c.edge.tail == c.vertex and c.edge.head == c.next) or (
                c.edge.head == c.vertex and c.edge.tail == c.next
            )
        for s in f.sides:
            assert s.face == f

    @ebb.kernel
    def join(e: mesh.edges):
        assert e.tail != e.head
        for end in e.ends:
            assert end.edge == e and end.vertex != end.other
            assert end.vertex == e.tail or end.vertex == e.head
        for c in e.corners:
            assert c.edge == e

    walk(mesh.faces)
    join(mesh.edges)
    faces, edges = lists(mesh.corners, "face", "vertex"), lists(mesh.corners, "face", "edge")
    weigh = [sum((place + 1) * row for place, row in enumerate(rows)) for rows in faces]
    assert mesh.faces.order.to_numpy().tolist() == weigh
    assert mesh.faces.edge_order.to_numpy().tolist() == [
        sum((place + 1) * row for place, row in enumerate(rows)) for rows in edges
    ]


def test_boundaries(mesh):
    _, faces, cells = arrays_of(mesh)
    around = lists(mesh.corners, "face", "edge")
    if cells:
        outer = {f for f, count in Counter(f for cell in cells for f in cell).items() if count == 1}
        assert counted(mesh.faces.boundary) == outer
        edges, vertices = {e for f in outer for e in around[f]}, {v for f in outer for v in faces[f]}
    else:
        edges = {e for e, count in Counter(e for own in around for e in own).items() if count == 1}
        vertices = {v for e in edges for v in (mesh.edges.tail.to_numpy()[e], mesh.edges.head.to_numpy()[e])}
    for relation, rows in ((mesh.edges, edges), (mesh.vertices, vertices)):
        assert counted(relation.boundary) == rows
        assert counted(relation.interior) == set(range(relation.size)) - rows


def counted(subset):
    """The rows of a subset, by a kernel."""
    name = f"mark_{subset.name}"
    subset.relation.new_field(name, ebb.int32, init=0)

    @ebb.kernel
    def mark(a, field: str):
        a[field] = 1

    mark(subset, name)
    return set(np.flatnonzero(subset.relation.fields[name].to_numpy()).tolist())


@pytest.mark.parametrize("precision", [ebb.float32, ebb.float64])
def test_areas_volumes_and_centres(precision):
    mesh = PolyMesh.dual(TetMesh.box(3, 2, 2, size=(3, 2, 2)), precision=precision)
    volume, area = ebb.Global(ebb.float64, 0.0), ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def enclose(s: mesh.sides):
        volume.value += s.sign * ebb.dot(s.face.center, s.face.area) / 3

    @ebb.kernel
    def outside(f: mesh.faces):
        area.value += ebb.length(f.area)

    @ebb.kernel
    def inside(c: mesh.cells):
        for s in c.sides:
            assert s.sign * ebb.dot(s.face.area, s.face.center - c.center) > 0

    enclose(mesh.sides)
    outside(mesh.faces.boundary)
    inside(mesh.cells)
    assert mesh.cells.volume.to_numpy().sum() == pytest.approx(12)
    assert volume.value == pytest.approx(12, rel=1e-5)
    assert area.value == pytest.approx(32, rel=1e-5)


def test_turning_faces_over_changes_no_volume():
    mesh = PolyMesh.dual(TetMesh.ball(2))
    assert np.sort(shuffled(mesh).cells.volume.to_numpy()) == pytest.approx(np.sort(mesh.cells.volume.to_numpy()))
    assert mesh.cells.volume.to_numpy().sum() == pytest.approx(TetMesh.ball(2).tetrahedra.volume.to_numpy().sum())


def test_a_cell_that_is_not_convex_has_its_volume():
    # A cross section like an L, 1 high: three squares of area 1.
    section = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]]
    points = [[x, y, z] for z in (0, 1) for x, y in section]
    sides = [[i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6)]
    mesh = PolyMesh.from_arrays(points, [list(range(6)), list(range(6, 12)), *sides], [list(range(8))])
    assert mesh.cells.volume.to_numpy() == pytest.approx([3])


def test_euler_characteristics():
    for name, expected in {"checkered": 1, "globe": 2, "goldberg": 2, "box": 1, "dual": 1}.items():
        mesh = SHAPES[name]()
        counts = [getattr(mesh, kind).size for kind in KINDS]
        assert counts[0] - counts[1] + counts[2] - counts[3] == expected, name


def test_generators():
    sizes = Counter(map(len, lists(PolyMesh.goldberg(2).corners, "face", "vertex")))
    assert sizes == {5: 12, 6: 150}
    sizes = Counter(map(len, lists(PolyMesh.globe(8, 6).corners, "face", "vertex")))
    assert sizes == {3: 16, 4: 32}
    sizes = Counter(map(len, lists(PolyMesh.grid(4, 4, split="checkered").corners, "face", "vertex")))
    assert sizes == {3: 16, 4: 8}
    foam = PolyMesh.dual(TetMesh.box(3, 3, 3))
    outer = counted(foam.faces.boundary)
    inner = [cell for cell in lists(foam.sides, "cell", "face") if not outer.intersection(cell)]
    assert list(map(len, inner)) == [14] * 8

    @ebb.kernel
    def look(f):
        assert ebb.dot(f.area, f.center) > 0

    look(PolyMesh.globe(9, 7).faces)
    look(PolyMesh.goldberg(2).faces)
    with pytest.raises(ValueError, match="split should be"):
        PolyMesh.grid(2, 2, split="triangles")
    with pytest.raises(ValueError, match="n_up should be an integer >= 2"):
        PolyMesh.globe(8, 1)


def test_from_other_meshes():
    solid, bricks, surface = TetMesh.ball(2), HexMesh.box(2, 2, 3), TriMesh.torus()
    made = PolyMesh.from_mesh(solid)
    assert made.cells.volume.to_numpy() == pytest.approx(solid.tetrahedra.volume.to_numpy())
    assert (made.edges.size, counted(made.faces.boundary)) == (
        solid.edges.size // 2,
        set(np.flatnonzero(np.bincount(made.sides.face.to_numpy()) == 1).tolist()),
    )
    assert len(counted(made.faces.interior)) == 2 * solid.tetrahedra.size - solid.triangles.size // 2
    assert PolyMesh.from_mesh(bricks).cells.volume.to_numpy() == pytest.approx(np.full(12, 1 / 12))
    made = PolyMesh.from_mesh(surface)
    assert lists(made.corners, "face", "vertex") == surface.triangles.v.to_numpy().tolist()
    assert repr(made) == "<PolyMesh: 1152 vertices, 3456 edges, 2304 faces>"


def test_a_smoothing_step_runs_everywhere(backend):
    mesh = PolyMesh.globe(6, 4)
    mesh.vertices.new_field("next", ebb.vec3f, init=0.0)

    @ebb.kernel
    def smooth(v: mesh.vertices):
        total, weight = ebb.zeros(ebb.vec3f), ebb.float32(0)
        for f in v.faces:
            area = ebb.length(f.area)
            total += area * f.center
            weight += area
        v.next = total / weight

    smooth(mesh.vertices)
    points, faces, _ = arrays_of(mesh)
    moved, weights = np.zeros_like(points), np.zeros(len(points))
    for corners in faces:
        p = points[corners]
        centre = p.mean(axis=0)
        area = np.linalg.norm(np.cross(p - centre, np.roll(p, -1, axis=0) - centre).sum(axis=0)) / 2
        moved[corners] += area * centre
        weights[corners] += area
    assert mesh.vertices.next.to_numpy() == pytest.approx(moved / weights[:, None], abs=1e-5)
