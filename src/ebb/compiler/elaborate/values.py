"""What a Python expression of a kernel denotes while it is elaborated: a small closed union."""

from __future__ import annotations

from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any, TypeAlias, TypeGuard

from ebb.compiler.elaborate.function import Func
from ebb.compiler.elaborate.intrinsics import Intrinsic
from ebb.compiler.host import HostConst, HostExpr, describe
from ebb.compiler.kir import Expr
from ebb.diagnostics.span import Span
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.globals import Constant, Global
from ebb.relations.member import Member
from ebb.relations.relation import Relation
from ebb.relations.subset import Subset
from ebb.types.builtins import Builtin, Form
from ebb.types.rules import lone_type
from ebb.types.types import KeyType, MatrixType, ScalarType, VectorType


@record
class Typed:
    """A value that the kernel computes."""

    expr: Expr

    @property
    def span(self) -> Span:
        return self.expr.span


@record
class Weak:
    """A Python number, whose type its surroundings fix. ``value`` is what it is now."""

    host: HostExpr
    value: bool | int | float
    span: Span

    @property
    def literal(self) -> bool:
        return isinstance(self.host, HostConst)


@record
class WeakChoice:
    """``then if condition else other`` of numbers that are weak themselves."""

    condition: Expr
    then: Weak | WeakChoice
    other: Weak | WeakChoice
    span: Span


@record
class Sequence:
    """``[x, y]`` or ``(x, y)``: a vector, a matrix, several values, or what a loop unrolls over."""

    elements: tuple[Value, ...]
    span: Span


@record
class Projection:
    """An attribute that is taken of each row of a query."""

    name: str
    span: Span


@record
class Query:
    """The rows of ``index.relation`` whose ``index`` is ``key``, and what is taken of each."""

    index: Field
    key: Expr
    path: tuple[Projection, ...]
    span: Span


@record
class Static:
    """An object of the host: a relation, field, function, module, type, tuple, string, or any with attributes."""

    object: Any
    host: HostExpr
    span: Span

    @property
    def name(self) -> str:
        """How the program calls it."""
        if isinstance(self.host, HostConst):
            return getattr(self.object, "__name__", repr(self.object))
        return describe(self.host)


@record
class BoundMember:
    """A member with further parameters, of a key: ``c.vertex`` before it is called."""

    member: Member
    key: Expr
    span: Span


@record
class Nothing:
    """The result of a function that returns nothing."""

    function: str
    span: Span


@record
class Poison:
    """The value of something wrong that has been reported; whatever uses it stays silent."""

    span: Span


Value: TypeAlias = Typed | Weak | WeakChoice | Sequence | Query | Static | BoundMember | Nothing | Poison


def noun(value: Value) -> str:
    """What ``value`` is, for messages."""
    match value:
        case Typed(expr):
            return f"a {'key' if isinstance(expr.type, KeyType) else 'value'} of type {expr.type!r}"
        case Weak(_, number, _):
            return f"a number of type {lone_type(number)!r}"
        case WeakChoice():
            return "a number"
        case Sequence():
            return "a list of values"
        case Query():
            return "a query"
        case Static(found, _, _):
            return static_noun(found)
        case BoundMember(member, _, _):
            return f"the member '{member.name}'"
        case Nothing(function, _):
            return f"the result of '{function}', which returns nothing"
        case Poison():
            return "something wrong"


def is_items(found: Any) -> TypeGuard[tuple[Any, ...] | list[Any]]:
    """Whether a captured object has elements that are looked at one by one."""
    return isinstance(found, tuple | list)


def static_noun(found: Any) -> str:
    """What an object of the host is, for messages."""
    for kind, text in _STATIC_NOUNS:
        if isinstance(found, kind):
            return text.format(name=getattr(found, "name", getattr(found, "__name__", "")))
    if callable(found) and hasattr(found, "__name__"):
        return f"the function '{found.__name__}'"
    return f"a {type(found).__name__}"


_STATIC_NOUNS: tuple[tuple[Any, str], ...] = (
    (Relation, "the relation '{name}'"),
    (Field, "the field '{name}'"),
    (Member, "the member '{name}'"),
    (Subset, "the subset '{name}'"),
    (Global, "an ebb.Global"),
    (Constant, "an ebb.constant"),
    (Builtin | Form | Intrinsic | BuiltinFunctionType, "the builtin function '{name}'"),
    (Func, "the func '{name}'"),
    (ScalarType | KeyType | VectorType | MatrixType, "an Ebb type"),
    (ModuleType, "the module '{name}'"),
    (str, "a string"),
    ((tuple, list), "a captured list of values"),
    (FunctionType, "the Python function '{name}'"),
    (type, "the class '{name}'"),
    (type(None), "None"),
)
