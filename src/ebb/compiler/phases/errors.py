"""What can be wrong with the phases and the stencil of a kernel: the codes E301 to E304, and E410."""

from __future__ import annotations

from typing import ClassVar

from ebb.compiler.phases.uses import Mode, Use
from ebb.diagnostics.diagnostic import Diagnostic, Label
from ebb.diagnostics.span import Span
from ebb.records import record

_MOST_LABELS = 4
"""How many places of one kind an error shows."""


@record
class FieldInTwoPhases(Diagnostic):
    """A field is changed in one phase and used in another, and at least one use is through another row.

    Args:
        place: the field with its relation, ``vertices.q``.
        change: the write or reduction that makes the conflict.
        others: the uses that it conflicts with.
    """

    code: ClassVar[str] = "E301"

    kernel: str
    relation: str
    row: str
    place: str
    field: str
    change: Use
    others: tuple[Use, ...]

    @property
    def title(self) -> str:
        return f"field {self.place!r} is in two phases in kernel {self.kernel!r}"

    @property
    def primary(self) -> Label:
        return Label(self.change.span, f"{self.change.phase}: {self._change_text()}")

    @property
    def secondary(self) -> tuple[Label, ...]:
        return tuple(Label(use.span, f"{use.phase}: {self._other_text(use)}") for use in self.others[:_MOST_LABELS])

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            f"all rows of {self.relation!r} run at once, so a field is only read, or only reduced with one operator, "
            f"or touched only at the kernel's own row {self.row!r}",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        if self._operators_differ:
            return ("use one operator, or reduce into two fields, or split the kernel",)
        if self.change.mode is Mode.WRITE and self.others[0].mode is Mode.REDUCE:
            return ("set the field in a kernel of its own, before or after this one",)
        if not self.change.centered:
            return ("reduce into a second field and read it in the next kernel, or split the kernel",)
        return ("write the new value to a second field and swap the two after the launch, or split the kernel",)

    @property
    def _operators_differ(self) -> bool:
        return self.change.op is not None and any(use.op not in (None, self.change.op) for use in self.others)

    def _change_text(self) -> str:
        if self._operators_differ:
            return f"reduces the {self.field!r} of {_whose(self.change)} with another operator"
        does = "sets" if self.change.mode is Mode.WRITE else "changes"
        if not self.change.centered:
            return f"{does} the {self.field!r} of another row"
        others_do = "read" if all(use.mode is Mode.READ for use in self.others) else "change"
        return f"{does} the {self.field!r} of this row, which other rows {others_do}"

    def _other_text(self, use: Use) -> str:
        text = _use_text(self.field, use)
        return f"{text}, which other rows change" if use.centered and use.mode is Mode.READ else text


@record
class GlobalAssigned(Diagnostic):
    """A global is assigned in a kernel. The elaborator finds it, since KIR has no such statement."""

    code: ClassVar[str] = "E302"

    name: str
    span: Span

    @property
    def title(self) -> str:
        return f"global {self.name!r} is assigned in a kernel"

    @property
    def primary(self) -> Label:
        return Label(self.span, "WRITE: every row would set the one value")

    @property
    def notes(self) -> tuple[str, ...]:
        return ("a kernel reads a global, or reduces into it with one operator; no row of a kernel is the last one",)

    @property
    def hints(self) -> tuple[str, ...]:
        return (f"reduce into it, as in '{self.name}.value += x', or set '{self.name}.value' between two launches",)


@record
class WriteToOtherRow(Diagnostic):
    """A field is written through a key that is not the kernel's own row.

    Args:
        place: the field with its relation, ``vertices.q``.
        writes: all such writes.
        reads: the reads of the field in other rows, which conflict with it too.
    """

    code: ClassVar[str] = "E303"

    kernel: str
    relation: str
    row: str
    place: str
    field: str
    writes: tuple[Use, ...]
    reads: tuple[Use, ...]

    @property
    def title(self) -> str:
        return (
            f"field {self.place!r} is written through a key that is not the kernel's own row, in kernel {self.kernel!r}"
        )

    @property
    def primary(self) -> Label:
        return Label(self.writes[0].span, f"WRITE: {_use_text(self.field, self.writes[0])}")

    @property
    def secondary(self) -> tuple[Label, ...]:
        # An augmented assignment such as ``/=`` reads and writes at one place; its write says it all.
        places = {write.span for write in self.writes}
        reads = [use for use in self.reads if use.query or use.span not in places]
        others = (*self.writes[1:_MOST_LABELS], *reads[:_MOST_LABELS])
        return tuple(Label(use.span, f"{use.phase}: {_use_text(self.field, use)}") for use in others)

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            f"all rows of {self.relation!r} run at once, and two of them may write to the same row, so the value left "
            f"would depend on their order; a kernel writes only to its own row {self.row!r}",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return (
            "reduce into the field (+=, *=, min, max), or let a kernel on the relation of the field gather the values "
            "with a query loop",
        )


@record
class GlobalInTwoPhases(Diagnostic):
    """A global is read and reduced, or reduced with two operators.

    Args:
        change: the reduction that makes the conflict.
        others: the uses that it conflicts with.
    """

    code: ClassVar[str] = "E304"

    kernel: str
    relation: str
    change: Use
    others: tuple[Use, ...]

    @property
    def title(self) -> str:
        return f"global {_global_name(self.change, *self.others)}is in two phases in kernel {self.kernel!r}"

    @property
    def primary(self) -> Label:
        if self.others[0].mode is Mode.REDUCE:
            return Label(self.change.span, f"{self.change.phase}: reduces the global with another operator")
        return Label(self.change.span, f"{self.change.phase}: changes the global, which other rows read")

    @property
    def secondary(self) -> tuple[Label, ...]:
        return tuple(
            Label(use.span, f"{use.phase}: {'reads' if use.mode is Mode.READ else 'reduces'} the global")
            for use in self.others[:_MOST_LABELS]
        )

    @property
    def notes(self) -> tuple[str, ...]:
        return (
            f"all rows of {self.relation!r} run at once, so a global is only read, or only reduced with one operator",
        )

    @property
    def hints(self) -> tuple[str, ...]:
        return ("reduce into a second global, or split the kernel",)


@record
class StencilOutOfBounds(Diagnostic):
    """An affine access of a kernel leaves its grid for some of the launched rows.

    Args:
        span: the access.
        move: what the access does to the coordinates of the row, ``offset (1, 0)``, or ``map [[2, 0, 1], [0, 2, 0]]``.
        source: the name of the kernel's relation.
        target: the name of the grid that the access leaves.
        dimension: the first dimension in which it does, from 0.
        extent: the length of the grid in that dimension.
        reach: the smallest and the largest index that the launched rows ask for there.
        row: the coordinates of a launched row for which it does.
        fitting: a subset that there is for which no access of the kernel fails, or None.
        subset: code that makes one of more rows; None where no box will do.
    """

    code: ClassVar[str] = "E410"

    kernel: str
    span: Span
    move: str
    source: str
    target: str
    dimension: int
    extent: int
    reach: tuple[int, int]
    row: tuple[int, ...]
    fitting: str | None
    subset: str | None

    @property
    def title(self) -> str:
        return f"{self.span.text!r} leaves the grid {self.target!r} in kernel {self.kernel!r}"

    @property
    def primary(self) -> Label:
        low, high = self.reach
        asked = f"index {low}" if low == high else f"indices {low} to {high}"
        has = f"has 0 to {self.extent - 1}" if self.extent else "is empty"
        return Label(self.span, f"{self.move} asks for {asked} of dimension {self.dimension}, which {has}")

    @property
    def notes(self) -> tuple[str, ...]:
        row = str(self.row) if len(self.row) > 1 else ", ".join(map(str, self.row))
        fact = f"it does so for row {row} of {self.source!r}, which is among the launched rows; nothing was run"
        if self.subset is not None or self.fitting is not None:
            return (fact,)
        return (fact, f"there is no box of rows of {self.source!r} for which all accesses of the kernel stay inside")

    @property
    def hints(self) -> tuple[str, ...]:
        other = 'make the dimension periodic, or clamp the access with ebb.affine(..., edge="clamp")'
        ready = () if self.fitting is None else (f"launch on '{self.fitting}', where all accesses stay inside",)
        rows = "the rows whose accesses stay inside" if self.fitting is None else "all such rows"
        new = () if self.subset is None else (f"launch on {rows}:\n    {self.subset}",)
        return (*ready, *new, other)


def _global_name(*uses: Use) -> str:
    """The name of a global as the kernel writes it, with a blank after it; empty where no use shows it alone."""
    texts = [use.span.text.removesuffix(".value") for use in uses]
    return next((f"{text!r} " for text in texts if text.replace(".", "_").isidentifier()), "")


def _whose(use: Use) -> str:
    return "this row" if use.centered else "another row"


def _use_text(field: str, use: Use) -> str:
    if use.query:
        return f"a query reads the grouping by {field!r}, that is the {field!r} of all rows"
    does = {Mode.READ: "", Mode.WRITE: "sets ", Mode.REDUCE: "reduces "}[use.mode]
    return f"{does}the {field!r} of {_whose(use)}"
