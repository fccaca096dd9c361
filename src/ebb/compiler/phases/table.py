"""The phases of a checked kernel: what the lowering and the launch know of each field and global."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from ebb.compiler.kir import ReduceOp
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.globals import Global


class PhaseKind(Enum):
    """The lattice: two kernels' rows may meet in a field only in READ, or in REDUCE with one operator."""

    READ = "READ"
    REDUCE = "REDUCE"
    EXCLUSIVE = "EXCLUSIVE"


@record
class FieldPhase:
    """The phase of one field.

    Attributes:
        kind: READ if it is only read, else EXCLUSIVE if it is used only through the kernel's own row, else REDUCE.
        op: the operator of a REDUCE phase, else None.
        read, written, reduced: whether some use does so.
        centered_only: whether every use is through the kernel's own row.
        queried: whether a query loop or a query's size reads the grouping by this field.
    """

    kind: PhaseKind
    op: ReduceOp | None
    read: bool
    written: bool
    reduced: bool
    centered_only: bool
    queried: bool = False

    @property
    def changed(self) -> bool:
        """Whether the kernel may change the field."""
        return self.written or self.reduced

    def __str__(self) -> str:
        return phase_text(self.kind, self.op)


@record
class GlobalPhase:
    """The phase of one global: READ, or REDUCE with ``op``."""

    kind: PhaseKind
    op: ReduceOp | None

    @property
    def reduced(self) -> bool:
        """Whether the kernel reduces into the global; else it reads it."""
        return self.kind is PhaseKind.REDUCE

    def __str__(self) -> str:
        return phase_text(self.kind, self.op)


@record
class PhaseTable:
    """The phases of all fields and globals that a kernel uses, in the order of their first use."""

    fields: Mapping[Field, FieldPhase]
    globals: Mapping[Global, GlobalPhase]


def phase_text(kind: PhaseKind, op: ReduceOp | None) -> str:
    """A phase as the paper writes it: ``READ``, ``REDUCE(+)``, ``EXCLUSIVE``."""
    return kind.value if op is None else f"{kind.value}({op.value})"
