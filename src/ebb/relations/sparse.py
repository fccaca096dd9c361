"""A field of entries or blocks as a sparse matrix by rows (CSR), on its own memory."""

from __future__ import annotations

import numpy as np

from ebb.errors import RelationError
from ebb.records import record
from ebb.relations.errors_matrix import NoMatrix
from ebb.relations.family import family_of
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.runtime.buffer import Array, Layout
from ebb.runtime.threads import launching
from ebb.types.types import KeyType

_FIRST = "ask for the matrix before the first view is taken"


@record(eq=False)
class MatrixRows:
    """A matrix of ``shape`` rows and columns (of blocks).

    Those of row i are ``data[starts[i] : starts[i + 1]]``, in the columns ``columns[...]``.
    """

    data: Array
    columns: Array
    starts: Array
    shape: tuple[int, int]


def matrix_rows(values: Field, row: Field, column: Field) -> MatrixRows:
    """The memory of three fields as a matrix, whose rows and columns are numbered as the rows of their relations.

    The relation of ``values`` is grouped by ``row`` if it is not yet. The relations that the keys refer to are brought
    into the order of row numbers, and ``values`` into rows; from then on all stay as they are, as after a view.

    Raises:
        RelationError: the fields make no matrix, or earlier views keep them as they are, which is otherwise (E552); or
            a writable view of a field is open.
    """
    relation, targets = _check(values, row, column)
    if row.grouping is None:
        relation.group_by(row)
    with launching():
        for field in (values, row, column):
            field.check_no_view()
        for target in targets:
            _restore_order(values, target)
        assert row.grouping is not None
        row.grouping.refresh()
        _check_stored(values, row, column)
        _restore_layout(values)
        shape = (targets[0].size, targets[1].size)
        data, columns, starts = values.view(), column.view(), row.grouping.offsets.view()
        starts.flags.writeable = False
        return MatrixRows(data, columns, starts, shape)


def _check(values: Field, row: Field, column: Field) -> tuple[Relation, tuple[Relation, Relation]]:
    relation = values.relation
    if values.holds_keys or len(values.type.shape) not in (0, 2):
        raise _wrong(values, f"it is of {values.type!r}, and the entries of a matrix are numbers or matrices")
    targets: list[Relation] = []
    for field in (row, column):
        if field.relation is not relation:
            raise _wrong(values, f"{field.path} is a field of another relation")
        if not isinstance(field.type, KeyType) or field.target is None:
            raise _wrong(values, f"{field.path} is of {field.type!r}, and should be of one key")
        targets.append(field.target)
    return relation, (targets[0], targets[1])


def _restore_order(values: Field, target: Relation) -> None:
    """Brings the rows of ``target`` into the order of their numbers, for good."""
    storage = target.storage
    if storage.rank is not None and not bool((storage.rank == np.arange(target.size)).all()):
        if storage.pinned or storage.primary is not None:
            why = "a view of them has been taken" if storage.pinned else "they are grouped"
            complaint = f"the rows of {target.name} lie in another order than that of their numbers, and {why}"
            raise RelationError(NoMatrix(values.path, complaint, (_FIRST,)))
        target.permute(storage.rank)
    storage.pinned = True


def _check_stored(values: Field, row: Field, column: Field) -> None:
    assert row.grouping is not None
    if row.grouping.rows is not None:
        raise _wrong(values, f"the rows of {row.relation.name} are not stored in the order of {row.name}")
    for field in (row, column):
        if field.maybe_unset and bool((field.data < 0).any()):
            raise _wrong(values, f"some keys of {field.path} are unset")


def _restore_layout(values: Field) -> None:
    """Brings the components of each row together, for good."""
    if values.buffer.layout is Layout.ROWS:
        return
    if values.relation.storage.pinned:
        complaint = "its components lie in columns, and a view of it has been taken"
        raise RelationError(NoMatrix(values.path, complaint, (_FIRST,)))
    family = family_of(values)
    family.layout = Layout.ROWS
    family.convert(*family.members)


def _wrong(values: Field, complaint: str) -> RelationError:
    return RelationError(NoMatrix(values.path, complaint))
