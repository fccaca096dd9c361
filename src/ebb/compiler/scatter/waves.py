"""Waves: which blocks of a launch run at once. Found by colouring stretches of blocks by the rows that they touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ebb.compiler.scatter.touched import Touched
from ebb.records import record
from ebb.relations.relation import Relation
from ebb.runtime.buffer import Array

if TYPE_CHECKING:
    import numpy.typing as npt

WIDTH = 8
"""The number of threads for which a schedule is judged. It is always this, so that no choice depends on the machine."""

WAVE_BLOCKS = 3.0
"""What it costs to start a wave, in blocks of rows that a thread runs meanwhile."""

COLOUR = 0.08
"""How much longer all rows take for each colour above two: each wave goes through the memory of all targets again."""

_MOST_COLOURS = 64
_GOOD = 0.75
_FIRST_CHUNKS = 2 * WIDTH
"""How many chunks the largest ones tried leave, about: fewer than that and threads stand idle in each wave."""

_FEWER = 4
"""How much smaller the chunks are that are tried next."""


@record(eq=False)
class Waves:
    """Stretches of blocks, the *items*, in waves. The items of a wave run at once, waves follow one another.

    Attributes:
        items: the first block of each item and the one after its last, int64, shape ``(items, 2)``; in each wave they
            ascend.
        starts: the item that each wave starts with, and the number of items.
        chunk: how many blocks an item has, but for the last one.
    """

    items: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    chunk: int

    @property
    def widest(self) -> int:
        """The most items of one wave."""
        return int(np.diff(self.starts).max(initial=0))

    @property
    def sizes(self) -> tuple[int, ...]:
        """The number of items of each wave."""
        return tuple(np.diff(self.starts).tolist())


def in_order(blocks: int) -> Waves:
    """All blocks one after the other."""
    return Waves(np.array([[0, blocks]]), np.array([0, 1]), blocks)


def efficiency(waves: Waves) -> float:
    """How much of ``WIDTH`` threads is used, 1 at best: by the longest share of each wave and what the waves cost."""
    lengths = waves.items[:, 1] - waves.items[:, 0]
    reached = np.concatenate(([0], np.cumsum(lengths)))
    time = 0.0
    for first, last in zip(waves.starts[:-1], waves.starts[1:], strict=True):
        shares = first + (last - first) * np.arange(WIDTH + 1) // WIDTH
        time += float(np.diff(reached[shares]).max(initial=0)) + WAVE_BLOCKS
    slower = 1 + COLOUR * max(0, len(waves.sizes) - 2)
    return float(reached[-1]) / (WIDTH * time * slower) if time else 0.0


def colour(places: Sequence[Touched], starts: Array) -> Waves | None:
    """The best waves found in which no two items of one wave touch the same row, or None where there are none.

    Args:
        places: what the rows touch.
        starts: the number in the launch of the first row of each block, and the number of rows.
    """
    blocks = len(starts) - 1
    best, best_use = None, 0.0
    chunk = max(1, 1 << round(np.log2(max(blocks / _FIRST_CHUNKS, 1))))
    while True:
        waves = colour_chunks(places, starts, chunk)
        use = efficiency(waves) if waves is not None else 0.0
        if use > best_use:
            best, best_use = waves, use
        if chunk == 1 or best_use >= _GOOD:
            return best
        chunk = max(1, chunk // _FEWER)


def colour_chunks(places: Sequence[Touched], starts: Array, chunk: int) -> Waves | None:
    """Waves of chunks of ``chunk`` blocks, coloured greedily one after the other; None if 64 colours do not do."""
    bounds = starts[np.append(np.arange(0, len(starts) - 1, chunk), len(starts) - 1)]
    masks_of = _masks_of(places)
    listed = [(masks_of[place.stmt.field.relation], *_stretches(place, bounds)) for place in places]
    colours: list[int] = []
    for number in range(len(bounds) - 1):
        touched = [(masks, positions[cut[number] : cut[number + 1]]) for masks, positions, cut in listed]
        taken = 0
        for masks, positions in touched:
            taken |= int(np.bitwise_or.reduce(masks[positions]))
        free = ~taken & (taken + 1)
        if free >> _MOST_COLOURS:
            return None
        bit = np.uint64(free)
        for masks, positions in touched:
            masks[positions] |= bit
            masks[-1] = 0  # that of the unset key, -1, which touches nothing
        colours.append(free.bit_length() - 1)
    return _waves(np.array(colours), chunk, len(starts) - 1)


def _masks_of(places: Sequence[Touched]) -> dict[Relation, npt.NDArray[np.uint64]]:
    """For each row of each relation that is touched, the colours of the chunks that touch it."""
    targets = dict.fromkeys(place.stmt.field.relation for place in places)
    return {target: np.zeros(target.size + 1, dtype=np.uint64) for target in targets}


def _stretches(place: Touched, bounds: Array) -> tuple[Array, list[int]]:
    """The positions that a place touches, and where in them each chunk begins."""
    cut = bounds if place.owners is None else np.searchsorted(place.owners, bounds)
    return place.positions, cut.tolist()


def _waves(colours: Array, chunk: int, blocks: int) -> Waves:
    order = np.argsort(colours, kind="stable")
    first = order * chunk
    items = np.stack((first, np.minimum(first + chunk, blocks)), axis=1).astype(np.int64)
    starts = np.concatenate(([0], np.cumsum(np.bincount(colours)))).astype(np.int64)
    return Waves(np.ascontiguousarray(items), starts, chunk)
