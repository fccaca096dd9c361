"""Affine maps between grids, in exact arithmetic, and the rows at coordinates."""

from __future__ import annotations

from math import lcm

import numpy as np

from ebb.compiler import kir
from ebb.records import record
from ebb.relations.relation import Relation
from ebb.types.types import KeyType


@record
class AffineMap:
    """The map of an ``Affine`` node.

    Attributes:
        source: the grid whose rows it maps.
        target: the grid it maps to.
        rows: the rows of the matrix times ``divisors``, so that they are whole numbers.
        divisors: one a row.
        edge: what happens beyond the end of a dimension that does not wrap.
    """

    source: Relation
    target: Relation
    rows: tuple[tuple[int, ...], ...]
    divisors: tuple[int, ...]
    edge: kir.Edge

    @classmethod
    def of(cls, node: kir.Affine) -> AffineMap:
        """The map of ``node``."""
        source, target = node.key.type, node.type
        assert isinstance(source, KeyType) and isinstance(source.target, Relation)
        assert isinstance(target, KeyType) and isinstance(target.target, Relation)
        divisors = tuple(lcm(*(entry.denominator for entry in row)) for row in node.matrix)
        rows = tuple(
            tuple(int(entry * divisor) for entry in row) for row, divisor in zip(node.matrix, divisors, strict=True)
        )
        return cls(source.target, target.target, rows, divisors, node.edge)

    def coordinates(self, position: int) -> tuple[int, ...]:
        """Where the row at ``position`` is mapped, before wrapping and clamping."""
        at = (*(int(index) for index in np.unravel_index(position, self.source.shape)), 1)
        return tuple(
            sum(entry * index for entry, index in zip(row, at, strict=True)) // divisor
            for row, divisor in zip(self.rows, self.divisors, strict=True)
        )


def position_at(grid: Relation, coordinates: tuple[int, ...], edge: kir.Edge) -> int | None:
    """The position of the row of ``grid`` at ``coordinates``, wrapped and clamped; None if there is no such row."""
    position = 0
    for at, extent, wraps in zip(coordinates, grid.shape, grid.periodic, strict=True):
        if wraps and extent:
            at %= extent
        elif edge is kir.Edge.CLAMP:
            at = min(max(at, 0), extent - 1)
        if not 0 <= at < extent:
            return None
        position = position * extent + at
    return position
