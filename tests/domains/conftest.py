"""The backends that the programs on grids run on."""

from __future__ import annotations

import pytest

import ebb
from backends import runnable


@pytest.fixture(params=runnable("cpu", "reference"))
def backend(request):
    """The name of the backend that the program runs on."""
    with ebb.backend(request.param):
        yield request.param
