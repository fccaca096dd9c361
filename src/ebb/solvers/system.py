"""Linear systems on relations: what a solver works on, checked, with the kernels that apply and precondition them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

import ebb
from ebb.errors import RelationError
from ebb.records import record
from ebb.solvers.errors import UnfitSystem

Product: TypeAlias = Callable[[str, str], object]
"""``product(source, target)`` launches kernels that compute the field ``target`` as the matrix times ``source``."""


@record(eq=False)
class Blocks:
    """A matrix by its entries or square blocks: a field of a relation, and the fields that say which row and column."""

    matrix: ebb.Field
    row: ebb.Field
    column: ebb.Field


class LinearSystem:
    """``A x = b`` for fields of one relation, with A stored in the rows of another or known by its product.

    Attributes:
        rows: the relation of ``x`` and ``b``.
        x: the unknowns.
        b: the right-hand side.
        blocks: the matrix, if it is stored.
        product: the matrix, if it is not.
        free: the bools that say which rows are to be solved for, or None if all are.
    """

    def __init__(
        self,
        x: Any,
        b: Any,
        matrix: Any,
        product: Any,
        row: str,
        column: str,
        rows: Any,
    ) -> None:
        self.x, self.b = _unknowns(x, b)
        self.rows: ebb.Relation = self.x.relation
        if (matrix is None) == (product is None):
            raise RelationError(UnfitSystem("a solver takes a matrix, or its product, and not both"))
        self.blocks = None if matrix is None else _blocks(matrix, row, column, self.x)
        if product is not None and not callable(product):
            raise RelationError(UnfitSystem(f"a product is a function of two names of fields, not {product!r}"))
        self.product: Product | None = product
        self.scalar: Any = self.x.type.scalar
        self.is_vector = bool(self.x.type.shape)
        self.unknowns = self.rows.size * (int(np.prod(self.x.type.shape)) or 1)
        self.free: ebb.Field | None = None
        if rows is not None:
            self._keep(rows)

    def work(self, name: str, type: Any = None) -> str:
        """The name of a work field of ``rows`` that no other solver of another type has; by default as ``x``."""
        wanted = self.x.type if type is None else type
        number = 1
        while True:
            free = name if number == 1 else f"{name}_{number}"
            found = self.rows.fields.get(free)
            if found is None:
                return self.rows.new_field(free, wanted).name
            if found.type == wanted:
                return free
            number += 1

    def _keep(self, rows: Any) -> None:
        if not isinstance(rows, ebb.Subset) or rows.relation is not self.rows:
            raise RelationError(UnfitSystem(f"rows= is a subset of '{self.rows.name}', not {rows!r}"))
        # A mask, since launches on all rows are quicker than on a list of most of them. Of its own: others have others.
        number = 1
        while f"solver_free_{number}" in self.rows.fields:
            number += 1
        name = f"solver_free_{number}"
        self.free = self.rows.new_field(name, ebb.bool_)

        @ebb.kernel
        def mark_free_rows(v: Any) -> None:
            v[name] = True

        mark_free_rows(rows)


def _unknowns(x: Any, b: Any) -> tuple[ebb.Field, ebb.Field]:
    for name, field in (("x", x), ("b", b)):
        if not isinstance(field, ebb.Field):
            raise RelationError(UnfitSystem(f"{name} is a field, such as vertices.{name}, not {field!r}"))
    if x.relation is not b.relation:
        raise RelationError(UnfitSystem(f"{x.path} and {b.path} are fields of two relations"))
    if x is b:
        raise RelationError(
            UnfitSystem(f"x and b are both {x.path}: the solution would overwrite what it is solved for")
        )
    if x.type != b.type or len(x.type.shape) > 1 or x.type.scalar not in (ebb.float32, ebb.float64):
        found = f"{x.path} is of {x.type!r} and {b.path} of {b.type!r}"
        raise RelationError(UnfitSystem("x and b are numbers or vectors, of one type of float32 or float64", found))
    return x, b


def _blocks(matrix: Any, row: str, column: str, x: ebb.Field) -> Blocks:
    if not isinstance(matrix, ebb.Field):
        raise RelationError(UnfitSystem(f"matrix= is a field, such as edges.stiffness, not {matrix!r}"))
    entries: ebb.Relation = matrix.relation
    keys: list[ebb.Field] = []
    for name in (row, column):
        field = entries.fields.get(name)
        if field is None or field.type != x.relation.key_type:
            found = "there is no such field" if field is None else f"{field.path} is of {field.type!r}"
            raise RelationError(UnfitSystem(f"'{name}' of '{entries.name}' is a key into '{x.relation.name}'", found))
        keys.append(field)
    size = x.type.shape * 2
    if matrix.type.shape != size or matrix.type.scalar != x.type.scalar:
        wanted = repr(ebb.matrix(x.type.scalar, *size) if size else x.type.scalar)
        found = f"{matrix.path} is of {matrix.type!r} and {x.path} of {x.type!r}"
        raise RelationError(UnfitSystem(f"each entry of the matrix is a {wanted}", found))
    entries.group_by(keys[0])
    return Blocks(matrix, keys[0], keys[1])
