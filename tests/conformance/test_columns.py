"""The programs of other files with every vector and matrix in columns, as a launch may lay them."""

from __future__ import annotations

import pytest

from ebb.runtime.buffer import Buffer, Layout

from .test_corners import *  # noqa: F403
from .test_fields import *  # noqa: F403
from .test_grid_maps import *  # noqa: F403
from .test_program import *  # noqa: F403
from .test_reductions import *  # noqa: F403
from .test_safety import *  # noqa: F403


@pytest.fixture(autouse=True)
def columns(monkeypatch):
    """New fields of several components lie in columns."""

    def buffer(shape, dtype):
        return Buffer(shape, dtype, Layout.COLUMNS if len(shape) > 1 else Layout.ROWS)

    monkeypatch.setattr("ebb.relations.field.Buffer", buffer)
