"""The backends that the solvers run on."""

from __future__ import annotations

import pytest

import ebb
from backends import BACKENDS, lacking


@pytest.fixture(params=BACKENDS)
def backend(request):
    """The name of the backend that the program runs on."""
    reason = lacking(request.param)
    if reason is not None:
        pytest.skip(reason)
    with ebb.backend(request.param):
        yield request.param
