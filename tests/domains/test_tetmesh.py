"""Solids: volumes, boundaries, edges and incidences."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import TetMesh, TriMesh

SHAPES = {
    "cube": (lambda **options: TetMesh.box(1, 1, 1, **options), 1.0),
    "box": (lambda **options: TetMesh.box(2, 3, 4, size=(1, 2, 3), **options), 6.0),
    "small ball": (lambda **options: TetMesh.ball(1, **options), 2.53615),
    "ball": (lambda **options: TetMesh.ball(4, radius=2.0, **options), 4 / 3 * np.pi * 8),
}


@pytest.fixture(params=SHAPES)
def shape(request):
    return SHAPES[request.param]


def boundary_surface(mesh):
    used, triangles = np.unique(mesh.triangles.v.to_numpy(), return_inverse=True)
    return TriMesh.from_arrays(mesh.vertices.pos.to_numpy()[used], triangles.reshape(-1, 3))


def test_volumes_are_positive_and_sum_up(shape):
    make, volume = shape
    mesh = make()
    volumes = mesh.tetrahedra.volume.to_numpy()
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(volume, rel=0.04)


def test_boundary_is_a_closed_outward_surface_about_the_same_volume(shape):
    make, _ = shape
    mesh = make()
    surface = boundary_surface(mesh)  # which checks that the triangles turn alike and that two meet at each edge
    assert surface.edges.size == 3 * surface.triangles.size
    assert surface.vertices.size - surface.edges.size // 2 + surface.triangles.size == 2
    points, triangles = surface.vertices.pos.to_numpy().astype(float), surface.triangles.v.to_numpy()
    a, b, c = (points[triangles[:, i]] for i in range(3))
    assert np.einsum("ij,ij", np.cross(a, b), c) / 6 == pytest.approx(mesh.tetrahedra.volume.to_numpy().sum(), rel=1e-5)


def test_euler_characteristic_of_a_solid(shape):
    make, _ = shape
    mesh = make()
    faces = (4 * mesh.tetrahedra.size + mesh.triangles.size) // 2
    assert mesh.vertices.size - mesh.edges.size // 2 + faces - mesh.tetrahedra.size == 1


@pytest.mark.parametrize("self_edges", [False, True])
def test_edge_matrix_joins_the_corners(shape, self_edges):
    make, _ = shape
    mesh = make(self_edges=self_edges)
    tail, head = mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy()
    edge, corners = mesh.tetrahedra.e.to_numpy(), mesh.tetrahedra.v.to_numpy()
    for i in range(4):
        for j in range(4):
            if i != j or self_edges:
                assert (tail[edge[:, i, j]] == corners[:, i]).all()
                assert (head[edge[:, i, j]] == corners[:, j]).all()
            else:
                assert (edge[:, i, j] == -1).all()
    pairs = set(zip(tail.tolist(), head.tolist(), strict=True))
    assert len(pairs) == mesh.edges.size
    assert sum(a == b for a, b in pairs) == (mesh.vertices.size if self_edges else 0)


def test_self_edges_are_the_diagonal():
    mesh = TetMesh.box(2, 2, 2, self_edges=True)
    diagonal = mesh.vertices.diag.to_numpy()
    rows = np.arange(mesh.vertices.size)
    assert np.array_equal(mesh.edges.tail.to_numpy()[diagonal], rows)
    assert np.array_equal(mesh.edges.head.to_numpy()[diagonal], rows)
    assert "diag" not in TetMesh.box(1, 1, 1).vertices.fields


def test_following_the_diagonal_without_self_edges_is_an_error():
    mesh = TetMesh.box(1, 1, 1)
    tetrahedra, edges = mesh.tetrahedra, mesh.edges
    edges.new_field("weight", ebb.float64, init=1.0)
    tetrahedra.new_field("sum", ebb.float64, init=0.0)

    @ebb.kernel
    def read_diagonal(t: tetrahedra):
        t.sum += t.e[1, 1].weight

    with pytest.raises(ebb.EbbError, match=r"tetrahedra\.e.*is not set"):
        read_diagonal(tetrahedra)


def test_members_in_kernels(shape):
    make, _ = shape
    mesh = make()
    vertices = mesh.vertices
    vertices.new_field("degree", ebb.int64, init=0)
    vertices.new_field("neighbor_sum", ebb.int64, init=0)
    vertices.new_field("share", ebb.float64, init=0.0)

    @ebb.kernel
    def gather(v: vertices):
        for e in v.edges:
            v.degree += 1
            assert e.tail == v
        for n in v.neighbors:
            v.neighbor_sum += ebb.id(n)
        for t in v.tetrahedra:
            v.share += t.volume / 4

    gather(vertices)
    tail, head = mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy()
    n = vertices.size
    volume, corners = mesh.tetrahedra.volume.to_numpy(), mesh.tetrahedra.v.to_numpy()
    assert np.array_equal(vertices.degree.to_numpy(), np.bincount(tail, minlength=n))
    assert np.array_equal(vertices.neighbor_sum.to_numpy(), np.bincount(tail, head, n))
    assert vertices.share.to_numpy() == pytest.approx(np.bincount(corners.ravel(), np.repeat(volume / 4, 4), n))
    assert vertices.share.to_numpy().sum() == pytest.approx(volume.sum())


def test_elements_of_the_ball_are_of_similar_size():
    volumes = TetMesh.ball(6).tetrahedra.volume.to_numpy()
    assert len(volumes) == 20 * 6**3
    assert volumes.max() / volumes.min() < 2.5


def test_inverted_elements_are_turned_on_request():
    points, cells = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1, 3]]
    with pytest.raises(ebb.MeshFormatError, match="inverted"):
        TetMesh.from_arrays(points, cells)
    for fix_orientation in (True, None):
        mesh = TetMesh.from_arrays(points, cells, fix_orientation=fix_orientation)
        assert mesh.tetrahedra.volume.to_numpy() == pytest.approx([1 / 6])
        assert mesh.tetrahedra.v.to_numpy().tolist() == [[0, 2, 3, 1]] and mesh.turned == 1
    assert TetMesh.box(1, 1, 1).turned == 0


def test_an_element_may_not_be_given_twice():
    box = TetMesh.box(2, 2, 2)
    points, cells = box.vertices.pos.to_numpy(), box.tetrahedra.v.to_numpy()
    for order in ([0, 1, 2, 3], [1, 2, 0, 3]):
        for kept in (cells, cells[[5, 20, 30]]):  # where others are at its faces, and where none are
            with pytest.raises(
                ebb.MeshFormatError, match=rf"tetrahedron {len(kept)} .* is the tetrahedron 1 once more"
            ):
                TetMesh.from_arrays(points, np.concatenate([kept, kept[1:2][:, order]]))


def test_the_caller_keeps_the_arrays():
    points, cells = np.eye(4, 3), np.array([[3, 0, 1, 2]])
    before = points.copy(), cells.copy()
    TetMesh.from_arrays(points, cells)
    assert np.array_equal(points, before[0]) and np.array_equal(cells, before[1])


def test_random_meshes_agree_with_sets():
    rng = np.random.default_rng(5)
    box = TetMesh.box(3, 3, 3)
    points, cells = box.vertices.pos.to_numpy(), box.tetrahedra.v.to_numpy()
    for _ in range(5):
        kept = cells[rng.random(len(cells)) < 0.5]
        mesh = TetMesh.from_arrays(points, kept)
        pairs = {(int(a), int(b)) for cell in kept for a in cell for b in cell if a != b}
        found = zip(mesh.edges.tail.to_numpy().tolist(), mesh.edges.head.to_numpy().tolist(), strict=True)
        assert set(found) == pairs
        faces: dict[tuple[int, ...], int] = {}
        for cell in kept.tolist():
            for i in range(4):
                face = tuple(sorted(cell[:i] + cell[i + 1 :]))
                faces[face] = faces.get(face, 0) + 1
        single = {face for face, count in faces.items() if count == 1}
        assert {tuple(sorted(face)) for face in mesh.triangles.v.to_numpy().tolist()} == single


def test_positions_in_float64():
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]) + 1e6 + 1e-5
    mesh = TetMesh.from_arrays(points, [(0, 1, 2, 3)], precision=ebb.float64)
    assert mesh.vertices.pos.type == ebb.vec3d
    np.testing.assert_array_equal(mesh.vertices.pos.to_numpy(), points)
    assert mesh.vertices.pos.to_numpy()[1, 0] - mesh.vertices.pos.to_numpy()[0, 0] == 1
    TetMesh.from_arrays(points * 1e60, [(0, 1, 2, 3)], precision=ebb.float64)
    with pytest.raises(ebb.MeshFormatError, match=r"E712.*precision"):
        TetMesh.from_arrays(points, [(0, 1, 2, 3)], precision=ebb.int32)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_matrix_of_blocks_is_assembled_on_the_edges(backend):
    """Blocks of an element matrix are added through ``t.e``: against a sum in NumPy."""
    mesh = TetMesh.ball(2, self_edges=True, precision=ebb.float64)
    tetrahedra, edges = mesh.tetrahedra, mesh.edges
    edges.new_field("stiffness", ebb.mat3d, init=0.0)

    @ebb.kernel
    def assemble(t: tetrahedra):
        for i in range(4):
            for j in range(4):
                t.e[i, j].stiffness += t.volume * ebb.outer(t.v[i].pos, t.v[j].pos)

    with ebb.backend(backend):
        assemble(tetrahedra)
    n = mesh.vertices.size
    expected = np.zeros((n, n, 3, 3))
    corners, pos = tetrahedra.v.to_numpy(), mesh.vertices.pos.to_numpy()
    for volume, rows in zip(tetrahedra.volume.to_numpy(), corners, strict=True):
        for i in rows:
            for j in rows:
                expected[i, j] += volume * np.outer(pos[i], pos[j])
    found = edges.stiffness.to_numpy()
    tail, head = edges.tail.to_numpy(), edges.head.to_numpy()
    np.testing.assert_allclose(found, expected[tail, head], rtol=1e-12, atol=1e-14)
    diagonal = mesh.vertices.diag.to_numpy()
    np.testing.assert_allclose(found[diagonal], expected[np.arange(n), np.arange(n)], rtol=1e-12, atol=1e-14)


def test_assembly_has_the_same_bits_for_any_number_of_threads():
    found = []
    for threads in (1, 2, 3):
        with ebb.backend("cpu", threads=threads):
            mesh = TetMesh.box(9, 9, 9, self_edges=True)
            tetrahedra = mesh.tetrahedra
            mesh.edges.new_field("stiffness", ebb.mat3d, init=0.0)

            @ebb.kernel
            def assemble(t: tetrahedra):
                for i in range(4):
                    for j in range(4):
                        t.e[i, j].stiffness += t.volume * ebb.outer(ebb.vec3d(t.v[i].pos), ebb.vec3d(t.v[j].pos))

            for _ in range(3):
                assemble(tetrahedra)
            found.append(mesh.edges.stiffness.to_numpy().tobytes())
    assert found[0] == found[1] == found[2]


def test_corners_are_made_when_a_kernel_asks_for_them():
    mesh = TetMesh.box(2, 1, 1)
    vertices = mesh.vertices
    vertices.new_field("share", ebb.float64, init=0.0)

    @ebb.kernel
    def share(v: vertices):
        for t in v.tetrahedra:
            v.share += t.volume / 4

    with ebb.capture() as step:  # also where launches are only recorded
        share(vertices)
    step.run()
    assert vertices.share.to_numpy().sum() == pytest.approx(1.0)
    assert mesh.corners.size == 4 * mesh.tetrahedra.size
