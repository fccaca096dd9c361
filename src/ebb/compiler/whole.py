"""From the source of a kernel to what is checked and ready to be lowered."""

from __future__ import annotations

from collections.abc import Callable

from ebb.compiler.elaborate.elaborate import elaborate
from ebb.compiler.elaborate.errors_syntax import TooDeep
from ebb.compiler.elaborate.guards import Guard
from ebb.compiler.elaborate.parameters import ParameterType
from ebb.compiler.elaborate.source import SourceFunction
from ebb.compiler.elaborate.trail import Trail
from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.stencil import Access, collect_stencil
from ebb.compiler.pipeline import PASSES, Unverified, run_passes
from ebb.compiler.scatter.step import Step
from ebb.errors import KernelSyntaxError
from ebb.records import record
from ebb.relations.relation import Relation
from ebb.runtime.collection import uncollected
from ebb.runtime.recording import suspended


@record(eq=False)
class Whole:
    """A kernel after the passes, whose phases are right.

    Attributes:
        guards: what it assumes of the host.
        trail: what the elaboration looked at.
        stencil: its affine accesses from the own row.
        verify: verifies what it was made of, unless that has been done.
    """

    step: Step
    guards: tuple[Guard, ...]
    trail: Trail
    stencil: tuple[Access, ...]
    verify: Callable[[], None]


def make_whole(source: SourceFunction, relation: Relation, types: tuple[ParameterType, ...]) -> Whole:
    """The kernel ``source`` for the rows of ``relation``, with further parameters of these types.

    Raises:
        EbbError: everything that is wrong with it, at once.
    """
    try:
        with uncollected():
            return _make(source, relation, types)
    except RecursionError:
        raise KernelSyntaxError(TooDeep(source.name)) from None


def _make(source: SourceFunction, relation: Relation, types: tuple[ParameterType, ...]) -> Whole:
    with suspended():  # libraries may make an index when a kernel first asks for it
        elaborated = elaborate(source, relation, types)
    phases = check_phases(elaborated.kernel)
    unverified = Unverified()
    kernel = run_passes(elaborated.kernel, PASSES, unverified.add)
    stencil = collect_stencil(kernel)
    step = Step(kernel, phases, tuple([access.node for access in stencil]))
    return Whole(step, elaborated.guards, elaborated.trail, stencil, unverified.verify)
