"""Determinant and inverse of matrices up to 4 x 4 in closed form (cofactors).

The formulas are written once, over anything with ``+ - *``: NumPy scalars in the reference interpreter, terms of
generated code in a compiled backend. So every backend does the same operations in the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

LARGEST = 4

Rows: TypeAlias = Sequence[Sequence[Any]]


def determinant(m: Rows) -> Any:
    """The determinant of the square matrix ``m`` of 1 to 4 rows, expanded along the first row."""
    if len(m) == 1:
        return m[0][0]
    if len(m) == 2:
        return m[0][0] * m[1][1] - m[0][1] * m[1][0]
    total = m[0][0] * cofactor(m, 0, 0)
    for j in range(1, len(m)):
        total = total + m[0][j] * cofactor(m, 0, j)
    return total


def cofactor(m: Rows, i: int, j: int) -> Any:
    """The determinant of ``m`` without row ``i`` and column ``j``, with the sign of its place.

    The sign is had by exchanging two rows of the minor, which costs no operation.
    """
    rows = [[value for column, value in enumerate(row) if column != j] for r, row in enumerate(m) if r != i]
    if (i + j) % 2 == 0:
        return determinant(rows)
    if len(rows) == 1:
        return -rows[0][0]
    return determinant([rows[1], rows[0], *rows[2:]])


def adjugate(m: Rows) -> list[list[Any]]:
    """The matrix whose product with ``m`` is the determinant times the identity; of at least 2 rows."""
    return [[cofactor(m, j, i) for j in range(len(m))] for i in range(len(m))]
