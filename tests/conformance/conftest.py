"""The backends that the conformance programs run on."""

from __future__ import annotations

from pathlib import Path

import pytest

import ptx
from backends import BACKENDS, COMPILED, running_on

TABLES = Path(__file__).parent / "ptx"


@pytest.fixture(params=[*BACKENDS, pytest.param("ptx", marks=pytest.mark.slow)])
def backend(request, monkeypatch):
    """The name of the backend that the program runs on; on ``ptx`` it runs on cpu, and PTX is made and assembled."""
    if request.param != "ptx":
        yield from running_on(request.param)
        return
    ptx.require()
    with ptx.emitting(monkeypatch) as made:
        yield "ptx"
    name = request.node.name.replace("[ptx]", "").replace("[ptx-", "[")
    table = TABLES / f"{request.path.stem}.txt"
    ptx.check_section(table, name, ptx.rows_of(made.images), update=request.config.getoption("--update-golden"))


@pytest.fixture(params=COMPILED)
def compiled(request):
    """As ``backend``, for programs that would take the reference interpreter too long."""
    yield from running_on(request.param)
