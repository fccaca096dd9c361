"""The command line, as a user calls it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import ebb
from ebb import cli
from ebb.backends.cache import ObjectCache
from ebb.diagnostics.explain import find_page, known_codes, nearest_codes


def ebb_command(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs ``ebb arguments`` in a process of its own."""
    start = [sys.executable, "-c", "import sys; from ebb.cli import main; sys.argv[0] = 'ebb'; main()"]
    return subprocess.run(
        [*start, *arguments], capture_output=True, text=True, check=False, env={**os.environ, **environment}
    )


def test_explain_prints_the_page() -> None:
    result = CliRunner().invoke(cli.app, ["explain", "E301"])
    assert result.exit_code == 0
    assert result.output.startswith("# E301: ")


@pytest.mark.parametrize("written", ["E301", "e301", "301", "error[E301]", "E301:"])
def test_codes_may_be_written_as_they_are_seen(written: str) -> None:
    assert find_page(written) == find_page("E301") is not None


def test_explain_lists_all_codes() -> None:
    lines = CliRunner().invoke(cli.app, ["explain"]).output.splitlines()
    assert [line.partition(":")[0] for line in lines] == list(known_codes())


def test_unknown_code_names_the_nearest() -> None:
    assert "E301" in nearest_codes("E3001")
    result = CliRunner().invoke(cli.app, ["explain", "E3001"])
    assert result.exit_code == 1
    assert "did you mean E301" in result.stderr


def test_info_says_what_there_is() -> None:
    result = CliRunner().invoke(cli.app, ["info"])
    assert result.exit_code == 0
    rows = dict(line.split(maxsplit=1) for line in result.output.splitlines() if not line.startswith(" "))
    assert rows["ebb"].startswith(ebb.__version__)
    assert {"python", "numpy", "llvmlite", "llvm", "processor", "threads", "cache"} <= set(rows)


def test_info_says_what_the_cache_holds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def described() -> str:
        return next(
            line for line in CliRunner().invoke(cli.app, ["info"]).output.splitlines() if line.startswith("cache")
        )

    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path / "kernels"))
    monkeypatch.setenv("EBB_CACHE_SIZE", "2")
    assert described().endswith("kernels: 0 kernels, 0 B of at most 2.0 MiB")
    ObjectCache(tmp_path / "kernels").put("1" * 64, bytes(1000))
    assert described().endswith("kernels: 1 kernel, 1.0 KiB of at most 2.0 MiB")
    (tmp_path / "file").touch()
    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path / "file" / "kernels"))
    assert "cannot be written" in described()
    monkeypatch.setenv("EBB_CACHE_SIZE", "0")
    assert "EBB_CACHE_SIZE is 0" in described()


PROGRAM = """import sys
import ebb

rows = ebb.Relation("rows", size=3)
rows.new_field("x", ebb.float64, init=1.0)


@ebb.kernel
def check(r: rows):
    assert r.x > 1, "too small"


print(sys.argv[1:], __name__, flush=True)
check(rows)
"""


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_run_gives_the_program_its_arguments_and_its_own_traceback(backend: str, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    result = ebb_command("run", "--backend", backend, str(program), "--steps", "3", "--backend", "x", EBB_TRACEBACK="")
    assert result.stdout == "['--steps', '3', '--backend', 'x'] __main__\n"
    assert result.returncode == 1
    frames = [line for line in result.stderr.splitlines() if line.startswith("  File ")]
    assert f'File "{program}", line 14' in frames[0]
    assert not any("runpy" in frame or "cli.py" in frame for frame in frames)
    assert "KernelAssertionError: error[E401]" in result.stderr


def test_run_passes_the_exit_status_on(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text("raise SystemExit(7)\n")
    assert ebb_command("run", str(program)).returncode == 7


def test_run_refuses_an_unknown_backend(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text("print('ran')\n")
    result = ebb_command("run", "--backend", "cpux", str(program))
    assert result.returncode == 1
    assert "ran" not in result.stdout
    assert "error[E6" in result.stderr


def test_run_without_a_file_says_so() -> None:
    result = ebb_command("run", "nothing.py")
    assert result.returncode == 2
    assert "nothing.py" in result.stderr


def test_demo_runs_the_example() -> None:
    result = ebb_command("demo", "--help")
    assert result.returncode == 0
    assert "--mesh" in result.stdout and "--steps" in result.stdout
