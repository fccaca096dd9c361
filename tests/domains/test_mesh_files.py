"""Mesh files: what is written is read again, and what is wrong is named with its line."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import ebb
from ebb.domains import TetMesh, TriMesh

TRIANGLE = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
TET = """# a comment
*VERTICES
4 3 0 0
1 0 0 0
2 1 0 0
3 0 1 0
4 0 0 1

*ELEMENTS
TET
1 4 0
1 1 2 3 4

*MATERIAL soft
ENU, 1000, 1e7, 0.4

*SET first
1

*REGION
first, soft
"""


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


# Reading


def test_off_with_comments_blank_lines_colours_and_counts_beside_the_keyword(tmp_path):
    text = """# made by hand

OFF 4 2 0  # counts
0 0 0 0.5 0.5 1
1 0 0

0 1 0
1 1 0 # corner
3 0 1 2 255 0 0
3 1 3 2
"""
    mesh = TriMesh.load(write(tmp_path / "square.OFF", text))
    assert mesh.vertices.pos.to_numpy().tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert mesh.triangles.v.to_numpy().tolist() == [[0, 1, 2], [1, 3, 2]]


def test_veg_with_materials_sets_and_regions(tmp_path):
    mesh = TetMesh.load(write(tmp_path / "tet.veg", TET))
    assert mesh.tetrahedra.v.to_numpy().tolist() == [[0, 1, 2, 3]]
    assert [(m.name, m.model, m.parameters) for m in mesh.materials] == [("soft", "ENU", (1000.0, 1e7, 0.4))]
    assert [(r.name, r.material.name, r.rows.tolist()) for r in mesh.regions] == [("first", "soft", [0])]


def test_veg_may_count_from_0_and_be_inverted(tmp_path):
    text = "*VERTICES\n4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n*ELEMENTS\nTET\n1 4 0\n0 0 2 1 3\n"
    path = write(tmp_path / "tet.veg", text)
    assert TetMesh.load(path).tetrahedra.volume.to_numpy() == pytest.approx([1 / 6])
    with pytest.raises(ebb.MeshFormatError, match=r"line 10: tetrahedron 0 .* is inverted"):
        TetMesh.load(path, fix_orientation=False)
    text = "*VERTICES\n5 3\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n4 0 0 -1\n*ELEMENTS\nTET\n2 4\n0 0 1 2 3\n1 0 1 2 4\n"
    path = write(tmp_path / "tets.veg", text)
    with pytest.raises(ebb.MeshFormatError, match=r"line 12: tetrahedron 1 .* is inverted") as caught:
        TetMesh.load(path)
    assert "1 of the 2 elements" in str(caught.value)
    assert TetMesh.load(path, fix_orientation=True).turned == 1


def test_files_of_windows_and_tabs(tmp_path):
    path = write(tmp_path / "mesh.off", "\ufeff" + TRIANGLE.replace("OFF\n", "OFF ").replace(" ", "\t"))
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert TriMesh.load(path).triangles.v.to_numpy().tolist() == [[0, 1, 2]]
    path = write(tmp_path / "mesh.veg", TET.replace("*MATERIAL soft", "*MATERIAL\tsoft"))
    assert TetMesh.load(path).materials[0].name == "soft"


def test_an_empty_mesh_is_a_mesh(tmp_path):
    assert TriMesh.load(write(tmp_path / "none.off", "OFF\n0 0 0\n")).triangles.size == 0
    assert TetMesh.load(write(tmp_path / "none.veg", "*VERTICES\n0 3\n*ELEMENTS\nTET\n0 4\n")).tetrahedra.size == 0


OFF_ERRORS = {
    "empty file": ("", "E703", 1),
    "no keyword": ("3 1 0\n0 0 0\n", "E703", 1),
    "other format": ("PLY\n", "E703", 1),
    "no counts": ("OFF\n", "E703", 1),
    "one count": ("OFF\n3\n", "E703", 2),
    "negative count": ("OFF\n-3 1 0\n", "E703", 2),
    "count is no number": ("OFF\nthree 1 0\n", "E703", 2),
    "count is a fraction": ("OFF\n3.5 1 0\n", "E703", 2),
    "ends in the points": ("OFF\n3 1 0\n0 0 0\n1 0 0\n", "E704", 4),
    "ends in the faces": (TRIANGLE.replace("3 1 0", "3 2 0"), "E704", 6),
    "a huge count": ("OFF\n999999999999 1 0\n0 0 0\n", "E704", 3),
    "a word for a number": (TRIANGLE.replace("1 0 0\n", "1 zero 0\n"), "E703", 4),
    "two coordinates": (TRIANGLE.replace("1 0 0\n", "1 0\n"), "E703", 4),
    "two signs": (TRIANGLE.replace("3 0 1 2", "3 0 -+1 2"), "E703", 6),
    "digits of another script": (TRIANGLE.replace("1 0 0\n", "\u0661 0 0\n"), "E703", 4),
    "a form feed in a comment": ("# one\f\n" + TRIANGLE.replace("1 0 0\n", "1 zero 0\n"), "E703", 5),
    "underscores": (TRIANGLE.replace("1 0 0\n", "1_0 0 0\n"), "E703", 4),
    "binary": ("OFF\n3 1 0\n\x00\x01\x02\n", "E704", 3),
    "NaN": (TRIANGLE.replace("1 0 0\n", "nan 0 0\n"), "E706", 4),
    "infinity": (TRIANGLE.replace("1 0 0\n", "1e999 0 0\n"), "E706", 4),
    "beyond float32": (TRIANGLE.replace("1 0 0\n", "1e200 0 0\n"), "E706", 4),
    "a quadrangle": ("OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 3 2\n", "E703", 7),
    "a short face": (TRIANGLE.replace("3 0 1 2", "3 0 1"), "E703", 6),
    "a fractional index": (TRIANGLE.replace("3 0 1 2", "3 0 1 2.0"), "E703", 6),
    "an index too large": (TRIANGLE.replace("3 0 1 2", "3 0 1 3"), "E705", 6),
    "a negative index": (TRIANGLE.replace("3 0 1 2", "3 0 -1 2"), "E705", 6),
    "an index beyond 64 bits": (TRIANGLE.replace("3 0 1 2", "3 0 1 99999999999999999999"), "E703", 6),
    "a point twice": (TRIANGLE.replace("3 0 1 2", "3 0 1 1"), "E707", 6),
    "points in a line": (TRIANGLE.replace("0 1 0\n3", "2 0 0\n3"), "E707", 6),
    "more than announced": (TRIANGLE + "3 2 1 0\n", "E703", 7),
}
VEG_ERRORS = {
    "empty file": ("", "E703", 1),
    "unknown section": ("*NODES\n", "E703", 1),
    "no elements": (TET.partition("*ELEMENTS")[0], "E703", 7),
    "elements first": (
        TET.replace("*VERTICES", "*X").replace("*ELEMENTS", "*VERTICES").replace("*X", "*ELEMENTS"),
        "E703",
        2,
    ),
    "points in the plane": (TET.replace("4 3 0 0", "4 2 0 0"), "E703", 3),
    "hexahedra": (TET.replace("TET\n1 4 0", "CUBIC\n1 8 0"), "E703", 10),
    "eight corners": (TET.replace("1 4 0\n1", "1 8 0\n1"), "E703", 11),
    "negative count": (TET.replace("1 4 0\n1", "-1 4 0\n1"), "E703", 11),
    "truncated": (TET.partition("4 0 0 1")[0], "E704", 6),
    "a number left out": (TET.replace("3 0 1 0\n4 0 0 1", "4 0 1 0\n5 0 0 1"), "E703", 6),
    "an index too large": (TET.replace("1 1 2 3 4", "1 1 2 3 5"), "E705", 12),
    "index 0": (TET.replace("1 1 2 3 4", "1 0 2 3 4"), "E705", 12),
    "NaN": (TET.replace("2 1 0 0", "2 nan 0 0"), "E706", 5),
    "flat": (TET.replace("4 0 0 1", "4 1 1 0"), "E707", 12),
    "material without numbers": (TET.replace("ENU, 1000, 1e7", "ENU, soft, 1e7"), "E703", 15),
    "material of NaN": (TET.replace("1e7", "nan"), "E703", 15),
    "material of underscores": (TET.replace("1e7", "1_0"), "E703", 15),
    "material twice": (TET + "*MATERIAL soft\nENU, 1, 2, 0.3\n", "E703", 22),
    "set twice": (TET + "*SET first\n1\n", "E703", 22),
    "set of all elements": (TET + "*SET allElements\n1\n", "E703", 22),
    "unknown material": (TET.replace("first, soft", "first, hard"), "E703", 21),
    "unknown set": (TET.replace("first, soft", "last, soft"), "E703", 21),
    "set out of range": (TET.replace("*SET first\n1", "*SET first\n2"), "E703", 18),
    "vertices twice": (TET + "*VERTICES\n0 3 0 0\n", "E703", 22),
}


@pytest.mark.parametrize("name", OFF_ERRORS)
def test_malformed_off(tmp_path, name):
    text, code, line = OFF_ERRORS[name]
    check_error(TriMesh, write(tmp_path / "mesh.off", text), code, line)


@pytest.mark.parametrize("name", VEG_ERRORS)
def test_malformed_veg(tmp_path, name):
    text, code, line = VEG_ERRORS[name]
    check_error(TetMesh, write(tmp_path / "mesh.veg", text), code, line)


def check_error(kind, path, code, line):
    with pytest.raises(ebb.MeshFormatError) as caught:
        kind.load(path)
    assert caught.value.codes == (code,)
    assert f"{path}, line {line}: " in caught.value.diagnostics[0].title
    assert f'File "{path}", line {line}' in str(caught.value)


def test_every_cut_of_a_file_is_refused_or_read(tmp_path):
    for kind, text, suffix in ((TriMesh, TRIANGLE, "off"), (TetMesh, TET, "veg")):
        for end in range(len(text)):
            path = write(tmp_path / f"cut.{suffix}", text[:end])
            try:
                kind.load(path)
            except ebb.MeshFormatError as error:
                assert str(path) in str(error)


def test_points_of_line_numbers_are_of_the_file_not_of_the_data(tmp_path):
    text = "# one\n# two\nOFF\n\n# five\n3 1 0\n0 0 0\n\n1 0 0\n# ten\n0 1 0\n3 0 1 9\n"
    check_error(TriMesh, write(tmp_path / "mesh.off", text), "E705", 12)


@pytest.mark.parametrize("name", ["mesh.off", "mesh.veg", "mesh.vtu"])
def test_missing_file_and_directory(tmp_path, name):
    kind = TriMesh if name.endswith("off") else TetMesh
    with pytest.raises(ebb.MeshFormatError, match="No such file") as caught:
        kind.load(tmp_path / name)
    assert caught.value.codes == ("E701",)
    (tmp_path / name).mkdir()
    with pytest.raises(ebb.MeshFormatError, match="directory") as caught:
        kind.load(tmp_path / name)
    assert caught.value.codes == ("E701",)


def test_the_wrong_kind_of_file_says_which_class_takes_it(tmp_path):
    with pytest.raises(ebb.MeshFormatError, match=r"TetMesh\.load"):
        TriMesh.load(write(tmp_path / "tet.veg", TET))
    with pytest.raises(ebb.MeshFormatError, match=r"TriMesh\.load"):
        TetMesh.load(write(tmp_path / "triangle.off", TRIANGLE))


# Writing


def test_off_keeps_every_digit(tmp_path):
    mesh = TriMesh.icosphere(1, radius=0.1)
    mesh.save(tmp_path / "sphere.off")
    again = TriMesh.load(tmp_path / "sphere.off")
    assert np.array_equal(again.vertices.pos.to_numpy(), mesh.vertices.pos.to_numpy())
    assert np.array_equal(again.triangles.v.to_numpy(), mesh.triangles.v.to_numpy())


def test_veg_keeps_every_digit_and_the_materials(tmp_path):
    first = TetMesh.load(write(tmp_path / "tet.veg", TET))
    first.save(tmp_path / "again.veg")
    again = TetMesh.load(tmp_path / "again.veg")
    assert np.array_equal(again.vertices.pos.to_numpy(), first.vertices.pos.to_numpy())
    assert again.materials == first.materials
    assert [(r.name, r.rows.tolist()) for r in again.regions] == [("first", [0])]


def test_regions_of_all_elements_and_of_one_set_are_kept(tmp_path):
    regions = "*MATERIAL hard\nENU, 1, 2, 0.3\n*REGION\nfirst, hard\n*REGION\nallElements, hard\n"
    first = TetMesh.load(write(tmp_path / "tet.veg", TET + regions))
    first.save(tmp_path / "again.veg")
    again = TetMesh.load(tmp_path / "again.veg")
    assert [(r.name, r.material.name, r.rows.tolist()) for r in again.regions] == [
        ("first", "soft", [0]),
        ("first", "hard", [0]),
        ("allElements", "hard", [0]),
    ]


def test_a_large_set_is_written_on_short_lines(tmp_path):
    box = TetMesh.box(3, 3, 3)
    box.save(tmp_path / "box.veg")
    names = ", ".join(str(row) for row in range(1, 163))
    with (tmp_path / "box.veg").open("a") as file:
        file.write(f"*MATERIAL soft\nENU, 1, 2, 0.3\n*SET all\n{names}\n*REGION\nall, soft\n")
    TetMesh.load(tmp_path / "box.veg").save(tmp_path / "again.veg")
    assert max(map(len, (tmp_path / "again.veg").read_text().splitlines())) < 120
    assert TetMesh.load(tmp_path / "again.veg").regions[0].rows.tolist() == list(range(162))


def test_another_field_may_say_where_the_vertices_are(tmp_path):
    mesh = TetMesh.box(1, 1, 1)
    mesh.vertices.new_field("q", ebb.vec3d, init=mesh.vertices.pos.to_numpy() + 2.0)
    mesh.save(tmp_path / "moved.veg", positions="q")
    assert TetMesh.load(tmp_path / "moved.veg").vertices.pos.to_numpy().min() == 2.0


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh"])
def test_meshio_formats_hold_fields(tmp_path, suffix):
    meshio = pytest.importorskip("meshio")
    mesh = TetMesh.box(2, 1, 1)
    mesh.vertices.new_field("speed", ebb.vec3f, init=lambda row: [row, 0, 1])
    mesh.vertices.new_field("fixed", ebb.bool_, init=lambda row: row % 2 == 0)
    mesh.vertices.new_field("frame", ebb.mat3d, init=np.arange(9.0).reshape(3, 3))
    path = tmp_path / f"box.{suffix}"
    mesh.save(path, fields=["speed", mesh.vertices.fixed, "frame", mesh.tetrahedra.volume])
    found = meshio.read(path)
    assert np.array_equal(found.point_data["speed"], mesh.vertices.speed.to_numpy())
    assert found.point_data["fixed"].ravel().tolist() == [1, 0] * 6
    assert found.point_data["frame"].reshape(-1, 9)[3].tolist() == list(range(9))
    assert found.cell_data["volume"][0].ravel() == pytest.approx(mesh.tetrahedra.volume.to_numpy())
    again = TetMesh.load(path)
    assert np.array_equal(again.tetrahedra.v.to_numpy(), mesh.tetrahedra.v.to_numpy())


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "vtu", "msh"])
def test_surfaces_through_meshio(tmp_path, suffix):
    pytest.importorskip("meshio")
    path = tmp_path / f"torus.{suffix}"
    TriMesh.torus(1, 0.4, 8, 5).save(path)
    again = TriMesh.load(path)
    assert (again.vertices.size, again.edges.size, again.triangles.size) == (40, 240, 80)


def test_a_format_without_the_cells_and_a_damaged_file(tmp_path):
    pytest.importorskip("meshio")
    TriMesh.icosphere(0).save(tmp_path / "sphere.vtu")
    with pytest.raises(ebb.MeshFormatError, match="it has triangle, and no cells of the type 'tetra'"):
        TetMesh.load(tmp_path / "sphere.vtu")
    whole = (tmp_path / "sphere.vtu").read_text()
    for end in (0, 10, len(whole) // 2):
        with pytest.raises(ebb.MeshFormatError) as caught:
            TriMesh.load(write(tmp_path / "cut.vtu", whole[:end]))
        assert caught.value.codes == ("E702",)
    with pytest.raises(ebb.MeshFormatError) as caught:
        TriMesh.load(write(tmp_path / "mesh.unknown", "1 2 3"))
    assert caught.value.codes == ("E702",)


def test_without_meshio_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    for action in (
        lambda: TetMesh.load(write(tmp_path / "mesh.msh", "")),
        lambda: TetMesh.box(1, 1, 1).save(tmp_path / "mesh.vtu"),
    ):
        with pytest.raises(ebb.BackendError, match=r'pip install "ebblang\[mesh\]"') as caught:
            action()
        assert caught.value.codes == ("E713",)


def unsavable(mesh, tmp_path):
    other = TetMesh.box(1, 1, 1)
    empty = TetMesh.from_arrays([], [])
    empty.vertices.new_field("frame", ebb.mat3d, init=0.0)
    mesh.vertices.new_field("speed", ebb.float64, init=0.0)
    yield "off", lambda: mesh.save(tmp_path / "box.off"), "do not hold cells"
    yield "veg", lambda: mesh.save(tmp_path / "box.veg", fields=["speed"]), "hold no fields"
    yield "name", lambda: mesh.save(tmp_path / "box.vtu", fields=["sped"]), "did you mean 'speed'"
    yield "foreign", lambda: mesh.save(tmp_path / "box.vtu", fields=[other.vertices.pos]), "none of vertices"
    yield "edges", lambda: mesh.save(tmp_path / "box.vtu", fields=[mesh.edges.tail]), "none of vertices"
    mesh.vertices.new_field("friends", ebb.vector(mesh.vertices, 3), init=0)
    yield "cells", lambda: mesh.save(tmp_path / "box.stl"), "does not hold cells of the type 'tetra'"
    yield "left out", lambda: mesh.save(tmp_path / "box.bdf", fields=["speed"]), "not hold the fields 'speed'"
    yield "keys", lambda: mesh.save(tmp_path / "box.veg", positions="friends"), "no vector of 3"
    yield "empty", lambda: empty.save(tmp_path / "none.vtu", fields=["frame"]), "cannot read again what it wrote"
    yield "place", lambda: mesh.save(tmp_path / "box.vtu", positions="speed"), "no vector of 3"
    yield "suffix", lambda: mesh.save(tmp_path / "box.unknown"), f"meshio.*{tmp_path}/box.unknown"


def test_what_cannot_be_saved(tmp_path):
    pytest.importorskip("meshio")
    for name, action, text in unsavable(TetMesh.box(1, 1, 1), tmp_path):
        with pytest.raises(ebb.MeshFormatError, match=text) as caught:
            action()
        assert caught.value.codes == ("E714",), name
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["no/such/box.veg", "no/such/box.vtu", "a\0b.veg"])
def test_a_place_that_cannot_be_written(tmp_path, name):
    with pytest.raises(ebb.MeshFormatError) as caught:
        TetMesh.box(1, 1, 1).save(tmp_path / name)
    assert caught.value.codes == ("E701",)
    assert list(tmp_path.iterdir()) == []


def test_a_file_stays_as_it_was_where_saving_fails(tmp_path, monkeypatch):
    path = tmp_path / "box.veg"
    TetMesh.box(1, 1, 1).save(path)
    before = path.read_bytes()

    def fill_the_disk(self, text, **options):
        self.write_bytes(text.encode()[:100])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", fill_the_disk)
    with pytest.raises(ebb.MeshFormatError, match="No space left"):
        TetMesh.box(2, 2, 2).save(path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_the_two_files_of_tetgen(tmp_path):
    pytest.importorskip("meshio")
    TetMesh.box(1, 1, 1).save(tmp_path / "é.node")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["é.ele", "é.node"]
    assert TetMesh.load(tmp_path / "é.ele").tetrahedra.size == 6
    write(tmp_path / "é.ele", "# nothing\n")
    with pytest.raises(ebb.MeshFormatError, match=r"'é\.ele' is missing or empty"):
        TetMesh.load(tmp_path / "é.node")
