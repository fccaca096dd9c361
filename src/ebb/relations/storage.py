"""Where the rows of a relation lie: the identity of a row is for ever, its position is not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary, WeakSet

import numpy as np
import numpy.typing as npt

from ebb.runtime.buffer import Array
from ebb.runtime.epoch import structure_changed

if TYPE_CHECKING:
    from ebb.relations.field import Field
    from ebb.relations.grouping import Grouping

Rows = npt.NDArray[np.int64]


class Storage:
    """The order in which the rows of one relation are stored, and who must know when it changes.

    Attributes:
        size: the number of rows.
        order: identity by position, or None while every row lies at its identity.
        rank: position by identity, the inverse of ``order``, or None.
        version: counts the permutations; what is derived from positions compares it.
        referrers: the key fields that point to the relation, held weakly.
        primary: the grouping that decides the order, or None.
        pinned: whether somebody may hold a view of a field, so that rows are not moved without being asked to.
        compiled: what each kernel keeps for the relation: here, so that it goes with the relation, and with the kernel.
    """

    __slots__ = ("compiled", "order", "pinned", "primary", "rank", "referrers", "size", "version")

    def __init__(self, size: int) -> None:
        self.size = size
        self.order: Rows | None = None
        self.rank: Rows | None = None
        self.version = 0
        self.referrers: WeakSet[Field] = WeakSet()
        self.primary: Grouping | None = None
        self.pinned = False
        self.compiled: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()

    def positions_of(self, identities: Array) -> Array:
        """The positions of the rows with these identities, all in range."""
        return identities if self.rank is None else self.rank[identities]

    def identities_of(self, positions: Array) -> Array:
        """The identities of the rows at these positions; -1, the unset key, stays -1."""
        if self.order is None:
            return positions
        return through_table(self.order, positions).astype(positions.dtype)

    def reorder(self, order: Rows, moved: Rows) -> None:
        """Records that the row at position ``order[p]`` has moved to ``p``; ``moved`` is the inverse of ``order``."""
        identities = order.copy() if self.order is None else self.order[order]
        self.rank = moved if self.rank is None else moved[self.rank]
        self.order = identities
        self.version += 1
        structure_changed()


def is_permutation(order: Rows, size: int) -> bool:
    """Whether ``order`` has each of the numbers from 0 to ``size - 1`` once."""
    if order.shape != (size,) or ((order < 0) | (order >= size)).any():
        return False
    seen = np.zeros(size, dtype=np.bool_)
    seen[order] = True
    return bool(seen.all())


def inverse(order: Rows) -> Rows:
    """The inverse of a permutation."""
    result = np.empty_like(order)
    result[order] = np.arange(order.size, dtype=np.int64)
    return result


def through_table(table: Array, keys: Array) -> Array:
    """``table[keys]`` with -1, the unset key, going to -1."""
    # Python's negative index does the test for us: entry -1 of the longer table is its last one.
    return np.append(table, -1)[keys]
