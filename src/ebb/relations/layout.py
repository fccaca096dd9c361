"""The layout of vector and matrix fields, chosen by how kernels reach them.

A kernel that goes over rows as they are stored, through the own row or at affine offsets, works on some 4 to 16 rows at
once if it can load one component of consecutive rows. Where the components of a row lie together, LLVM loads and
shuffles them, at a price that grows with their number: none to be seen for up to four components, half of the time
from some six on, and from nine on it goes through memory element by element. In columns there is no such price. A
kernel that goes through keys wants the components of a row together: they are one or two lines of the cache, and in
columns one line each.

So wide fields that are only streamed lie in columns, all others in rows. Keys stay in rows: what takes the time are the
rows that they lead to. The decision follows from the launches alone, never from time measured, and it costs a second
compilation of the kernels that reach the field, so that it waits until a launch has come back some times.
"""

from __future__ import annotations

from ebb.relations.family import Family, family_of
from ebb.relations.field import Field
from ebb.relations.reach import Reach
from ebb.relations.subset import RowSet
from ebb.runtime.buffer import Layout

LEAST_COMPONENTS = 5
"""From how many components on columns pay."""

LEAST_ROWS = 16_384
"""From how many rows on the time that a launch saves is worth a compilation."""

COUNTED_RUNS = range(2, 8)
"""The runs of a launch that are counted: what runs once or twice, to begin with, says nothing of what follows."""

DECIDING_RUN = 5
"""From this run of a launch on, counted from 0, the layout of what it reaches is decided."""

GATHER_WEIGHT = 4
"""A row that is reached through a key loses about that many times what a row that is streamed gains."""

MOST_CONVERSIONS = 2
"""To columns, and back if what comes later goes through keys."""


def consider_layout(rows: RowSet, reaches: tuple[Reach, ...], run: int) -> None:
    """May convert fields to another layout. The caller holds ``launching()``.

    Called after the storage order has been considered, and before the launch takes any data or index.

    Args:
        rows: what the kernel runs on.
        reaches: how it reaches each field that it uses.
        run: how many times the launch has run before.
    """
    for reach in reaches:
        if not _is_wide(reach.field) or reach.field.relation.storage.pinned:
            continue
        family = family_of(reach.field)
        if run in COUNTED_RUNS:
            _count(rows, reaches, reach, family)
        if run >= DECIDING_RUN:
            _decide(family)
        family.convert(family.layout)


def _is_wide(field: Field) -> bool:
    return field.type.size >= LEAST_COMPONENTS and not field.holds_keys and field.relation.size >= LEAST_ROWS


def _count(rows: RowSet, reaches: tuple[Reach, ...], reach: Reach, family: Family) -> None:
    """Notes one launch."""
    if reach.keyed:
        family.gathered += _rows_through(rows, reach.through)
    elif rows.boxes is None and rows.row_positions() is not None:
        family.gathered += rows.size
    elif not any(other.queried or (other.keyed and other.changed) for other in reaches):
        family.streamed += rows.size  # else one row after the other is computed, and either layout will do


def _rows_through(rows: RowSet, through: tuple[Field, ...]) -> int:
    """About how many rows a launch reaches by the key fields ``through``: a query finds many for each of its own."""
    most = max((field.relation.size for field in through), default=0)
    return max(rows.size, most * rows.size // max(rows.relation.size, 1))


def _decide(family: Family) -> None:
    pays = family.streamed > 0 and GATHER_WEIGHT * family.gathered <= family.streamed
    layout = Layout.COLUMNS if pays else Layout.ROWS
    if layout is not family.layout and family.conversions < MOST_CONVERSIONS:
        family.conversions += 1
        family.layout = layout
