"""Boxes of a grid cut into blocks of rows: whole lines where they are short, stretches of a line where it is long."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ebb.compiler.lir import BLOCK_ROWS
from ebb.relations.subset import Box, RowSet

if TYPE_CHECKING:
    import numpy.typing as npt

_BAND_BYTES = 128 << 10
"""The bytes of a band in one plane. The three planes of most stencils are then less than half of a second cache."""


_BAND_ROWS = 4 * BLOCK_ROWS
"""The rows of a block of a band. Code for streams takes a while to begin; what it goes through has many blocks."""


def tile_boxes(boxes: Sequence[Box], row_bytes: int = 0) -> npt.NDArray[np.int64]:
    """The blocks of ``boxes``: start and stop in each dimension.

    Args:
        boxes: disjoint boxes of one grid of ``ndim`` dimensions.
        row_bytes: what a row reads that rows of the next planes of the grid read again; 0 if their order matters more.

    Returns:
        An array of the shape ``(blocks, ndim, 2)``. A block has about ``BLOCK_ROWS`` rows, which follow one another in
        the order of indices within their box, as blocks do. With ``row_bytes`` a box of three dimensions is gone
        through in bands, few enough lines of each plane that three planes stay in the second cache, in larger blocks.
    """
    parts: list[npt.NDArray[np.int64]] = []
    for box in boxes:
        rows = _BAND_ROWS if row_bytes and len(box.start) == 3 else BLOCK_ROWS
        parts += [_tiles(band, rows) for band in _bands(box, row_bytes) if box.size]
    ndim = len(boxes[0].start) if boxes else 1
    return np.ascontiguousarray(np.concatenate(parts)) if parts else np.zeros((0, ndim, 2), dtype=np.int64)


def block_starts(rows: RowSet) -> npt.NDArray[np.int64]:
    """The number in a launch on ``rows`` of the first row of each block, and the number of rows."""
    if rows.boxes is None:
        return np.minimum(np.arange(-(-rows.size // BLOCK_ROWS) + 1) * BLOCK_ROWS, rows.size)
    tiles = tile_boxes(rows.boxes)
    return np.concatenate(([0], np.cumsum((tiles[:, :, 1] - tiles[:, :, 0]).prod(axis=1))))


def _bands(box: Box, row_bytes: int) -> list[Box]:
    """``box`` in bands of its middle dimension, as alike as can be."""
    if not row_bytes or len(box.start) != 3:
        return [box]
    lines = box.stop[1] - box.start[1]
    count = -(-lines * (box.stop[2] - box.start[2]) * row_bytes // _BAND_BYTES)
    ends = [box.start[1] + lines * k // count for k in range(count + 1)]
    first, _, third = zip(box.start, box.stop, strict=True)
    return [
        Box((first[0], start, third[0]), (first[1], stop, third[1])) for start, stop in pairwise(ends) if start < stop
    ]


def _tiles(box: Box, rows: int) -> npt.NDArray[np.int64]:
    sides = [
        np.arange(start, stop, side) for start, stop, side in zip(box.start, box.stop, _sides(box, rows), strict=True)
    ]
    starts = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(sides))
    stops = np.minimum(starts + np.array(_sides(box, rows)), np.array(box.stop))
    return np.stack((starts, stops), axis=-1).astype(np.int64)


def _sides(box: Box, rows: int) -> list[int]:
    """The extents of a block of ``rows``. More than one index of a dimension only where all inner ones are whole."""
    sides: list[int] = []
    room = rows
    for start, stop in zip(reversed(box.start), reversed(box.stop), strict=True):
        side = max(1, min(stop - start, room))
        room = room // side if side == stop - start else 1
        sides.append(side)
    return sides[::-1]
