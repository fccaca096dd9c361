"""The benchmarks, on tiny inputs: they run, what they time is right, and what is missing is said."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
TINY = ("--scale", "tiny", "--batch", "0.001", "--threads", "1")

# Every program of Ebb's in one process, against NumPy.
ALL_PROGRAMS = """
import os
os.environ |= {"BENCHMARKS_SYSTEM": "ebb", "EBB_NUM_THREADS": "2"}
from benchmarks.contest import largest_error
from benchmarks.programs import PROGRAMS, Scale
from benchmarks.systems import ebb
for program in PROGRAMS:
    arrays = program.make(program.sizes[Scale.TINY])
    truth = program.expected(arrays, program.check_steps)
    prepared = ebb.PROGRAMS[program.code](arrays)
    prepared.run(program.check_steps)
    error = largest_error(prepared.outputs(), truth)
    assert error <= program.tolerance, f"{program.name} is off by {error}"
    print(program.name)
"""


def run_python(*arguments: str) -> str:
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_programs_compute_what_numpy_computes() -> None:
    names = run_python("-c", ALL_PROGRAMS).split()
    assert {"gather", "scatter-shuffled", "stencil", "pcg", "captured"} <= set(names)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str]:
    """A run of one program by Ebb, by C++, and by a peer that is not installed where it is looked for."""
    folder = tmp_path_factory.mktemp("benchmarks")
    kept = ("--json", str(folder / "results.json"), "--cache", str(folder / "cache"))
    chosen = ("--only", "streaming", "--systems", "ebb,cpp,quadrants", "--rounds", "2")
    table = run_python("-m", "benchmarks.run", *TINY, *chosen, *kept, "--python", sys.executable)
    return json.loads((folder / "results.json").read_text()), table


def test_a_run_times_what_is_there(results: tuple[dict[str, Any], str]) -> None:
    (program,) = results[0]["programs"]
    own = {one["system"]: one for one in program["contestants"] if one["program"] == "streaming"}
    assert own["ebb"]["status"] == "ok"
    assert len(own["ebb"]["seconds"]) == 2
    if shutil.which("g++"):
        assert own["cpp"]["status"] == "ok"
        assert "triad of the machine" in results[1]
    else:
        assert own["cpp"]["text"] == "g++"


def test_a_run_says_what_is_missing(results: tuple[dict[str, Any], str]) -> None:
    (program,) = results[0]["programs"]
    peer = next(one for one in program["contestants"] if one["system"] == "quadrants")
    if peer["status"] != "ok":
        assert (peer["status"], peer["text"]) == ("missing", "quadrants")
        assert "not installed: quadrants" in results[1]


def test_the_page_of_the_docs_has_every_row(results: tuple[dict[str, Any], str]) -> None:
    program = "import json, sys; from benchmarks.report import page; print(*page(json.load(sys.stdin), 'a'), sep='\\n')"
    given = json.dumps(results[0])
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=ROOT, input=given, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    rows = done.stdout.partition("## Every row")[2]
    assert rows.count("| `streaming` |") == len(results[0]["programs"][0]["contestants"])
