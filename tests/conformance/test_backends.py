"""Choosing a backend, and switching in the middle of a program."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import ebb
from backends import runnable

from .harness import LARGE, rejects, rows_with

PROGRAM = """
import ebb
rows = ebb.Relation("rows", size=3)
rows.new_field("x", ebb.float64, init=1.0)
@ebb.kernel
def add(r: rows):
    r.x += 1
add(rows)
print(add.inspect(rows, "kir") != "", rows.x.to_numpy().tolist())
try:
    print(add.inspect(rows, "llvm") != "")
except ebb.KernelTypeError:
    print("no llvm")
"""


def run_program(tmp_path, **environment):
    """The program above in a process of its own."""
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    cleared = {name: value for name, value in os.environ.items() if not name.startswith("EBB_")}
    return subprocess.run(
        [sys.executable, str(path)],
        env={**cleared, "EBB_CACHE_DIR": str(tmp_path / "cache"), **environment},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def counter():
    rows = rows_with(x=(ebb.float64, [0, 0]))

    @ebb.kernel
    def add(r: rows):
        r.x += 1

    return rows, add


@pytest.fixture(autouse=True)
def restored_backend():
    """``set_backend`` is for the rest of the program; here, for the rest of the test."""
    with ebb.backend("cpu"):
        yield


def shows_llvm(kernel, rows):
    try:
        return kernel.inspect(rows, "llvm") != ""
    except ebb.KernelTypeError:
        return False


def test_set_backend(counter):
    rows, add = counter
    for name in runnable():
        ebb.set_backend(name)
        add(rows)
        assert shows_llvm(add, rows) == (name != "reference")
    np.testing.assert_array_equal(rows.x.to_numpy(), len(runnable()))


def test_with_backend_restores(counter):
    rows, add = counter
    with ebb.backend("reference"):
        assert not shows_llvm(add, rows)
        with ebb.backend("cpu", threads=1):
            assert shows_llvm(add, rows)
            add(rows)
        assert not shows_llvm(add, rows)
        add(rows)
    assert shows_llvm(add, rows)
    with pytest.raises(ZeroDivisionError), ebb.backend("reference"):
        1 / 0
    assert shows_llvm(add, rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [2, 2])


def test_switching_in_the_middle_of_a_program():
    vertices, edges = ebb.Relation("vertices", size=5), ebb.Relation("edges", size=20)
    edges.new_field("tail", vertices, init=np.arange(20) * 7 % 5)
    edges.new_field("head", vertices, init=np.arange(20) * 3 % 5)
    vertices.new_field("x", ebb.float64, init=np.arange(5.0))
    vertices.new_field("y", ebb.float64, init=0.0)
    edges.group_by("tail")
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def gather(v: vertices):
        v.y = 0
        for e in ebb.where(edges.tail, v):
            v.y += e.head.x

    @ebb.kernel
    def measure(v: vertices):
        total.value += v.y

    expected, x = 0.0, np.arange(5.0)
    for step in range(7):
        with ebb.backend(runnable()[step % len(runnable())]):
            gather(vertices)
            measure(vertices)
        vertices.swap("x", "y")
        x = np.bincount(np.arange(20) * 7 % 5, x[np.arange(20) * 3 % 5], 5)
        expected += x.sum()
        edges.tail.load(edges.tail.to_numpy())
    np.testing.assert_array_equal(vertices.x.to_numpy(), x)
    assert total.value == expected


@pytest.mark.parametrize("name", ["gpu", "CPU", "", "cuda2", "numba"])
def test_unknown_names(counter, name):
    rows, add = counter
    error = rejects(ebb.BackendError, "E6", lambda: ebb.set_backend(name))
    assert "cpu" in str(error)
    rejects(ebb.BackendError, "E6", lambda: ebb.backend(name).__enter__())
    add(rows)
    assert shows_llvm(add, rows)


def test_unknown_options(counter):
    rejects(ebb.BackendError, "E6", lambda: ebb.set_backend("cpu", treads=2))
    rejects(ebb.BackendError, "E6", lambda: ebb.set_backend("reference", threads=2))
    for threads in (0, -1, 1.5, "two"):
        rejects(ebb.BackendError, "E6", lambda: ebb.set_backend("cpu", threads=threads))


@pytest.mark.parametrize("name", ["opencl", "cuda"])
def test_a_missing_driver_is_an_error_and_changes_nothing(counter, name):
    """On a machine that has the device the backend is simply there."""
    rows, add = counter
    try:
        ebb.set_backend(name)
    except ebb.BackendError as error:
        assert name in str(error)
    add(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [1, 1])


def test_the_environment_variable(tmp_path):
    default, reference = run_program(tmp_path), run_program(tmp_path, EBB_BACKEND="reference")
    assert default.stdout.splitlines() == ["True [2.0, 2.0, 2.0]", "True"], default.stderr
    assert reference.stdout.splitlines() == ["True [2.0, 2.0, 2.0]", "no llvm"], reference.stderr


def test_the_environment_variable_names_no_backend(tmp_path):
    process = run_program(tmp_path, EBB_BACKEND="nonsense")
    assert process.returncode == 1
    assert "BackendError" in process.stderr and "nonsense" in process.stderr


def test_the_number_of_threads_from_the_environment(tmp_path):
    process = run_program(tmp_path, EBB_NUM_THREADS="2")
    assert process.stdout.startswith("True [2.0"), process.stderr
    process = run_program(tmp_path, EBB_NUM_THREADS="many")
    assert process.returncode == 1 and "EBB_NUM_THREADS" in process.stderr


def test_compiled_kernels_are_kept_on_disk(tmp_path):
    first = run_program(tmp_path)
    files = {path for path in (tmp_path / "cache").rglob("*") if path.is_file()}
    assert files, first.stderr
    second = run_program(tmp_path)
    assert second.stdout == first.stdout
    for path in files:
        path.write_bytes(b"damaged")
    assert run_program(tmp_path).stdout == first.stdout


def test_an_unwritable_cache_folder_is_a_warning(tmp_path):
    (tmp_path / "file").write_text("in the way")
    process = run_program(tmp_path, EBB_CACHE_DIR=str(tmp_path / "file" / "cache"))
    assert process.stdout.startswith("True [2.0"), process.stderr
    assert "Warning" in process.stderr and "cache" in process.stderr


def test_numbers_of_threads_give_one_result():
    rows = ebb.Relation("rows", size=LARGE)
    rows.new_field("x", ebb.float64, init=np.linspace(0, 1, LARGE))
    rows.new_field("y", ebb.float64)

    @ebb.kernel
    def program(r: rows):
        r.y = ebb.sin(r.x) * ebb.exp(r.x) / (1 + r.x)

    results = set()
    for threads in (1, 2, 5):
        with ebb.backend("cpu", threads=threads):
            program(rows)
        results.add(rows.y.to_numpy().tobytes())
    assert len(results) == 1
