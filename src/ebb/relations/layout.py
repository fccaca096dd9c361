"""The layout of vector and matrix fields, chosen by the kernels that reach them.

LLVM computes 4 to 16 consecutive rows of a straight-line kernel at once. It then needs vectors of one component of
consecutive rows. In columns that is a load; where the components of a row lie together it is loads and shuffles, at a
price that grows with the number of components. Measured on Zen 4, for kernels with arithmetic enough that memory is
not all that counts: hardly any up to four components, 1.5 times the time at five and six, 1.5 to 4 times at nine. For
kernels that wait for memory the two are alike; columns may be slower, since each is a stream of its own.

All others want the components of a row together: kernels that go through keys, which in columns would fetch a line of
the cache for each component, and kernels with loops, where LLVM makes vectors of the components of one row.

So wide fields lie in columns where launches gain by it that do not lose elsewhere. Keys stay in rows: what takes the
time are the rows that they lead to. The decision follows from the launches alone, never from time measured. It costs
a second compilation of the kernels that reach the field, so it waits until a launch has come back some times.
"""

from __future__ import annotations

from collections.abc import Callable

from ebb.relations.family import Family, family_of
from ebb.relations.field import Field
from ebb.relations.reach import Pace, Reach
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

LOSS = 2
"""How much more a row loses by columns that is none for them than one gains that is."""

MOST_CONVERSIONS = 2
"""To columns, and back if those that lose come later."""


def consider_layout(rows: RowSet, reaches: tuple[Reach, ...], pace: Callable[[], Pace], run: int) -> None:
    """May convert fields to another layout. The caller holds ``launching()``.

    Called after the storage order has been considered, and before the launch takes any data or index.

    Args:
        rows: what the kernel runs on.
        reaches: how it reaches each field that it uses.
        pace: tells how it goes over its rows.
        run: how many times the launch has run before.
    """
    for reach in reaches:
        if not _is_wide(reach.field) or reach.field.relation.storage.pinned:
            continue
        family = family_of(reach.field)
        if run in COUNTED_RUNS:
            _count(rows, reach, pace(), family)
        if run >= DECIDING_RUN:
            _decide(family)
        family.convert(*family.members)


def may_convert(reaches: tuple[Reach, ...]) -> bool:
    """Whether ``consider_layout`` may ever convert anything that a launch reaches."""
    return any([_is_wide(reach.field) for reach in reaches])


def _is_wide(field: Field) -> bool:
    return field.type.size >= LEAST_COMPONENTS and not field.holds_keys and field.relation.size >= LEAST_ROWS


def _count(rows: RowSet, reach: Reach, pace: Pace, family: Family) -> None:
    """Notes one launch."""
    is_list = rows.boxes is None and rows.row_positions() is not None
    if reach.keyed:
        family.losing += _rows_through(rows, reach.through)
    elif is_list or pace is Pace.SCALAR:
        family.losing += rows.size
    elif pace is Pace.VECTOR:
        family.gaining += rows.size


def _rows_through(rows: RowSet, through: tuple[Field, ...]) -> int:
    """About how many rows a launch reaches by the key fields ``through``: a query finds many for each of its own."""
    most = max((field.relation.size for field in through), default=0)
    return max(rows.size, most * rows.size // max(rows.relation.size, 1))


def _decide(family: Family) -> None:
    pays = family.gaining > 0 and LOSS * family.losing <= family.gaining
    layout = Layout.COLUMNS if pays else Layout.ROWS
    if layout is not family.layout and family.conversions < MOST_CONVERSIONS:
        family.conversions += 1
        family.layout = layout
