"""Indexes that no program knows of: the compiler makes them to find the rows that reduce into a row."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ebb.relations.field import Field
from ebb.relations.grouping import Grouping
from ebb.relations.sorting import stable_order
from ebb.runtime.buffer import Array, Buffer

if TYPE_CHECKING:
    from ebb.relations.relation import Relation


def hidden_index(relation: Relation, name: str, target: Relation) -> Field:
    """A field whose grouping finds rows of ``relation`` by rows of ``target``; ``index_keys`` says which.

    It is no field of the relation: it has no values, orders no storage, and does not follow a permutation.
    """
    index = Field(relation, name, target.key_type, Buffer((0,), target.key_dtype))
    index.grouping = Grouping(index)
    return index


def index_keys(index: Field, keys: Array, rows: Array | None) -> None:
    """Makes the grouping of a hidden index that of ``keys``.

    Args:
        index: the hidden index.
        keys: positions of its target, -1 where there is none.
        rows: the position of the row that has each of the keys; None where they count up from 0.
    """
    grouping, target = index.grouping, index.target
    assert grouping is not None and target is not None
    order = stable_order(keys)
    dtype = index.relation.key_dtype
    grouping.rows = (order if rows is None else rows[order]).astype(dtype)
    counts = np.bincount(np.add(keys, 1, dtype=np.int64), minlength=target.size + 1)
    grouping.offsets = np.cumsum(counts, dtype=dtype)
