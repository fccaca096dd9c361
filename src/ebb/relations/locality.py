"""How close together rows lie that are reached one after the other, measured on a sample of what keys refer to."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ebb.records import record
from ebb.relations.cuthill_mckee import Graph
from ebb.relations.storage import Rows, inverse
from ebb.runtime.buffer import Array

BLOCK_KEYS = 1 << 15
"""Keys in a block of the sample: in the time of so many accesses a line of the cache may well stay where it is."""

SAMPLED_BLOCKS = 16

GRANULE = 256
"""Bytes: a few lines of the cache, since the processor fetches neighbours of the line that it was asked for."""


@record
class Spread:
    """The memory that the rows lie in which a block of keys reaches.

    Attributes:
        keys: how many there are in a block.
        touched: bytes, on average, in whole granules.
        least: bytes, if all rows lay in the order in which they are reached.
    """

    keys: int
    touched: float
    least: float

    @property
    def ratio(self) -> float:
        """How many times the least memory is touched."""
        return self.touched / self.least if self.least else 1.0


@record
class Placed:
    """A relation whose rows are reached: how many there are, and the bytes of each that are used."""

    size: int
    width: int

    def spread(self, blocks: Iterable[Array], share: float) -> Spread:
        """The spread of ``blocks`` of positions, each of which stands for that share of all accesses."""
        step = max(GRANULE, self.width)
        touched, keys, count = 0, 0, 0
        for positions in blocks:
            granules = positions[positions >= 0].astype(np.int64) * self.width // step
            mark = np.zeros(self.size * self.width // step + 1, dtype=np.bool_)
            mark[granules] = True
            touched += int(np.count_nonzero(mark)) * step
            keys += positions.size
            count += 1
        return Spread(keys // max(count, 1), touched / max(count, 1), self.size * self.width * share)


def spread_of_keys(placed: Placed, columns: Array, order: Rows | None = None, moved: Rows | None = None) -> Spread:
    """The spread of keys that are read row after row.

    Args:
        placed: what the keys refer to.
        columns: the keys of each row, shape ``(rows, keys of a row)``.
        order: the order in which the rows are taken, by default that in which they stand.
        moved: the new position of each row that is referred to, by default as it is.
    """
    rows, keys = columns.shape
    length = min(rows, max(1, BLOCK_KEYS // keys))

    def blocks() -> Iterator[Array]:
        for start in _sample(rows, length):
            block = slice(start, start + length)
            found = columns[block] if order is None else columns[order[block]]
            yield found.ravel() if moved is None else np.where(found < 0, -1, moved[found]).ravel()

    return placed.spread(blocks(), length / rows)


def spread_of_links(placed: Placed, graph: Graph, order: Rows) -> Spread:
    """The spread of the neighbours of rows that are taken, and lie, in ``order``."""
    length = max(1, min(graph.size, BLOCK_KEYS * graph.size // max(graph.neighbours.size, 1)))
    moved = inverse(order)

    def blocks() -> Iterator[Array]:
        for start in _sample(graph.size, length):
            yield moved[graph.reached(order[start : start + length])[0]]

    return placed.spread(blocks(), length / graph.size)


def _sample(rows: int, length: int) -> list[int]:
    """Where the sampled blocks of that length begin, spread evenly over the rows."""
    count = max(1, rows // length)
    return [index * count // min(count, SAMPLED_BLOCKS) * length for index in range(min(count, SAMPLED_BLOCKS))]
