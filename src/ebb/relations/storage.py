"""Where the rows of a relation lie: the identity of a row is for ever, its position is not."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np

from ebb.records import record
from ebb.runtime.buffer import Array
from ebb.runtime.epoch import structure_changed

if TYPE_CHECKING:
    import numpy.typing as npt

    from ebb.relations.field import Field
    from ebb.relations.grouping import Grouping

Rows: TypeAlias = "npt.NDArray[np.int64]"

MOST_PATIENCE = 1 << 16
"""How many times keys that keep changing must be met unchanged before the order of rows is decided by them."""


class Storage:
    """The order in which the rows of one relation are stored, and who must know when it changes.

    Attributes:
        size: the number of rows.
        key_dtype: how rows are numbered: in int32 while it has a number for each, else in int64.
        order: identity by position, or None while every row lies at its identity.
        rank: position by identity, the inverse of ``order``, or None.
        version: counts the permutations; what is derived from positions compares it.
        referrers: the key fields that point to the relation, held weakly, the oldest first.
        primary: the grouping that decides the order, or None.
        reason: why the rows are stored in another order than that of a grouping or their creation, or None.
        may_reorder: whether the rows may be permuted for locality without being asked.
        watches: for each key field of the relation that kernels follow, how long it has stayed as it is.
        pinned: whether somebody may hold a view of a field, so that rows are not moved without being asked to.
        compiled: what each kernel keeps for the relation: here, so that it goes with the relation, and with the kernel.
    """

    __slots__ = (
        "compiled",
        "key_dtype",
        "may_reorder",
        "order",
        "pinned",
        "primary",
        "rank",
        "reason",
        "referrers",
        "size",
        "version",
        "watches",
    )

    def __init__(self, size: int) -> None:
        self.size = size
        self.key_dtype: np.dtype[Any] = np.dtype(np.int32 if size <= np.iinfo(np.int32).max else np.int64)
        self.order: Array | None = None
        self.rank: Array | None = None
        self.version = 0
        self.referrers: WeakKeyDictionary[Field, None] = WeakKeyDictionary()
        self.primary: Grouping | None = None
        self.reason: str | None = None
        self.may_reorder = True
        self.watches: dict[Field, Watch] = {}
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

    def moved(self, order: Rows, moved: Rows) -> tuple[Array, Array]:
        """The order and the rank when the row at position ``order[p]`` moves to ``p``; ``moved`` is its inverse."""
        identities = order if self.order is None else self.order[order]
        ranks = moved if self.rank is None else moved[self.rank]
        return identities.astype(self.key_dtype), ranks.astype(self.key_dtype)

    def take_order(self, order: Array, rank: Array, version: int) -> None:
        """Records where the rows have moved to. To do so once more changes nothing."""
        self.order, self.rank = order, rank
        self.reason = None
        self.version = version
        structure_changed()


@record(frozen=False, eq=False)
class Watch:
    """How long the keys of a field have stayed as they are, and what has been decided for them.

    Attributes:
        version: the version of the field that is watched.
        calm: how many times it has been met again since.
        patience: how many times it must be, before anything is decided. It doubles when the keys change, up to a limit.
        width: the widest rows for which has been decided whether they should lie in another order; 0 at first.
    """

    version: int
    calm: int = 0
    patience: int = 2
    width: int = 0

    def restart(self, version: int) -> None:
        """The keys have changed."""
        self.version = version
        self.calm = 0
        self.patience = min(2 * self.patience, MOST_PATIENCE)
        self.width = 0


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
