"""The interpreter of KIR: what every node means, on NumPy scalars and small arrays.

Scalars are NumPy scalars of exactly the node's type, vectors and matrices are arrays, a key is a Python int: the
position of its row. Values are never changed in place, so that two names never share a vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ebb.backends.reference.breakpoint import stop
from ebb.backends.reference.grids import AffineMap, position_at
from ebb.compiler import failures, kir
from ebb.compiler.kir_walk import draws
from ebb.compiler.print_format import format_value
from ebb.records import field, record
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.relations.subset import RowSet
from ebb.runtime import random
from ebb.types.arithmetic import BINARY, COMPARE, UNARY, convert, identity_of
from ebb.types.builtins import BUILTINS
from ebb.types.types import KeyType, ScalarType, Type

Left: TypeAlias = kir.Break | kir.Continue | kir.Leave | None
"""How a body ended: the statement that left it early, or None."""


def run(kernel: kir.Kernel, rows: RowSet, uniforms: tuple[Any, ...], order: Sequence[int] | None = None) -> None:
    """Runs ``kernel`` once on each of ``rows``, whose groupings are valid.

    Args:
        kernel: a verified kernel whose phases are right.
        rows: the relation of the kernel or a subset of it.
        uniforms: the values of ``kernel.uniforms``, as NumPy values of their types.
        order: a permutation of ``range(rows.size)``, the order in which to run the rows; by default storage order, or
            box after box.

    Raises:
        KernelAssertionError: an ``assert`` does not hold.
        BoundsError: a component or a cell of a grid does not exist.
        RelationError: an unset key is read.
        KernelTypeError: the step of a range is zero.
    """
    positions = _positions(rows)
    if order is not None:
        positions = positions[np.asarray(order, dtype=np.int64)]
    launch = Launch(kernel, uniforms, random.next_launch() if draws(kernel) else None)
    with np.errstate(all="ignore"):
        for position in positions.tolist():
            Row(launch, position).execute_body(kernel.body)
    launch.finish()


def _positions(rows: RowSet) -> npt.NDArray[np.int64]:
    """The positions of the rows, in the order in which a failure is the first on every backend."""
    if rows.boxes is not None and len(rows.boxes) > 1:
        numbers = np.arange(rows.relation.size).reshape(rows.relation.shape)
        return np.concatenate([numbers[box.slices].ravel() for box in rows.boxes])
    listed = rows.row_positions()
    return np.arange(rows.size) if listed is None else listed


@record(frozen=False, eq=False)
class Launch:
    """What the rows of one launch share.

    Attributes:
        kernel: that runs.
        uniforms: its uniforms.
        random: the key of its random numbers, None where it draws none.
        partial: what the rows so far have reduced into each global.
        constants: the values of ``Const`` nodes, by ``id``.
        maps: the maps of ``Affine`` nodes, by ``id``.
    """

    kernel: kir.Kernel
    uniforms: tuple[Any, ...]
    random: random.LaunchKey | None
    partial: dict[Global, tuple[kir.ReduceOp, Any]] = field(default_factory=dict[Global, tuple[kir.ReduceOp, Any]])
    constants: dict[int, Any] = field(default_factory=dict[int, Any])
    maps: dict[int, AffineMap] = field(default_factory=dict[int, AffineMap])

    def constant(self, node: kir.Const) -> Any:
        """The value of ``node``."""
        value = self.constants.get(id(node))
        if value is None:
            value = self.constants[id(node)] = convert(np.array(node.value, node.type.dtype), node.type)
        return value

    def affine(self, node: kir.Affine) -> AffineMap:
        """The map of ``node``."""
        found = self.maps.get(id(node))
        if found is None:
            found = self.maps[id(node)] = AffineMap.of(node)
        return found

    def accumulator(self, globl: Global, op: kir.ReduceOp) -> Any:
        """The array that the rows reduce into, which starts as the identity of ``op``."""
        if globl not in self.partial:
            self.partial[globl] = op, np.full(globl.type.shape, identity_of(op.value, globl.type.dtype))
        return self.partial[globl][1]

    def finish(self) -> None:
        """Combines what the rows reduced into each global with the value it had."""
        with np.errstate(all="ignore"):
            for globl, (op, accumulated) in self.partial.items():
                globl.data[...] = BINARY[op.value](globl.data, accumulated)


class Row:
    """The run of a kernel for one row.

    Attributes:
        position: of the row.
        locals: the values of the variables, by ``uid``.
        variables: those that have a value, by ``uid``, for the debugger.
        drawn: how many random numbers the row has drawn.
    """

    __slots__ = ("drawn", "kernel", "launch", "locals", "position", "variables")

    def __init__(self, launch: Launch, position: int) -> None:
        self.launch = launch
        self.kernel = launch.kernel
        self.position = position
        self.locals: dict[int, Any] = {self.kernel.row.uid: position}
        self.variables: dict[int, kir.Local] = {self.kernel.row.uid: self.kernel.row}
        self.drawn = 0

    # ---- Expressions ----

    def value(self, expr: kir.Expr) -> Any:  # noqa: C901 - the table of the language's expressions
        """The value of ``expr`` for this row."""
        match expr:
            case kir.Const():
                return self.launch.constant(expr)
            case kir.ReadLocal(local):
                return self.locals[local.uid]
            case kir.ReadField(source, key):
                return self.read(expr, source, self.value(key), ())
            case kir.Component(operand, indices):
                return self.component(expr, operand, indices)
            case kir.Binary(op, left, right):
                return BINARY[op](self.value(left), self.value(right))
            case kir.Unary(op, operand):
                return UNARY[op](self.value(operand))
            case kir.Compare(op, left, right):
                return COMPARE[op](self.value(left), self.value(right))
            case kir.Logic("and", left, right):
                return self.value(left) and self.value(right)
            case kir.Logic(_, left, right):
                return self.value(left) or self.value(right)
            case kir.Choose(condition, then, other):
                return self.value(then if self.value(condition) else other)
            case kir.Cast(operand, type) | kir.Splat(operand, type):
                return convert(self.value(operand), type)
            case kir.Build(elements, type):
                return np.array([self.value(e) for e in elements], type.dtype).reshape(type.shape)
            case kir.Call(name, arguments):
                return BUILTINS[name].meaning(*[self.value(argument) for argument in arguments])
            case kir.Uniform(index, type):
                return _scalar_key(self.launch.uniforms[index], type)
            case kir.ReadGlobal(globl):
                return globl.data.copy()[()]
            case kir.Random():
                return self.draw(expr)
            case kir.Affine(_, key):
                return self.affine(expr, self.value(key))
            case kir.RowAt(asked):
                return self.row_at(expr, tuple(int(index) for index in self.value(asked)))
            case kir.RowId(key):
                return np.int64(failures.identity(_target(key.type), self.value(key)))
            case kir.Coords(key):
                return np.array(failures.coordinates(_target(key.type), self.value(key)), np.int32)
            case kir.QuerySize(index, key):
                return np.int32(len(self.query(index, self.value(key))))

    def read(self, node: kir.Expr, source: Field, key: int, indices: tuple[int, ...]) -> Any:
        """A field's value in the row ``key``, or the part of it that ``indices`` select."""
        value = source.data[(key, *indices)]
        if source.maybe_unset and np.any(value < 0):
            raise failures.unset_key(self.kernel, self.position, node.span, source, key)
        return _scalar_key(value if not np.ndim(value) else value.copy(), node.type)

    def component(self, node: kir.Component, operand: kir.Expr, indices: tuple[kir.Expr, ...]) -> Any:
        """Part of a value. Of a field only that part is read, so that its other keys may be unset."""
        if isinstance(operand, kir.ReadField):
            key = self.value(operand.key)
            return self.read(node, operand.field, key, self.indices(indices, operand.type))
        value = self.value(operand)
        return _scalar_key(value[self.indices(indices, operand.type)], node.type)

    def indices(self, indices: tuple[kir.Expr, ...], type: Type) -> tuple[int, ...]:
        """The values of ``indices``, each within the shape of ``type``."""
        found = tuple([int(self.value(index)) for index in indices])
        for axis, index in enumerate(found):
            if not 0 <= index < type.shape[axis]:
                span = indices[axis].span
                raise failures.component_out_of_range(self.kernel, self.position, span, index, axis, type)
        return found

    def draw(self, node: kir.Random) -> Any:
        """The row's next random number."""
        assert self.launch.random is not None and isinstance(node.type, ScalarType)
        row = failures.identity(self.kernel.relation, self.position)
        self.drawn += 1
        return random.draw(node.distribution, node.type, self.launch.random, row, self.drawn - 1)

    def affine(self, node: kir.Affine, key: int) -> int:
        """The row of a grid that an affine map gives."""
        return self.row_at(node, self.launch.affine(node).coordinates(key))

    def row_at(self, node: kir.Affine | kir.RowAt, at: tuple[int, ...]) -> int:
        """The row of a grid at coordinates, wrapped and clamped as the node says."""
        position = position_at(_target(node.type), at, node.edge)
        if position is None:
            raise failures.affine_outside(self.kernel, self.position, node, at)
        return position

    def query(self, index: Field, key: int) -> range | Any:
        """The positions of the rows whose ``index`` is ``key``, in the order of their identities."""
        grouping = index.grouping
        assert grouping is not None
        first, last = int(grouping.offsets[key]), int(grouping.offsets[key + 1])
        return range(first, last) if grouping.rows is None else grouping.rows[first:last].tolist()

    # ---- Statements ----

    def execute_body(self, body: kir.Body) -> Left:
        """Runs ``body`` up to its end, or to the statement that leaves it."""
        for stmt in body:
            left = self.execute(stmt)
            if left is not None:
                return left
        return None

    def execute(self, stmt: kir.Stmt) -> Left:  # noqa: C901 - the table of the language's statements
        """Runs ``stmt``; gives what leaves the bodies around it."""
        match stmt:
            case kir.Assign(local, indices, value):
                self.assign(local, indices, self.value(value))
            case kir.WriteField(target, key, indices, value):
                place = (self.value(key), *self.indices(indices, target.type))
                target.data[place] = self.value(value)
            case kir.ReduceField(target, key, indices, op, value):
                place = (self.value(key), *self.indices(indices, target.type))
                target.data[place] = BINARY[op.value](target.data[place], self.value(value))
            case kir.ReduceGlobal(globl, indices, op, value):
                place = self.indices(indices, globl.type)
                accumulator = self.launch.accumulator(globl, op)
                accumulator[place] = BINARY[op.value](accumulator[place], self.value(value))
            case kir.If(condition, then, orelse):
                return self.execute_body(then if self.value(condition) else orelse)
            case kir.ForRange():
                return self.for_range(stmt)
            case kir.ForQuery(local, index, key, body):
                return self.loop(local, self.query(index, self.value(key)), body)
            case kir.While(condition, body):
                return self.loop_while(condition, body)
            case kir.Break() | kir.Continue() | kir.Leave():
                return stmt
            case kir.Block(label, body):
                left = self.execute_body(body)
                return None if isinstance(left, kir.Leave) and left.label == label else left
            case kir.Assert(condition):
                if not self.value(condition):
                    raise failures.assertion_failed(self.kernel, self.position, stmt)
            case kir.Print(parts):
                print("".join([part if isinstance(part, str) else self.text(*part) for part in parts]))
            case kir.Breakpoint(span):
                stop(self.kernel.name, span, [(local, self.locals[uid]) for uid, local in self.variables.items()])
        return None

    def assign(self, local: kir.Local, indices: tuple[kir.Expr, ...], value: Any) -> None:
        """Gives ``local`` a value, or a new value that differs in one part."""
        if indices:
            place = self.indices(indices, local.type)
            changed = self.locals[local.uid].copy()
            changed[place] = value
            value = changed
        self.locals[local.uid] = value
        self.variables[local.uid] = local

    def for_range(self, stmt: kir.ForRange) -> Left:
        """A loop over numbers of the type of its variable."""
        start, stop, step = (int(self.value(bound)) for bound in (stmt.start, stmt.stop, stmt.step))
        if step == 0:
            raise failures.zero_step(self.kernel, self.position, stmt)
        dtype = stmt.local.type.dtype
        return self.loop(stmt.local, map(dtype.type, range(start, stop, step)), stmt.body)

    def loop(self, local: kir.Local, values: Any, body: kir.Body) -> Left:
        """Runs ``body`` for each of ``values``."""
        for value in values:
            self.assign(local, (), value)
            left = self.execute_body(body)
            if isinstance(left, kir.Break):
                break
            if isinstance(left, kir.Leave):
                return left
        return None

    def loop_while(self, condition: kir.Expr, body: kir.Body) -> Left:
        """Runs ``body`` while ``condition`` holds."""
        while self.value(condition):
            left = self.execute_body(body)
            if isinstance(left, kir.Break):
                break
            if isinstance(left, kir.Leave):
                return left
        return None

    def text(self, expr: kir.Expr, spec: str) -> str:
        """The value of ``expr`` as ``print`` shows it."""
        return format_value(self.value(expr), expr.type, spec)


def _scalar_key(value: Any, type: Type) -> Any:
    return int(value) if isinstance(type, KeyType) else value


def _target(type: Type) -> Relation:
    assert isinstance(type, KeyType) and isinstance(type.target, Relation)
    return type.target
