from __future__ import annotations

import os
import subprocess
import sys
import warnings

import pytest
from both_backends import checked
from kir_forms import OnRows, binary, const, read, write

import ebb.backends.compile as compiling
from ebb.backends.cache import ObjectCache, cache_directory, key_of
from ebb.backends.cpu import CpuBackend
from ebb.relations.relation import Relation
from ebb.runtime.cpu import CpuDevice
from ebb.types.types import float32


@pytest.fixture
def doubling():
    relation = Relation("rows", size=10)
    relation.new_field("x", float32, init=3.0)
    on = OnRows(relation)
    return on.kernel(write(relation.x, on.row, binary("*", read(relation.x, on.row), const(2.0, float32))))


@pytest.fixture
def compilations(monkeypatch):
    """The names of the programs that LLVM compiled."""
    names = []
    optimize = compiling.optimize

    def counting(text, target):
        names.append(text)
        return optimize(text, target)

    monkeypatch.setattr(compiling, "optimize", counting)
    return names


def run(kernel, cache):
    before = kernel.relation.x.to_numpy()
    CpuBackend(CpuDevice(1), cache).prepare(checked(kernel)).bind(kernel.relation).run(())
    assert (kernel.relation.x.to_numpy() == 2 * before).all()


def test_code_is_compiled_once(doubling, compilations, tmp_path):
    run(doubling, ObjectCache(tmp_path))
    run(doubling, ObjectCache(tmp_path))
    assert len(compilations) == 1
    assert [path.suffix for path in tmp_path.iterdir()] == [".o"]


@pytest.mark.parametrize("damage", [b"", b"rubbish", None])
def test_a_damaged_file_is_compiled_again(doubling, compilations, tmp_path, damage):
    run(doubling, ObjectCache(tmp_path))
    (path,) = tmp_path.iterdir()
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2] if damage is None else damage)
    run(doubling, ObjectCache(tmp_path))
    assert len(compilations) == 2 and path.read_bytes() == content


def test_a_folder_that_cannot_be_written_warns_once(doubling, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    cache = ObjectCache(blocked / "cache")
    with pytest.warns(UserWarning, match="EBB_CACHE_DIR") as caught:
        run(doubling, cache)
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cache.put("key", b"code")
    assert cache.get("key") is None


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(source, target):
        raise OSError("no space left")

    monkeypatch.setattr(os, "replace", full)
    with pytest.warns(UserWarning, match="no space left"):
        ObjectCache(tmp_path).put("key", b"code")
    assert not list(tmp_path.iterdir())


def test_keys_tell_the_parts_apart():
    assert key_of("ab", "c") != key_of("a", "bc") and key_of("a") == key_of("a")


def test_the_folder_is_chosen_by_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path))
    assert cache_directory() == tmp_path
    monkeypatch.delenv("EBB_CACHE_DIR")
    assert cache_directory().name == "ebb"


def test_processes_share_a_folder(tmp_path):
    """Two processes that fill one folder at the same time leave whole files."""
    script = (
        "import sys, pathlib\n"
        "from ebb.backends.cache import ObjectCache\n"
        "cache = ObjectCache(pathlib.Path(sys.argv[1]))\n"
        "for turn in range(40):\n"
        "    cache.put('key', bytes([65 + turn % 2]) * 100_000)\n"
        "    found = cache.get('key')\n"
        "    assert found is not None and len(found) == 100_000 and len(set(found)) == 1\n"
    )
    processes = [subprocess.Popen([sys.executable, "-c", script, str(tmp_path)]) for _ in range(2)]
    assert [process.wait(timeout=120) for process in processes] == [0, 0]
