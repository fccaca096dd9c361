"""Calls: builtins, casts, funcs, members."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any

import numpy as np

from ebb.compiler import kir
from ebb.compiler.elaborate.attributes import relation_of
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.convert import (
    Operand,
    common_scalar,
    convert,
    fit,
    leaves,
    lone_scalar,
    operand,
    shape_of,
    typed,
    weak_beside,
)
from ebb.compiler.elaborate.errors_calls import BuiltinArguments
from ebb.compiler.elaborate.errors_names import UnknownFunction
from ebb.compiler.elaborate.errors_syntax import RejectedSyntax
from ebb.compiler.elaborate.errors_types import BadCast, NumberRange
from ebb.compiler.elaborate.function import Func
from ebb.compiler.elaborate.inline import inline_func, inline_member
from ebb.compiler.elaborate.intrinsics import Intrinsic
from ebb.compiler.elaborate.keys import FORMS, INTRINSICS
from ebb.compiler.elaborate.operators import beside, binary, weak_operation
from ebb.compiler.elaborate.rejected import REJECTED_CLAUSES
from ebb.compiler.elaborate.values import (
    BoundMember,
    Poison,
    Query,
    Sequence,
    Static,
    Typed,
    Value,
    Weak,
    WeakChoice,
    is_items,
    noun,
    static_noun,
)
from ebb.compiler.host import HostConst, HostOperation
from ebb.diagnostics.span import Span
from ebb.records import record
from ebb.relations.member import Member
from ebb.relations.relation import Relation
from ebb.types.builtins import BUILTINS, Builtin, Form, from_python
from ebb.types.rules import castable, fits
from ebb.types.signatures import Complaint
from ebb.types.types import (
    Element,
    KeyType,
    Kind,
    MatrixType,
    ScalarType,
    Type,
    VectorType,
    bool_,
    int32,
    shaped_type,
)

_BY_PYTHON = (abs, min, max, round, pow, math.floor, math.ceil, math.trunc)
"""Functions that Python itself computes on Python numbers, so that their results are Python's."""

_ELSEWHERE: Mapping[Any, str] = {
    print: "it is a statement of its own",
    range: "it stands after 'in' in a 'for'",
    int: "write the type: ebb.int32(x) or ebb.int64(x)",
    float: "write the type: ebb.float32(x) or ebb.float64(x)",
    sum: "add the components: v.x + v.y + v.z, or loop over them",
    enumerate: "count in a local of your own",
    zip: "loop over a tuple of tuples",
    id: "use ebb.id(key), the number of a row",
    isinstance: "types are known when the kernel is compiled",
    input: "read it outside the kernel",
    open: "read or write files outside the kernel",
    np.linalg.norm: "use ebb.length(v)",
    np.linalg.inv: "use ebb.inverse(m)",
    np.array: "write the vector or matrix out: [x, y, z]",
}


@record
class Arguments:
    """The arguments of a call, evaluated, and where the whole call and each argument stand."""

    given: list[Value]
    named: dict[str, Value]
    span: Span


def call(ctx: Context, node: ast.Call) -> Value:
    """``function(arguments)``."""
    span = ctx.span(node)
    nodes = [node.func, *node.args, *(each.value for each in node.keywords)]
    function, *values = ctx.values(nodes)
    if any(each.arg is None for each in node.keywords):
        return ctx.poison(RejectedSyntax(span, *REJECTED_CLAUSES["**"]))
    if isinstance(function, Poison) or any(isinstance(value, Poison) for value in values):
        return Poison(span)
    count = len(node.args)
    named = {each.arg: value for each, value in zip(node.keywords, values[count:], strict=True) if each.arg is not None}
    return _apply(ctx, function, Arguments(values[:count], named, span))


def _apply(ctx: Context, function: Value, arguments: Arguments) -> Value:
    match function:
        case Typed(expr) if isinstance(expr.type, KeyType):
            return _key_call(ctx, expr, arguments)
        case BoundMember(member, key, _):
            given: list[Value] = [Typed(key), *arguments.given]
            return inline_member(ctx, member.function, member, given, arguments.span, arguments.named)
        case Static(Func() as func, _, _):
            return inline_func(ctx, func, arguments.given, arguments.named, arguments.span)
        case Static(Intrinsic(name), _, _):
            return INTRINSICS[name](ctx, arguments.given, arguments.named, arguments.span)
        case Static() if arguments.named:
            complaint = "takes its arguments in order, without names"
            return ctx.poison(BuiltinArguments(arguments.span, function.name, complaint, None))
        case Static(Form(name), _, _):
            return FORMS[name](ctx, arguments.given, arguments.span)
        case Static(found, _, _):
            return _static_call(ctx, function, found, arguments)
        case _:
            advice = "call a builtin, an ebb.func, a member or a type"
            return ctx.poison(UnknownFunction(arguments.span, function.span.text, noun(function), advice))


def _static_call(ctx: Context, function: Static, found: Any, arguments: Arguments) -> Value:
    if isinstance(found, ScalarType | VectorType | MatrixType):
        return cast(ctx, found, arguments.given, arguments.span)
    if found is bool:
        return cast(ctx, bool_, arguments.given, arguments.span)
    if found is len:
        return _length(ctx, arguments)
    row = found if isinstance(found, Builtin) else from_python(found)
    if row is not None:
        return builtin(ctx, row, found, function.name, arguments.given, arguments.span)
    advice = _advice(found, function.name)
    return ctx.poison(UnknownFunction(function.span, function.name, static_noun(found), advice))


def _advice(found: Any, name: str) -> str:
    if isinstance(found, Relation | KeyType):
        return "a key is not made from a number: follow a key field, use a query, or on a grid ebb.affine or ebb.row_at"
    if isinstance(found, Member):
        return f"use it of a row: v.{found.name}"
    try:
        known = _ELSEWHERE.get(found)
    except TypeError:
        known = None
    if known is not None:
        return known
    short = getattr(found, "__name__", name.rpartition(".")[2])
    if (isinstance(found, np.ufunc) or str(getattr(found, "__module__", "")).startswith("numpy")) and (
        short in BUILTINS or short in _NUMPY_TYPES
    ):
        return f"use ebb.{short}"
    if type(found).__name__ == "Kernel":
        return "launch it from the host, or make what they share an @ebb.func"
    if isinstance(found, FunctionType):
        return f"decorate '{name}' with @ebb.func"
    return "use a builtin of ebb or math, or write it as an @ebb.func"


_NUMPY_TYPES = ("bool_", "int32", "int64", "uint32", "uint64", "float32", "float64")


def _key_call(ctx: Context, key: kir.Expr, arguments: Arguments) -> Value:
    """``c(1, 0)``: the member ``__call__`` of the relation."""
    relation = relation_of(key)
    member = relation.attribute("__call__")
    if not isinstance(member, Member):
        advice = f'define what that means: @{relation.name}.member("__call__")'
        return ctx.poison(UnknownFunction(arguments.span, arguments.span.text, f"a key of '{relation.name}'", advice))
    given: list[Value] = [Typed(key), *arguments.given]
    return inline_member(ctx, member.function, member, given, arguments.span, arguments.named)


def _length(ctx: Context, arguments: Arguments) -> Value:
    span = arguments.span
    match arguments.given:
        case [Query(index, key, _, _)]:
            return Typed(kir.QuerySize(index, key, int32, span))
        case [Static(items, host, _)] if is_items(items):
            ctx.guard_structure(host, items)
            return Weak(HostConst(len(items)), len(items), span)
        case [Static(Relation() as relation, host, _)]:
            return Weak(HostOperation(len, (host,)), len(relation), span)
        case [value]:
            found = operand(ctx, value)
            shape = None if found is None else shape_of(ctx, found)
            if shape:
                return Weak(HostConst(shape[0]), shape[0], span)
            if found is None or shape is None:
                return Poison(span)
            return ctx.poison(
                BuiltinArguments(span, "len", f"takes a vector, a matrix or a query, not {noun(found)}", None)
            )
        case given:
            return ctx.poison(BuiltinArguments(span, "len", f"takes 1 argument, not {len(given)}", None))


# ---- Builtins ----


def builtin(ctx: Context, row: Builtin, function: Any, name: str, given: list[Value], span: Span) -> Value:
    """A call of a builtin: of numbers that Python knows by Python, else a ``kir.Call`` with converted arguments."""
    if row.static is not None:
        return _static_builtin(ctx, row, name, given, span)
    if function is math.log and len(given) == 2:
        of_number, of_base = (builtin(ctx, row, function, name, [value], span) for value in given)
        return binary(ctx, "/", of_number, of_base, span)
    found = [operand(ctx, value) for value in given]
    known: list[Operand] = [value for value in found if value is not None]
    if len(known) < len(given) or any(shape_of(ctx, value) is None for value in known):
        return Poison(span)
    by_python = _by_python(ctx, row, function, known, span)
    if by_python is not None:
        return by_python
    if row.operator is None and function is pow:
        return (
            binary(ctx, "**", known[0], known[1], span) if len(known) == 2 else _typed_call(ctx, row, name, known, span)
        )
    if row.operator is not None and len(known) == 1:
        return _fold_components(ctx, row, name, known[0], span)
    return _typed_call(ctx, row, name, known, span)


def _typed_call(ctx: Context, row: Builtin, name: str, known: list[Operand], span: Span) -> Value:
    """The call of a builtin with typed arguments, or what it says about them."""
    exprs: list[kir.Expr] = []
    for value in known:
        expr = beside(ctx, value, _beside(value, known))
        if expr is None:
            return Poison(span)
        exprs.append(expr)
    signature = row.signature(tuple(expr.type for expr in exprs))
    if isinstance(signature, Complaint):
        where = span if signature.argument is None else exprs[signature.argument].span
        return ctx.poison(BuiltinArguments(where, name, signature.text, signature.hint))
    fitted = [fit(expr, type_) for expr, type_ in zip(exprs, signature.arguments, strict=True)]
    if row.operator is None:
        return Typed(kir.Call(row.name, tuple(fitted), signature.result, span))
    result = fitted[0]
    for each in fitted[1:]:
        result = kir.Binary(row.operator, result, each, signature.result, span)
    return Typed(result)


def _beside(value: Operand, known: list[Operand]) -> Element | None:
    """The element type beside which a weak argument takes its own: of the typed arguments that are numbers as it is."""
    if isinstance(value, Typed):
        return None
    weak = [leaf for leaf in leaves(value) if not isinstance(leaf, Typed)]
    strong = [leaf for each in known for leaf in leaves(each) if isinstance(leaf, Typed)]
    alike = [leaf for leaf in strong if all(weak_beside(each, leaf.expr.type.scalar) is not None for each in weak)]
    return common_scalar([*alike]) if alike else None


@record
class OnPythonNumbers:
    """A builtin as a function of Python numbers, for what the host computes at each launch."""

    row: Builtin

    @property
    def __name__(self) -> str:
        return self.row.name

    def __call__(self, *numbers: Any) -> Any:
        value = self.row(*numbers)
        return value.item()


def _by_python(ctx: Context, row: Builtin, function: Any, known: list[Operand], span: Span) -> Value | None:
    """The call on weak numbers, None where some argument is not weak or a bool, which is no number."""
    numbers = [value for value in known if isinstance(value, Weak) and not isinstance(value.value, bool)]
    if len(numbers) < len(known) or row.name == "select" or not numbers:
        return None
    if any(function is each for each in _BY_PYTHON) and (function not in (round, pow) or len(numbers) <= 2):
        return weak_operation(ctx, function, tuple(numbers), span)
    if isinstance(row.signature(tuple(lone_scalar(each) for each in numbers)), Complaint):
        return None
    return weak_operation(ctx, OnPythonNumbers(row), tuple(numbers), span)


def _fold_components(ctx: Context, row: Builtin, name: str, value: Operand, span: Span) -> Value:
    """``min(v)``: over the components of a vector, as of a list in Python."""
    expr = typed(ctx, value)
    if expr is None:
        return Poison(span)
    if not isinstance(expr.type, VectorType):
        return _typed_call(ctx, row, name, [Typed(expr)], span)
    whole = ctx.simple(expr)
    parts: list[Operand] = [
        Typed(kir.Component(whole, (kir.Const(i, int32, span),), expr.type.scalar, span)) for i in range(expr.type.n)
    ]
    return parts[0] if len(parts) == 1 else _typed_call(ctx, row, name, parts, span)


def _static_builtin(ctx: Context, row: Builtin, name: str, given: list[Value], span: Span) -> Value:
    """``identity`` and ``zeros``: constants of types and sizes."""
    known: list[Any] = []
    for value in given:
        found = _known_value(ctx, value)
        if found is None:
            text = "takes types and sizes that are known when the kernel is compiled"
            return ctx.poison(BuiltinArguments(value.span, name, text, None))
        known.append(found)
    constant = row.constant(tuple(known))
    if isinstance(constant, Complaint):
        where = span if constant.argument is None else given[constant.argument].span
        return ctx.poison(BuiltinArguments(where, name, constant.text, constant.hint))
    return Typed(kir.Const(constant.value, constant.type, span))


def _known_value(ctx: Context, value: Value) -> Any:
    match value:
        case Weak(host, number, _):
            ctx.guard_value(host, number)
            return number
        case Static(items, host, _) if is_items(items):
            ctx.guard_value(host, items)
            return tuple(items)
        case Static(found, _, _):
            return found
        case Sequence(elements, _):
            items = [_known_value(ctx, element) for element in elements]
            return None if None in items else tuple(items)
        case _:
            return None


# ---- Casts ----


def cast(ctx: Context, target: Type, given: list[Value], span: Span) -> Value:
    """``ebb.int32(x)``, ``ebb.vec3f(v)``, ``ebb.vec3f(x, y, z)``."""
    if len(given) > 1 and isinstance(target, VectorType):
        given = [Sequence(tuple(given), span)]
    if len(given) != 1:
        return ctx.poison(BadCast(span, target, f"takes {_arity(target)}, not {len(given)} values"))
    found = operand(ctx, given[0])
    if found is None:
        return Poison(span)
    if isinstance(found, Weak | WeakChoice | Sequence) and isinstance(target.scalar, ScalarType):
        exact = _cast_weak(ctx, found, target, target.scalar, span)
        if exact is not None:
            return exact
    expr = typed(ctx, found)
    if expr is None:
        return Poison(span)
    if not castable(expr.type, target):
        return ctx.poison(BadCast(span, target, f"does not convert a value of type {expr.type!r}"))
    converted = fit(expr, target)
    return Typed(converted if converted is not expr else expr)


def _cast_weak(ctx: Context, found: Operand, target: Type, scalar: ScalarType, span: Span) -> Value | None:
    """A Python number or a literal of them, converted by Python; None where it is left to the kernel."""
    shape = shape_of(ctx, found)
    if shape is None:
        return Poison(span)
    if shape not in ((), target.shape):
        return None
    if not isinstance(found, Weak):
        return _cast_literal(ctx, found, target, span)
    function = {Kind.BOOL: bool, Kind.FLOAT: float}.get(scalar.kind, int)
    value = found if type(found.value) is function else weak_operation(ctx, function, (found,), span)
    if not isinstance(value, Weak):
        return value
    if scalar.kind in (Kind.SIGNED, Kind.UNSIGNED) and not fits(int(value.value), scalar):
        return ctx.poison(NumberRange(span, str(value.value), scalar))
    expr = convert(ctx, value, target, "the cast", spread=True)
    return Poison(span) if expr is None else Typed(expr)


def _cast_literal(ctx: Context, found: Operand, target: Type, span: Span) -> Value | None:
    if not isinstance(found, Sequence) or not isinstance(target.scalar, ScalarType):
        return None
    elements: list[Value] = []
    inner = shaped_type(target.scalar, target.shape[1:])
    for element in found.elements:
        value = cast(ctx, inner, [element], element.span)
        if isinstance(value, Poison):
            return value
        elements.append(value)
    expr = convert(ctx, Sequence(tuple(elements), span), target, "the cast")
    return Poison(span) if expr is None else Typed(expr)


def _arity(target: Type) -> str:
    return f"one value, or {target.n}" if isinstance(target, VectorType) else "one value"


EXPRESSIONS: Mapping[type[ast.expr], Callable[[Context, Any], Value]] = {ast.Call: call}
