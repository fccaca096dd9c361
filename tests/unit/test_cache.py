from __future__ import annotations

import os
import shutil
import stat
import sys
import time
import warnings
from pathlib import Path

import pytest
from both_backends import checked
from kir_forms import OnRows, binary, const, read, write

import ebb.backends.llvm.optimize as optimizing
from ebb.backends import cache as caching
from ebb.backends import known
from ebb.backends.cache import DEFAULT_LIMIT, ObjectCache, cache_directory, cache_limit, cache_usage
from ebb.backends.cpu import CpuBackend, backend, cpu_backend
from ebb.relations.relation import Relation
from ebb.runtime.cpu import CpuDevice
from ebb.runtime.digest import key_of
from ebb.types.types import float32

KEY = "5" * 64
SWEEPING = "0" * 63

needs_users = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files are kept apart in other ways here")


@pytest.fixture(autouse=True)
def nothing_said_yet(monkeypatch):
    monkeypatch.setattr(caching._Warned, "variables", frozenset())


@pytest.fixture(autouse=True)
def settled_sources(monkeypatch):
    """Files of the package that were changed just now would keep the interfaces out of the cache."""
    monkeypatch.setattr(known, "package_state", lambda: "these")


@pytest.fixture(autouse=True)
def driver_elsewhere(monkeypatch):
    """The driver is compiled and kept like kernels: these tests count files and kernels."""
    driver = cpu_backend(1).driver()
    monkeypatch.setattr(backend, "_driver", lambda device, kept: driver)


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
    optimize = optimizing.optimize

    def counting(text, target):
        names.append(text)
        return optimize(text, target)

    monkeypatch.setattr(optimizing, "optimize", counting)
    return names


def run(kernel, cache):
    before = kernel.relation.x.to_numpy()
    CpuBackend(CpuDevice(1), cache).prepare(checked(kernel)).bind(kernel.relation).run(())
    assert (kernel.relation.x.to_numpy() == 2 * before).all()


def test_code_is_compiled_once(doubling, compilations, tmp_path):
    run(doubling, ObjectCache(tmp_path))
    run(doubling, ObjectCache(tmp_path))
    assert len(compilations) == 1
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".i", ".o"]


def truncated(count):
    return lambda content: content[:count]


def flipped(place):
    def damage(content):
        changed = bytearray(content)
        changed[place] ^= 1
        return bytes(changed)

    return damage


DAMAGES = {
    "empty": truncated(0),
    "a byte": truncated(1),
    "part of the checksum": truncated(31),
    "the checksum alone": truncated(32),
    "the first byte of the code": truncated(33),
    "half": lambda content: content[: len(content) // 2],
    "all but one byte": truncated(-1),
    "one byte too many": lambda content: content + b"x",
    "twice": lambda content: content + content,
    "a bit of the checksum": flipped(3),
    "a bit of the code": flipped(32),
    "the last bit": flipped(-1),
    "zeros": lambda content: bytes(len(content)),
    "rubbish": lambda content: b"rubbish" * 5000,
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
@pytest.mark.parametrize(("suffix", "times"), [(".o", 2), (".i", 1)])
def test_a_damaged_file_is_written_again(doubling, compilations, tmp_path, damage, suffix, times):
    run(doubling, ObjectCache(tmp_path))
    (path,) = tmp_path.glob(f"*{suffix}")
    content = path.read_bytes()
    path.write_bytes(damage(content))
    run(doubling, ObjectCache(tmp_path))
    assert len(compilations) == times and path.read_bytes() == content


def test_a_file_under_the_name_of_another_is_none(tmp_path):
    cache = ObjectCache(tmp_path)
    cache.put(KEY, b"code")
    other = "6" * 64
    shutil.copy2(tmp_path / f"{KEY}.o", tmp_path / f"{other}.o")
    assert cache.get(KEY) == b"code" and cache.get(other) is None


def test_what_is_no_file_is_passed_over(tmp_path):
    cache = ObjectCache(tmp_path)
    place = tmp_path / f"{KEY}.o"
    place.mkdir()
    assert cache.get(KEY) is None
    with pytest.warns(UserWarning, match="cannot be kept"):
        cache.put(KEY, b"code")
    place.rmdir()
    place.symlink_to(tmp_path / "nowhere")
    assert cache.get(KEY) is None
    cache.put(KEY, b"code")
    assert cache.get(KEY) == b"code" and not place.is_symlink()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")
def test_a_pipe_or_a_device_is_not_waited_for(tmp_path):
    cache = ObjectCache(tmp_path)
    place = tmp_path / f"{KEY}.o"
    os.mkfifo(place)
    assert cache.get(KEY) is None
    place.unlink()
    place.symlink_to("/dev/zero")
    assert cache.get(KEY) is None


def test_a_huge_file_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(caching, "_LARGEST_FILE", 1000)
    cache = ObjectCache(tmp_path)
    (tmp_path / f"{KEY}.o").write_bytes(bytes(1001))
    assert cache.get(KEY) is None
    cache.put(KEY, bytes(999))
    assert (tmp_path / f"{KEY}.o").stat().st_size == 1001, "too large to be kept"


@needs_users
@pytest.mark.parametrize("mode", [0o620, 0o602])
def test_code_that_others_may_write_is_not_run(doubling, compilations, tmp_path, mode):
    run(doubling, ObjectCache(tmp_path))
    (path,) = tmp_path.glob("*.o")
    path.chmod(mode)
    run(doubling, ObjectCache(tmp_path))
    assert len(compilations) == 2 and stat.S_IMODE(path.stat().st_mode) == 0o600


@needs_users
def test_code_of_another_user_is_not_run(tmp_path, monkeypatch):
    cache = ObjectCache(tmp_path)
    cache.put(KEY, b"code")
    monkeypatch.setattr(os, "geteuid", lambda: 4321)
    if (tmp_path / f"{KEY}.o").stat().st_uid:
        assert cache.get(KEY) is None
    else:
        assert cache.get(KEY) == b"code", "root may keep code for all"
        os.chown(tmp_path / f"{KEY}.o", 1234, 1234)
        assert cache.get(KEY) is None
    with pytest.warns(UserWarning, match="other users"):
        monkeypatch.setattr(caching, "_is_trusted", lambda status: False)
        cache.put(KEY, b"code")


@needs_users
def test_the_folder_is_made_for_the_user_alone(tmp_path):
    ObjectCache(tmp_path / "a" / "b").put(KEY, b"code")
    assert stat.S_IMODE((tmp_path / "a" / "b").stat().st_mode) == 0o700


def test_a_folder_that_cannot_be_written_warns_once(doubling, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    cache = ObjectCache(blocked / "cache")
    with pytest.warns(UserWarning, match="EBB_CACHE_DIR") as caught:
        run(doubling, cache)
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cache.put(KEY, b"code")
        ObjectCache(blocked).put(KEY, b"code")  # another cache of this process
    assert cache.get(KEY) is None and ObjectCache(blocked).get(KEY) is None


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no folder that nobody can write")
def test_a_read_only_file_system_is_lived_with(doubling):
    with pytest.warns(UserWarning, match="cannot be kept in /proc/ebb"):
        run(doubling, ObjectCache(Path("/proc/ebb")))


@pytest.mark.parametrize("name", ["with a space", "новый", "a\nb", "%s{0}", "'\"", "x" * 200, "." * 3])
def test_odd_names_of_folders(tmp_path, name):
    ObjectCache(tmp_path / name).put(KEY, b"code")
    assert ObjectCache(tmp_path / name).get(KEY) == b"code"


def test_a_name_that_is_too_long(doubling, tmp_path):
    with pytest.warns(UserWarning, match="cannot be kept"):
        run(doubling, ObjectCache(tmp_path / ("x" * 300)))


def test_a_folder_that_is_removed_is_made_again(doubling, compilations, tmp_path):
    cache = ObjectCache(tmp_path / "cache")
    run(doubling, cache)
    shutil.rmtree(cache.directory)
    run(doubling, cache)
    assert len(compilations) == 2 and cache_usage(cache.directory)[0] == 1


def test_a_failed_write_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(source, target):
        raise OSError("no space left")

    monkeypatch.setattr(os, "replace", full)
    with pytest.warns(UserWarning, match="no space left"):
        ObjectCache(tmp_path).put(KEY, b"code")
    assert not list(tmp_path.iterdir())


def test_who_is_late_does_not_warn(tmp_path, monkeypatch):
    """On Windows a file that is being read cannot be replaced; there it is all the same."""
    cache = ObjectCache(tmp_path)
    cache.put(KEY, b"code")

    def in_use(source, target):
        raise PermissionError("in use")

    monkeypatch.setattr(os, "replace", in_use)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cache.put(KEY, b"code")
    assert cache.get(KEY) == b"code" and len(list(tmp_path.iterdir())) == 1


def test_keys_tell_the_parts_apart():
    assert key_of("ab", "c") != key_of("a", "bc") and key_of("a") == key_of("a")


def test_the_folder_is_chosen_by_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path))
    assert cache_directory() == tmp_path
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EBB_CACHE_DIR", "here")
    assert cache_directory() == tmp_path / "here"
    monkeypatch.delenv("EBB_CACHE_DIR")
    assert cache_directory().name == "ebb"


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="the folder is elsewhere")
def test_a_user_without_a_home(monkeypatch, tmp_path):
    for name in ("EBB_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    assert cache_directory() == tmp_path / f"ebb-{os.geteuid()}"


def test_a_working_folder_that_is_gone(monkeypatch, tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    try:
        gone.rmdir()
    except OSError:
        pytest.skip("it cannot be removed here")
    monkeypatch.setenv("EBB_CACHE_DIR", "here")
    with pytest.warns(UserWarning, match="cannot be kept"):
        ObjectCache().put(KEY, b"code")


def test_the_limit_is_chosen_by_the_environment(monkeypatch):
    monkeypatch.delenv("EBB_CACHE_SIZE", raising=False)
    assert cache_limit() == DEFAULT_LIMIT
    monkeypatch.setenv("EBB_CACHE_SIZE", "3")
    assert cache_limit() == 3 << 20
    for text in ("much", "-1", "1.5", "5G"):
        monkeypatch.setattr(caching._Warned, "variables", frozenset())
        monkeypatch.setenv("EBB_CACHE_SIZE", text)
        with pytest.warns(UserWarning, match="EBB_CACHE_SIZE"):
            assert cache_limit() == DEFAULT_LIMIT


def test_a_limit_of_zero_keeps_nothing(doubling, compilations, tmp_path):
    run(doubling, ObjectCache(tmp_path))
    run(doubling, ObjectCache(tmp_path, 0))
    run(doubling, ObjectCache(tmp_path / "other", 0))
    assert len(compilations) == 3 and not (tmp_path / "other").exists()


def aged(path, seconds):
    then = time.time() - seconds
    os.utime(path, (then, then))


def test_what_was_not_used_for_longest_goes(tmp_path):
    cache = ObjectCache(tmp_path, 1000)
    keys = [f"1{number:063x}" for number in range(9)]
    for number, key in enumerate(keys):
        cache.put(key, bytes(100))
        aged(tmp_path / f"{key}.o", 10_000 * (len(keys) - number))
    stranger = tmp_path / "thesis.o"
    stranger.write_bytes(bytes(5000))
    assert cache.get(keys[0]) is not None, "a use is noted"
    cache.put(SWEEPING + "a", bytes(100))
    left = {path.stem for path in tmp_path.iterdir()}
    assert left == {keys[0], *keys[-3:], SWEEPING + "a", "thesis"}, "750 bytes stay"
    assert cache_usage(tmp_path) == (5, 5 * 132)


def test_below_the_limit_nothing_goes(tmp_path):
    cache = ObjectCache(tmp_path, 1000)
    for last in "abcdef":
        cache.put(SWEEPING + last, bytes(100))
    assert cache_usage(tmp_path)[0] == 6


def test_code_larger_than_the_limit_is_not_kept(tmp_path):
    ObjectCache(tmp_path, 1000).put(SWEEPING + "a", bytes(1000))
    assert not list(tmp_path.iterdir())


def test_what_killed_processes_left_goes_when_it_is_old(tmp_path):
    old, new = (tmp_path / f"{KEY}.{letter * 16}.part" for letter in "ab")
    other = tmp_path / "download.part"
    for path in (old, new, other):
        path.write_bytes(b"half")
    for path in (old, other):
        aged(path, 100_000)
    ObjectCache(tmp_path).put(SWEEPING + "a", b"code")
    assert not old.exists() and new.exists() and other.exists()
