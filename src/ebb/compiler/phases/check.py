"""The phase check: rows of a kernel meet in a place only if all of them read it, or reduce it with one operator.

A kernel that passes has no data race, and its rows may run in any order (paper, section 3).
"""

from __future__ import annotations

from ebb.compiler import kir
from ebb.compiler.phases.centered import find_centered
from ebb.compiler.phases.errors import FieldInTwoPhases, GlobalInTwoPhases, WriteToOtherRow
from ebb.compiler.phases.table import FieldPhase, GlobalPhase, PhaseKind, PhaseTable
from ebb.compiler.phases.uses import Mode, Use, Uses, collect_uses
from ebb.diagnostics.diagnostic import Diagnostic
from ebb.errors import PhaseError
from ebb.relations.field import Field


def check_phases(kernel: kir.Kernel) -> PhaseTable:
    """The phase of each field and global that ``kernel`` uses.

    Raises:
        PhaseError: some field or global is in two phases; all of them are reported.
    """
    uses = collect_uses(kernel, find_centered(kernel))
    conflicts = _find_conflicts(kernel, uses)
    if conflicts:
        raise PhaseError(*conflicts)
    return phase_table(uses)


def phase_table(uses: Uses) -> PhaseTable:
    """The phases of uses that do not conflict."""
    return PhaseTable(
        {field: _field_phase(of_field) for field, of_field in uses.fields.items()},
        {globl: _global_phase(of_global) for globl, of_global in uses.globals.items()},
    )


def _field_phase(uses: list[Use]) -> FieldPhase:
    modes = {use.mode for use in uses}
    centered_only = all(use.centered for use in uses)
    kind = PhaseKind.EXCLUSIVE if centered_only else PhaseKind.REDUCE
    if modes == {Mode.READ}:
        kind = PhaseKind.READ
    return FieldPhase(
        kind,
        op=uses[0].op if kind is PhaseKind.REDUCE else None,
        read=Mode.READ in modes,
        written=Mode.WRITE in modes,
        reduced=Mode.REDUCE in modes,
        centered_only=centered_only,
        queried=any(use.query for use in uses),
    )


def _global_phase(uses: list[Use]) -> GlobalPhase:
    kind = PhaseKind.REDUCE if uses[0].mode is Mode.REDUCE else PhaseKind.READ
    return GlobalPhase(kind, uses[0].op)


def _find_conflicts(kernel: kir.Kernel, uses: Uses) -> list[Diagnostic]:
    found = [_field_conflict(kernel, field, of_field) for field, of_field in uses.fields.items()]
    found += [_global_conflict(kernel, of_global) for of_global in uses.globals.values()]
    return [diagnostic for diagnostic in found if diagnostic is not None]


def _field_conflict(kernel: kir.Kernel, field: Field, uses: list[Use]) -> Diagnostic | None:
    facts = (kernel.name, kernel.relation.name, kernel.row.name, field.path, field.name)
    away = [use for use in uses if not use.centered]
    if not away:
        return None
    writes = [use for use in away if use.mode is Mode.WRITE]
    if writes:
        return WriteToOtherRow(*facts, tuple(writes), tuple(use for use in away if use.mode is Mode.READ))
    pair = _clash(uses, away)
    return None if pair is None else FieldInTwoPhases(*facts, *pair)


def _clash(uses: list[Use], away: list[Use]) -> tuple[Use, tuple[Use, ...]] | None:
    """The change that makes the conflict and the uses that it conflicts with. ``away`` are those of other rows."""
    changes = [use for use in uses if use.mode is not Mode.READ]
    reads_away = [use for use in away if use.mode is Mode.READ]
    if reads_away:
        return (changes[0], tuple(reads_away)) if changes else None
    # What is left of ``away`` are reductions, and there is one.
    reduction = away[0]
    writes = [use for use in changes if use.mode is Mode.WRITE]
    if writes:
        return writes[0], tuple(away)
    mixed = [use for use in changes if use.op is not reduction.op]
    if mixed:
        return mixed[0], (reduction,)
    reads = tuple(use for use in uses if use.mode is Mode.READ)
    return (reduction, reads) if reads else None


def _global_conflict(kernel: kir.Kernel, uses: list[Use]) -> Diagnostic | None:
    reads = tuple(use for use in uses if use.mode is Mode.READ)
    reductions = [use for use in uses if use.mode is Mode.REDUCE]
    if not reductions:
        return None
    if reads:
        return GlobalInTwoPhases(kernel.name, kernel.relation.name, reductions[0], reads)
    mixed = [use for use in reductions if use.op is not reductions[0].op]
    if mixed:
        return GlobalInTwoPhases(kernel.name, kernel.relation.name, mixed[0], (reductions[0],))
    return None
