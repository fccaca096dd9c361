"""Groupings: for each row of a target, the rows whose key refers to it, found in constant time (CSR)."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from ebb.relations.sorting import stable_order
from ebb.relations.storage import Rows
from ebb.runtime.buffer import Array
from ebb.runtime.epoch import structure_changed

if TYPE_CHECKING:
    from ebb.relations.field import Field
    from ebb.relations.relation import Relation


class Grouping:
    """The index of a key field. ``Relation.group_by`` makes them; ``refresh`` makes one valid.

    The rows whose key is position ``t`` of the target are ``range(offsets[t], offsets[t + 1])``, through ``rows`` if
    that is not None, in the order of identities. Rows with an unset key come before ``offsets[0]``.

    Attributes:
        field: the key field.
        offsets: one more than the target has rows, in the relation's ``key_dtype``.
        rows: positions in that dtype, or None where the rows are stored in this very order.
        orders_storage: whether the grouping permutes its relation so that ``rows`` is None.
    """

    __slots__ = ("_built", "field", "offsets", "orders_storage", "rows", "target")

    def __init__(self, field: Field) -> None:
        self.field = field
        self.target = cast("Relation", field.target)
        self.orders_storage = _may_order(field.relation, self.target)
        self.offsets: Array = np.zeros(self.target.size + 1, dtype=field.relation.key_dtype)
        self.rows: Array | None = None
        self._built: tuple[int, int, int] | None = None

    @property
    def stale(self) -> bool:
        """Whether keys or positions have changed since the index was built."""
        return self._built != self._state()

    def refresh(self) -> None:
        """Makes the index valid. May permute the relation, the target, and those that order the target.

        Raises:
            RelationError: the relation must be permuted and a writable view of one of its fields is open.
        """
        _settle(self.field.relation)
        _settle(self.target)
        if self.stale:
            self.build()

    def _state(self) -> tuple[int, int, int]:
        return (self.field.version, self.field.relation.storage.version, self.target.storage.version)

    def build(self) -> None:
        """Builds the index, whether or not it is stale; ``refresh`` decides that."""
        relation, keys = self.field.relation, self.field.data
        self.rows = None
        if not _sorted(keys, relation.storage.order):
            rank = relation.storage.rank
            # Equal keys stay in the order in which they are given: that of identities.
            order = stable_order(keys) if rank is None else rank[stable_order(keys[rank])]
            if self.orders_storage:
                relation.permute(order)
            else:
                self.rows = order.astype(relation.key_dtype)
        # Counted in storage order, and so sequentially where that is sorted. Unset keys, -1, come first.
        counts = np.bincount(np.add(self.field.data, 1, dtype=np.int64), minlength=self.target.size + 1)
        self.offsets = np.cumsum(counts, dtype=relation.key_dtype)
        self._built = self._state()
        structure_changed()

    def __repr__(self) -> str:
        return f"<grouping of {self.field.relation.name} by {self.field.name}>"


def _sorted(keys: Array, identities: Rows | None) -> bool:
    """Whether rows with these keys and identities lie in the order of keys, then identities."""
    if not bool((keys[:-1] <= keys[1:]).all()):
        return False
    return identities is None or bool(((keys[:-1] < keys[1:]) | (identities[:-1] < identities[1:])).all())


def _may_order(relation: Relation, target: Relation) -> bool:
    """Whether a new grouping by a key into ``target`` may decide the storage order of ``relation``.

    The first grouping may, unless the order of the target depends, in the end, on that of the relation: sorting the
    one would then disturb the other for ever.
    """
    if relation.is_grid or any(field.grouping is not None for field in relation.fields.values()):
        return False
    reached: Relation | None = target
    while reached is not None and reached is not relation:
        primary = reached.storage.primary
        reached = primary.target if primary is not None else None
    return reached is None


def _settle(relation: Relation) -> None:
    """Brings the rows of ``relation`` into the order of its primary grouping, after those that it depends on."""
    primary = relation.storage.primary
    if primary is None:
        return
    _settle(primary.target)
    if primary.stale:
        primary.build()
