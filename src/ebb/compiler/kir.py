"""KIR, the kernel IR: what a kernel computes on the rows of a relation. The whole grammar is this file.

A tree of typed expressions and structured statements, without control-flow graph or SSA. Every name is resolved, every
function and member inlined, every coercion written out; what is left are values, rows, keys, fields and reductions.
The reference interpreter (``ebb.backends.reference``) defines what each node means.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

from ebb.compiler.host import HostValue
from ebb.diagnostics.span import Span
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import Type

if TYPE_CHECKING:
    from fractions import Fraction


class Edge(Enum):
    """What an access to a row of a grid does beyond the end of a dimension that does not wrap."""

    CHECK = "check"
    CLAMP = "clamp"


class ReduceOp(Enum):
    """The operators of reductions. Each is associative and commutative up to rounding, and has an identity."""

    ADD = "+"
    MULTIPLY = "*"
    MIN = "min"
    MAX = "max"
    AND = "&"
    OR = "|"
    XOR = "^"


@record
class Local:
    """A variable of the kernel. ``uid`` is unique in the kernel: two variables may share a name."""

    name: str
    uid: int
    type: Type


@record
class Label:
    """The name of a ``Block``, which ``Leave`` leaves."""

    name: str
    uid: int


# ---- Expressions. ``type`` is the type of the value; operands have exactly the types that the comment names. ----


@record
class Const:
    """``value`` is a Python bool, int or float, or for vectors and matrices nested tuples of these."""

    value: Any
    type: Type
    span: Span


@record
class Uniform:
    """The value of ``Kernel.uniforms[index]``, evaluated by the host at each launch."""

    index: int
    type: Type
    span: Span


@record
class ReadLocal:
    local: Local
    type: Type
    span: Span


@record
class ReadGlobal:
    globl: Global
    type: Type
    span: Span


@record
class ReadField:
    """The whole value of ``field`` in the row ``key``. Wrap it in a ``Component`` to read a part."""

    field: Field
    key: Expr
    type: Type
    span: Span


@record
class Unary:
    """``-`` on numbers, ``~`` on integers, ``not`` on bools; elementwise."""

    op: str
    operand: Expr
    type: Type
    span: Span


@record
class Binary:
    """``+ - * / // % ** & | ^ << >> min max`` on two operands of the type ``type``, elementwise.

    ``/`` is on floats only. Integer ``//`` and ``%`` by zero give 0 and overflow wraps, as in NumPy; a shift by a
    negative amount or by the width or more gives 0 (-1 for ``>>`` of a negative number). An integer to a negative power
    is the exact value truncated: 1 or -1 where the base is, else 0. ``@`` is the ``Call`` of ``matmul``.
    """

    op: str
    left: Expr
    right: Expr
    type: Type
    span: Span


@record
class Compare:
    """``== != < <= > >=`` on two operands of one type, elementwise; ``== !=`` also on keys. The type is bool-valued."""

    op: str
    left: Expr
    right: Expr
    type: Type
    span: Span


@record
class Logic:
    """``and``/``or`` of two bools; the right operand is evaluated only where the left one does not decide."""

    op: str
    left: Expr
    right: Expr
    type: Type
    span: Span


@record
class Choose:
    """``then if condition else other``; only the chosen one is evaluated."""

    condition: Expr
    then: Expr
    other: Expr
    type: Type
    span: Span


@record
class Cast:
    """A conversion of numbers or bools to ``type``, elementwise, same shape.

    Floats to integers truncate and saturate, NaN gives 0. Integers to narrower ones wrap. Numbers to bool are != 0.
    """

    operand: Expr
    type: Type
    span: Span


@record
class Splat:
    """A scalar in every component of the vector or matrix ``type``."""

    operand: Expr
    type: Type
    span: Span


@record
class Build:
    """A vector or matrix from its components, row-major."""

    elements: tuple[Expr, ...]
    type: Type
    span: Span


@record
class Component:
    """``operand[indices]``: a component, or with one index on a matrix, a row as a vector.

    Indices are integer expressions. Constant ones are known to be in range; others are checked when the kernel runs.
    Indices count from 0; a negative constant has been resolved, a negative dynamic one is out of range.
    """

    operand: Expr
    indices: tuple[Expr, ...]
    type: Type
    span: Span


@record
class Call:
    """A builtin of ``ebb.types.builtins`` by name; its row there gives the signature and the meaning."""

    builtin: str
    arguments: tuple[Expr, ...]
    type: Type
    span: Span


@record
class Random:
    """The next number of the row's own Philox stream: ``rand`` is uniform in [0, 1), ``randn`` standard normal.

    It stands only as the whole right side of an ``Assign``, so that the order of draws is the order of statements.
    """

    distribution: str
    type: Type
    span: Span


Entry: TypeAlias = "Fraction | int"
"""An entry of an affine map; an int where it is whole."""


@record
class Affine:
    """The row of the grid ``type.target`` at ``floor(matrix @ [*coords(key), 1])``; periodic dimensions wrap."""

    matrix: tuple[tuple[Entry, ...], ...]
    key: Expr
    edge: Edge
    type: Type
    span: Span


@record
class RowAt:
    """The row of the grid ``type.target`` at the coordinates ``operand``, an int64 vector; periodic dimensions wrap."""

    operand: Expr
    edge: Edge
    type: Type
    span: Span


@record
class RowId:
    """``ebb.id(key)``: the row's number when it was created, an int64."""

    key: Expr
    type: Type
    span: Span


@record
class Coords:
    """``ebb.coords(key)``: the coordinates of a grid row, a vector of int32."""

    key: Expr
    type: Type
    span: Span


@record
class QuerySize:
    """The number of rows whose ``index`` field is ``key``, an int32."""

    index: Field
    key: Expr
    type: Type
    span: Span


Expr: TypeAlias = (
    Const | Uniform | ReadLocal | ReadGlobal | ReadField | Unary | Binary | Compare | Logic | Choose | Cast | Splat
    | Build | Component | Call | Random | Affine | RowAt | RowId | Coords | QuerySize
)  # fmt: skip

# ---- Statements. ``indices`` select a part of the place as in ``Component``; () is the whole of it. ----

Body: TypeAlias = "tuple[Stmt, ...]"


@record
class Assign:
    """Declares ``local`` where it is its first assignment, else changes it."""

    local: Local
    indices: tuple[Expr, ...]
    value: Expr
    span: Span


@record
class WriteField:
    field: Field
    key: Expr
    indices: tuple[Expr, ...]
    value: Expr
    span: Span


@record
class ReduceField:
    """``place = place op value``, elementwise; ``-=`` has been made an ADD of the negated value."""

    field: Field
    key: Expr
    indices: tuple[Expr, ...]
    op: ReduceOp
    value: Expr
    span: Span


@record
class ReduceGlobal:
    globl: Global
    indices: tuple[Expr, ...]
    op: ReduceOp
    value: Expr
    span: Span


@record
class If:
    condition: Expr
    then: Body
    orelse: Body
    span: Span


@record
class ForRange:
    """``for local in range(start, stop, step)``, all of ``local.type``; ``step`` 0 is an in-kernel error.

    ``local`` is assigned at the start of each turn, so that it keeps its last value after the loop, as in Python.
    """

    local: Local
    start: Expr
    stop: Expr
    step: Expr
    body: Body
    span: Span


@record
class ForQuery:
    """Runs ``body`` for each row of ``index.relation`` whose grouped key field ``index`` equals ``key``.

    ``local`` is that row's key. Rows come in the order of their creation.
    """

    local: Local
    index: Field
    key: Expr
    body: Body
    span: Span


@record
class While:
    condition: Expr
    body: Body
    span: Span


@record
class Break:
    span: Span


@record
class Continue:
    span: Span


@record
class Block:
    """``body``, which a ``Leave`` of ``label`` inside it ends early: an inlined function and its returns."""

    label: Label
    body: Body
    span: Span


@record
class Leave:
    label: Label
    span: Span


@record
class Assert:
    condition: Expr
    text: str
    span: Span


@record
class Print:
    """One line. ``parts`` are literal text, or a value with its format specification."""

    parts: tuple[str | tuple[Expr, str], ...]
    span: Span


@record
class Breakpoint:
    """Stops in the debugger on the reference backend (``sys.breakpointhook``); compiled backends pass over it."""

    span: Span


Stmt: TypeAlias = (
    Assign | WriteField | ReduceField | ReduceGlobal | If | ForRange | ForQuery | While | Break | Continue | Block
    | Leave | Assert | Print | Breakpoint
)  # fmt: skip


@record
class Kernel:
    """A kernel on one relation, with all of its types known and no data. ``row`` is the key of the kernel's own row."""

    name: str
    relation: Relation
    row: Local
    uniforms: tuple[HostValue, ...]
    body: Body
    span: Span
