"""The text of LIR: for ``kernel.inspect``, for golden tests, and as the key of the disk cache.

The text is the program, but for spans: two programs of one text compile to the same code.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from ebb.compiler import lir
from ebb.types.types import int64

_INDENT = "  "


def text(program: lir.Program) -> str:
    """``program`` as text, one statement a line."""
    return "\n".join(_program(program)) + "\n"


def statement(stmt: lir.Stmt) -> str:
    """One statement as text, with the bodies inside it."""
    return "\n".join(_statement(stmt))


def _program(program: lir.Program) -> Iterator[str]:
    space = program.space.value if program.space is lir.Space.LINE else f"box {program.dimensions}"
    yield f"program {program.name} over {space}, floats {program.precision.value}"
    if program.group_size is not None:
        yield f"{_INDENT}groups of {program.group_size}, {program.coverage.value}"
    for slot in program.slots:
        yield f"{_INDENT}slot s{slot.number}: {slot.type!r} {slot.access.value}  # {_binding(slot.binding)}"
    for argument in program.arguments:
        yield f"{_INDENT}argument a{argument.number}: {argument.type!r}  # {_binding(argument.binding)}"
    if program.prints:
        yield f"{_INDENT}print words {program.print_words}"
    yield f"block {_temp(program.block_number)}:"
    yield from _body(program.block)
    if program.finish:
        yield "finish:"
        yield from _body(program.finish)


def _binding(binding: lir.SlotBinding | lir.ArgumentBinding) -> str:  # noqa: C901 - one case a kind of binding
    match binding:
        case lir.FieldData(field):
            return f"{field.relation.name}.{field.name}"
        case lir.GroupOffsets(index):
            return f"offsets of {index.relation.name}.{index.name}"
        case lir.GroupRows(index):
            return f"rows by {index.relation.name}.{index.name}"
        case lir.RowOrder(relation):
            return f"identities of {relation.name}"
        case lir.GlobalData():
            return "global"
        case lir.Partials(reduction, _):
            return f"partials of reduction {reduction}"
        case lir.LaunchPositions():
            return "positions of the launch"
        case lir.PrintRecords():
            return "print records"
        case lir.UniformComponent(uniform, component):
            return f"uniform {uniform}[{component}]"
        case lir.Extent(relation, dimension):
            return f"{relation.name}.shape[{dimension}]"
        case lir.ColumnStride(relation, itemsize):
            return f"columns of {relation.name}, {itemsize} bytes an element"
        case lir.BlockCount():
            return "blocks of the launch"
        case lir.RandomWord():
            return f"random {binding.value}"


def _body(body: lir.Body) -> Iterator[str]:
    for stmt in body:
        for line in _statement(stmt):
            yield _INDENT + line


def _statement(stmt: lir.Stmt) -> Iterator[str]:  # noqa: C901 - one case a kind of statement
    match stmt:
        case lir.Let(temp, operation):
            yield f"{_temp(temp)}: {temp.type!r} = {_operation(operation)}"
        case lir.Declare(var):
            shared = "group " if var.memory is lir.Memory.GROUP else ""
            yield f"{shared}var {_var(var)}: {var.type!r}[{var.size}]"
        case lir.StoreVar(var, index, stored):
            yield f"{_var(var)}[{value(index)}] = {value(stored)}"
        case lir.Store(slot, index, stored):
            yield f"s{slot.number}[{value(index)}] = {value(stored)}"
        case lir.AtomicUpdate(slot, index, op, added):
            yield f"atomic s{slot.number}[{value(index)}] {op} {value(added)}"
        case lir.Accumulate(var, index, op, added):
            yield f"accumulate {_var(var)}[{value(index)}] {op} {value(added)}"
        case lir.If(condition, then, orelse):
            yield f"if {value(condition)}:"
            yield from _body(then)
            if orelse:
                yield "else:"
                yield from _body(orelse)
        case lir.For(counter, start, stop, body, turns):
            order = ", in any order" if turns is lir.Turns.ANY_ORDER else ""
            yield f"for {_temp(counter)}: {counter.type!r} in {value(start)} .. {value(stop)}{order}:"
            yield from _body(body)
        case lir.While(head, condition, body):
            yield "while:"
            yield from _body(head)
            yield f"holds {value(condition)}:"
            yield from _body(body)
        case lir.Block(label, body):
            yield f"block {_label(label)}:"
            yield from _body(body)
        case lir.Leave(label):
            yield f"leave {_label(label)}"
        case lir.RowLoop() | lir.Barrier() | lir.Fail() | lir.Print():
            yield from _row_statement(stmt)


def _row_statement(stmt: lir.RowLoop | lir.Barrier | lir.Fail | lir.Print) -> Iterator[str]:
    match stmt:
        case lir.RowLoop(index, rows, body, inside, streaming):
            yield f"rows {_values(index)}, {rows.value}:"
            yield from _body(body)
            if inside is not None:
                before, after = inside.ends
                yield f"inside, from {before} to {after} before a{inside.length.number}:"
                yield from _body(inside.body)
            if streaming is not None:
                yield from (f"streams {_place(place)}" for place in streaming.written)
                yield from (f"ahead {_place(place)}" for place in streaming.ahead)
        case lir.Barrier():
            yield "barrier"
        case lir.Fail(site, position, payload):
            yield f"fail {site} at {value(position)} ({_values(payload)})"
        case lir.Print(number, slot, position, values):
            yield f"print {number} into s{slot.number} at {value(position)} ({_values(values)})"


def _place(place: lir.RowPlace) -> str:
    return f"s{place.slot.number}, row {value(place.row)} of {place.size}"


def _operation(operation: lir.Operation) -> str:
    match operation:
        case lir.Unary(op, operand):
            return f"{op} {value(operand)}"
        case lir.Binary(op, left, right) | lir.Compare(op, left, right):
            return f"{value(left)} {op} {value(right)}"
        case lir.Select(condition, then, other):
            return f"select {value(condition)} ? {value(then)} : {value(other)}"
        case lir.Convert(operand):
            return f"convert {value(operand)}"
        case lir.Math(function, operands):
            return f"{function}({_values(operands)})"
        case lir.Load(slot, index):
            return f"s{slot.number}[{value(index)}]"
        case lir.LoadVar(var, index):
            return f"{_var(var)}[{value(index)}]"
        case lir.LoadArgument(argument):
            return f"a{argument.number}"
        case lir.ThreadNumber():
            return "thread"


def value(operand: lir.Value) -> str:
    """A temporary by its number, a literal with its type unless that is int64, as indices are."""
    match operand:
        case lir.Temp():
            return _temp(operand)
        case lir.Literal(literal, scalar) if scalar == int64:
            return repr(literal)
        case lir.Literal(literal, scalar):
            return f"{literal!r}:{scalar!r}"


def _values(values: Iterable[lir.Value]) -> str:
    return ", ".join(value(operand) for operand in values)


def _temp(temp: lir.Temp) -> str:
    return f"%{temp.number}"


def _var(var: lir.Var) -> str:
    return f"{var.name}.{var.number}"


def _label(label: lir.Label) -> str:
    return f"{label.name}.{label.number}"
