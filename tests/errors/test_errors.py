"""Wrong programs, and what the user reads: each case has a mark on the line of the error and a golden text beside it.

A case is a program ``cases/GROUP/NAME.py`` with ``#~ E301`` on the line of the primary caret, or where an error has no
place in a kernel, on the line of the case that raised it. ``NAME.err`` is what the user reads.
"""

from __future__ import annotations

import re
import runpy
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path

import pytest

import ebb
from backends import BACKENDS, require
from ebb.diagnostics.diagnostic import Diagnostic

HERE = Path(__file__).parent
CASES = sorted((HERE / "cases").glob("*/*.py"))
# What stops a running kernel reads the same on every backend, so these cases run on all of them.
RUNNING = [(case, backend) for case in CASES for backend in BACKENDS if case.parent.name == "running"]


def run_case(case: Path) -> ebb.EbbError:
    with pytest.raises(ebb.EbbError) as caught:
        runpy.run_path(str(case), run_name="case")
    return caught.value


def expected_marks(case: Path) -> list[tuple[int, str]]:
    lines = enumerate(case.read_text(encoding="utf-8").splitlines(), 1)
    return sorted((number, code) for number, line in lines if "#~" in line for code in line.split("#~")[1].split())


def found_marks(case: Path, error: ebb.EbbError) -> list[tuple[int, str]]:
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(case)]
    return sorted((mark_line(case, each) or frames[-1].lineno or 0, each.code) for each in error.diagnostics)


def mark_line(case: Path, diagnostic: Diagnostic) -> int | None:
    span = diagnostic.primary.span if diagnostic.primary else None
    while span is not None and span.source.filename != str(case):
        span = span.caller
    return span.line if span is not None else None


def user_text(error: ebb.EbbError, work: Path) -> str:
    text = str(error)
    for folder in (work, HERE / "cases", HERE, Path(ebb.__file__).parents[1]):
        text = text.replace(f"{folder}/", "")
    return re.sub(r"0x[0-9a-f]{6,}", "0x...", f"{type(error).__name__}: {text}\n")


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty current directory, and the case's imports from here. What a case takes away comes back."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(HERE)
    modules = dict(sys.modules)
    yield tmp_path
    sys.modules.update(modules)
    for name in [name for name, module in sys.modules.items() if module is None and name not in modules]:
        del sys.modules[name]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.parent.name}-{case.stem}")
def test_error(case: Path, work: Path, golden) -> None:
    error = run_case(case)
    golden(case.with_suffix(".err"), user_text(error, work))
    assert found_marks(case, error) == expected_marks(case)


@pytest.mark.parametrize(("case", "backend"), RUNNING, ids=lambda value: getattr(value, "stem", value))
def test_a_running_kernel_stops_alike_on_every_backend(case: Path, backend: str, work: Path, golden) -> None:
    require(backend)
    with ebb.backend(backend):
        error = run_case(case)
    golden(case.with_suffix(".err"), user_text(error, work))
    assert found_marks(case, error) == expected_marks(case)


def test_every_golden_text_has_its_case() -> None:
    assert sorted((HERE / "cases").glob("*/*.err")) == [case.with_suffix(".err") for case in CASES]
