"""The backends that the conformance programs run on, and the marks for what a backend does not do yet."""

from __future__ import annotations

import pytest

import ebb

from .harness import BACKENDS


def pytest_configure(config):
    config.addinivalue_line(
        "markers",
        "notimpl(*backends, reason): these backends cannot run this program yet; strict, so that no gap lingers",
    )


def pytest_collection_modifyitems(items):
    for item in items:
        mark_gaps(item)


def mark_gaps(item):
    """Expects ``BackendError``, strictly, of a program on a backend that one of its ``notimpl`` marks names."""
    running_on = getattr(item, "callspec", None) and item.callspec.params.get("backend")
    for mark in item.iter_markers("notimpl"):
        if running_on in mark.args:
            item.add_marker(pytest.mark.xfail(reason=mark.kwargs["reason"], raises=ebb.BackendError, strict=True))


@pytest.fixture(params=BACKENDS)
def backend(request):
    """The name of the backend that the program runs on."""
    with ebb.backend(request.param):
        yield request.param
