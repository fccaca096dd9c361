"""The storage order of relations, chosen by how kernels reach their rows."""

from __future__ import annotations

from ebb.relations.reach import Reach
from ebb.relations.relation import Relation


def consider_order(rows: Relation, reaches: tuple[Reach, ...], run: int) -> None:
    """May permute relations so that what a kernel reaches lies close together. The caller holds ``launching()``.

    Called before a launch takes any data or index: at each of the first runs of a launch, and whenever the structure
    has changed since its last run.

    Args:
        rows: the relation that the kernel runs on.
        reaches: how it reaches each field that it uses.
        run: how many times the launch has run before.
    """
