"""Which loops over rows can do several rows at once, in the lanes of vector registers.

LLVM's own vectoriser takes plain loops over rows as they are; it gives up on those that this is for: rows that read or
change many rows of other relations, and rows that may fail. A loop is taken when its body is straight: arithmetic,
loads, stores to the own row, sums into other rows, conditions, and checks that fail.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum

from ebb.backends.llvm.fit import Change, Unfit, change_of, demand, demand_lanes, is_failure
from ebb.backends.llvm.row_elements import Elements
from ebb.backends.llvm.row_skips import leaves_out
from ebb.backends.llvm.transpose import LANES
from ebb.backends.llvm.vector_math import VectorForms
from ebb.compiler import lir
from ebb.compiler.lir_walk import operands, statements, values
from ebb.records import record
from ebb.types.types import Kind

LEAST_WORK = 12
"""The operations on floats, for each place that lanes reach by themselves, from which on strips pay."""

MOST_LISTED = 1000
"""Longer bodies of loops over lists are compiled once, not in strips as well."""


class Reach(Enum):
    """How the rows of a strip reach a place: all the same, one after the other, or each its own."""

    SAME = "same"
    FOLLOWING = "following"
    OWN = "own"


@record
class RowPlan:
    """How a loop over rows runs in strips.

    Attributes:
        definitions: the operation of each temporary, by number.
        updates: the stores that change elements of other rows, by the identity of the statement.
        skipped: the loads and operations that updates stand for, by the number of the temporary.
        checks: how many statements may fail.
    """

    definitions: dict[int, lir.Operation]
    updates: dict[int, Change]
    skipped: set[int]
    checks: int


def plan_rows(loop: lir.RowLoop, vector_math: VectorForms) -> RowPlan | None:
    """How ``loop`` runs in strips, or None where it cannot, or gains nothing by it."""
    try:
        return _Planner(loop, vector_math).plan(gains=True)
    except Unfit:
        return None


def plan_runs(loop: lir.RowLoop, vector_math: VectorForms) -> tuple[lir.RowLoop, RowPlan] | None:
    """How a loop over a list of rows runs in strips where rows follow one another: the loop over rows, and its plan.

    None where it is no loop over a list of rows, or they cannot.
    """
    match loop:
        case lir.RowLoop((counter,), lir.Rows.INDEPENDENT, (lir.Let(row, lir.Load(slot, index)), *rest)):
            if slot.binding != lir.LaunchPositions() or index != counter:
                return None
        case _:
            return None
    if any(value == counter for stmt in statements(tuple(rest)) for value in values(stmt)):
        return None
    rows = lir.RowLoop((row,), loop.rows, tuple(rest))
    try:
        planner = _Planner(rows, vector_math)
        demand(len(planner.all) <= MOST_LISTED)
        return rows, planner.plan(gains=False)
    except Unfit:
        return None


class _Planner:
    def __init__(self, loop: lir.RowLoop, vector_math: VectorForms) -> None:
        self.loop, self.vector_math = loop, vector_math
        self.all = list(statements(loop.body))
        self.lets = [stmt for stmt in self.all if isinstance(stmt, lir.Let)]
        self.definitions = {let.temp.number: let.operation for let in self.lets}
        self.uses = Counter(value.number for stmt in self.all for value in values(stmt) if isinstance(value, lir.Temp))
        self.reach = {index.number: Reach.SAME for index in loop.index}
        self.reach[loop.index[-1].number] = Reach.FOLLOWING
        self.declared = {stmt.var.number for stmt in self.all if isinstance(stmt, lir.Declare)}
        self.updates: dict[int, Change] = {}
        self.skipped: set[int] = set()
        self.touches: Counter[int] = Counter()
        self.changes: Counter[int] = Counter()
        self.checks = 0

    def plan(self, gains: bool) -> RowPlan:
        self.find_reach()
        self.count_changes()
        self.check(self.loop.body, nested=False)
        stored = [stmt for stmt in self.all if isinstance(stmt, lir.Store)]
        changed = {stmt.slot.number for stmt in stored if id(stmt) in self.updates}
        elements = Elements(self.loop)
        for stmt in stored:
            number = stmt.slot.number
            demand(elements.are_known(number) and (number in changed or elements.are_of_one_row(number)))
            # What other rows change is neither read nor set by the row itself.
            demand(stmt.slot.number not in changed or id(stmt) in self.updates)
        for let in self.lets:
            if isinstance(let.operation, lir.Load) and let.temp.number not in self.skipped:
                demand(let.operation.slot.number not in changed)
        demand(not gains or self.pays())
        return RowPlan(self.definitions, self.updates, self.skipped, self.checks)

    def pays(self) -> bool:
        """Whether there is arithmetic enough for the places that lanes reach by themselves, or a check in the way."""
        work = sum(_work(let.operation) for let in self.lets if let.temp.type.kind is Kind.FLOAT)
        own = {
            (let.operation.slot.number, let.operation.index)
            for let in self.lets
            if isinstance(let.operation, lir.Load) and self.reach_of(let.operation.index) is Reach.OWN
        }
        places = len(own) + len(self.updates)
        gains = places > 0 or self.checks > 0 or leaves_out(self.loop)
        return work >= LANES and gains and work >= LEAST_WORK * places / 8

    # ---- How places are reached ----

    def reach_of(self, value: lir.Value) -> Reach:
        return self.reach.get(value.number, Reach.SAME) if isinstance(value, lir.Temp) else Reach.SAME

    def find_reach(self) -> None:
        for let in self.lets:
            reaches = {self.reach_of(value) for value in operands(let.operation)}
            match let.operation:
                case lir.LoadVar():
                    self.reach[let.temp.number] = Reach.OWN
                case lir.Load():
                    self.reach[let.temp.number] = Reach.SAME if reaches == {Reach.SAME} else Reach.OWN
                case lir.Binary("+" | "-" | "*") | lir.Convert() if Reach.OWN not in reaches:
                    self.reach[let.temp.number] = Reach.FOLLOWING if Reach.FOLLOWING in reaches else Reach.SAME
                case _:
                    self.reach[let.temp.number] = Reach.SAME if reaches <= {Reach.SAME} else Reach.OWN

    # ---- What is fit ----

    def check(self, body: lir.Body, nested: bool) -> None:
        for stmt in body:
            match stmt:
                case lir.Let(temp, operation):
                    self.check_operation(temp, operation)
                case lir.Declare():
                    pass
                case lir.StoreVar(var, lir.Literal(), _):
                    demand(var.number in self.declared)
                case lir.Accumulate(var, lir.Literal(), _, _):
                    demand(var.number not in self.declared)
                case lir.If() if is_failure(stmt):
                    self.checks += 1
                case lir.If(_, then, orelse):
                    self.check(then, nested=True)
                    self.check(orelse, nested=True)
                case lir.Store(slot, index, value):
                    self.check_store(stmt, slot, index, value, nested)
                case _:
                    raise Unfit

    def check_store(self, stmt: lir.Store, slot: lir.Slot, index: lir.Value, value: lir.Value, nested: bool) -> None:
        if self.find_update(stmt, slot, index, value):
            demand(not nested and self.reach_of(index) is not Reach.SAME)
            return
        demand(self.reach_of(index) is Reach.FOLLOWING and slot.type.kind is not Kind.BOOL)

    def find_update(self, stmt: lir.Store, slot: lir.Slot, index: lir.Value, stored: lir.Value) -> bool:
        """Whether ``stmt`` changes an element of another row by an operation; notes it."""
        if self.loop.rows is lir.Rows.INDEPENDENT:
            return False  # independent rows change nothing but their own
        change = self.change(slot, index, stored)
        if change is None or self.touches[slot.number] != 2 * self.changes[slot.number]:
            return False
        self.skipped |= change.made
        self.updates[id(stmt)] = change
        return True

    def change(self, slot: lir.Slot, index: lir.Value, stored: lir.Value) -> Change | None:
        return change_of(slot, index, stored, self.definitions, self.uses)

    def count_changes(self) -> None:
        """How often each slot is touched, and how often loaded, changed and stored."""
        for stmt in self.all:
            match stmt:
                case lir.Let(_, lir.Load(slot, _)):
                    self.touches[slot.number] += 1
                case lir.Store(slot, index, stored):
                    self.touches[slot.number] += 1
                    self.changes[slot.number] += self.change(slot, index, stored) is not None
                case _:
                    pass

    def check_operation(self, temp: lir.Temp, operation: lir.Operation) -> None:
        same = self.reach_of(temp) is Reach.SAME
        match operation:
            case lir.LoadVar(var, index):
                demand(isinstance(index, lir.Literal) and var.number in self.declared)
            case lir.Load(slot, _):
                demand(same or slot.type.kind is not Kind.BOOL)
            case _ if same:
                demand(not isinstance(operation, lir.ThreadNumber))
            case lir.Binary(">>", _, right):
                demand(temp.type.kind is Kind.SIGNED and self.reach_of(right) is Reach.SAME)
            case _:
                demand_lanes(temp, operation, self.vector_math)


def _work(operation: lir.Operation) -> int:
    match operation:
        case lir.Binary("/") | lir.Math():
            return 8
        case lir.Unary() | lir.Binary() | lir.Select():
            return 1
        case _:
            return 0
