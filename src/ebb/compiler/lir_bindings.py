"""What stands behind the slots and the arguments of an LIR program: the runtime looks it up at each launch.

It is part of ``ebb.compiler.lir``, where all of these names stand, too.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

from ebb.records import record

if TYPE_CHECKING:
    from ebb.compiler import lir
    from ebb.relations.field import Field
    from ebb.relations.globals import Global
    from ebb.relations.relation import Relation


@record
class FieldData:
    field: Field


@record
class GroupOffsets:
    """Where each group of the grouping of ``index`` starts; one more entry than the target has rows."""

    index: Field


@record
class GroupRows:
    """The positions of the grouped rows, where the storage is not sorted by ``index``."""

    index: Field


@record
class RowOrder:
    """The identity of the row at each position of ``relation``."""

    relation: Relation


@record
class GlobalData:
    globl: Global


@record
class Partials:
    """What each block has summed in ``sum`` by the reduction number ``reduction``, one block after the other."""

    reduction: int
    sum: lir.Var


@record
class LaunchPositions:
    """The positions of the rows to run on, where they are given as a list."""


@record
class PrintRecords:
    """Records of ``PRINT_HEADER + Program.print_words`` int64 words from ``PRINT_RECORDS`` on, behind how many prints
    there were (``PRINT_COUNTER``) and how many records there is room for (``PRINT_CAPACITY``)."""


@record
class UniformComponent:
    uniform: int
    component: int


@record
class Extent:
    """``relation.shape[dimension]``."""

    relation: Relation
    dimension: int


@record
class ColumnStride:
    """How many elements after a column of a field of ``relation`` the next one begins, in the layout of columns, for
    elements of ``itemsize`` bytes.
    """

    relation: Relation
    itemsize: int


@record
class BlockCount:
    """How many blocks the launch has."""


class RandomWord(Enum):
    """A word of the key or the counter of the random numbers that is the same for a whole launch."""

    SEED_LOW = "seed low"
    SEED_HIGH = "seed high"
    LAUNCH = "launch"
