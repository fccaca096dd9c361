"""Checks that KIR is what ``kir`` says it is. What is found here is a bug of the compiler, never the user's error."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from typing import Any, cast

from ebb.compiler import kir
from ebb.compiler.kir_walk import bodies, children, operands
from ebb.records import field, record
from ebb.relations.relation import Relation
from ebb.types.builtins import BUILTINS
from ebb.types.rules import (
    ARITHMETIC,
    BITWISE,
    EQUALITIES,
    SHIFTS,
    Mismatch,
    binary_type,
    compare_type,
    fits,
    is_bool,
    is_float,
    is_integer,
    is_key,
    is_number,
    reduce_mismatch,
)
from ebb.types.signatures import Complaint
from ebb.types.types import KeyType, Kind, ScalarType, Type, bool_, int32, int64, shaped_type, vector

_BINARY = frozenset((*ARITHMETIC, *BITWISE, *SHIFTS))


class CompilerBug(Exception):  # noqa: N818 - a bug of ours, not an error of the user
    """The compiler broke one of its own rules. Not an ``EbbError``: nothing in the user's program caused it."""


def verify_kernel(kernel: kir.Kernel) -> None:
    """Checks types, places, labels and the definite assignment of variables in ``kernel``.

    Raises:
        CompilerBug: naming the first thing that is wrong, with its line.
    """
    _require(kernel.row.type == kernel.relation.key_type, kernel, "the row is not a key of the kernel's relation")
    verifier = _Verifier(kernel, {kernel.row.uid: kernel.row})
    verifier.body(kernel.body, _Flow(frozenset({kernel.row.uid})), _Targets())


@record
class _Flow:
    """The variables that surely have a value at a point of the program; None where no run comes by."""

    assigned: frozenset[int] | None

    def and_assigned(self, local: kir.Local) -> _Flow:
        return self if self.assigned is None else _Flow(self.assigned | {local.uid})


_NOWHERE = _Flow(None)


def _surely_runs(loop: kir.ForRange | kir.ForQuery) -> bool:
    """Whether a loop has at least one turn, whatever the data."""
    match loop:
        case kir.ForRange(start=kir.Const(start), stop=kir.Const(stop), step=kir.Const(step)) if step:
            return len(range(start, stop, step)) > 0
        case _:
            return False


def _join(flows: Iterable[_Flow]) -> _Flow:
    reached = [flow.assigned for flow in flows if flow.assigned is not None]
    return _Flow(reduce(frozenset[int].intersection, reached)) if reached else _NOWHERE


@record
class _Targets:
    """Where a body may be left to: the blocks around it and the loop around it, with what was assigned at each exit."""

    blocks: dict[int, list[_Flow]] = field(default_factory=dict[int, list[_Flow]])
    breaks: list[_Flow] | None = None
    continues: list[_Flow] | None = None

    def in_loop(self, breaks: list[_Flow], continues: list[_Flow]) -> _Targets:
        return _Targets(self.blocks, breaks, continues)

    def in_block(self, label: kir.Label, exits: list[_Flow]) -> _Targets:
        return _Targets({**self.blocks, label.uid: exits}, self.breaks, self.continues)


@record
class _Verifier:
    kernel: kir.Kernel
    locals: dict[int, kir.Local]

    # ---- Statements ----

    def body(self, body: kir.Body, flow: _Flow, targets: _Targets) -> _Flow:
        for stmt in body:
            flow = self.statement(stmt, flow, targets)
        return flow

    def statement(self, stmt: kir.Stmt, flow: _Flow, targets: _Targets) -> _Flow:
        """Checks ``stmt``, which is reached with ``flow``; gives the flow after it."""
        for operand in operands(stmt):
            whole = isinstance(stmt, kir.Assign) and operand is stmt.value
            self.expr(operand, flow, may_draw=whole)
        self.place(stmt)
        match stmt:
            case kir.Assign(local, indices):
                if indices and flow.assigned is not None:
                    _require(local.uid in flow.assigned, stmt, f"a part of '{local.name}' is set before the whole")
                return flow.and_assigned(local)
            case kir.If() | kir.ForRange() | kir.ForQuery() | kir.While() | kir.Block():
                return self.compound(stmt, flow, targets)
            case kir.Break() | kir.Continue():
                _require(targets.breaks is not None, stmt, "break or continue outside of a loop")
                exits = targets.breaks if isinstance(stmt, kir.Break) else targets.continues
                if exits is not None:
                    exits.append(flow)
                return _NOWHERE
            case kir.Leave(label):
                _require(
                    label.uid in targets.blocks, stmt, f"leaves the block '{label.name}', in which it does not stand"
                )
                targets.blocks[label.uid].append(flow)
                return _NOWHERE
            case _:
                return flow

    def compound(self, stmt: kir.Stmt, flow: _Flow, targets: _Targets) -> _Flow:
        """Checks the bodies of ``stmt``; gives the flow after it."""
        exits: list[_Flow] = []
        continues: list[_Flow] = []
        match stmt:
            case kir.If(_, then, orelse):
                return _join((self.body(then, flow, targets), self.body(orelse, flow, targets)))
            case kir.ForRange(local, body=body) | kir.ForQuery(local, body=body):
                end = self.body(body, flow.and_assigned(local), targets.in_loop(exits, continues))
                return _join((end, *exits, *continues)) if _surely_runs(stmt) else flow
            case kir.While(condition, body):
                self.body(body, flow, targets.in_loop(exits, continues))
                for_ever = isinstance(condition, kir.Const) and condition.value is True
                return _join(exits) if for_ever else _join((flow, *exits))
            case kir.Block(label, body):
                exits.append(self.body(body, flow, targets.in_block(label, exits)))
                return _join(exits)
            case _:
                raise CompilerBug(f"{stmt!r} has no bodies, but {len(bodies(stmt))}")

    def place(self, stmt: kir.Stmt) -> None:
        """Checks the types of what ``stmt`` does."""
        match stmt:
            case kir.Assign(local, indices, value):
                self.bind(local, stmt)
                self.same(_part(local.type, indices, stmt), value, stmt)
            case kir.WriteField(target, key, indices, value):
                self.same(target.relation.key_type, key, stmt)
                self.same(_part(target.type, indices, stmt), value, stmt)
            case kir.ReduceField(target, key, indices, op, value):
                self.same(target.relation.key_type, key, stmt)
                self.reduction(_part(target.type, indices, stmt), op, value, stmt)
            case kir.ReduceGlobal(globl, indices, op, value):
                self.reduction(_part(globl.type, indices, stmt), op, value, stmt)
            case kir.If(condition) | kir.While(condition) | kir.Assert(condition):
                self.same(bool_, condition, stmt)
            case kir.ForRange(local, start, stop, step):
                self.bind(local, stmt)
                _require(is_integer(local.type) and not local.type.shape, stmt, "a range is of integers")
                for bound in (start, stop, step):
                    self.same(local.type, bound, stmt)
            case kir.ForQuery(local, index, key):
                self.bind(local, stmt)
                _require(
                    local.type == index.relation.key_type, stmt, "the loop variable is not a key of what is queried"
                )
                self.query(index, key, stmt)
            case kir.Break() | kir.Continue() | kir.Block() | kir.Leave() | kir.Print() | kir.Breakpoint():
                pass

    def bind(self, local: kir.Local, stmt: kir.Stmt) -> None:
        known = self.locals.setdefault(local.uid, local)
        if known != local:
            raise CompilerBug(_message(stmt, f"two variables have the uid {local.uid}: {known} and {local}"))

    def same(self, expected: Type, value: kir.Expr, where: kir.Stmt | kir.Expr) -> None:
        found = value.type
        if found is not expected and found != expected:  # the text is made only then: this is asked of every node
            raise CompilerBug(_message(where, f"expected a {expected!r}, found a {found!r}"))

    def reduction(self, place: Type, op: kir.ReduceOp, value: kir.Expr, stmt: kir.Stmt) -> None:
        self.same(place, value, stmt)
        if reduce_mismatch(op.value, place, value.type) is not None:
            raise CompilerBug(_message(stmt, f"no reduction {op.value} of {place!r}"))

    def query(self, index: Any, key: kir.Expr, where: kir.Stmt | kir.Expr) -> None:
        _require(index.grouping is not None, where, f"'{index.path}' is not grouped")
        self.same(index.type, key, where)

    # ---- Expressions ----

    def expr(self, expr: kir.Expr, flow: _Flow, may_draw: bool = False) -> None:
        """Checks ``expr`` and all in it, evaluated where ``flow`` holds."""
        for child in children(expr):
            self.expr(child, flow)
        if isinstance(expr, kir.Random):
            _require(may_draw, expr, "a random number is not the whole right side of an assignment")
        if isinstance(expr, kir.ReadLocal):
            self.local(expr, flow)
        found = self.type_of(expr)
        if found is not None and found is not expr.type and found != expr.type:
            raise CompilerBug(_message(expr, f"it has the type {found!r}, not {expr.type!r}"))

    def local(self, expr: kir.ReadLocal, flow: _Flow) -> None:
        local = expr.local
        if self.locals.get(local.uid) != local:
            raise CompilerBug(_message(expr, f"'{local.name}' ({local.uid}) is not declared before"))
        if flow.assigned is not None and local.uid not in flow.assigned:
            raise CompilerBug(_message(expr, f"'{local.name}' ({local.uid}) may have no value"))

    def type_of(self, expr: kir.Expr) -> Type | None:  # noqa: C901 - one case a kind of node
        """The type that ``expr`` must have, given its operands; None where any will do and has been checked."""
        match expr:
            case kir.Const(value, type):
                if not _is_constant(value, type, type.shape):
                    raise CompilerBug(_message(expr, f"{value!r} is no {type!r}"))
            case kir.Uniform(index):
                _require(0 <= index < len(self.kernel.uniforms), expr, f"there is no uniform {index}")
                return self.kernel.uniforms[index].type
            case kir.ReadLocal(local):
                return local.type
            case kir.ReadGlobal(globl):
                return globl.type
            case kir.ReadField(source, key):
                self.same(source.relation.key_type, key, expr)
                return source.type
            case kir.Unary() | kir.Binary() | kir.Compare() | kir.Logic() | kir.Choose():
                return self.operator(expr)
            case kir.Cast(operand, type):
                _require(operand.type.shape == type.shape, expr, "a cast keeps the shape")
                _require(not is_key(type) and not is_key(operand.type), expr, "keys are not cast")
            case kir.Splat(operand, type):
                _require(bool(type.shape), expr, "a splat is of a vector or matrix")
                self.same(type.scalar, operand, expr)
            case kir.Build(elements, type):
                if not type.shape or len(elements) != type.size:
                    raise CompilerBug(_message(expr, f"{len(elements)} elements for {type!r}"))
                for element in elements:
                    self.same(type.scalar, element, expr)
            case kir.Component(operand, indices):
                _require(bool(indices), expr, "a component has indices")
                return _part(operand.type, indices, expr)
            case kir.Call():
                return self.call(expr)
            case kir.Random(distribution, type):
                _require(distribution in ("rand", "randn"), expr, f"there is no distribution {distribution!r}")
                _require(is_float(type) and not type.shape, expr, "a random number is a float")
            case kir.Affine():
                self.affine(expr)
            case kir.RowAt(coordinates, _, type):
                self.same(vector(int64, _grid(type, expr).ndim), coordinates, expr)
            case kir.RowId(key):
                _require(isinstance(key.type, KeyType), expr, "id() is of a key")
                return int64
            case kir.Coords(key):
                return vector(int32, _grid(key.type, expr).ndim)
            case kir.QuerySize(index, key):
                self.query(index, key, expr)
                return int32
        return None

    def operator(self, expr: kir.Unary | kir.Binary | kir.Compare | kir.Logic | kir.Choose) -> Type:
        """The type of an operator, whose operands must already have the types that it computes in."""
        match expr:
            case kir.Unary(op, operand):
                fit = {"-": is_number, "~": is_integer, "not": is_bool}.get(op)
                _require(fit is not None and fit(operand.type), expr, f"no operator {op} on {operand.type!r}")
                return operand.type
            case kir.Binary(op, left, right):
                self.same(left.type, right, expr)
                types = binary_type(op, left.type, right.type)
                if op not in _BINARY or isinstance(types, Mismatch) or (op == "/" and not is_float(left.type)):
                    raise CompilerBug(_message(expr, f"no operator {op} on {left.type!r}"))
                return left.type
            case kir.Compare(op, left, right):
                self.same(left.type, right, expr)
                types = compare_type(op, left.type, right.type)
                if isinstance(types, Mismatch):
                    raise CompilerBug(_message(expr, types.text))
                _require(op in EQUALITIES or not is_key(left.type), expr, "keys have no order")
                return types.result
            case kir.Logic(op, left, right):
                _require(op in ("and", "or"), expr, f"no operator {op}")
                self.same(bool_, left, expr)
                self.same(bool_, right, expr)
                return bool_
            case kir.Choose(condition, then, other):
                self.same(bool_, condition, expr)
                self.same(then.type, other, expr)
                return then.type

    def call(self, expr: kir.Call) -> Type:
        row = BUILTINS.get(expr.builtin)
        if row is None or row.static is not None:
            raise CompilerBug(_message(expr, f"there is no builtin {expr.builtin!r} to call"))
        types = tuple(argument.type for argument in expr.arguments)
        signature = row.signature(types)
        if isinstance(signature, Complaint):
            raise CompilerBug(_message(expr, f"{expr.builtin} {signature.text}"))
        if signature.arguments != types:
            raise CompilerBug(_message(expr, f"{expr.builtin} takes {signature.arguments}, not {types}"))
        return signature.result

    def affine(self, expr: kir.Affine) -> None:
        source, target = _grid(expr.key.type, expr), _grid(expr.type, expr)
        fitting = len(expr.matrix) == target.ndim and all(len(row) == source.ndim + 1 for row in expr.matrix)
        _require(fitting, expr, f"the matrix is not {target.ndim} x {source.ndim + 1}")


def _part(type: Type, indices: tuple[kir.Expr, ...], where: kir.Stmt | kir.Expr) -> Type:
    """The type of the part of a ``type`` that ``indices`` select."""
    if not indices:
        return type
    if len(indices) > len(type.shape):
        raise CompilerBug(_message(where, f"{len(indices)} indices into {type!r}"))
    for index, extent in zip(indices, type.shape, strict=False):
        if not is_integer(index.type) or index.type.shape:
            raise CompilerBug(_message(where, f"an index is a {index.type!r}"))
        if isinstance(index, kir.Const) and not 0 <= index.value < extent:
            raise CompilerBug(_message(where, f"the constant index {index.value} is not in range({extent})"))
    return shaped_type(type.scalar, type.shape[len(indices) :])


def _grid(type: Type, where: kir.Expr) -> Relation:
    if isinstance(type, KeyType) and isinstance(type.target, Relation) and type.target.is_grid:
        return type.target
    raise CompilerBug(_message(where, f"expected a key of a grid, found a {type!r}"))


def _is_constant(value: Any, type: Type, shape: tuple[int, ...]) -> bool:
    if shape:
        parts = cast("tuple[Any, ...]", value) if isinstance(value, tuple) else ()
        return len(parts) == shape[0] and all(_is_constant(part, type, shape[1:]) for part in parts)
    if not isinstance(type.scalar, ScalarType):
        return False
    match type.scalar.kind:
        case Kind.BOOL:
            return isinstance(value, bool)
        case Kind.FLOAT:
            return isinstance(value, float | int) and not isinstance(value, bool)
        case Kind.SIGNED | Kind.UNSIGNED:
            return isinstance(value, int) and not isinstance(value, bool) and fits(value, type.scalar)


def _require(holds: bool, where: kir.Kernel | kir.Stmt | kir.Expr, text: str) -> None:
    if not holds:
        raise CompilerBug(_message(where, text))


def _message(where: kir.Kernel | kir.Stmt | kir.Expr, text: str) -> str:
    return f"{type(where).__name__} at {where.span} ({where.span.text!r}): {text}"
