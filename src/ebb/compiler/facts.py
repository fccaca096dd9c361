"""What a launch must know of a checked kernel, in this process or, packed, in another."""

from __future__ import annotations

from ebb.compiler.outline import Outline
from ebb.compiler.pace import pace_of
from ebb.compiler.phases.reach import collect_reaches
from ebb.compiler.phases.residency import overwritten
from ebb.compiler.phases.stencil import Move, moves_of
from ebb.compiler.phases.table import PhaseTable
from ebb.compiler.whole import Whole
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.reach import Pace, Reach


@record(eq=False)
class LaunchFacts:
    """What a launch must know of a kernel.

    Attributes:
        outline: what backends ask.
        phases: of its fields and globals.
        reaches: how it reaches each field.
        pace: how it goes over its rows.
        sets: the key fields that every row sets.
        moves: the checked accesses from the own row.
    """

    outline: Outline
    phases: PhaseTable
    reaches: tuple[Reach, ...]
    pace: Pace
    sets: tuple[Field, ...]
    moves: tuple[tuple[Move, ...], ...]


def launch_facts(whole: Whole) -> LaunchFacts:
    """The facts of a kernel."""
    kernel, phases = whole.step.kernel, whole.step.phases
    writes_keys = any([phase.changed and field.holds_keys for field, phase in phases.fields.items()])
    return LaunchFacts(
        outline=whole.step.outline,
        phases=phases,
        reaches=collect_reaches(kernel),
        pace=pace_of(kernel, whole.step.outline.cost),
        sets=tuple(each for each in overwritten(kernel, phases) if each.holds_keys) if writes_keys else (),
        moves=moves_of(whole.stencil),
    )
