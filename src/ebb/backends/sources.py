"""What stands behind the slots and arguments of a program at a launch, for every backend that compiles kernels."""

from __future__ import annotations

from typing import TypeAlias

from ebb.compiler import lir
from ebb.relations.subset import RowSet
from ebb.runtime.buffer import Array, column_stride
from ebb.runtime.random import LaunchKey

Index: TypeAlias = lir.GroupOffsets | lir.GroupRows | lir.RowOrder | lir.LaunchPositions
"""What programs find rows by. Other arrays take the place of these when the structure changes."""

Constant: TypeAlias = lir.Extent | lir.ColumnStride | lir.BlockCount
"""Arguments that are the same for all launches of a binding."""


def index_array(binding: Index, rows: RowSet) -> Array:
    """The array behind ``binding`` for launches on ``rows``. The groupings that the kernel queries are valid."""
    match binding:
        case lir.GroupOffsets(index):
            found = None if index.grouping is None else index.grouping.offsets
        case lir.GroupRows(index):
            found = None if index.grouping is None else index.grouping.rows
        case lir.RowOrder(relation):
            found = relation.storage.order
        case lir.LaunchPositions():
            found = rows.row_positions()
    assert found is not None, "the program was lowered for data that have it"
    return found


def constant_value(binding: Constant, blocks: int) -> int:
    """The value of an argument for launches of ``blocks`` blocks, or work-groups."""
    match binding:
        case lir.Extent(relation, dimension):
            return relation.shape[dimension]
        case lir.ColumnStride(relation, itemsize):
            return column_stride(relation.size, itemsize)
        case lir.BlockCount():
            return blocks


def random_word(word: lir.RandomWord, key: LaunchKey) -> int:
    """A word of what makes the random numbers of a launch its own."""
    match word:
        case lir.RandomWord.SEED_LOW:
            return key.seed & 0xFFFFFFFF
        case lir.RandomWord.SEED_HIGH:
            return key.seed >> 32
        case lir.RandomWord.LAUNCH:
            return key.launch
