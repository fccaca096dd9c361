"""Memory that has been freed goes back to the system when a simulation begins."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import ebb
from ebb.runtime.heap import return_freed

STATM = Path("/proc/self/statm")
PIECE, PIECES = 1 << 16, 512


def resident():
    """Bytes."""
    return int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def leave_holes():
    """Frees 32 MiB in pieces, between which something stays that is returned."""
    pieces = [np.ones(PIECE, dtype=np.uint8) for _ in range(2 * PIECES)]
    return pieces[::2]


@pytest.mark.skipif(not STATM.exists(), reason="the system does not say what is resident")
@pytest.mark.skipif("CS_GNU_LIBC_VERSION" not in os.confstr_names, reason="another C library")
def test_what_was_freed_is_given_back_when_a_captured_step_runs_first():
    relation = ebb.Relation("rows", size=4)
    relation.new_field("x", ebb.float64, init=0.0)

    @ebb.kernel
    def count(r):
        r.x += 1

    count(relation)
    assert given_back_by(return_freed)
    with ebb.capture() as step:
        count(relation)
    assert given_back_by(step.run)
    assert not given_back_by(step.run)
    assert (relation.x.to_numpy() == 3).all()


def given_back_by(act):
    kept = leave_holes()
    before = resident()
    act()
    assert all((piece == 1).all() for piece in kept)
    return before - resident() > PIECE * PIECES // 2
