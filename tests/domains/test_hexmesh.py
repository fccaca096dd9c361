"""Solids of hexahedra: neighbours, kinds of boundaries, incidences, files, and arrays that are refused."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import Grid3D, HexGrid, HexMesh
from ebb.domains.hexahedra import FACES, SIDES, hex_volumes

CUBE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
OCTANT = ("xneg", "yneg", "zneg")


def neighbors_of(mesh):
    return np.stack([mesh.elements.fields[side].to_numpy() for side in SIDES], axis=1)


def arrays_of(mesh):
    return mesh.vertices.pos.to_numpy().astype(float), mesh.elements.v.to_numpy().astype(int)


def shuffled(points, cells, seed=3):
    """The same solid with points and elements in another order, each element turned in its own frame."""
    rng = np.random.default_rng(seed)
    place, order = rng.permutation(len(points)), rng.permutation(len(cells))
    moved = np.empty_like(points)
    moved[place] = points
    turns = np.array([(0, 1, 2, 3, 4, 5, 6, 7), (1, 2, 3, 0, 5, 6, 7, 4), (3, 2, 6, 7, 0, 1, 5, 4)])
    turn = turns[rng.integers(len(turns), size=len(cells))]
    return moved, np.take_along_axis(place[cells[order]], turn, axis=1)


def test_a_box_is_numbered_as_a_grid():
    mesh = HexMesh.box(2, 3, 4, size=(2, 6, 12), precision=ebb.float64)
    points, cells = arrays_of(mesh)
    centres = points[cells].mean(axis=1).reshape(2, 3, 4, 3)
    assert centres[1, 2, 3].tolist() == [1.5, 5, 10.5]
    assert centres[0, 0, 1].tolist() == [0.5, 1, 4.5]
    assert hex_volumes(points, cells) == pytest.approx(np.full(24, 6.0))
    assert mesh.vertices.pos.type == ebb.vec3d
    first = points[cells[0]] / [1, 2, 3]
    assert first.tolist() == CUBE


def test_neighbors_of_a_box_agree_with_those_found_by_faces():
    box = HexMesh.box(3, 2, 4)
    again = HexMesh.from_arrays(*arrays_of(box))
    assert np.array_equal(neighbors_of(box), neighbors_of(again))
    assert np.array_equal(box.elements.sides.to_numpy(), again.elements.sides.to_numpy())
    assert np.array_equal(box.quads.v.to_numpy(), again.quads.v.to_numpy())


def test_neighbors_share_the_face_between_them():
    points, cells = arrays_of(HexMesh.box(3, 3, 2))
    mesh = HexMesh.from_arrays(*shuffled(points, cells))
    points, cells = arrays_of(mesh)
    neighbors, kinds = neighbors_of(mesh), mesh.elements.sides.to_numpy()
    faces: dict[frozenset[int], list[int]] = {}
    for element, corners in enumerate(cells):
        for face in FACES:
            faces.setdefault(frozenset(corners[face].tolist()), []).append(element)
    for element, corners in enumerate(cells):
        for side, face in enumerate(FACES):
            [other] = [e for e in faces[frozenset(corners[face].tolist())] if e != element] or [element]
            assert neighbors[element, side] == other
            assert (kinds[element] >> 2 * side & 3 == HexMesh.FREE) == (other == element)


def test_the_boundary_is_closed_and_outward():
    mesh = HexMesh.from_arrays(*shuffled(*arrays_of(HexMesh.box(3, 2, 2, size=(3, 2, 2)))))
    points, _ = arrays_of(mesh)
    a, b, c, d = (points[mesh.quads.v.to_numpy()[:, i]] for i in range(4))
    assert mesh.quads.size == 2 * (6 + 6 + 4)
    assert np.einsum("ij,ij", np.cross(a, b) + np.cross(c, d) + np.cross(b, c) + np.cross(d, a), (a + c) / 2) / 6 == (
        pytest.approx(12)
    )
    assert np.linalg.norm(np.cross(c - a, d - b), axis=1).sum() / 2 == pytest.approx(32)


def octant(n, made):
    """A cube of n elements a side, with three planes of symmetry."""
    mesh = HexMesh.box(n, n, n, symmetry=OCTANT)
    if made == "box":
        return mesh
    points, cells = arrays_of(mesh)
    return HexMesh.from_arrays(points, cells, symmetry={f: points[:, axis] == 0 for axis, f in enumerate(OCTANT)})


@pytest.mark.parametrize("made", ["box", "arrays"])
def test_kinds_of_boundaries_in_kernels(made):
    n = 3
    mesh = octant(n, made)
    elements, vertices = mesh.elements, mesh.vertices
    elements.new_field("kinds", ebb.vec3i, init=0)
    vertices.new_field("fixed", ebb.int32, init=0)

    @ebb.kernel
    def count(e: elements):
        for side in range(6):
            e.kinds[e.boundary(side)] += 1
        assert (e.xneg == e) == (e.boundary(0) != HexMesh.INTERIOR)
        assert e.xpos == e or e.xpos.xneg == e
        assert e.zneg == e or e.zneg.v[4] == e.v[0]

    @ebb.kernel
    def fix(v: vertices):
        v.fixed += 1

    count(elements)
    for name in OCTANT:
        fix(getattr(vertices, name))
    grid, nodes = np.indices((n, n, n)), np.indices((n + 1, n + 1, n + 1))
    kinds = elements.kinds.to_numpy().reshape(n, n, n, 3)
    assert np.array_equal(kinds[..., HexMesh.SYMMETRY], (grid == 0).sum(axis=0))
    assert np.array_equal(kinds[..., HexMesh.FREE], (grid == n - 1).sum(axis=0))
    assert (kinds.sum(axis=-1) == 6).all()
    assert np.array_equal(vertices.fixed.to_numpy(), (nodes == 0).sum(axis=0).ravel())


@pytest.mark.parametrize("made", ["box", "arrays"])
def test_corners_join_vertices_and_elements(made):
    n = 3
    mesh = octant(n, made)
    vertices = mesh.vertices
    vertices.new_field("degree", ebb.int32, init=0)
    vertices.new_field("sum", ebb.int64, init=0)

    @ebb.kernel
    def gather(v: vertices):
        for e in v.elements:
            v.sum += ebb.id(e)
        for c in v.corners:
            v.degree += 1
            assert c.element.v[c.number] == v

    gather(vertices)
    nodes, cells = np.indices((n + 1, n + 1, n + 1)), mesh.elements.v.to_numpy()
    assert np.array_equal(vertices.degree.to_numpy(), 2 ** ((nodes > 0) & (nodes < n)).sum(axis=0).ravel())
    assert np.array_equal(vertices.sum.to_numpy(), np.bincount(cells.ravel(), np.repeat(np.arange(n**3), 8)))


def test_a_grid_and_a_bent_box():
    grid = Grid3D((2, 3, 4), origin=(1, 2, 3), extent=(2, 6, 8))
    mesh = HexMesh.from_grid(grid)
    points, cells = arrays_of(mesh)
    place = np.stack(np.meshgrid([1.5, 2.5], [3, 5, 7], [4, 6, 8, 10], indexing="ij"), axis=-1)
    assert np.allclose(points[cells].mean(axis=1), place.reshape(-1, 3))
    assert points.min(axis=0).tolist() == [1, 2, 3]
    assert points.max(axis=0).tolist() == [3, 8, 11]
    r, angle, z = np.meshgrid(np.linspace(1, 2, 3), np.linspace(0, np.pi / 2, 9), np.linspace(0, 1, 2), indexing="ij")
    sector = HexMesh.from_grid(np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1), symmetry=["yneg", "ypos"])
    assert hex_volumes(*arrays_of(sector)).sum() == pytest.approx(np.pi / 4 * 3, rel=0.01)
    with pytest.raises(ValueError, match="periodic"):
        HexMesh.from_grid(Grid3D((2, 2, 2), periodic=True))
    with pytest.raises(ValueError, match="symmetry should name sides"):
        HexMesh.box(1, 1, 1, symmetry=["left"])
    with pytest.raises(ValueError, match="nx should be an integer"):
        HexMesh.box(0, 1, 1)
    with pytest.raises(ValueError, match="positive lengths"):
        HexMesh.box(1, 1, 1, size=(1, 0, 1))
    with pytest.raises(ValueError, match="positive lengths"):
        HexGrid.box(1, 1, 1, size=(np.inf, 1, 1))


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh", "inp"])
def test_files(tmp_path, suffix):
    pytest.importorskip("meshio")
    mesh = HexMesh.from_arrays(*shuffled(*arrays_of(HexMesh.box(2, 2, 3))), precision=ebb.float64)
    fields = []
    if suffix in ("vtu", "vtk"):
        mesh.elements.new_field("e", ebb.float64, init=np.arange(12.0))
        fields.append(mesh.elements.e)
    path = tmp_path / f"body.{suffix}"
    mesh.save(path, fields=fields)
    again = HexMesh.load(path, precision=ebb.float64, fix_orientation=False)
    assert np.allclose(again.vertices.pos.to_numpy(), mesh.vertices.pos.to_numpy())
    assert np.array_equal(again.elements.v.to_numpy(), mesh.elements.v.to_numpy())
    assert np.array_equal(neighbors_of(again), neighbors_of(mesh))


def moved(corner, place):
    points = np.array(CUBE, dtype=float)
    points[corner] = place
    return points


INVERTED = [4, 5, 6, 7, 0, 1, 2, 3]
STAR = [*CUBE, *np.add(CUBE[:4], [3, 3, 5]).tolist(), *np.add(CUBE[:4], [-3, 3, 5]).tolist()]
REFUSED = {
    "tetrahedra": (CUBE, [[0, 1, 2, 3]], "E712", r"\(n, 8\)"),
    "index too large": (CUBE, [[0, 1, 2, 3, 4, 5, 6, 8]], "E705", "element 0 has the corner 8"),
    "not finite": (moved(3, [0, np.nan, 0]), [list(range(8))], "E706", "point 3"),
    "corner twice": (CUBE, [list(range(8)), [0, 1, 2, 3, 4, 5, 6, 6]], "E707", "element 1 .* names one point twice"),
    "flat": ([[x, y, 0] for x, y, _ in CUBE], [list(range(8))], "E707", "no volume"),
    "inverted": (CUBE, [INVERTED], "E708", "element 0 .* is inverted: its volume is -1"),
    "wrong order": (CUBE, [[0, 1, 3, 2, 4, 5, 7, 6]], "E715", "is folded at the points"),
    "folded": (moved(6, [0.2, 0.2, 0.2]), [list(range(8))], "E715", "is folded at the point"),
    "corner in a plane": (moved(6, [1 / 3, 5 / 6, 5 / 6]), [list(range(8))], "E715", "is folded at the point"),
    "three at a face": (
        STAR,
        [[0, 1, 2, 3, 4, 5, 6, 7], [0, 1, 2, 3, 8, 9, 10, 11], [0, 1, 2, 3, 12, 13, 14, 15]],
        "E709",
        "one of 3 at the face",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    points, cells, code, text = REFUSED[name]
    with pytest.raises(ebb.MeshFormatError, match=text) as caught:
        HexMesh.from_arrays(points, cells)
    assert caught.value.codes == (code,)


def test_bad_elements_are_counted():
    points, cells = arrays_of(HexMesh.box(2, 2, 2))
    cells[[2, 5]] = cells[[2, 5]][:, INVERTED]
    with pytest.raises(ebb.MeshFormatError, match="2 of the 8 elements are inverted") as caught:
        HexMesh.from_arrays(points, cells)
    assert "element 2" in str(caught.value)
    mesh = HexMesh.from_arrays(points, cells, fix_orientation=True)
    assert hex_volumes(*arrays_of(mesh)) == pytest.approx(np.full(8, 1 / 8)) and mesh.turned == 2
    with pytest.raises(ebb.MeshFormatError, match="2 of the 8 elements are inverted"):
        HexMesh.from_arrays(points, cells, fix_orientation=None)
    assert HexMesh.from_arrays(points, cells[[2, 5]], fix_orientation=None).turned == 2
    cells[1] = cells[1, 0]
    cells[3, 7] = cells[3, 6]
    with pytest.raises(ebb.MeshFormatError, match="2 of the 8 elements are degenerate"):
        HexMesh.from_arrays(points, cells)


@pytest.mark.parametrize("kept", [slice(None), [0, 3, 7]])
def test_an_element_may_not_be_given_twice(kept):
    points, cells = arrays_of(HexMesh.box(2, 2, 2))
    given = cells[kept]
    twice = np.concatenate([given, given[1:2, [1, 2, 3, 0, 5, 6, 7, 4]]])
    with pytest.raises(ebb.MeshFormatError, match=rf"element {len(given)} .* is the element 1 once more"):
        HexMesh.from_arrays(points, twice)


def test_bad_options():
    with pytest.raises(ebb.MeshFormatError, match=r"precision should be ebb.float32 or ebb.float64"):
        HexMesh.box(1, 1, 1, precision=ebb.int32)
    with pytest.raises(ebb.MeshFormatError, match="symmetry"):
        HexMesh.from_arrays(CUBE, [list(range(8))], symmetry={"left": [8]})


def test_an_empty_mesh_and_one_element():
    mesh = HexMesh.from_arrays([], [])
    assert (mesh.vertices.size, mesh.elements.size, mesh.quads.size, mesh.corners.size) == (0, 0, 0, 0)
    assert (
        repr(HexMesh.from_arrays(CUBE, [list(range(8))])) == "<HexMesh: 8 vertices, 1 elements, 6 boundary quadrangles>"
    )


def test_scale_does_not_decide_what_is_flat():
    for scale in (1e-30, 1e30):
        assert HexMesh.from_arrays(np.multiply(CUBE, scale), [list(range(8))], precision=ebb.float64).quads.size == 6


def test_a_set_of_no_points():
    mesh = HexMesh.from_arrays(*arrays_of(HexMesh.box(1, 1, 1)), symmetry={"nowhere": []})
    assert mesh.vertices.nowhere.size == 0
