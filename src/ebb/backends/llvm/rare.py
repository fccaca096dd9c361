"""Rows in which nothing rare happens: checks that hold, coordinates that lie within a period of their grid.

A branch that leaves the loop, or leads to a division, keeps LLVM from computing several rows at once. So before some
rows run, a loop looks at the conditions alone, several rows at once. Where none of them comes true, which is nearly
always, the rows run without the branches; else they run one by one, with them, up to the row that fails.

That is the same as long as the conditions can be had ahead: from values of the own row that nothing has changed yet.
Where they cannot, the rows run without the branches at once, and note the conditions meanwhile; what they overwrite has
been kept, and is put back if one of them came true.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from ebb.backends.llvm.fit import is_failure
from ebb.backends.llvm.shifts import Linear, Names
from ebb.backends.llvm.writer import FunctionWriter
from ebb.compiler import lir
from ebb.compiler.lir_walk import operands, statements
from ebb.records import record
from ebb.types.types import bool_, int64

MOST_STATEMENTS = 250
"""Of longer rows vectors would not pay: LLVM gathers what keys lead to element by element."""

PART = 1024
"""So many rows are looked at, then run: what is loaded for the conditions is then still in the nearest cache."""

MOST_KEPT = 64
"""How many bytes a row may overwrite to be run before it is known whether something rare happens."""

LANES = 16
"""How many rows run together: those beyond the last so many of a part run one by one."""


@record(eq=False)
class RarePlan:
    """How the rows of a loop run.

    Attributes:
        ahead: what sets ``_HAPPENS`` if something rare happens in the row; nothing where only ``smooth`` can tell.
        smooth: the body without what is rare, which then sets it.
        kept: then, the slots that rows overwrite, and how many elements of each are a row's.
    """

    ahead: lir.Body
    smooth: lir.Body
    kept: tuple[tuple[lir.Slot, int], ...] = ()


_HAPPENS = lir.Var(-1, "rare", bool_, 1, lir.Memory.PRIVATE)
"""Whether something rare happens. No program has numbers below 0."""


def plan_rare(loop: lir.RowLoop) -> RarePlan | None:
    """The plan for ``loop``, or None where there is nothing rare, or nothing to win by leaving it out."""
    rare = [stmt for stmt in loop.body if isinstance(stmt, lir.If) and is_rare(stmt)]
    if loop.rows is not lir.Rows.INDEPENDENT or not rare:
        return None
    smooth = tuple(stmt for stmt in loop.body if not (isinstance(stmt, lir.If) and is_rare(stmt)))
    if not _is_straight(smooth):
        return None
    needed = _slice(loop, [stmt.condition for stmt in rare])
    if needed is None:
        return _plan_tried(loop, rare)
    notes = [note for number, stmt in enumerate(rare) for note in _noted(stmt, number)]
    return RarePlan((*needed, *notes), smooth)


def _plan_tried(loop: lir.RowLoop, rare: list[lir.If]) -> RarePlan | None:
    """The plan by which rows run before it is known whether something rare happens, or None where they must not."""
    kept = _overwritten(loop)
    if kept is None or sum(slot.type.dtype.itemsize * size for slot, size in kept.items()) > MOST_KEPT:
        return None
    smooth: list[lir.Stmt] = []
    for stmt in loop.body:
        if isinstance(stmt, lir.If) and is_rare(stmt):
            smooth += _noted(stmt, rare.index(stmt))
        else:
            smooth.append(stmt)
    return RarePlan((), tuple(smooth), tuple(kept.items()))


def _overwritten(loop: lir.RowLoop) -> dict[lir.Slot, int] | None:
    """The slots that rows overwrite and the size of a row in each; None where running a row again would not be enough.

    That is so where it adds to what is not its own, or where a place may depend on what is rare, and so lie anywhere.
    """
    names, kept, is_sure = Names(loop.index[-1]), dict[lir.Slot, int](), True
    if _sets_beyond(loop.body):
        return None
    for stmt in statements(loop.body):
        match stmt:
            case lir.Let(_, operation):
                names.name(stmt)
                if not is_sure and not _lies_in_own_row(names, operation):
                    return None
            case lir.StoreVar(_, index, _) if not is_sure and not isinstance(index, lir.Literal):
                return None
            case lir.Store(slot, index, _):
                size = _row_size(names, index)
                if size == 0 or kept.setdefault(slot, size) != size:
                    return None
            case lir.If():
                is_sure = is_sure and not is_rare(stmt)
            case _:
                pass
    return kept


def _sets_beyond(body: lir.Body) -> bool:
    """Whether a variable is set that other rows see, too."""
    inner = list(statements(body))
    declared = {stmt.var for stmt in inner if isinstance(stmt, lir.Declare)}
    return any(isinstance(stmt, lir.StoreVar | lir.Accumulate) and stmt.var not in declared for stmt in inner)


def _row_size(names: Names, index: lir.Value) -> int:
    """How many elements lie from a row to the next, where ``index`` is one of the own row's; else 0."""
    match names.linear.get(index.number) if isinstance(index, lir.Temp) else None:
        case Linear(terms, size, constant) if not terms and 0 <= constant < size:
            return size
        case _:
            return 0


def _lies_in_own_row(names: Names, operation: lir.Operation) -> bool:
    """Whether ``operation`` reads nothing whose place could be wrong."""
    match operation:
        case lir.Load(_, index):
            return _row_size(names, index) > 0
        case lir.LoadVar(_, index):
            return isinstance(index, lir.Literal)
        case _:
            return True


def is_rare(stmt: lir.If) -> bool:
    """Whether ``stmt`` does nothing but fail, or sets a variable to the remainder of a division."""
    if is_failure(stmt):
        return True
    match stmt:
        case lir.If(_, (lir.Let(_, lir.Binary("%")), lir.StoreVar()), ()):
            return True
        case _:
            return False


def _noted(stmt: lir.If, number: int) -> Iterator[lir.Stmt]:
    """What notes that ``stmt`` does something; ``number`` is that of the statement among those that are rare."""
    condition = stmt.condition
    if not stmt.then:
        condition = lir.Temp(-3 - number, bool_)
        yield lir.Let(condition, lir.Unary("not", stmt.condition))
    yield lir.Accumulate(_HAPPENS, lir.Literal(0, int64), "|", condition)


def _is_straight(body: lir.Body) -> bool:
    """Whether LLVM could make vectors of rows with this body."""
    count = 0
    for stmt in statements(body):
        count += 1
        if not isinstance(stmt, lir.Let | lir.Declare | lir.StoreVar | lir.Store | lir.Accumulate | lir.If):
            return False
    return count <= MOST_STATEMENTS


def _slice(loop: lir.RowLoop, wanted: list[lir.Value]) -> lir.Body | None:
    """The statements that compute the wanted values; None where more than the own row is needed, or what it becomes."""
    places = {stmt.temp.number: place for place, stmt in enumerate(loop.body) if isinstance(stmt, lir.Let)}
    given = {temp.number for temp in loop.index}
    needed = set[int]()
    rest = [(value, False) for value in wanted]  # and whether an index depends on it
    while rest:
        value, places_something = rest.pop()
        if not isinstance(value, lir.Temp) or value.number in given:
            continue
        place = places.get(value.number)
        stmt = None if place is None else loop.body[place]
        if place is None or not isinstance(stmt, lir.Let) or not _can_be_ahead(loop.body[:place], stmt.operation):
            return None
        is_load = isinstance(stmt.operation, lir.Load)
        if is_load and places_something:
            return None
        needed.add(place)
        rest += [(operand, places_something or is_load) for operand in operands(stmt.operation)]
    return tuple(loop.body[place] for place in sorted(needed))


def _can_be_ahead(before: lir.Body, operation: lir.Operation) -> bool:
    """Whether ``operation`` gives the same before any of the row's statements has run; ``before`` are those."""
    match operation:
        case lir.LoadVar() | lir.ThreadNumber():
            return False
        case lir.Load(slot, _):
            changed = (stmt for stmt in statements(before) if isinstance(stmt, lir.Store | lir.Accumulate))
            return all(_place(stmt) != slot for stmt in changed)
        case _:
            return True


def _place(stmt: lir.Store | lir.Accumulate) -> lir.Slot | lir.Var:
    return stmt.slot if isinstance(stmt, lir.Store) else stmt.var


class Emitter(Protocol):
    """What emits the loops."""

    w: FunctionWriter
    access_group: str | None
    temps: dict[int, str]

    def element(self, slot: lir.Slot, index: str) -> str:
        """The address of an element of a slot."""
        ...

    def load_var(self, var: lir.Var, index: str) -> str:
        """A component of a variable."""
        ...

    def declare(self, var: lir.Var) -> None:
        """Makes ``var``."""
        ...

    def count(self, counter: lir.Temp, start: str, stop: str, body: lir.Body, metadata: str = "") -> None:
        """A loop whose turns are counted, with ``metadata`` at its end."""
        ...

    def loop_notes(self, *notes: str) -> str:
        """The metadata that says so of a loop."""
        ...


_ONCE = '!"llvm.loop.unroll.disable"'
_ONE_BY_ONE = ('!"llvm.loop.vectorize.enable", i1 false', _ONCE)
"""Each loop is compiled in one form alone, of vectors or of single rows: more take long to compile."""

_FIRST, _LANE = lir.Temp(-1, int64), lir.Temp(-2, int64)


def emit_rare(e: Emitter, loop: lir.RowLoop, plan: RarePlan, bounds: tuple[str, str]) -> None:
    """The innermost loop of ``loop``, from one of ``bounds`` to the other."""
    w, (low, high), counter = e.w, bounds, loop.index[-1]
    w.module.is_vectors = True
    with w.loop(low, high, PART) as part:
        first = part.counter
        end = w.emit(f"add nsw i64 {first}, {PART}")
        last = w.emit(f"select i1 {w.emit(f'icmp slt i64 {end}, {high}')}, i64 {end}, i64 {high}")
        whole = w.emit(f"and i64 {w.emit(f'sub nsw i64 {last}, {first}')}, {-LANES}")
        rest = w.emit(f"add nsw i64 {first}, {whole}")
        e.declare(_HAPPENS)
        if plan.ahead:
            _emit_lanes(e, counter, (first, rest), plan.ahead)
            rest = w.emit(f"select i1 {e.load_var(_HAPPENS, '0')}, i64 {first}, i64 {rest}")
            _emit_lanes(e, counter, (first, rest), plan.smooth)
        else:
            rest = _try(e, plan, counter, (first, rest))
        e.count(counter, rest, last, loop.body, e.loop_notes(*_ONE_BY_ONE))


def _try(e: Emitter, plan: RarePlan, counter: lir.Temp, rows: tuple[str, str]) -> str:
    """Runs the rows from one of ``rows`` to the other, or none if something rare happens; the row behind them."""
    w, (first, rest) = e.w, rows
    w.declare("void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")
    moves: list[str] = []
    for slot, size in plan.kept:
        nbytes = slot.type.dtype.itemsize * size
        buffer = w.allocate(f"[{PART * nbytes} x i8], align 64")
        place = e.element(slot, w.emit(f"mul i64 {first}, {size}"))
        length = w.emit(f"mul i64 {w.emit(f'sub i64 {rest}, {first}')}, {nbytes}")
        w.do(f"call void @llvm.memcpy.p0.p0.i64(ptr {buffer}, ptr {place}, i64 {length}, i1 false)")
        moves.append(f"call void @llvm.memcpy.p0.p0.i64(ptr {place}, ptr {buffer}, i64 {length}, i1 false)")
    _emit_lanes(e, counter, rows, plan.smooth)
    again, on = w.fresh("again"), w.fresh("on")
    happens = e.load_var(_HAPPENS, "0")
    w.branch_if(happens, again, on)
    w.start(again)
    for move in moves:
        w.do(move)
    w.branch(on)
    w.start(on)
    return w.emit(f"select i1 {happens}, i64 {first}, i64 {rest}")


def _emit_lanes(e: Emitter, counter: lir.Temp, bounds: tuple[str, str], body: lir.Body) -> None:
    """A loop with ``body``, so many rows at once as there are lanes: their number is a multiple of that."""
    with e.w.loop(*bounds, LANES) as turn:
        e.temps[_FIRST.number] = turn.counter
        row = lir.Let(counter, lir.Binary("+", _FIRST, _LANE))
        parallel = f'!"llvm.loop.parallel_accesses", {e.access_group}'
        e.count(_LANE, "0", str(LANES), (row, *body), e.loop_notes(parallel, _ONCE))
