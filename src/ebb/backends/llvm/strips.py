"""Which loops can do several turns at once, in the lanes of vector registers, and what each of their parts is then.

LLVM's own vectoriser gives up on the loops that matter most here: few turns, sums in the memory of the row, values of
other rows. Those of a query run in any order, and sums over them are taken in any grouping. A loop is taken when all
it does is arithmetic, loads, and sums into places that no turn chooses; conditions become masks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import TypeAlias

from ebb.backends.llvm.fit import Unfit, change_of, demand, demand_lanes, is_failure
from ebb.backends.llvm.vector_math import VectorForms
from ebb.compiler import lir
from ebb.compiler.lir_walk import operands, statements, values, variable_reads
from ebb.records import record

WORK_OF_A_SUM, WORK_OF_A_LOAD = 4, 1
"""A loop of less work a turn than this, for each sum and once more, and for each number that a turn loads, is left as
it is: adding the lanes of each sum up, a last strip that is half empty, and bringing what was loaded into lanes then
cost more than the lanes save. Measured on groups of 6 and 14 rows: a plain sum of products, or of matrices times
vectors, is 1.5 times as quick turn by turn, and lengths or springs half as quick."""

_SLOW_WORK = 8
"""The work of a division, a root or another function, of which a vector of eight costs little more than one."""

PlaceKey: TypeAlias = tuple[str, int, int | str]
"""What tells places apart: kind and number of the slot or variable, and the index."""


@record
class Sum:
    """A place that turns add to, by ``op``."""

    place: lir.Slot | lir.Var
    index: lir.Value
    op: str


@record
class Update:
    """A store that adds ``value`` to the sum ``key`` by ``op``: that of the sum, or ``-`` where that is ``+``."""

    key: PlaceKey
    op: str
    value: lir.Value


@record
class RowLoad:
    """The loads of one slot at a root and small offsets: mostly the components of a row of another relation."""

    slot: lir.Slot
    root: lir.Value
    loads: list[tuple[int, lir.Temp]]


class StripPlan:
    """How a loop runs in strips.

    Attributes:
        definitions: the operation of each temporary of the loop, by number.
        varying: the temporaries that differ between turns.
        early: those that are computed before the loop, in order.
        skipped: the loads and sums that updates stand for.
        addressing: the temporaries that addresses are computed from.
        private: the variables that belong to one turn, by number.
        loose: the temporaries that come from such a variable: beyond the end they may be anything.
        sums: the places that are added to.
        updates: the stores that do so, by the identity of the statement.
        rows: the loads of rows, by the number of the temporary of the load that comes first.
        members: the temporaries that some other load of the row defines.
        fails: whether a turn may fail.
    """

    def __init__(self) -> None:
        self.definitions: dict[int, lir.Operation] = {}
        self.varying: set[int] = set()
        self.early: list[lir.Let] = []
        self.skipped: set[int] = set()
        self.addressing: set[int] = set()
        self.private: set[int] = set()
        self.loose: set[int] = set()
        self.sums: dict[PlaceKey, Sum] = {}
        self.updates: dict[int, Update] = {}
        self.rows: dict[int, RowLoad] = {}
        self.members: set[int] = set()
        self.fails = False

    def varies(self, value: lir.Value) -> bool:
        """Whether ``value`` differs between turns."""
        return isinstance(value, lir.Temp) and value.number in self.varying

    def is_loose(self, value: lir.Value) -> bool:
        """Whether ``value`` may be anything in a lane beyond the end."""
        return isinstance(value, lir.Temp) and value.number in self.loose


def plan_strips(loop: lir.For, reads: Mapping[int, int], vector_math: VectorForms) -> StripPlan | None:
    """How ``loop`` runs in strips, or None where it cannot.

    Args:
        loop: a loop whose turns may run in any order.
        reads: how often the program reads each variable, by number, this loop included.
        vector_math: the functions that the target has for several values at once.
    """
    try:
        return _Planner(loop, reads, vector_math).plan
    except Unfit:
        return None


def split(definitions: Mapping[int, lir.Operation], index: lir.Value) -> tuple[lir.Value, int]:
    """``index`` as a root and a constant."""
    offset = 0
    while isinstance(index, lir.Temp):
        match definitions.get(index.number):
            case lir.Binary("+", root, lir.Literal(constant)):
                index, offset = root, offset + constant
            case _:
                break
    return index, offset


class _Planner:
    """Makes the plan of one loop."""

    def __init__(self, loop: lir.For, reads: Mapping[int, int], vector_math: VectorForms) -> None:
        self.loop, self.vector_math = loop, vector_math
        self.plan = StripPlan()
        lets = [stmt for stmt in statements(loop.body) if isinstance(stmt, lir.Let)]
        self.plan.definitions = {let.temp.number: let.operation for let in lets}
        self.uses = Counter(
            value.number for stmt in statements(loop.body) for value in values(stmt) if isinstance(value, lir.Temp)
        )
        self.find_updates(loop.body)
        self.find_private(reads)
        self.find_varying(lets)
        self.find_early(lets)
        self.check(loop.body, set[tuple[int, int]]())
        self.check_places(loop.body, checked=False)
        self.find_rows(loop.body)
        self.find_addressing(lets)
        demand(bool(self.plan.sums))
        least = WORK_OF_A_SUM * (len(self.plan.sums) + 1) + WORK_OF_A_LOAD * self.loaded()
        demand(self.work(lets) >= least)

    def loaded(self) -> int:
        """How many numbers a turn loads that are no keys."""
        loads = [temp.number for row in self.plan.rows.values() for _, temp in row.loads]
        return sum(number not in self.plan.addressing for number in loads)

    def work(self, lets: list[lir.Let]) -> int:
        """What a turn computes that differs from turn to turn, in additions of floats. Addresses cost nothing."""
        varying = [let for let in lets if let.temp.number in self.plan.varying - self.plan.addressing]
        return sum(_work(let.operation) for let in varying)

    # ---- Sums ----

    def find_updates(self, body: lir.Body) -> None:
        for stmt in statements(body):
            match stmt:
                case lir.Store(place, index, value) | lir.StoreVar(place, index, value):
                    self.find_update(stmt, place, index, value)
                case lir.Accumulate(var, index, op, value):
                    self.add_update(stmt, var, index, Update(place_key(var, index), op, value))
                case _:
                    pass

    def find_update(self, stmt: lir.Stmt, place: lir.Slot | lir.Var, index: lir.Value, stored: lir.Value) -> None:
        """Notes that ``stmt`` adds to the place, if it does."""
        change = change_of(place, index, stored, self.plan.definitions, self.uses)
        if change is not None:
            self.plan.skipped |= change.made
            self.add_update(stmt, place, index, Update(place_key(place, index), change.op, change.value))

    def add_update(self, stmt: lir.Stmt, place: lir.Slot | lir.Var, index: lir.Value, update: Update) -> None:
        op = "+" if update.op == "-" else update.op
        self.plan.sums.setdefault(update.key, Sum(place, index, op))
        for other in self.plan.sums.values():
            demand(other.op == op or other.place != place or self.apart(other.index, index))
        self.plan.updates[id(stmt)] = update

    def apart(self, left: lir.Value, right: lir.Value) -> bool:
        """Whether two indexes surely differ, as those of two components of one row do."""
        if isinstance(left, lir.Literal) and isinstance(right, lir.Literal):
            return left != right
        (root, offset), (other, another) = split(self.plan.definitions, left), split(self.plan.definitions, right)
        return offset != another and self.same(root, other)

    def same(self, left: lir.Value, right: lir.Value) -> bool:
        """Whether two values of one turn are surely the same, maybe computed twice."""
        if left == right:
            return True
        if not (isinstance(left, lir.Temp) and isinstance(right, lir.Temp)):
            return False
        match self.plan.definitions.get(left.number), self.plan.definitions.get(right.number):
            case lir.Binary(op, a, b), lir.Binary(other, c, d):
                return op == other and self.same(a, c) and self.same(b, d)
            case _:
                return False

    # ---- What varies ----

    def find_private(self, reads: Mapping[int, int]) -> None:
        """Variables that are stored to and are no sums are of one turn: nothing else may read them."""
        summed = {sum_.place.number for sum_ in self.plan.sums.values() if isinstance(sum_.place, lir.Var)}
        here = variable_reads(self.loop.body)
        for stmt in statements(self.loop.body):
            if isinstance(stmt, lir.Declare | lir.StoreVar) and id(stmt) not in self.plan.updates:
                demand(stmt.var.number not in summed and here[stmt.var.number] == reads[stmt.var.number])
                self.plan.private.add(stmt.var.number)

    def find_varying(self, lets: list[lir.Let]) -> None:
        varying, loose = self.plan.varying, self.plan.loose
        varying.add(self.loop.counter.number)
        for let in lets:
            private = isinstance(let.operation, lir.LoadVar) and let.operation.var.number in self.plan.private
            if private or any(map(self.plan.is_loose, operands(let.operation))):
                loose.add(let.temp.number)
            if private or any(map(self.plan.varies, operands(let.operation))):
                varying.add(let.temp.number)

    def find_early(self, lets: list[lir.Let]) -> None:
        """Arithmetic on what does not vary is done before the loop, whether or not a turn asks for it."""
        late = {self.loop.counter.number}
        for let in lets:
            number = let.temp.number
            reads = isinstance(let.operation, lir.Load | lir.LoadVar)
            used = [value.number for value in operands(let.operation) if isinstance(value, lir.Temp)]
            if reads or number in self.plan.varying or not late.isdisjoint(used):
                late.add(number)
            elif number not in self.plan.skipped:
                self.plan.early.append(let)
        for sum_ in self.plan.sums.values():
            demand(not (isinstance(sum_.index, lir.Temp) and sum_.index.number in late))

    def find_addressing(self, lets: list[lir.Let]) -> None:
        wanted = self.plan.addressing
        for let in reversed(lets):
            match let.operation:
                case lir.Load(_, index) if let.temp.number not in self.plan.skipped:
                    wanted.update(value.number for value in (index,) if isinstance(value, lir.Temp))
                case _ if let.temp.number not in wanted:
                    continue
                case _:
                    pass
            if let.temp.number in wanted:
                wanted.update(value.number for value in operands(let.operation) if isinstance(value, lir.Temp))

    # ---- What is fit ----

    def check(self, body: lir.Body, assigned: set[tuple[int, int]]) -> None:
        """Every statement can be done in lanes; ``assigned`` are the components of private variables with a value."""
        for stmt in body:
            match stmt:
                case lir.Let(temp, operation) if temp.number not in self.plan.skipped:
                    self.check_operation(temp, operation, assigned)
                case lir.Declare(var):
                    assigned |= {(var.number, k) for k in range(var.size)}
                case lir.StoreVar(var, lir.Literal(k)) if id(stmt) not in self.plan.updates:
                    assigned.add((var.number, k))
                case lir.If() if is_failure(stmt):
                    self.plan.fails = True
                case lir.If(_, then, orelse):
                    arms = assigned.copy(), assigned.copy()
                    self.check(then, arms[0])
                    self.check(orelse, arms[1])
                    assigned |= arms[0] & arms[1]
                case lir.Let():
                    pass
                case _:
                    demand(id(stmt) in self.plan.updates)

    def check_operation(self, temp: lir.Temp, operation: lir.Operation, assigned: set[tuple[int, int]]) -> None:
        match operation:
            case lir.LoadVar(var, index):
                self.check_variable(var, index, assigned)
            case lir.Load(slot, _):
                demand(all(sum_.place != slot for sum_ in self.plan.sums.values()))
            case _ if temp.number not in self.plan.varying:
                pass
            case _:
                demand_lanes(temp, operation, self.vector_math)

    def check_variable(self, var: lir.Var, index: lir.Value, assigned: set[tuple[int, int]]) -> None:
        summed = any(sum_.place == var for sum_ in self.plan.sums.values())
        demand(not summed and not self.plan.varies(index))
        if var.number in self.plan.private:
            demand(isinstance(index, lir.Literal) and (var.number, index.value) in assigned)

    def check_places(self, body: lir.Body, checked: bool) -> None:
        """All sums are added to their places behind the loop, so none may be at a place that a check keeps turns from.

        Args:
            body: a body of the loop.
            checked: whether some turns come to a check on their way to it, and others do not come to it.
        """
        for stmt in body:
            match stmt:
                case lir.If(_, then, orelse) if not is_failure(stmt):
                    for arm in (then, orelse):
                        fails = any(isinstance(inner, lir.If) and is_failure(inner) for inner in arm)
                        self.check_places(arm, checked or fails)
                case _ if checked and id(stmt) in self.plan.updates:
                    demand(self.is_component(self.plan.sums[self.plan.updates[id(stmt)].key]))
                case _:
                    pass

    def is_component(self, sum_: Sum) -> bool:
        """Whether a place is surely a component of a variable, or of a row that is known before the loop."""
        if isinstance(sum_.place, lir.Var):
            return isinstance(sum_.index, lir.Literal)
        binding = sum_.place.binding
        size = binding.field.type.size if isinstance(binding, lir.FieldData) else 1
        row, component = split(self.plan.definitions, sum_.index)
        if size > 1 and isinstance(row, lir.Temp):
            match self.plan.definitions.get(row.number):
                case lir.Binary("*", row, lir.Literal(factor)) if factor == size:
                    pass
                case _:
                    return False
        return isinstance(row, lir.Temp) and row.number not in self.plan.definitions and 0 <= component < size

    # ---- Rows ----

    def find_rows(self, body: lir.Body) -> None:
        """Gathers the loads of one body by slot and root: they run under one mask, and nothing stores in between.

        What is loaded behind a check stays behind it: it may be no row where the check fails.
        """
        found: dict[tuple[int, lir.Value], RowLoad] = {}
        for stmt in body:
            match stmt:
                case lir.Let(temp, lir.Load(slot, index)) if self.plan.varies(index):
                    if temp.number not in self.plan.skipped:
                        self.find_row(found, temp, slot, index)
                case lir.If() if is_failure(stmt):
                    found.clear()
                case lir.If(_, then, orelse):
                    self.find_rows(then)
                    self.find_rows(orelse)
                case _:
                    pass

    def find_row(
        self, found: dict[tuple[int, lir.Value], RowLoad], temp: lir.Temp, slot: lir.Slot, index: lir.Value
    ) -> None:
        root, offset = split(self.plan.definitions, index)
        row = found.get((slot.number, root))
        if row is None:
            row = found[slot.number, root] = self.plan.rows[temp.number] = RowLoad(slot, root, [])
        else:
            self.plan.members.add(temp.number)
        row.loads.append((offset, temp))


def _work(operation: lir.Operation) -> int:
    match operation:
        case lir.Binary("/") | lir.Math():
            return _SLOW_WORK
        case lir.Unary() | lir.Binary() | lir.Compare() | lir.Select():
            return 1
        case _:
            return 0


def place_key(place: lir.Slot | lir.Var, index: lir.Value) -> PlaceKey:
    """The key of a place."""
    kind = "slot" if isinstance(place, lir.Slot) else "var"
    return kind, place.number, index.number if isinstance(index, lir.Temp) else f"literal {index.value}"
