"""Polygons and polyhedra in files and arrays, and those that are refused."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import HexMesh, PolyMesh, TetMesh

CUBE = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def faces_of(mesh):
    return lists(mesh.corners, "face", "vertex")


def cells_of(mesh):
    """Each cell as a set of faces, which are sets of points."""
    faces = [frozenset(face) for face in faces_of(mesh)]
    return {frozenset(faces[face] for face in cell) for cell in lists(mesh.sides, "cell", "face")}


def lists(table, by, of):
    rows = [[] for _ in range(table.fields[by].target.size)]
    for key, value in zip(table.fields[by].to_numpy().tolist(), table.fields[of].to_numpy().tolist(), strict=True):
        rows[key].append(value)
    return rows


def test_lists_arrays_and_offsets_are_the_same():
    given = PolyMesh.from_arrays(CUBE, SIDES, [range(6)])
    array = PolyMesh.from_arrays(np.array(CUBE), np.array(SIDES, np.uint8), np.arange(6).reshape(1, 6))
    flat = PolyMesh.from_arrays(
        CUBE, np.ravel(SIDES), np.arange(6), face_offsets=np.arange(0, 25, 4), cell_offsets=[0, 6]
    )
    for mesh in (given, array, flat):
        assert faces_of(mesh) == SIDES
        assert mesh.cells.volume.to_numpy() == pytest.approx([1])
    empty = PolyMesh.from_arrays([], [])
    assert repr(empty) == "<PolyMesh: >" and empty.corners.size == 0


def test_off_holds_polygons(tmp_path):
    path = tmp_path / "mixed.off"
    path.write_text(
        "OFF\n6 3 0 # a roof\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n.5 0 1\n.5 1 1\n4 0 3 2 1\n4 1 2 5 4 0.1 0.2 0.3\n3 0 1 4\n"
    )
    mesh = PolyMesh.load(path)
    assert faces_of(mesh) == [[0, 3, 2, 1], [1, 2, 5, 4], [0, 1, 4]]
    mesh.save(tmp_path / "again.off")
    again = PolyMesh.load(tmp_path / "again.off")
    assert faces_of(again) == faces_of(mesh)
    assert np.array_equal(again.vertices.pos.to_numpy(), mesh.vertices.pos.to_numpy())


OFF = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
BAD_FILES = {
    "two corners": (OFF + "3 0 1 2\n2 0 2\n", "E703", "bad.off, line 8: expected 3 or more"),
    "too few numbers": (OFF + "4 0 1 2\n3 0 2 3\n", "E703", "bad.off, line 7: expected 5 integers"),
    "a word": (OFF + "3 0 1 2\n4 0 1 x 3\n", "E703", "bad.off, line 8"),
    "too few faces": (OFF + "4 0 1 2 3\n", "E704", "2 faces are announced, but only 1"),
    "no such point": (OFF + "4 0 1 2 3\n3 0 1 4\n", "E705", "bad.off, line 8: face 1 has the corner 4"),
    "no area": (OFF + "4 0 1 2 3\n3 0 1 1\n", "E707", "bad.off, line 8: face 1"),
    "turned over": (OFF + "3 0 1 2\n3 0 2 3\n".replace("0 2 3", "2 0 3"), "E710", "bad.off, line 8: face 1 and face 0"),
    "not finite": (OFF.replace("1 1 0", "1 nan 0") + "3 0 1 2\n3 0 2 3\n", "E706", "bad.off, line 5: point 2"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_named_with_their_lines(tmp_path, monkeypatch, name):
    text, code, message = BAD_FILES[name]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.off").write_text(text)
    with pytest.raises(ebb.MeshFormatError, match=message) as caught:
        PolyMesh.load("bad.off")
    assert caught.value.codes == (code,)


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "ply", "obj"])
def test_surfaces_through_meshio(tmp_path, suffix):
    pytest.importorskip("meshio")
    mesh = PolyMesh.goldberg(1) if suffix != "vtk" else PolyMesh.globe(6, 5)
    fields = []
    if suffix in ("vtu", "vtk"):
        mesh.faces.new_field("corner_count", ebb.float64, init=[float(len(face)) for face in faces_of(mesh)])
        fields = [mesh.faces.corner_count]
    mesh.save(tmp_path / f"s.{suffix}", fields=fields)
    again = PolyMesh.load(tmp_path / f"s.{suffix}")
    assert faces_of(again) == sorted(faces_of(mesh), key=len)
    assert np.allclose(again.vertices.pos.to_numpy(), mesh.vertices.pos.to_numpy(), atol=1e-6)


@pytest.mark.parametrize("made", ["tetrahedra", "hexahedra", "polyhedra"])
def test_solids_through_meshio(tmp_path, made):
    meshio = pytest.importorskip("meshio")
    path = tmp_path / "solid.vtu"
    if made == "polyhedra":
        mesh = PolyMesh.dual(TetMesh.box(2, 2, 1), precision=ebb.float64)
        volume = mesh.cells.volume
        mesh.save(path, fields=[volume])
        kept = np.concatenate(meshio.read(path).cell_data["volume"])
        counts = [len(v) for v in lists(mesh.cell_vertices, "cell", "vertex")]
        assert np.array_equal(kept, volume.to_numpy()[np.argsort(counts, kind="stable")])
    else:
        solid = TetMesh.box(2, 2, 1) if made == "tetrahedra" else HexMesh.box(2, 2, 1)
        solid.save(path)
        mesh = PolyMesh.from_mesh(solid)
    again = PolyMesh.load(path, precision=ebb.float64)
    assert cells_of(again) == cells_of(mesh)
    assert again.cells.volume.to_numpy().sum() == pytest.approx(1)
    for suffix in ("off", "vtk"):
        with pytest.raises(ebb.MeshFormatError, match="hold no polyhedra"):
            mesh.save(tmp_path / f"no.{suffix}")


def test_wedges_and_pyramids(tmp_path):
    meshio = pytest.importorskip("meshio")
    points = [*CUBE, [0.5, 0.5, 1.5]]
    hexahedron, pyramid = [[0, 4, 6, 2, 1, 5, 7, 3]], [[1, 5, 7, 3, 8]]
    meshio.Mesh(points, [("hexahedron", hexahedron), ("pyramid", pyramid)]).write(tmp_path / "tent.vtu")
    tent = PolyMesh.load(tmp_path / "tent.vtu")
    assert (tent.faces.size, tent.cells.volume.to_numpy().tolist()) == (10, pytest.approx([1, 1 / 6]))
    meshio.Mesh(CUBE, [("wedge", [[0, 4, 2, 1, 5, 3], [4, 6, 2, 5, 7, 3]])]).write(tmp_path / "halves.vtu")
    assert PolyMesh.load(tmp_path / "halves.vtu").cells.volume.to_numpy() == pytest.approx([0.5, 0.5])
    meshio.Mesh(CUBE, [("line", [[0, 1]])]).write(tmp_path / "line.vtu")
    with pytest.raises(ebb.MeshFormatError, match="no polygons or polyhedra"):
        PolyMesh.load(tmp_path / "line.vtu")
    with pytest.raises(ebb.MeshFormatError, match=r"TetMesh\.load"):
        PolyMesh.load("body.veg")


SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]]
TWO = [*CUBE, [2, 0, 0], [2, 0, 1], [2, 1, 0], [2, 1, 1]]
SECOND = [[8, 10, 11, 9], [4, 8, 9, 5], [6, 7, 11, 10], [4, 6, 10, 8], [5, 9, 11, 7]]
REFUSED = {
    "no rows": ((SQUARE, 3), "E712", "faces should be rows of integers"),
    "floats": ((SQUARE, [[0.0, 1.0, 2.0]]), "E712", "rows of float64"),
    "words": ((SQUARE, [["a", "b", "c"]]), "E712", "faces should be rows of integers"),
    "points in the plane": (([[0, 0], [1, 1]], [[0, 1, 2]]), "E712", "positions should be"),
    "no point": ((SQUARE, [[0, 1, 2], [1, 2, 6]]), "E705", "face 1 has the corner 6"),
    "two corners": ((SQUARE, [[0, 1, 2], [1, 2]]), "E718", "face 1 has 2 corners, and 3 is the least"),
    "corner twice": ((SQUARE, [[0, 1, 2, 1]]), "E707", "names one point twice"),
    "in a line": ((SQUARE, [[0, 1, 4]]), "E707", "no area"),
    "crowded edge": (([*SQUARE, [0, 0, 1]], [[0, 1, 2], [1, 0, 3], [0, 1, 6]]), "E709", "one of 3 at the edge"),
    "turned over": ((SQUARE, [[0, 1, 2, 3], [1, 2, 5, 4]]), "E710", "face 1 and face 0"),
    "no face": ((CUBE, SIDES, [[0, 1, 2, 3, 4, 6]]), "E705", "cell 0 has the face 6, but the faces are numbered"),
    "three faces": ((CUBE, SIDES, [[0, 1, 2]]), "E718", "cell 0 has 3 faces"),
    "face twice": ((CUBE, SIDES, [[0, 1, 2, 3, 4, 4]]), "E718", "cell 0 names one face twice"),
    "open": ((CUBE, SIDES, [[0, 1, 2, 3, 4]]), "E716", r"cell 0 is no polyhedron: at the edge .* it has 1 face"),
    "two parts": (
        ([*CUBE, *np.add(CUBE, [3, 0, 0]).tolist()], [*SIDES, *np.add(SIDES, 8).tolist()], [range(12)]),
        "E716",
        "several parts",
    ),
    "flat": (([[x, y, 0] for x, y in np.random.default_rng(1).random((4, 2))],
              [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]], [range(4)]), "E707", "no volume"),
    "three cells at a face": ((CUBE, SIDES, [range(6)] * 3), "E709", "one of 3 at the face"),
    "overlapping": ((CUBE, SIDES, [range(6)] * 2), "E717", "cell 1 and cell 0 lie on the same side of face 0"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name):
    arrays, code, text = REFUSED[name]
    with pytest.raises(ebb.MeshFormatError, match=text) as caught:
        PolyMesh.from_arrays(*arrays)
    assert caught.value.codes == (code,)


OFFSETS = {
    "too short": ([0, 3], "rising from 0 to 6"),
    "falling": ([0, 4, 3, 6], "rising"),
    "not from 0": ([1, 6], "rising"),
    "floats": ([0.0, 6.0], "integers"),
    "empty": ([], "rising"),
}


@pytest.mark.parametrize("name", OFFSETS)
def test_offsets_that_do_not_divide(name):
    offsets, text = OFFSETS[name]
    with pytest.raises(ebb.MeshFormatError, match=f"the offsets of faces should be {text}"):
        PolyMesh.from_arrays(SQUARE, [0, 1, 2, 0, 2, 3], face_offsets=offsets)


def test_two_cells_share_a_face_and_manifold_is_for_surfaces():
    mesh = PolyMesh.from_arrays(TWO, [*SIDES, *SECOND], [range(6), [1, 6, 7, 8, 9, 10]])
    assert mesh.cells.volume.to_numpy() == pytest.approx([1, 1])
    points, faces = REFUSED["crowded edge"][0]
    assert PolyMesh.from_arrays(points, faces, manifold=False).faces.size == 3
    with pytest.raises(ebb.MeshFormatError, match="precision should be"):
        PolyMesh.from_arrays(points, faces, precision=ebb.int32)
