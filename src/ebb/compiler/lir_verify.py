"""Checks that an LIR program is well formed. A complaint is a fault of the compiler, never of the user."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

from ebb.compiler import lir, lir_print
from ebb.compiler.kir_verify import CompilerBug
from ebb.types.types import Kind, ScalarType, bool_, int64


class MalformedLir(CompilerBug):
    """A program that the compiler must not have made."""


def verify(program: lir.Program) -> None:
    """Checks scopes, types and operators of ``program``.

    Raises:
        MalformedLir: with the statement that is wrong.
    """
    loops = [stmt for stmt in program.block if isinstance(stmt, lir.RowLoop)]
    if len(loops) != 1:
        raise MalformedLir(f"a block has one loop over rows, not {len(loops)}")
    if program.group_size is not None:
        _verify_groups(program, program.group_size, loops[0])
    for body, row_loops in ((program.block, True), (program.finish, False)):
        checker = _Checker(program, row_loops)
        checker.temps.add(program.block_number.number)
        checker.body(body)


def _verify_groups(program: lir.Program, size: int, loop: lir.RowLoop) -> None:
    strided = program.coverage is lir.Coverage.STRIDED
    if not 1 <= size <= lir.MOST_THREADS:
        raise MalformedLir(f"a group has 1 to {lir.MOST_THREADS} threads, not {size}")
    if loop.rows is lir.Rows.IN_ORDER and not (size == 1 and strided):
        raise MalformedLir("rows in order are strided over groups of one thread")
    if program.finish and not strided:
        raise MalformedLir("there is a partial result a group, but as many groups as the rows need")


class _Checker:
    """What is in scope at the statement at hand."""

    def __init__(self, program: lir.Program, row_loops: bool) -> None:
        self.program = program
        self.row_loops = row_loops
        self.slots = {id(slot) for slot in program.slots}
        self.arguments = {id(argument) for argument in program.arguments}
        self.temps: set[int] = set()
        self.defined: set[int] = set()
        self.vars: set[int] = set()
        self.labels: set[int] = set()
        self.depth = 0
        self.in_row = False

    @contextmanager
    def scope(self) -> Generator[None, None, None]:
        temps, vars_, labels = set(self.temps), set(self.vars), set(self.labels)
        self.depth += 1
        yield
        self.depth -= 1
        self.temps, self.vars, self.labels = temps, vars_, labels

    def body(self, body: lir.Body) -> None:
        with self.scope():
            for stmt in body:
                try:
                    self.statement(stmt)
                except MalformedLir as error:
                    if error.args[1:]:
                        raise
                    raise MalformedLir(error.args[0], lir_print.statement(stmt)) from None

    def statement(self, stmt: lir.Stmt) -> None:  # noqa: C901 - one case a kind of statement
        match stmt:
            case lir.Let(temp, operation):
                self.operation(operation, temp.type)
                self.define(temp)
            case lir.Declare(var):
                self.demand(var.memory is lir.Memory.PRIVATE or self.together(), "declares a variable of a group here")
                self.vars.add(var.number)
            case lir.StoreVar(var, index, value):
                self.var(var, index)
                self.typed(value, var.type)
            case lir.Accumulate(var, index, _, value):
                self.demand(var.memory is lir.Memory.PRIVATE, "accumulates where other threads do")
                self.var(var, index)
                self.typed(value, var.type)
            case lir.Store(slot, index, value) | lir.AtomicUpdate(slot, index, _, value):
                self.slot(slot, index, lir.Access.WRITE)
                self.typed(value, slot.type)
            case lir.If(condition, then, orelse):
                self.typed(condition, bool_)
                self.body(then)
                self.body(orelse)
            case lir.For(counter, start, stop, body, _):
                self.typed(start, counter.type)
                self.typed(stop, counter.type)
                self.loop((counter,), body)
            case lir.While():
                self.while_loop(stmt)
            case lir.Block(label, body):
                with self.scope():
                    self.labels.add(label.number)
                    self.body(body)
            case lir.Leave(label):
                self.demand(label.number in self.labels, f"leaves {label.name}, which it is not in")
            case lir.RowLoop():
                self.row_loop(stmt)
            case lir.Barrier():
                self.demand(self.together(), "waits where not all threads of a group get")
            case lir.Fail() | lir.Print():
                self.report(stmt)

    def report(self, stmt: lir.Fail | lir.Print) -> None:
        match stmt:
            case lir.Fail(site, position, payload):
                self.demand(0 <= site < len(self.program.sites), f"fails at site {site}, which there is not")
                self.demand(len(payload) <= lir.PAYLOAD_WORDS, "has too long a payload")
                for value in (position, *payload):
                    self.typed(value, int64)
            case lir.Print(number, slot, position, values):
                self.demand(0 <= number < len(self.program.prints), f"is print {number}, which there is not")
                self.demand(len(values) <= self.program.print_words, "prints more words than a record has")
                self.slot(slot, position, lir.Access.WRITE)
                for value in values:
                    self.read(value)

    def loop(self, index: tuple[lir.Temp, ...], body: lir.Body) -> None:
        with self.scope():
            for temp in index:
                self.define(temp)
            self.body(body)

    def row_loop(self, stmt: lir.RowLoop) -> None:
        self.demand(self.row_loops, "loops over rows outside of a block")
        self.demand(len(stmt.index) == self.program.dimensions, "has not one index a dimension")
        self.in_row = True
        self.loop(stmt.index, stmt.body)
        if stmt.inside is not None:
            self.demand(self.program.space is lir.Space.BOX, "has lines without boxes")
            self.demand(id(stmt.inside.length) in self.arguments, "has an argument that the program has not")
            self.inside(stmt.index, stmt.inside.body)
        if stmt.streaming is not None:
            self.demand(stmt.rows is lir.Rows.INDEPENDENT, "streams rows in order")
            self.streaming(stmt.streaming)
        self.in_row = False

    def inside(self, index: tuple[lir.Temp, ...], body: lir.Body) -> None:
        """The other body of the same rows."""
        with self.scope():
            self.temps |= {temp.number for temp in index}
            self.body(body)

    def streaming(self, streaming: lir.Streaming) -> None:
        for place in (*streaming.written, *streaming.ahead):
            known = isinstance(place.row, lir.Literal) or place.row.number in self.defined
            self.demand(known, "streams by what is not there")
        written = all(place.slot.access is lir.Access.WRITE for place in streaming.written)
        self.demand(written, "streams what it only reads")

    def while_loop(self, stmt: lir.While) -> None:
        with self.scope():
            for head in stmt.head:
                self.statement(head)
            self.typed(stmt.condition, bool_)
            self.body(stmt.body)

    def operation(self, operation: lir.Operation, result: ScalarType) -> None:
        match operation:
            case lir.Unary(op, operand):
                self.demand(op in ("-", "~", "not"), f"has no operator {op}")
                self.typed(operand, result)
            case lir.Binary(op, left, right):
                self.demand(_takes(op, result), f"has no operator {op} on {result!r}")
                self.typed(left, result)
                self.typed(right, result)
            case lir.Compare(op, left, right):
                self.demand(op in ("==", "!=", "<", "<=", ">", ">=") and result == bool_, f"compares by {op}")
                self.typed(right, left.type)
                self.read(left)
            case lir.Select(condition, then, other):
                self.typed(condition, bool_)
                self.typed(then, result)
                self.typed(other, result)
            case lir.Convert(operand):
                self.read(operand)
            case lir.Math(function, operands):
                self.demand(lir.MATH.get(function) == len(operands), f"has no function {function}")
                for operand in operands:
                    self.typed(operand, result)
            case _:
                self.reading(operation, result)

    def reading(
        self, operation: lir.Load | lir.LoadVar | lir.LoadArgument | lir.ThreadNumber, result: ScalarType
    ) -> None:
        match operation:
            case lir.Load(slot, index):
                self.slot(slot, index, lir.Access.READ)
                self.demand(slot.type == result, "loads another type than the slot has")
            case lir.LoadVar(var, index):
                self.var(var, index)
                self.demand(var.type == result, "loads another type than the variable has")
            case lir.LoadArgument(argument):
                self.demand(id(argument) in self.arguments, "loads an argument that the program has not")
                self.demand(argument.type == result, "loads another type than the argument has")
            case lir.ThreadNumber():
                self.demand(self.program.group_size is not None, "asks for a thread's number where there are no groups")
                self.demand(result == int64, "has a thread's number that is no int64")

    def define(self, temp: lir.Temp) -> None:
        self.demand(temp.number not in self.defined, f"defines %{temp.number} again")
        self.defined.add(temp.number)
        self.temps.add(temp.number)

    def read(self, value: lir.Value) -> None:
        if isinstance(value, lir.Temp):
            self.demand(value.number in self.temps, f"reads %{value.number}, which is not in scope")

    def typed(self, value: lir.Value, expected: ScalarType) -> None:
        self.read(value)
        self.demand(value.type == expected, f"has {value.type!r} where {expected!r} belongs")

    def var(self, var: lir.Var, index: lir.Value) -> None:
        self.demand(var.number in self.vars, f"uses {var.name}.{var.number}, which is not in scope")
        self.demand(not (self.in_row and var.memory is lir.Memory.GROUP), f"uses {var.name} of the group in a row")
        self.typed(index, int64)
        if isinstance(index, lir.Literal):
            self.demand(0 <= index.value < var.size, f"uses component {index.value} of {var.size}")

    def slot(self, slot: lir.Slot, index: lir.Value, access: lir.Access) -> None:
        self.demand(id(slot) in self.slots, f"uses slot {slot.number}, which the program has not")
        self.demand(access is lir.Access.READ or slot.access is access, f"writes the read-only slot {slot.number}")
        self.typed(index, int64)

    def together(self) -> bool:
        """Whether all threads of a group get here."""
        return self.program.group_size is not None and self.depth == 1

    @staticmethod
    def demand(holds: bool, text: str) -> None:
        if not holds:
            raise MalformedLir(text)


def _takes(op: str, scalar: ScalarType) -> bool:
    match scalar.kind:
        case Kind.BOOL:
            return op in ("&", "|", "^")
        case Kind.FLOAT:
            return op in ("+", "-", "*", "/", "//", "%", "min", "max")
        case _:
            return op in ("+", "-", "*", "//", "%", "min", "max", "&", "|", "^", "<<", ">>")
