"""How reductions into other rows are done: in colours, gathered, staged, or in row order on one thread.

Devices know no colours: they run so many threads that waves would leave most of them idle. Every way is a function of
the program and its data alone, never of the number of threads, and so are the bits of the results. The model judges
each way by the time that a row takes, shared by ``waves.WIDTH`` threads: the bytes and operations of ``cost_of``,
weighted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from functools import cached_property

from ebb.compiler import kir
from ebb.compiler.cost import Cost
from ebb.compiler.kir_walk import statements
from ebb.compiler.lir import BLOCK_ROWS, Precision
from ebb.compiler.lower import Launched, lower
from ebb.compiler.pace import is_straight
from ebb.compiler.scatter.gather import Route, Routes, find_routes, gather
from ebb.compiler.scatter.kept_plans import KeptPlan, PlanStore, plan_name, unpacked
from ebb.compiler.scatter.staged import Stage, make_stages, stage, staged_parts
from ebb.compiler.scatter.step import Step
from ebb.compiler.scatter.touched import NotStatic, Touches, find_touched, own_positions
from ebb.compiler.scatter.waves import WIDTH, Waves, colour, efficiency, in_order
from ebb.errors import RelationError
from ebb.records import record, replace
from ebb.relations.field import Field
from ebb.relations.inverse import hidden_index, index_keys
from ebb.relations.subset import RowSet
from ebb.runtime.buffer import Array

FEW_BLOCKS = 4
"""Launches of fewer blocks than this run in row order: there is nothing to share."""

MOST_KEPT = 2
"""How many plans of a launch are kept between processes at most: keys may change for as long as a program runs."""

OWN_BYTE, OTHER_BYTE, WRITTEN_BYTE, OPERATION, STRAIGHT_OPERATION = 0.05, 0.12, 0.1, 0.08, 0.02
"""Nanoseconds: for a byte of the own row, of another row, or written; for an operation on scalars, and for one where
several rows are computed at once."""

STRAIGHT_OPERATIONS = 12
"""From how many operations on straight rows are computed so, at least."""

LISTED_ROW, STAGED_VALUE = 0.5, 5.0
"""Nanoseconds for a row that is found through a list, since what belongs to it lies anywhere, and for a value that goes
through memory on its way to a target that finds it so."""

ANY_ORDER = "any: blocks of rows run on all threads"

ROW_AFTER_ROW = "into other rows: row after row in storage order, on one thread"

ATOMICALLY = "into other rows, atomically, in any order: the bits depend on the threads"

BLOCK_TOTALS = "one partial result a block of rows, combined in the order of the blocks"
"""What is done with reductions into globals on a processor."""

CLEAR = 1.25
"""How much quicker than in row order, on ``WIDTH`` threads, a way must be to be taken."""


class Way(Enum):
    """How reductions into other rows are done."""

    IN_ORDER = "in order"
    COLOURS = "colours"
    GATHER = "gather"
    STAGE = "stage"


def quickest(times: Mapping[Way, float]) -> Way:
    """The way that takes the least time, by the model; row order, if it is one of them, where that is hardly slower."""
    best = min(times, key=lambda way: times[way])
    return Way.IN_ORDER if Way.IN_ORDER in times and times[Way.IN_ORDER] < CLEAR * times[best] else best


@record(eq=False)
class Run:
    """A step on a set of rows. ``waves`` is None where all blocks may run at once."""

    step: Step
    rows: RowSet
    waves: Waves | None


@record(eq=False)
class Plan:
    """What a launch runs, one after the other.

    Attributes:
        runs: the kernels and their rows.
        how: how the reductions are done, for ``explain``.
        order: in which order the rows run, for ``explain``; None for any.
        read: the key fields on whose values the plan depends.
        settled: whether it stands until these change; else it is only for the next launch.
    """

    runs: tuple[Run, ...]
    how: str
    order: str | None
    read: tuple[Field, ...]
    settled: bool = True


class Planner:
    """Plans the launches of one kernel on one set of rows, and keeps what belongs to each way."""

    def __init__(
        self, step: Step, rows: RowSet, starts: Callable[[], Array] | None, kept: PlanStore | None = None
    ) -> None:  # fmt: skip
        """Nothing is planned yet.

        Args:
            step: the kernel.
            rows: what it runs on.
            starts: gives the number in the launch of the first row of each block, and the number of rows; None on a
                device, where threads take rows, not blocks: there are no colours, and row order is the last resort.
            kept: where the first plans may be kept.
        """
        self._starts = starts
        self._kept = kept
        self._step = step
        self._rows = rows
        self._keys = step.outline.sources.keys
        self._hidden: dict[Route, Field] = {}
        self._gathered: dict[tuple[Field, ...], list[Step]] = {}
        self._stages: tuple[tuple[Stage, ...], list[Step]] | None = None
        self._plan: Plan | None = None
        self._made_at: object = None
        self._seen: object = None
        self._builds = 0
        self._looked = 0

    @cached_property
    def _routes(self) -> Routes | None:
        return find_routes(self._step.kernel, self._step.phases)

    def plan(self) -> Plan:
        """The plan for the keys as they are. Its indexes are valid.

        Where keys change before launch after launch, rows run in order: an index or colours would pay for one launch
        only. The plan is made again once the keys have stayed the same for a launch.
        """
        now = self._state()
        before, self._seen = self._seen, now
        if self._plan is not None and now == self._made_at:
            self._builds = 0
            return self._plan
        if self._builds >= 2 and now != before:
            read = self._plan.read if self._plan is not None else ()
            why = "the keys changed before each of the last launches"
            return replace(self.plan_in_order(why, read), settled=False)
        self._builds += 1
        self._plan = self._make_or_find()
        self._made_at = self._seen = self._state()  # refreshing a grouping may have permuted its relation
        return self._plan

    def plan_in_order(self, why: str, read: tuple[Field, ...] = ()) -> Plan:
        """Row after row on one thread, for the reason ``why``; ``read`` is that of the plan."""
        order = f"one after the other, so that sums in other rows do not depend on the threads: {why}"
        waves = None if self._starts is None else in_order(len(self._starts()) - 1)
        return Plan((Run(self._step, self._rows, waves),), ROW_AFTER_ROW, order, read)

    def _state(self) -> object:
        """What a plan depends on of the data."""
        if self._plan is None:
            return None
        fields = self._plan.read
        targets = [field.target for field in fields if field.target is not None]
        relations = [self._rows.relation, *targets]
        return (
            *[(field.version, field.grouping) for field in fields],
            *[relation.storage.version for relation in relations],
            *[field.maybe_unset for field in self._keys],
        )

    def _make_or_find(self) -> Plan:
        """The plan for the keys as they are. The first two may be kept: rows may be moved after the first."""
        step, rows, starts, kept = self._step, self._rows, self._starts, self._kept
        if starts is None or kept is None or self._is_small() or self._looked == MOST_KEPT:
            return self._make()
        self._looked += 1
        name = plan_name(step.outline, rows, starts())
        content = None if name is None else kept.get(name)
        if content is not None:
            known = unpacked(content, step.outline)
            return Plan((Run(step, rows, known.waves),), known.how, known.order, known.read)
        plan = self._make()
        run = plan.runs[0] if len(plan.runs) == 1 else None
        if name is not None and run is not None and run.step is step and run.waves is not None:
            kept.put(name, KeptPlan(run.waves, plan.how, plan.order, plan.read).packed(step.outline))
        return plan

    # ---- The choice ----

    def _is_small(self) -> bool:
        return self._starts is not None and self._rows.size < FEW_BLOCKS * BLOCK_ROWS

    def _make(self) -> Plan:
        step, rows = self._step, self._rows
        if self._is_small():
            return self.plan_in_order(f"fewer than {FEW_BLOCKS} blocks of {BLOCK_ROWS:,} rows")
        again = self._may_gather()
        # Of every route, before anything is listed by position: a grouping that is refreshed may move rows.
        if again is not None and all([self._is_range(route) for route in again.all]):
            return self._gather_ranges(again)
        touches = find_touched(step.kernel, step.phases, rows)
        if isinstance(touches, NotStatic):
            return self.plan_in_order(f"the places depend on {touches.why}")
        waves, times = None, dict[Way, float]()
        if self._starts is not None:
            waves = colour(touches.places, self._starts())
            times[Way.IN_ORDER] = self._time(step, rows) * WIDTH
        if waves is not None:
            times[Way.COLOURS] = self._time(step, rows) / efficiency(waves)
        if again is not None:
            times[Way.GATHER] = self._gather_time(again)
        parts = staged_parts(step.kernel, step.phases)
        if parts is not None:
            self._stages = self._stages or self._make_stages(parts)
            times[Way.STAGE] = self._stage_time(self._stages)
        if not times:
            return self.plan_in_order("the values can neither be computed again nor staged", touches.read)
        way = quickest(times)
        if way is not Way.STAGE:
            self._stages = None  # they were made to be weighed, and hold memory
        return self._by(way, touches, waves)

    def _by(self, way: Way, touches: Touches, waves: Waves | None) -> Plan:
        match way:
            case Way.COLOURS:
                assert waves is not None
                return self._colours(waves, touches)
            case Way.GATHER:
                assert self._routes is not None
                return self._gather(self._routes, touches)
            case Way.STAGE:
                assert self._stages is not None
                return self._stage(self._stages, touches)
            case Way.IN_ORDER:
                return self.plan_in_order("no other way is clearly quicker", touches.read)

    # ---- Colours ----

    def _colours(self, waves: Waves, touches: Touches) -> Plan:
        rows = f"{waves.chunk * BLOCK_ROWS:,} rows" if self._rows.boxes is None else f"{waves.chunk} blocks"
        how = f"into other rows, coloured: {_count(len(waves.sizes), 'wave')} of {_sizes(waves)} chunks of {rows}"
        order = "in waves of blocks that have no place in common; those of a wave run on all threads"
        return Plan((Run(self._step, self._rows, waves),), how, order, touches.read)

    # ---- Gather ----

    def _may_gather(self) -> Routes | None:
        """The routes by which values may be computed again for each target, or None."""
        routes, step = self._routes, self._step
        if routes is None or (None in routes.all and own_positions(self._rows) is not None):
            return None
        if any([isinstance(stmt, kir.Assert) for stmt in statements(step.kernel.body)]):
            return None  # known without lowering it
        sources = step.outline.sources
        facts = sources.facts(sources.state())
        program = lower(step.kernel, step.phases, step.unchecked, facts, Launched.ALL, Precision.CONTRACT)
        return None if program.sites else routes  # whatever can fail has to fail in the order of rows

    def _is_range(self, route: Route) -> bool:
        """Whether the rows that refer to a target are stored one after the other."""
        if route is None:
            return True
        field, _ = route
        if field.grouping is None or own_positions(self._rows) is not None:
            return False
        try:
            field.grouping.refresh()
        except RelationError:  # a view is open: the storage has to stay as it is
            return False
        return field.grouping.rows is None

    def _indexes(self, routes: Routes) -> dict[Route, Field]:
        """The field whose grouping finds the rows by their target, for each route."""
        found: dict[Route, Field] = {}
        for route in routes.all:
            if route is None:
                continue
            if self._is_range(route):
                found[route] = route[0]
                continue
            if route not in self._hidden:
                name = "_".join((route[0].name, *map(str, route[1]), "inverse"))
                assert route[0].target is not None
                self._hidden[route] = hidden_index(self._rows.relation, name, route[0].target)
            found[route] = self._hidden[route]
        return found

    def _gather_steps(self, routes: Routes, indexes: Mapping[Route, Field]) -> list[Step]:
        key = tuple(indexes.values())
        if key not in self._gathered:
            self._gathered[key] = gather(self._step.kernel, routes, indexes, self._step.unchecked)
        return self._gathered[key]

    def _gather_time(self, routes: Routes) -> float:
        indexes = self._indexes(routes)
        listed = sum(index in self._hidden.values() for index in indexes.values())
        return self._times(self._gather_steps(routes, indexes)) + listed * self._rows.size * LISTED_ROW

    def _gather(self, routes: Routes, touches: Touches) -> Plan:
        indexes = self._indexes(routes)
        own = own_positions(self._rows)
        for route, index in indexes.items():
            if route is not None and index is self._hidden.get(route):
                field, component = route
                keys = field.data[(slice(None) if own is None else own, *component)]
                index_keys(index, keys, own)
        names = ", ".join(_route_text(route) for route in indexes)
        how = f"into other rows, gathered through the inverse of {names}: each value is computed where it is needed"
        return self._gather_plan(routes, indexes, how, touches.read)

    def _gather_ranges(self, routes: Routes) -> Plan:
        indexes = self._indexes(routes)
        names = ", ".join(_route_text(route) for route in indexes)
        how = f"into other rows, gathered through the inverse of {names}: its groups are ranges"
        return self._gather_plan(routes, indexes, how, tuple(dict.fromkeys(indexes.values())))

    def _gather_plan(self, routes: Routes, indexes: Mapping[Route, Field], how: str, read: tuple[Field, ...]) -> Plan:
        steps = self._gather_steps(routes, indexes)
        return Plan(tuple(Run(step, self._rows_of(step), None) for step in steps), how, None, read)

    # ---- Stages ----

    def _make_stages(self, parts: dict[Field, tuple[kir.ReduceField, ...]]) -> tuple[tuple[Stage, ...], list[Step]]:
        stages = make_stages(self._rows.relation, parts)
        return stages, stage(self._step.kernel, stages, self._step.unchecked)

    def _stage_time(self, staged: tuple[tuple[Stage, ...], list[Step]]) -> float:
        stages, steps = staged
        given = sum(len(each.parts) for each in stages)
        return self._times(steps) + given * self._rows.size * STAGED_VALUE

    def _stage(self, staged: tuple[tuple[Stage, ...], list[Step]], touches: Touches) -> Plan:
        stages, steps = staged
        own = own_positions(self._rows)
        for each in stages:
            each.refresh(touches.places, own)
        how = "into other rows, staged: each row writes what it gives, and each target gathers it"
        return Plan(tuple(Run(step, self._rows_of(step), None) for step in steps), how, None, touches.read)

    # ---- Costs ----

    def _rows_of(self, step: Step) -> RowSet:
        """The rows that a step runs on: those of the launch, or all of a target."""
        of_launch = step.kernel.row == self._step.kernel.row
        return self._rows if of_launch else step.kernel.relation

    def _times(self, steps: Sequence[Step]) -> float:
        return sum(self._time(step, self._rows_of(step)) for step in steps)

    def _time(self, step: Step, rows: RowSet) -> float:
        return rows.size * _row_time(step.cost(), is_straight(step.kernel))


def _row_time(cost: Cost, straight: bool) -> float:
    moved = cost.own_bytes * OWN_BYTE + cost.other_bytes * OTHER_BYTE + cost.written_bytes * WRITTEN_BYTE
    together = straight and cost.operations >= STRAIGHT_OPERATIONS
    return moved + cost.operations * (STRAIGHT_OPERATION if together else OPERATION)


def _route_text(route: Route) -> str:
    assert route is not None
    field, index = route
    return field.path + (f"[{', '.join(map(str, index))}]" if index else "")


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _sizes(waves: Waves) -> str:
    sizes = [f"{size:,}" for size in waves.sizes]
    if len(sizes) > 4:
        return f"up to {max(waves.sizes):,}"
    return " and ".join((", ".join(sizes[:-1]), sizes[-1])) if len(sizes) > 1 else sizes[0]
