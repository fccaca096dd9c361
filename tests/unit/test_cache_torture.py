"""The cache under processes that are killed, that all begin at once, and whose disk is full: results stay right."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ebb.backends.cache import cache_usage

HERE = Path(__file__).parent
PROGRAM = HERE / "cached_program.py"
KERNELS = 4
FILES = KERNELS + 1  # the driver takes launches through all of them

needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")


def start(folder, *before, script=PROGRAM, arguments=()):
    """Starts a Python process; ``before`` are lines that run ahead of the script."""
    code = "\n".join(
        (
            *before,
            f"import runpy, sys; sys.argv = {[str(script), *arguments]!r}",
            f"runpy.run_path({str(script)!r}, run_name='__main__')",
        )
    )
    environment = {**os.environ, "EBB_CACHE_DIR": str(folder), "EBB_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", code], env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def finish(process):
    """What the process printed, and what it complained of."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return out, err


def run(folder, *before):
    """Runs the program, whose results must be right, and returns its complaints."""
    out, err = finish(start(folder, *before))
    assert out == "right\n"
    return err


@needs_fork
@pytest.mark.parametrize("count", [10, pytest.param(200, marks=pytest.mark.slow)])
def test_processes_are_killed_while_they_write(tmp_path, count):
    full, torn = tmp_path / "full", tmp_path / "torn"
    assert run(full) == ""
    script = HERE / "killed_writers.py"
    out, err = finish(start(full, script=script, arguments=(str(full), str(torn), str(count))))
    assert err == "" and int(out) > 0, "some were killed in the middle of a file"
    assert run(torn) == ""
    assert cache_usage(torn)[0] >= KERNELS


@pytest.mark.parametrize("count", [4, pytest.param(8, marks=pytest.mark.slow)])
def test_processes_begin_at_once_on_an_empty_folder(tmp_path, count):
    processes = [start(tmp_path / "cache") for _ in range(count)]
    assert [finish(process) for process in processes] == [("right\n", "")] * count
    files = sorted(path.suffix for path in (tmp_path / "cache").iterdir())
    assert [suffix for suffix in files if suffix not in (".f", ".i")] == [".o"] * FILES


@pytest.mark.slow
def test_processes_throw_out_the_files_of_each_other(tmp_path):
    """With room for one kernel or two, every process removes what the others are about to read."""
    always = "import ebb.backends.cache as c; c._SWEEPING = ''; c.cache_limit = lambda: 5000"
    for _ in range(3):
        processes = [start(tmp_path, always) for _ in range(4)]
        assert [finish(process) for process in processes] == [("right\n", "")] * 4
    assert cache_usage(tmp_path)[1] <= 5000


@pytest.mark.slow
def test_the_folder_is_removed_again_and_again(tmp_path):
    folder = tmp_path / "cache"
    removing = "import shutil, sys, time\nwhile True: shutil.rmtree(sys.argv[1], ignore_errors=True); time.sleep(1e-4)"
    remover = subprocess.Popen([sys.executable, "-c", removing, str(folder)])
    try:
        for _ in range(4):
            run(folder)
    finally:
        remover.kill()
        remover.wait()


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such limits")
@pytest.mark.parametrize("largest", [0, 1, 300])
def test_files_cannot_grow(tmp_path, largest):
    """A write that the system cuts short fails as on a full disk does."""
    limited = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({largest}, {largest}))"
    complaint = run(tmp_path, limited)
    assert complaint.count("UserWarning") == 1 and "cannot be kept" in complaint
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".i"]


@pytest.fixture
def tiny_disk(tmp_path):
    """A file system with room for a page or two."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=8k", "tmpfs", str(folder)]
    try:
        subprocess.run(mount, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no file system can be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_the_disk_is_full(tiny_disk):
    complaint = run(tiny_disk)
    assert complaint.count("UserWarning") == 1 and "No space left" in complaint
    assert not list(tiny_disk.glob("*.part"))
    assert 0 < cache_usage(tiny_disk)[0] < KERNELS, "what there was room for was kept"
    assert "No space left" in run(tiny_disk)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no folder that nobody can write")
def test_nothing_can_be_kept():
    complaint = run("/proc/ebb")
    assert complaint.count("UserWarning") == 1, "once for all kernels"
