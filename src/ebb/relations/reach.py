"""How a kernel reaches the values of a field: what the storage order and the layout are chosen by."""

from __future__ import annotations

from enum import Enum

from ebb.records import record
from ebb.relations.field import Field


class Pace(Enum):
    """How a kernel goes over its rows."""

    VECTOR = "several rows at once"
    """Straight-line code with some arithmetic for each byte: it takes less time where vector registers fill easily."""

    MEMORY = "as fast as memory comes"
    """Straight-line code with little arithmetic."""

    SCALAR = "row after row"
    """Code with loops or checks, or that changes other rows."""


@record
class Reach:
    """The ways in which one kernel uses one field.

    Attributes:
        field: the field.
        changed: whether the kernel may write it or reduce into it.
        centered: whether some use is through the kernel's own row.
        affine: whether some use is at an affine offset, on a grid.
        keyed: whether some use is through a key that was read from a field, or through a row of a query.
        queried: whether the index of the field, a grouped key field, is read.
        through: the key fields, read or queried, by which its rows are reached, in the order of their first use.
    """

    field: Field
    changed: bool
    centered: bool
    affine: bool
    keyed: bool
    queried: bool
    through: tuple[Field, ...]
