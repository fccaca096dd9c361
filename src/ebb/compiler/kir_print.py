"""KIR as text, for snapshots, dumps and ``kernel.inspect``: near the Python it came from, every conversion in sight.

    kernel apply_forces(v: vertices)
      uniform $0: float32 = dt
      qdd: vector(float32, 3) = vertices.force[v] / vector(float32, 3)(vertices.mass[v])
      vertices.qd[v] += qdd * vector(float32, 3)($0)

A field's value in a row is ``relation.field[key]``. A variable has its ``uid`` behind its name only where two share
the name. Constants carry a suffix unless they are bool, int32 or float64.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

from ebb.compiler import kir
from ebb.compiler.host import describe
from ebb.compiler.kir_walk import expressions, statements
from ebb.records import field, record
from ebb.relations.globals import Global
from ebb.types.types import KeyType, Type

_SUFFIXES: Mapping[str, str] = {"int64": "i64", "uint32": "u32", "uint64": "u64", "float32": "f32"}
_INDENT = "  "


def text(kernel: kir.Kernel) -> str:
    """The text of ``kernel``: the same for equal kernels, in every run."""
    printer = _Printer(_local_names(kernel), _label_names(kernel), _global_names(kernel), {kernel.row.uid})
    lines = [f"kernel {kernel.name}({printer.local(kernel.row)}: {kernel.relation.name})"]
    lines += [
        f"{_INDENT}uniform ${index}: {uniform.type!r} = {describe(uniform.expr)}"
        for index, uniform in enumerate(kernel.uniforms)
    ]
    lines += printer.body(kernel.body)
    return "\n".join(lines)


@record
class _Printer:
    """The names of one kernel. ``declared`` holds the variables that the text so far has given a type."""

    locals: Mapping[int, str]
    labels: Mapping[int, str]
    globals: Mapping[Global, str]
    declared: set[int] = field(default_factory=set[int])

    def local(self, local: kir.Local) -> str:
        return self.locals[local.uid]

    def declaration(self, local: kir.Local) -> str:
        """The name, with the type where it stands for the first time."""
        if local.uid in self.declared:
            return self.local(local)
        self.declared.add(local.uid)
        return f"{self.local(local)}: {_type(local.type)}"

    # ---- Statements ----

    def body(self, body: kir.Body) -> Iterator[str]:
        """The lines of ``body``, indented by one step."""
        if not body:
            yield f"{_INDENT}pass"
        for stmt in body:
            for line in self.statement(stmt):
                yield _INDENT + line

    def statement(self, stmt: kir.Stmt) -> Iterator[str]:  # noqa: C901 - one case a kind of node
        """The lines of ``stmt``."""
        match stmt:
            case kir.If() | kir.ForRange() | kir.ForQuery() | kir.While() | kir.Block():
                yield from self.compound(stmt)
            case kir.Assign(local, indices, value):
                name = self.declaration(local) if not indices else self.local(local)
                yield f"{name}{self.indices(indices)} = {self.top(value)}"
            case kir.WriteField(target, key, indices, value):
                yield f"{target.path}[{self.top(key)}]{self.indices(indices)} = {self.top(value)}"
            case kir.ReduceField(target, key, indices, op, value):
                place = f"{target.path}[{self.top(key)}]{self.indices(indices)}"
                yield f"{place} {op.value}= {self.top(value)}"
            case kir.ReduceGlobal(globl, indices, op, value):
                yield f"{self.globals[globl]}{self.indices(indices)} {op.value}= {self.top(value)}"
            case kir.Break():
                yield "break"
            case kir.Continue():
                yield "continue"
            case kir.Leave(label):
                yield f"leave {self.labels[label.uid]}"
            case kir.Assert(condition, said):
                yield f"assert {self.top(condition)}" + (f", {said!r}" if said else "")
            case kir.Print(parts):
                yield f"print({', '.join(map(self.part, parts))})"
            case kir.Breakpoint():
                yield "breakpoint()"

    def compound(self, stmt: kir.If | kir.ForRange | kir.ForQuery | kir.While | kir.Block) -> Iterator[str]:
        """The lines of a statement with bodies."""
        match stmt:
            case kir.If(condition, then, orelse):
                yield f"if {self.top(condition)}:"
                yield from self.body(then)
                if orelse:
                    yield "else:"
                    yield from self.body(orelse)
            case kir.ForRange(local, start, stop, step, body):
                bounds = ", ".join(map(self.top, (start, stop, step)))
                yield f"for {self.declaration(local)} in range({bounds}):"
                yield from self.body(body)
            case kir.ForQuery(local, index, key, body):
                yield f"for {self.declaration(local)} in where({index.path}, {self.top(key)}):"
                yield from self.body(body)
            case kir.While(condition, body):
                yield f"while {self.top(condition)}:"
                yield from self.body(body)
            case kir.Block(label, body):
                yield f"block {self.labels[label.uid]}:"
                yield from self.body(body)

    def part(self, part: str | tuple[kir.Expr, str]) -> str:
        """A part of a ``print``."""
        if isinstance(part, str):
            return repr(part)
        value, spec = part
        return f"{self.top(value)}:{spec}" if spec else self.top(value)

    def indices(self, indices: tuple[kir.Expr, ...]) -> str:
        return f"[{', '.join(map(self.top, indices))}]" if indices else ""

    # ---- Expressions ----

    def top(self, expr: kir.Expr) -> str:
        """``expr`` where nothing stands beside it: without parentheses around it."""
        shown = self.expr(expr)
        bare = isinstance(expr, kir.Binary | kir.Compare | kir.Logic | kir.Choose | kir.Unary)
        return shown[1:-1] if bare and shown.startswith("(") else shown

    def expr(self, expr: kir.Expr) -> str:  # noqa: C901 - one case a kind of node
        """``expr`` as an operand."""
        match expr:
            case kir.Const(value, type):
                return f"{_constant(value)}{_SUFFIXES.get(repr(type.scalar), '')}"
            case kir.Uniform(index):
                return f"${index}"
            case kir.ReadLocal(local):
                return self.local(local)
            case kir.ReadGlobal(globl):
                return self.globals[globl]
            case kir.ReadField(source, key):
                return f"{source.path}[{self.top(key)}]"
            case kir.Unary(op, operand):
                return f"({op}{' ' if op == 'not' else ''}{self.expr(operand)})"
            case kir.Binary("min" | "max" as op, left, right):
                return f"{op}({self.top(left)}, {self.top(right)})"
            case kir.Binary(op, left, right) | kir.Compare(op, left, right) | kir.Logic(op, left, right):
                return f"({self.expr(left)} {op} {self.expr(right)})"
            case kir.Choose(condition, then, other):
                return f"({self.expr(then)} if {self.expr(condition)} else {self.expr(other)})"
            case kir.Cast(operand, type) | kir.Splat(operand, type):
                return f"{type!r}({self.top(operand)})"
            case kir.Build(elements, type):
                return _nested([self.top(element) for element in elements], type)
            case kir.Component(operand, indices):
                return f"{self.expr(operand)}{self.indices(indices)}"
            case kir.Call(builtin, arguments):
                return f"{builtin}({', '.join(map(self.top, arguments))})"
            case kir.Random(distribution, type):
                return f"{distribution}({type!r})"
            case kir.Affine(matrix, key, edge, type):
                rows = ", ".join(f"[{', '.join(map(str, row))}]" for row in matrix)
                clamp = ", clamp" if edge is kir.Edge.CLAMP else ""
                return f"affine({_type(type)}, [{rows}], {self.top(key)}{clamp})"
            case kir.RowAt(coordinates, edge, type):
                clamp = ", clamp" if edge is kir.Edge.CLAMP else ""
                return f"row_at({_type(type)}, {self.top(coordinates)}{clamp})"
            case kir.RowId(key):
                return f"id({self.top(key)})"
            case kir.Coords(key):
                return f"coords({self.top(key)})"
            case kir.QuerySize(index, key):
                return f"len(where({index.path}, {self.top(key)}))"


def _type(type: Type) -> str:
    return type.target.name if isinstance(type, KeyType) else repr(type)


def _constant(value: Any) -> str:
    return f"[{', '.join(map(_constant, value))}]" if isinstance(value, tuple) else repr(value)  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]


def _nested(elements: list[str], type: Type) -> str:
    if len(type.shape) < 2:
        return f"[{', '.join(elements)}]"
    rows, cols = type.shape
    nested = (", ".join(elements[row * cols : (row + 1) * cols]) for row in range(rows))
    return f"[{', '.join(f'[{row}]' for row in nested)}]"


def _local_names(kernel: kir.Kernel) -> dict[int, str]:
    assigned = [
        stmt.local for stmt in statements(kernel.body) if isinstance(stmt, kir.Assign | kir.ForRange | kir.ForQuery)
    ]
    read = [node.local for node in expressions(kernel.body) if isinstance(node, kir.ReadLocal)]
    return _distinct({local.uid: local.name for local in (kernel.row, *assigned, *read)})


def _label_names(kernel: kir.Kernel) -> dict[int, str]:
    labels = [stmt.label for stmt in statements(kernel.body) if isinstance(stmt, kir.Block | kir.Leave)]
    return _distinct({label.uid: label.name for label in labels})


def _distinct(names: Mapping[int, str]) -> dict[int, str]:
    """Each name as it is where only one thing has it, else with the ``uid`` behind it."""
    owners: defaultdict[str, set[int]] = defaultdict(set)
    for uid, name in names.items():
        owners[name].add(uid)
    return {uid: name if len(owners[name]) == 1 else f"{name}.{uid}" for uid, name in names.items()}


def _global_names(kernel: kir.Kernel) -> dict[Global, str]:
    """Globals have no names of their own: they are numbered as they come."""
    reduced = [stmt.globl for stmt in statements(kernel.body) if isinstance(stmt, kir.ReduceGlobal)]
    read = [node.globl for node in expressions(kernel.body) if isinstance(node, kir.ReadGlobal)]
    return {globl: f"global{number}" for number, globl in enumerate(dict.fromkeys((*reduced, *read)))}
