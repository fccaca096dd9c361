"""Options and fixtures that all kinds of tests share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from backends import BACKENDS, running_on

# Test processes run side by side, so threads that wait must not spin. Read when an OpenMP runtime is loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

Golden = Callable[[Path, str], None]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-golden", action="store_true", help="write the golden files instead of comparing")


@pytest.fixture(scope="session", autouse=True)
def compiled_kernels(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """One cache folder a session: programs that differ in data only compile once, and no older build is believed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EBB_CACHE_DIR", str(tmp_path_factory.mktemp("kernels")))
        yield


@pytest.fixture(scope="session", autouse=True)
def threads_for_little_work() -> Iterator[None]:
    """Tests run on small data, where a launch would take one thread whatever it is allowed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ebb.runtime.threads.GRAIN", 1e-6)
        patch.setattr("ebb.runtime.threads.GRAIN_OF_PYTHON", 1e-6)
        yield


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Iterator[str]:
    """The name of the backend that the program runs on."""
    yield from running_on(request.param)


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """Compares a text with a golden file, or writes the file under ``--update-golden``."""

    def check(path: Path, text: str) -> None:
        if request.config.getoption("--update-golden"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        assert path.is_file(), f"there is no {path.name}; write it with --update-golden, then read it"
        assert text == path.read_text(encoding="utf-8")

    return check
