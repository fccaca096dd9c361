"""What can be wrong about relations, fields, groupings, subsets and loads: E501 to E521."""

from __future__ import annotations

from typing import ClassVar, Literal

from ebb.diagnostics.diagnostic import Diagnostic
from ebb.diagnostics.nearest import nearest
from ebb.records import record

Row = tuple[int, ...]
"""The row that is at fault, as indices into arrays of the relation's shape."""


def row_text(row: Row) -> str:
    """``row`` as users index it: ``3``, or ``(1, 2)`` on a grid."""
    return str(row[0]) if len(row) == 1 else str(row)


@record
class BadName(Diagnostic):
    """A name that cannot stand after a dot."""

    code: ClassVar[str] = "E501"
    what: str
    name: str

    @property
    def title(self) -> str:
        return f"{self.name} is no name for a {self.what}"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("a name is a Python identifier, no keyword, and does not start with two underscores",)


@record
class NameTaken(Diagnostic):
    """A second thing of one name."""

    code: ClassVar[str] = "E502"
    relation: str
    name: str
    taken_by: str

    @property
    def title(self) -> str:
        return f"the name '{self.name}' is taken: relation '{self.relation}' has a {self.taken_by} of that name"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("fields, members, subsets and the relation's own attributes share one set of names",)


@record
class UnknownName(Diagnostic):
    """A name that is nothing of the relation, or nothing of the kind that is needed."""

    code: ClassVar[str] = "E503"
    relation: str
    what: str
    name: str
    known: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"relation '{self.relation}' has no {self.what} '{self.name}'"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"it has {', '.join(self.known)}" if self.known else f"it has no {self.what}s",)

    @property
    def hints(self) -> tuple[str, ...]:
        close = nearest(self.name, self.known)
        return (f"write '{close}'",) if close else ()


@record
class ForeignField(Diagnostic):
    """A field of another relation where one of this relation is needed."""

    code: ClassVar[str] = "E504"
    relation: str
    field: str

    @property
    def title(self) -> str:
        return f"'{self.field}' is no field of relation '{self.relation}'"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("the rows of two relations have nothing to do with each other",)

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"to load its values row by row, load {self.field}.to_numpy()",)


@record
class BadExtent(Diagnostic):
    """Rows that a relation cannot have."""

    code: ClassVar[str] = "E505"
    relation: str
    problem: str

    @property
    def title(self) -> str:
        return f"relation '{self.relation}' cannot have these rows: {self.problem}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("give size=n, or shape= with one to three extents and periodic= with as many bools",)


@record
class WrongShape(Diagnostic):
    """A value of a shape that does not fit. ``allowed`` names each shape that would."""

    code: ClassVar[str] = "E506"
    target: str
    type: str
    shape: tuple[int, ...] | None
    allowed: tuple[tuple[str, tuple[int, ...]], ...]
    row: Row | None = None

    @property
    def title(self) -> str:
        shape = f"the shape {self.shape}" if self.shape is not None else "no regular shape"
        if self.row is None:
            return f"'{self.target}' cannot take a value of {shape}"
        return f"'{self.target}' cannot take a value of {shape} in row {row_text(self.row)}"

    @property
    def notes(self) -> tuple[str, ...]:
        shapes = "; ".join(f"{shape} {what}" for what, shape in self.allowed)
        return (f"its type is {self.type}", f"it takes {shapes}")


@record
class WrongKind(Diagnostic):
    """Values of a kind that would lose data, or that are no numbers."""

    code: ClassVar[str] = "E507"
    target: str
    type: str
    kind: str
    row: Row | None
    value: str | None
    hint: str | None = None

    @property
    def title(self) -> str:
        return f"'{self.target}' is of {self.type} and cannot take {self.kind}"

    @property
    def notes(self) -> tuple[str, ...]:
        if self.value is None:
            return ()
        if self.row is None:
            return (f"{self.value} does not fit",)
        return (f"the first that does not fit is {self.value} in row {row_text(self.row)}",)

    @property
    def hints(self) -> tuple[str, ...]:
        return (self.hint,) if self.hint else ()


@record
class ValueOutOfRange(Diagnostic):
    """A number that the type cannot hold."""

    code: ClassVar[str] = "E508"
    target: str
    type: str
    row: Row | None
    value: str

    @property
    def title(self) -> str:
        where = f" (row {row_text(self.row)})" if self.row is not None else ""
        return f"'{self.target}' is of {self.type}, which cannot hold {self.value}{where}"


@record
class KeyOutOfRange(Diagnostic):
    """A key that refers to no row."""

    code: ClassVar[str] = "E509"
    target: str
    row: Row | None
    value: str
    relation: str
    shape: tuple[int, ...]

    @property
    def title(self) -> str:
        where = f"row {row_text(self.row)} of " if self.row is not None else ""
        return f"{where}'{self.target}' would refer to row {self.value} of '{self.relation}', which does not exist"

    @property
    def notes(self) -> tuple[str, ...]:
        match self.shape:
            case (n,):
                return (f"'{self.relation}' has {n} rows, which count from 0",)
            case shape:
                return (f"'{self.relation}' has the shape {shape}; indices count from 0, negative ones are no rows",)


@record
class TypeMismatch(Diagnostic):
    """Two fields whose types differ, or cannot be converted."""

    code: ClassVar[str] = "E510"
    action: Literal["swap", "copy", "load"]
    left: str
    left_type: str
    right: str
    right_type: str

    @property
    def title(self) -> str:
        joined = {"swap": "and", "copy": "to", "load": "from"}[self.action]
        return f"cannot {self.action} '{self.left}' {joined} '{self.right}': their types differ"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"'{self.left}' is of {self.left_type}", f"'{self.right}' is of {self.right_type}")


@record
class NotGroupable(Diagnostic):
    """A field that is no single key."""

    code: ClassVar[str] = "E511"
    relation: str
    field: str
    type: str
    keys: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"'{self.relation}' cannot be grouped by '{self.field}', which is of {self.type}"

    @property
    def notes(self) -> tuple[str, ...]:
        listed = ", ".join(self.keys) if self.keys else "none"
        return ("rows are grouped by a field that holds one key", f"the key fields of '{self.relation}': {listed}")


@record
class ViewOpen(Diagnostic):
    """The runtime would use memory that the host is writing."""

    code: ClassVar[str] = "E512"
    field: str

    @property
    def title(self) -> str:
        return f"'{self.field}' cannot be used now: a writable view of it is open"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("while the view is open its memory belongs to what writes there",)

    @property
    def hints(self) -> tuple[str, ...]:
        return ("end the block 'with ... as ...:' of the view first",)


@record
class KeysNotWritable(Diagnostic):
    """A writable view of keys."""

    code: ClassVar[str] = "E513"
    field: str

    @property
    def title(self) -> str:
        return f"'{self.field}' holds keys, which cannot be written through a view"

    @property
    def notes(self) -> tuple[str, ...]:
        return ("in memory a key is the place of a row, which the runtime may change; a wrong one would be followed",)

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"use {self.field}.load(...), which takes row numbers and checks them",)


@record
class BadSubset(Diagnostic):
    """A selection of rows that cannot be understood."""

    code: ClassVar[str] = "E514"
    subset: str
    problem: str

    @property
    def title(self) -> str:
        return f"subset '{self.subset}' cannot be selected: {self.problem}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("select by slices (np.s_[1:-1, :]), a list of those, a boolean array of the relation's shape, or rows",)


@record
class SubsetOutOfRange(Diagnostic):
    """A selection that names a row which does not exist."""

    code: ClassVar[str] = "E515"
    subset: str
    part: str
    row: str
    shape: tuple[int, ...]

    @property
    def title(self) -> str:
        return f"{self.part} of subset '{self.subset}' is {self.row}, which does not exist"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"the relation has the shape {self.shape}; rows count from 0",)


@record
class AttributeAssigned(Diagnostic):
    """An assignment to an attribute of a relation on the host."""

    code: ClassVar[str] = "E516"
    relation: str
    name: str
    what: str | None

    @property
    def title(self) -> str:
        return f"'{self.relation}.{self.name}' cannot be assigned on the host"

    @property
    def hints(self) -> tuple[str, ...]:
        match self.what:
            case "field":
                return (f"to change its values, call {self.relation}.{self.name}.load(...)",)
            case None:
                return (f"to add a field, call {self.relation}.new_field('{self.name}', type, init=...)",)
            case _:
                return ()


@record
class NotNumbers(Diagnostic):
    """A global or constant of keys."""

    code: ClassVar[str] = "E517"
    what: str
    type: str

    @property
    def title(self) -> str:
        return f"a {self.what} is of numbers or bools, not of {self.type}"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("keep keys in a field of a relation",)


@record
class UnknownReducer(Diagnostic):
    """A reducer for an operator that is no reduction."""

    code: ClassVar[str] = "E518"
    relation: str
    member: str
    op: str
    operators: tuple[str, ...]

    @property
    def title(self) -> str:
        return f"member '{self.relation}.{self.member}' cannot be reduced by {self.op!r}"

    @property
    def notes(self) -> tuple[str, ...]:
        return (f"the reductions are {' '.join(self.operators)}; 'x -= e' is the reduction '+' of -e",)


@record
class MemberNotAFunction(Diagnostic):
    """A member that is no function."""

    code: ClassVar[str] = "E519"
    relation: str
    member: str
    value: str

    @property
    def title(self) -> str:
        return f"member '{self.relation}.{self.member}' is a function of a key, not {self.value}"


@record
class GridReordered(Diagnostic):
    """A grid that is to be reordered."""

    code: ClassVar[str] = "E520"
    relation: str

    @property
    def title(self) -> str:
        return f"relation '{self.relation}' is a grid, whose rows lie in the order of their indices"

    @property
    def hints(self) -> tuple[str, ...]:
        return ("reorder the relations that have keys into it",)


@record
class NotABool(Diagnostic):
    """An option of a relation that is neither True nor False."""

    code: ClassVar[str] = "E521"
    relation: str
    option: str
    value: str

    @property
    def title(self) -> str:
        return f"relation '{self.relation}': {self.option}={self.value} is neither True nor False"
