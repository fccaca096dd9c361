"""What the lowering of one kernel knows: the facts, and the slots, arguments, sites and locals so far."""

from __future__ import annotations

from enum import Enum
from typing import TypeAlias

from ebb.compiler import kir, lir
from ebb.compiler.lower.builder import Builder, Values
from ebb.compiler.lower.facts import Facts
from ebb.compiler.lower.line import Line
from ebb.compiler.lower.sites import Site
from ebb.compiler.phases.table import PhaseTable
from ebb.records import field, record
from ebb.relations.relation import Relation
from ebb.types.types import Element, ScalarType, from_dtype, int32, int64, uint64


class Launched(Enum):
    """How the rows of a launch are given; code is made for each as it is met."""

    ALL = "all rows in storage order"
    LISTED = "a list of positions"
    BOXES = "boxes of a grid"


@record
class Moved:
    """A position that is ``base`` moved by whole offsets on one grid, without wrapping."""

    base: lir.Value
    offsets: tuple[int, ...]


Coordinates: TypeAlias = Values | Moved


@record(frozen=False, eq=False)
class Context:
    """The state of one lowering.

    Attributes:
        kernel: what is lowered.
        phases: of its fields and globals.
        unchecked: its affine accesses that the launch has checked.
        facts: of the data.
        updates: how rows reduce into other rows.
        build: where statements go.
        row: the position of the row, set once the loop over rows is open.
        values: the locals that need no variable, by ``uid``.
        variables: those that do.
        ranges: the first and last value of loop variables that have constant bounds, by ``uid``.
        coordinates: the coordinates of positions, by the number of the temporary, where they are known.
        loops: the labels that ``break`` and ``continue`` leave, innermost last.
        labels: those of KIR's blocks, by ``uid``.
        accumulators: the private sums of the globals that are reduced.
        drawn: counts the random numbers of the row.
        line: the line of the grid along which rows run, where they are given as boxes, or as all rows in order.
    """

    kernel: kir.Kernel
    phases: PhaseTable
    unchecked: frozenset[kir.Affine]
    facts: Facts
    updates: lir.Updates = lir.Updates.PLAIN
    build: Builder = field(default_factory=Builder)
    row: lir.Value | None = None
    values: dict[int, Values] = field(default_factory=dict[int, Values])
    variables: dict[int, lir.Var] = field(default_factory=dict[int, lir.Var])
    ranges: dict[int, tuple[int, int]] = field(default_factory=dict[int, tuple[int, int]])
    coordinates: dict[int, Coordinates] = field(default_factory=dict[int, Coordinates])
    loops: list[tuple[lir.Label, lir.Label]] = field(default_factory=list[tuple[lir.Label, lir.Label]])
    labels: dict[int, lir.Label] = field(default_factory=dict[int, lir.Label])
    accumulators: dict[object, lir.Var] = field(default_factory=dict[object, lir.Var])
    drawn: lir.Var | None = None
    line: Line | None = None
    slots: dict[lir.SlotBinding, lir.Slot] = field(default_factory=dict[lir.SlotBinding, lir.Slot])
    arguments: dict[lir.ArgumentBinding, lir.Argument] = field(default_factory=dict[lir.ArgumentBinding, lir.Argument])
    sites: list[Site] = field(default_factory=list[Site])
    prints: list[kir.Print] = field(default_factory=list[kir.Print])
    print_words: int = 0

    # ---- Memory ----

    def slot(self, binding: lir.SlotBinding) -> lir.Slot:
        """The slot of ``binding``."""
        if binding not in self.slots:
            element, access = self._slot_kind(binding)
            self.slots[binding] = lir.Slot(len(self.slots), element, access, binding)
        return self.slots[binding]

    def _slot_kind(self, binding: lir.SlotBinding) -> tuple[ScalarType, lir.Access]:
        match binding:
            case lir.FieldData(source):
                phase = self.phases.fields[source]
                access = lir.Access.WRITE if phase.written or phase.reduced else lir.Access.READ
                return memory_scalar(source.type.scalar), access
            case lir.GlobalData(globl):
                access = lir.Access.WRITE if self.phases.globals[globl].reduced else lir.Access.READ
                return value_scalar(globl.type.scalar), access
            case lir.Partials(_, sum_):
                return sum_.type, lir.Access.WRITE
            case lir.PrintRecords():
                return int64, lir.Access.WRITE
            case lir.GroupOffsets(index) | lir.GroupRows(index):
                return memory_scalar(index.relation.key_type), lir.Access.READ
            case lir.RowOrder(relation):
                return memory_scalar(relation.key_type), lir.Access.READ
            case lir.LaunchPositions():
                return int64, lir.Access.READ

    def argument(self, binding: lir.ArgumentBinding, scalar: ScalarType) -> lir.Value:
        """The value of the argument of ``binding``."""
        argument = self.arguments.get(binding)
        if argument is None:
            argument = self.arguments[binding] = lir.Argument(len(self.arguments), scalar, binding)
        return self.build.let(lir.LoadArgument(argument), scalar)

    def extent(self, relation: Relation, dimension: int) -> lir.Value:
        """An extent of a grid, an int64."""
        return self.argument(lir.Extent(relation, dimension), int64)

    def random_word(self, word: lir.RandomWord) -> lir.Value:
        return self.argument(word, uint64)

    # ---- Failures ----

    def fail_if(self, condition: lir.Value, site: Site, payload: Values = ()) -> None:
        """Stops the launch where ``condition`` holds."""
        assert self.row is not None
        self.sites.append(site)
        fail = lir.Fail(len(self.sites) - 1, self.row, payload)
        self.build.add(lir.If(condition, (fail,), ()))

    def fail_unless(self, condition: lir.Value, site: Site) -> None:
        """Stops the launch where ``condition`` does not hold."""
        assert self.row is not None
        self.sites.append(site)
        self.build.add(lir.If(condition, (), (lir.Fail(len(self.sites) - 1, self.row, ()),)))


def value_scalar(element: Element) -> ScalarType:
    """The type in which values of ``element`` are computed: keys are int64 positions."""
    return element if isinstance(element, ScalarType) else int64


def memory_scalar(element: Element) -> ScalarType:
    """The type in which fields hold values of ``element``."""
    if isinstance(element, ScalarType):
        return element
    stored = from_dtype(element.dtype)
    assert stored in (int32, int64)
    return stored
