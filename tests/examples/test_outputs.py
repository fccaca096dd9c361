"""What the programs ask before they write, and how they write."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))

import software
from animation import Film
from outputs import replacing, save_arrays, save_text, why_unwritable


def test_where_nothing_can_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    assert why_unwritable(tmp_path / "new" / "out.npz") is None and not any((tmp_path / "new").iterdir())
    assert why_unwritable(tmp_path / "file") is None
    assert why_unwritable(tmp_path) == "it is a folder"
    assert "file" in str(why_unwritable(tmp_path / "file" / "out.npz"))


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="it needs a file system that takes no files")
def test_a_file_system_that_takes_no_files():
    assert "nothing can be written" in str(why_unwritable(Path("/proc/out.npz")))


def test_arrays_are_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "out.npz"
    save_arrays(path, a=np.arange(3))

    with pytest.raises(ValueError, match="Object arrays"):
        save_arrays(path, a=np.zeros(1000), b=np.array([None]))
    with np.load(path) as saved:
        assert saved["a"].tolist() == [0, 1, 2]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["series.pvd", "picture.png", "film.gif"])
def test_texts_and_pictures_are_written_whole_or_not_at_all(tmp_path, monkeypatch, name):
    def write(value):
        if name == "series.pvd":
            save_text(path, "text" if value is not None else "text\udc00")  # of which UTF-8 takes a part only
        elif name == "picture.png":
            software.write_png(path, np.full((2, 2, 3), 255.0))
        else:
            pytest.importorskip("PIL")
            with Film(None, path) as film:
                film.add(np.full((2, 2, 3), 255.0))

    path = tmp_path / name
    write(1)
    before = path.read_bytes()
    assert before
    if name != "series.pvd":
        monkeypatch.setattr("outputs.os.replace", lambda *_: (_ for _ in ()).throw(OSError("the disk is full")))
    with pytest.raises((OSError, UnicodeError)):
        write(None)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_an_error_in_between_leaves_what_was_there(tmp_path):
    path = tmp_path / "out"
    path.write_text("old")
    with pytest.raises(KeyError), replacing(path) as part:
        part.write_text("half")
        raise KeyError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
