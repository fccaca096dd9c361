"""KIR statements to LIR."""

from __future__ import annotations

from collections.abc import Iterator

from ebb.compiler import kir, lir
from ebb.compiler.kir_walk import bodies
from ebb.compiler.lower.builder import Values, number
from ebb.compiler.lower.context import Context, memory_scalar, value_scalar
from ebb.compiler.lower.expressions import group, lower_expr, lower_indices, lower_scalar
from ebb.compiler.lower.keys import Place, part, place
from ebb.compiler.lower.sites import AssertSite, StepSite
from ebb.compiler.phases.table import PhaseKind
from ebb.types.types import int64, uint64


def lower_body(ctx: Context, body: kir.Body) -> None:
    """Appends ``body`` to the open body."""
    for stmt in body:
        lower_stmt(ctx, stmt)


def _nested(ctx: Context, body: kir.Body) -> lir.Body:
    with ctx.build.body() as stmts:
        lower_body(ctx, body)
    return tuple(stmts)


def lower_stmt(ctx: Context, stmt: kir.Stmt) -> None:  # noqa: C901 - one case a kind of statement
    """Appends ``stmt`` to the open body."""
    b = ctx.build
    match stmt:
        case kir.Assign():
            _assign(ctx, stmt)
        case kir.WriteField(field=field, value=value):
            at, size = _field_place(ctx, stmt)
            stored = [b.convert(v, memory_scalar(field.type.scalar)) for v in lower_expr(ctx, value)]
            slot = ctx.slot(lir.FieldData(field))
            for k in range(size):
                b.add(lir.Store(slot, at.component(ctx, k), stored[k]))
        case kir.ReduceField():
            _reduce_field(ctx, stmt)
        case kir.ReduceGlobal(globl, indices, op, value):
            start, size = part(ctx, indices, lower_indices(ctx, indices), globl.type)
            for k, added in enumerate(lower_expr(ctx, value)):
                b.add(lir.Accumulate(ctx.accumulators[globl], b.add_index(start, k), op.value, added))
        case kir.If(condition, then, orelse):
            decided = lower_scalar(ctx, condition)
            b.add(lir.If(decided, _nested(ctx, then), _nested(ctx, orelse)))
        case kir.ForRange():
            _for_range(ctx, stmt)
        case kir.ForQuery():
            _for_query(ctx, stmt)
        case kir.While(condition, body):
            _while(ctx, condition, body)
        case kir.Break():
            b.add(lir.Leave(ctx.loops[-1][0]))
        case kir.Continue():
            b.add(lir.Leave(ctx.loops[-1][1]))
        case kir.Block(label, body):
            ctx.labels[label.uid] = b.label(label.name)
            b.add(lir.Block(ctx.labels[label.uid], _nested(ctx, body)))
        case kir.Leave(label):
            b.add(lir.Leave(ctx.labels[label.uid]))
        case kir.Assert(condition):
            ctx.fail_unless(lower_scalar(ctx, condition), AssertSite(stmt))
        case kir.Print():
            _print(ctx, stmt)
        case kir.Breakpoint():
            pass


def bind(ctx: Context, local: kir.Local, values: Values) -> None:
    """Gives ``local`` its value, as a variable or as the values themselves."""
    if local.uid in ctx.variables:
        ctx.build.store_all(ctx.variables[local.uid], values)
    else:
        ctx.values[local.uid] = values


def _assign(ctx: Context, stmt: kir.Assign) -> None:
    if not stmt.indices:
        bind(ctx, stmt.local, lower_expr(ctx, stmt.value))
        return
    var = ctx.variables[stmt.local.uid]
    values = lower_expr(ctx, stmt.value)
    start, _ = part(ctx, stmt.indices, lower_indices(ctx, stmt.indices), stmt.local.type)
    for k, value in enumerate(values):
        ctx.build.store_var(var, ctx.build.add_index(start, k), value)


def _field_place(ctx: Context, stmt: kir.WriteField | kir.ReduceField) -> tuple[Place, int]:
    """What ``stmt`` changes of the field's slot, and the number of components."""
    position = lower_scalar(ctx, stmt.key)
    start, size = part(ctx, stmt.indices, lower_indices(ctx, stmt.indices), stmt.field.type)
    return place(ctx, stmt.field, position, start), size


def _reduce_field(ctx: Context, stmt: kir.ReduceField) -> None:
    b = ctx.build
    changed, size = _field_place(ctx, stmt)
    values = lower_expr(ctx, stmt.value)
    slot = ctx.slot(lir.FieldData(stmt.field))
    atomic = ctx.updates is lir.Updates.ATOMIC and ctx.phases.fields[stmt.field].kind is PhaseKind.REDUCE
    for k in range(size):
        at = changed.component(ctx, k)
        if atomic:
            b.add(lir.AtomicUpdate(slot, at, stmt.op.value, values[k]))
        else:
            b.add(lir.Store(slot, at, b.binary(stmt.op.value, b.load(slot, at), values[k])))


# ---- Loops ----


def _own(body: kir.Body) -> Iterator[kir.Stmt]:
    """The statements of a loop's body that are in no loop inside it."""
    for stmt in body:
        yield stmt
        if not isinstance(stmt, kir.ForRange | kir.ForQuery | kir.While):
            for inner in bodies(stmt):
                yield from _own(inner)


def _loop_body(ctx: Context, body: kir.Body) -> lir.Body:
    """The body of a loop, in a block that ``continue`` leaves. The label of ``break`` is on top of ``ctx.loops``."""
    inner = _nested(ctx, body)
    if any(isinstance(stmt, kir.Continue) for stmt in _own(body)):
        return (lir.Block(ctx.loops[-1][1], inner),)
    return inner


def _add_loop(ctx: Context, body: kir.Body, loop: lir.Stmt) -> None:
    """Appends a loop, in a block that ``break`` leaves, and closes its labels."""
    label, _ = ctx.loops.pop()
    broken = any(isinstance(stmt, kir.Break) for stmt in _own(body))
    ctx.build.add(lir.Block(label, (loop,)) if broken else loop)


def _open_loop(ctx: Context) -> None:
    ctx.loops.append((ctx.build.label("break"), ctx.build.label("continue")))


def _counted(
    ctx: Context, loop: kir.ForRange | kir.ForQuery, counter: lir.Temp, bounds: tuple[lir.Value, lir.Value],
    start: list[lir.Stmt], value: lir.Value,
) -> None:  # fmt: skip
    """``loop``, each turn of which first runs ``start``, which computes ``value``, the value of its local."""
    _open_loop(ctx)
    with ctx.build.body() as turn:
        ctx.build.extend(start)
        bind(ctx, loop.local, (value,))
        ctx.build.extend(_loop_body(ctx, loop.body))
    turns = lir.Turns.ANY_ORDER if isinstance(loop, kir.ForQuery) else lir.Turns.IN_ORDER
    _add_loop(ctx, loop.body, lir.For(counter, *bounds, tuple(turn), turns))


def _for_range(ctx: Context, stmt: kir.ForRange) -> None:
    b = ctx.build
    scalar = value_scalar(stmt.local.type.scalar)
    start, stop, step = (lower_scalar(ctx, bound) for bound in (stmt.start, stmt.stop, stmt.step))
    if isinstance(step, lir.Literal) and step.value == 1:
        if isinstance(start, lir.Literal) and isinstance(stop, lir.Literal) and stmt.local.uid not in ctx.variables:
            ctx.ranges[stmt.local.uid] = (start.value, stop.value - 1)
        counter = b.temp(scalar)
        _counted(ctx, stmt, counter, (start, stop), [], counter)
        return
    if not isinstance(step, lir.Literal) or step.value == 0:
        ctx.fail_if(b.compare("==", step, number(0, scalar)), StepSite(stmt))
    count = _turns(ctx, start, stop, step)
    counter = b.temp(uint64)
    with b.body() as head:
        value = b.binary("+", start, b.binary("*", b.convert(counter, scalar), step))
    _counted(ctx, stmt, counter, (lir.Literal(0, uint64), count), head, value)


def _turns(ctx: Context, start: lir.Value, stop: lir.Value, step: lir.Value) -> lir.Value:
    """``len(range(start, stop, step))`` as uint64: the distance, less one, by the size of the step, and one more."""
    b = ctx.build
    one, none = lir.Literal(1, uint64), lir.Literal(0, uint64)
    low, high, stride = (b.convert(value, uint64) for value in (start, stop, step))
    up = b.compare(">", step, number(0, step.type))
    ahead = b.compare("<", start, stop)
    behind = b.compare("<", stop, start)
    some = b.select(up, ahead, behind)
    distance = b.select(up, b.binary("-", high, low), b.binary("-", low, high))
    size = b.select(up, stride, b.binary("-", none, stride))
    turns = b.binary("+", b.binary("//", b.binary("-", distance, one), size), one)
    return b.select(some, turns, none)


def _for_query(ctx: Context, stmt: kir.ForQuery) -> None:
    b = ctx.build
    bounds = group(ctx, stmt.index, lower_scalar(ctx, stmt.key))
    counter = b.temp(int64)
    value: lir.Value = counter
    with b.body() as head:
        if stmt.index in ctx.facts.indirect:
            value = b.convert(b.load(ctx.slot(lir.GroupRows(stmt.index)), counter), int64)
    _counted(ctx, stmt, counter, bounds, head, value)


def _while(ctx: Context, condition: kir.Expr, body: kir.Body) -> None:
    _open_loop(ctx)
    with ctx.build.body() as head:
        holds = lower_scalar(ctx, condition)
    inner = _loop_body(ctx, body)
    _add_loop(ctx, body, lir.While(tuple(head), holds, inner))


# ---- Prints ----


def _print(ctx: Context, stmt: kir.Print) -> None:
    assert ctx.row is not None
    values = [value for part_ in stmt.parts if not isinstance(part_, str) for value in lower_expr(ctx, part_[0])]
    ctx.prints.append(stmt)
    ctx.print_words = max(ctx.print_words, len(values))
    slot = ctx.slot(lir.PrintRecords())
    ctx.build.add(lir.Print(len(ctx.prints) - 1, slot, ctx.row, tuple(values)))
