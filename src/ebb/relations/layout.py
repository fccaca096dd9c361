"""The layout of vector and matrix fields, chosen by how kernels reach them."""

from __future__ import annotations

from ebb.relations.reach import Reach
from ebb.relations.relation import Relation


def consider_layout(rows: Relation, reaches: tuple[Reach, ...], run: int) -> None:
    """May convert fields to another layout. The caller holds ``launching()``; arguments as for ``consider_order``.

    Called after the storage order has been considered, and before the launch takes any data or index.
    """
