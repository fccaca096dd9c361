"""The backends that the conformance programs run on."""

from __future__ import annotations

import pytest

import ebb
from backends import BACKENDS, COMPILED, require


@pytest.fixture(params=BACKENDS)
def backend(request):
    """The name of the backend that the program runs on."""
    yield from running_on(request.param)


@pytest.fixture(params=COMPILED)
def compiled(request):
    """As ``backend``, for programs that would take the reference interpreter too long."""
    yield from running_on(request.param)


def running_on(name):
    """Runs the program on the backend ``name``."""
    require(name)
    with ebb.backend(name):
        yield name
