"""What launches ask of a kernel whose code is known: so little that it can be kept, and no kernel has to be made."""

from __future__ import annotations

from collections.abc import Iterable

from ebb.compiler import kir
from ebb.compiler.cost import Cost, cost_of, group_size
from ebb.compiler.host import HostValue
from ebb.compiler.kir_key import KernelKey, kernel_key
from ebb.compiler.kir_walk import draws, statements
from ebb.compiler.lower.facts import FactSources, sources_of
from ebb.compiler.lower.kernel import most_variable_bytes
from ebb.compiler.phases.order import InOrder, why_in_order
from ebb.compiler.phases.table import PhaseTable
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.relation import Relation


@record
class Group:
    """How many rows a query by ``index`` finds on average, and whether it finds them in a list."""

    index: Field
    size: float
    listed: bool


@record(eq=False)
class Outline:
    """What is asked of a kernel before it is lowered.

    Attributes:
        key: the text of the kernel, which is all that programs depend on beside the facts and how rows are given.
        sources: where these facts come from.
        in_order: why rows run one after the other, or None.
        draws: whether it draws random numbers.
        variable_bytes: at least the size of its variables.
        cost: of a row, while queries find ``groups``.
    """

    name: str
    relation: Relation
    uniforms: tuple[HostValue, ...]
    key: KernelKey
    sources: FactSources
    in_order: InOrder | None
    draws: bool
    variable_bytes: int
    cost: Cost
    groups: tuple[Group, ...]

    def is_of(self, other: Outline) -> bool:
        """Whether two outlines are of one kernel, on the same objects."""
        return self.key.text == other.key.text and self.key.named == other.key.named


def outline_of(kernel: kir.Kernel, phases: PhaseTable, unchecked: Iterable[kir.Affine]) -> Outline:
    """The outline of a kernel."""
    indexes = dict.fromkeys(stmt.index for stmt in statements(kernel.body) if isinstance(stmt, kir.ForQuery))
    return Outline(
        name=kernel.name,
        relation=kernel.relation,
        uniforms=kernel.uniforms,
        key=kernel_key(kernel, phases, unchecked),
        sources=sources_of(kernel),
        in_order=why_in_order(kernel, phases),
        draws=draws(kernel),
        variable_bytes=most_variable_bytes(kernel),
        cost=cost_of(kernel),
        groups=tuple(map(group_of, indexes)),
    )


def group_of(index: Field) -> Group:
    """What queries by ``index`` find now."""
    return Group(index, group_size(index), index.grouping is not None and index.grouping.rows is not None)
