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
    return "\n".join(_body((stmt,), ""))


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


def _body(body: lir.Body, indent: str = _INDENT) -> list[str]:
    lines: list[str] = []
    _add(body, indent, lines)
    return lines


def _add(body: lir.Body, indent: str, lines: list[str]) -> None:
    """Appends the lines of ``body``."""
    for stmt in body:
        if isinstance(stmt, lir.Let):  # most are
            temp = stmt.temp
            lines.append(f"{indent}%{temp.number}: {temp.type!r} = {_operation(stmt.operation)}")
        else:
            _add_statement(stmt, indent, lines)


def _add_statement(stmt: lir.Stmt, indent: str, lines: list[str]) -> None:  # noqa: C901 - one case a kind of statement
    inner = indent + _INDENT
    match stmt:
        case lir.Let():
            _add((stmt,), indent, lines)
        case lir.Declare(var):
            shared = "group " if var.memory is lir.Memory.GROUP else ""
            lines.append(f"{indent}{shared}var {_var(var)}: {var.type!r}[{var.size}]")
        case lir.StoreVar(var, index, stored):
            lines.append(f"{indent}{_var(var)}[{value(index)}] = {value(stored)}")
        case lir.Store(slot, index, stored):
            lines.append(f"{indent}s{slot.number}[{value(index)}] = {value(stored)}")
        case lir.AtomicUpdate(slot, index, op, added):
            lines.append(f"{indent}atomic s{slot.number}[{value(index)}] {op} {value(added)}")
        case lir.Accumulate(var, index, op, added):
            lines.append(f"{indent}accumulate {_var(var)}[{value(index)}] {op} {value(added)}")
        case lir.If(condition, then, orelse):
            lines.append(f"{indent}if {value(condition)}:")
            _add(then, inner, lines)
            if orelse:
                lines.append(f"{indent}else:")
                _add(orelse, inner, lines)
        case lir.For(counter, start, stop, body, turns):
            order = ", in any order" if turns is lir.Turns.ANY_ORDER else ""
            lines.append(f"{indent}for {_temp(counter)}: {counter.type!r} in {value(start)} .. {value(stop)}{order}:")
            _add(body, inner, lines)
        case lir.While(head, condition, body):
            lines.append(f"{indent}while:")
            _add(head, inner, lines)
            lines.append(f"{indent}holds {value(condition)}:")
            _add(body, inner, lines)
        case lir.Block(label, body):
            lines.append(f"{indent}block {_label(label)}:")
            _add(body, inner, lines)
        case lir.Leave(label):
            lines.append(f"{indent}leave {_label(label)}")
        case lir.RowLoop() | lir.Barrier() | lir.Fail() | lir.Print():
            _add_row_statement(stmt, indent, lines)


def _add_row_statement(
    stmt: lir.RowLoop | lir.Barrier | lir.Fail | lir.Print, indent: str, lines: list[str]
) -> None:  # fmt: skip
    inner = indent + _INDENT
    match stmt:
        case lir.RowLoop(index, rows, body, inside, streaming):
            lines.append(f"{indent}rows {_values(index)}, {rows.value}:")
            _add(body, inner, lines)
            if inside is not None:
                before, after = inside.ends
                lines.append(f"{indent}inside, from {before} to {after} before a{inside.length.number}:")
                _add(inside.body, inner, lines)
            if streaming is not None:
                lines += [f"{indent}streams {_place(place)}" for place in streaming.written]
                lines += [f"{indent}ahead {_place(place)}" for place in streaming.ahead]
        case lir.Barrier():
            lines.append(f"{indent}barrier")
        case lir.Fail(site, position, payload):
            lines.append(f"{indent}fail {site} at {value(position)} ({_values(payload)})")
        case lir.Print(number, slot, position, values):
            lines.append(f"{indent}print {number} into s{slot.number} at {value(position)} ({_values(values)})")


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
    if isinstance(operand, lir.Temp):
        return f"%{operand.number}"
    if operand.type == int64:
        return repr(operand.value)
    return f"{operand.value!r}:{operand.type!r}"


def _values(values: Iterable[lir.Value]) -> str:
    return ", ".join([value(operand) for operand in values])


def _temp(temp: lir.Temp) -> str:
    return f"%{temp.number}"


def _var(var: lir.Var) -> str:
    return f"{var.name}.{var.number}"


def _label(label: lir.Label) -> str:
    return f"{label.name}.{label.number}"
