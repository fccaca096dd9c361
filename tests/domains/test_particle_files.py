"""Particles in files: what comes back, and what is refused."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import ebb
from ebb.domains import Grid2D, Particles

FIELDS = {
    "mass": np.arange(5.0),
    "kind": np.arange(5, dtype=np.int32),
    "fixed": np.arange(5) % 2 == 0,
    "vel": np.arange(10.0).reshape(5, 2),
    "F": np.arange(20.0).reshape(5, 2, 2),
}


def some(ndim=2, precision=ebb.float64):
    return Particles.from_arrays(np.random.default_rng(0).random((5, ndim)), precision=precision, **FIELDS)


@pytest.mark.parametrize("ndim", [1, 2, 3])
@pytest.mark.parametrize("precision", [ebb.float32, ebb.float64], ids=["f", "d"])
def test_archives_hold_everything(tmp_path, ndim, precision):
    particles = some(ndim, precision)
    particles.save(tmp_path / "dust.npz")
    found = Particles.load(str(tmp_path / "dust.npz"), precision=precision, name="dust")
    assert (found.name, found.dimension) == ("dust", ndim)
    assert {name: field.type for name, field in found.fields.items()} == {
        name: field.type for name, field in particles.fields.items()
    }
    for name, field in particles.fields.items():
        np.testing.assert_array_equal(found.fields[name].to_numpy(), field.to_numpy())


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_formats_of_meshio(tmp_path, suffix):
    pytest.importorskip("meshio")
    particles = some()
    particles.save(tmp_path / f"dust{suffix}", ["mass", particles.kind, "fixed", "vel", "F"])
    found = Particles.load(tmp_path / f"dust{suffix}", dimension=2, precision=ebb.float64)
    np.testing.assert_array_equal(found.pos.to_numpy(), particles.pos.to_numpy())
    assert sorted(found.fields) == ["F", "fixed", "kind", "mass", "pos", "vel"]
    np.testing.assert_array_equal(found.mass.to_numpy(), FIELDS["mass"])
    np.testing.assert_array_equal(found.kind.to_numpy(), FIELDS["kind"])
    np.testing.assert_array_equal(found.fixed.to_numpy(), FIELDS["fixed"])
    np.testing.assert_array_equal(found.F.to_numpy(), FIELDS["F"].reshape(5, 4))
    assert Particles.load(tmp_path / f"dust{suffix}").dimension == 3


def test_the_points_of_a_mesh(tmp_path):
    from ebb.domains import TriMesh

    pytest.importorskip("meshio")
    TriMesh.icosphere(1).save(tmp_path / "ball.vtu")
    assert Particles.load(tmp_path / "ball.vtu").size == 42


def test_keys_are_left_out(tmp_path):
    particles = some()
    particles.couple(Grid2D((4, 4)))
    particles.save(tmp_path / "dust.npz")
    assert "cell" not in Particles.load(tmp_path / "dust.npz").fields
    with pytest.raises(ebb.MeshFormatError, match=r"E714.*particles\.cell holds keys"):
        particles.save(tmp_path / "dust.npz", ["cell"])


def test_none_and_no_fields(tmp_path):
    Particles(np.empty((0, 2))).save(tmp_path / "none.npz")
    assert Particles.load(tmp_path / "none.npz").size == 0
    some().save(tmp_path / "bare.npz", [])
    assert list(Particles.load(tmp_path / "bare.npz").fields) == ["pos"]


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path):
    path = tmp_path / "dust.npz"
    some().save(path)
    before = path.read_bytes()
    for wrong in (["mess"], [some().mass]):
        with pytest.raises(ebb.MeshFormatError, match="E714"):
            some().save(path, wrong)
    assert path.read_bytes() == before and [each.name for each in tmp_path.iterdir()] == ["dust.npz"]
    with pytest.raises(ebb.MeshFormatError, match="E701"):
        some().save(tmp_path / "missing" / "dust.npz")


def archive(path, **arrays):
    np.savez(path, **arrays)
    return path


def bad_archives(folder):
    points = np.zeros((3, 2))
    yield "no such file", folder / "missing.npz", "E701"
    yield "folder", folder, "E70"
    (folder / "text.npz").write_text("pos")
    yield "text", folder / "text.npz", "E702"
    (folder / "empty.npz").write_bytes(b"")
    yield "empty", folder / "empty.npz", "E702"
    whole = archive(folder / "whole.npz", pos=points).read_bytes()
    (folder / "cut.npz").write_bytes(whole[: len(whole) // 2])
    yield "cut", folder / "cut.npz", "E702"
    np.save(folder / "one.npy", points)
    (folder / "one.npy").rename(folder / "one.npz")
    yield "one array", folder / "one.npz", "E702.*is no archive"
    yield "no pos", archive(folder / "other.npz", x=points), "E702.*no array 'pos'"
    yield "flat", archive(folder / "flat.npz", pos=points[0]), "E702.*shape"
    yield "four", archive(folder / "four.npz", pos=np.zeros((2, 4))), "E702.*shape"
    yield "words", archive(folder / "words.npz", pos=np.array([["a", "b"]])), "E702"
    yield "objects", archive(folder / "objects.npz", pos=np.array([[None, 1]])), "E702"
    yield "lengths", archive(folder / "lengths.npz", pos=points, mass=np.zeros(4)), "E702.*3 points"
    yield "nan", archive(folder / "nan.npz", pos=[[0, 0], [0, np.nan]]), "E706.*point 1"
    yield "large", archive(folder / "large.npz", pos=[[0, 1e300]]), "E706.*float32"
    yield "name", archive(folder / "name.npz", pos=points, **{"a b": np.zeros(3)}), "E50"


def test_bad_files_are_refused(tmp_path):
    for what, path, said in bad_archives(tmp_path):
        with pytest.raises(ebb.EbbError) as caught:
            Particles.load(path)
        assert caught.match(f"(?s){said}"), what


def test_dimensions(tmp_path):
    some(3).save(tmp_path / "dust.npz")
    with pytest.raises(ebb.MeshFormatError, match=r"E702.*2 are asked for"):
        Particles.load(tmp_path / "dust.npz", dimension=2)
    for wrong in (0, 4, "2"):
        with pytest.raises(ebb.RelationError, match="E540"):
            Particles.load(tmp_path / "dust.npz", dimension=wrong)
    with pytest.raises(ebb.RelationError, match="E540"):
        Particles.load(tmp_path / "dust.npz", precision=ebb.int32)


def test_without_meshio_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    some().save(tmp_path / "dust.npz")
    (tmp_path / "dust.vtu").write_text("")
    with pytest.raises(ebb.BackendError, match="E713"):
        Particles.load(tmp_path / "dust.vtu")
    with pytest.raises(ebb.BackendError, match="E713"):
        some().save(tmp_path / "dust.vtu")
