"""Operators on what Python expressions denote: arithmetic, comparison, logic, conditional expressions."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from ebb.compiler import kir
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.convert import (
    Operand,
    WeakNumber,
    adapted,
    all_weak,
    build,
    common_scalar,
    common_type_of,
    convert,
    fit,
    leaves,
    lone_scalar,
    operand,
    shape_of,
    typed,
    weak_beside,
    widest,
)
from ebb.compiler.elaborate.errors_names import CaptureFailed
from ebb.compiler.elaborate.errors_syntax import RejectedSyntax
from ebb.compiler.elaborate.errors_types import ConditionType, DifferentTypes, OperandTypes
from ebb.compiler.elaborate.values import Poison, Sequence, Typed, Value, Weak, WeakChoice, noun
from ebb.compiler.host import HostAttempt, HostConst, HostOperation, describe
from ebb.diagnostics.span import Span
from ebb.records import replace
from ebb.types.rules import (
    EQUALITIES,
    ORDERINGS,
    Mismatch,
    OperatorTypes,
    binary_type,
    compare_type,
    condition_mismatch,
    unary_type,
)
from ebb.types.types import Element, Type, bool_

BINARY: Mapping[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.FloorDiv: "//",
    ast.Mod: "%",
    ast.Pow: "**",
    ast.MatMult: "@",
    ast.BitAnd: "&",
    ast.BitOr: "|",
    ast.BitXor: "^",
    ast.LShift: "<<",
    ast.RShift: ">>",
}

_UNARY: Mapping[type[ast.unaryop], str] = {ast.USub: "-", ast.UAdd: "+", ast.Invert: "~", ast.Not: "not"}
_HOST_UNARY = {"-": "neg", "+": "pos", "~": "invert", "not": "not"}

_COMPARE: Mapping[type[ast.cmpop], str] = {
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
}

_REJECTED_COMPARE: Mapping[type[ast.cmpop], tuple[str, str]] = {
    ast.Is: ("'is'", "use '==': it compares values, and keys of one relation"),
    ast.IsNot: ("'is not'", "use '!=': it compares values, and keys of one relation"),
    ast.In: ("'in'", "compare with each: x == a or x == b"),
    ast.NotIn: ("'not in'", "compare with each: x != a and x != b"),
}


# ---- Arithmetic ----

_TypesOf: TypeAlias = Callable[[str, Type, Type], OperatorTypes | Mismatch]


def binary(ctx: Context, op: str, left: Value, right: Value, span: Span) -> Value:
    """``left op right``: by Python among weak numbers, else in the kernel."""
    types_of = compare_type if op in EQUALITIES or op in ORDERINGS else binary_type
    if isinstance(left, Typed) and isinstance(right, Typed):  # most are
        return _typed_binary(ctx, op, left.expr, right.expr, span, types_of)
    a, b = operand(ctx, left), operand(ctx, right)
    if a is None or b is None or shape_of(ctx, a) is None or shape_of(ctx, b) is None:
        return Poison(span)
    if isinstance(a, Weak) and isinstance(b, Weak):
        return _weak_binary(ctx, op, a, b, span, types_of)
    elementwise = _weak_elements(ctx, op, a, b, span) if op != "@" else None
    if elementwise is not None:
        return elementwise
    pair = _typed_pair(ctx, a, b)
    return Poison(span) if pair is None else _typed_binary(ctx, op, *pair, span, types_of)


def _typed_binary(ctx: Context, op: str, left: kir.Expr, right: kir.Expr, span: Span, types_of: _TypesOf) -> Value:
    types = types_of(op, left.type, right.type)
    if isinstance(types, Mismatch):
        return ctx.poison(OperandTypes(span, types, tuple((each.span, each.type) for each in (left, right))))
    return Typed(_operation(op, fit(left, types.left), fit(right, types.right), types, span))


def weak_operation(ctx: Context, op: Any, operands: tuple[Weak, ...], span: Span) -> Value:
    """An operation on weak numbers, done by Python: now if they are literals, else at each launch."""
    operation = HostOperation(op, tuple(each.host for each in operands))
    host = operation if ctx.surely_runs else HostAttempt(operation, _otherwise(op, operands))
    has_value, value = ctx.evaluate(host, span)
    if not has_value:
        return Poison(span)
    if not isinstance(value, bool | int | float):
        return ctx.poison(CaptureFailed(span, describe(host), f"it is {value!r}, which is no real number"))
    if all(each.literal for each in operands):
        return Weak(HostConst(value), value, span)
    if op in _TYPE_BY_VALUE:
        ctx.guard_type(host, type(value))
    return Weak(host, value, span)


_TYPE_BY_VALUE = ("**", pow, min, max)
"""What Python gives the type of depends on the values, not only on their types."""


def _otherwise(op: Any, operands: tuple[Weak, ...]) -> int | float:
    """What an operation gives on a way that no row takes, where Python would raise: of the type that it has else."""
    rounds = op in (math.floor, math.ceil, math.trunc, int) or (op is round and len(operands) == 1)
    whole = all(isinstance(each.value, int) for each in operands) and op not in ("/", "**", pow)
    return 0 if rounds or whole else math.nan


def _operation(op: str, left: kir.Expr, right: kir.Expr, types: OperatorTypes, span: Span) -> kir.Expr:
    if op == "@":
        return kir.Call("matmul", (left, right), types.result, span)
    if op in EQUALITIES or op in ORDERINGS:
        return kir.Compare(op, left, right, types.result, span)
    return kir.Binary(op, left, right, types.result, span)


def _weak_binary(ctx: Context, op: str, a: Weak, b: Weak, span: Span, types_of: _TypesOf) -> Value:
    types = types_of(op, lone_scalar(a), lone_scalar(b))
    if isinstance(types, Mismatch):
        return ctx.poison(OperandTypes(span, types, ((a.span, lone_scalar(a)), (b.span, lone_scalar(b)))))
    return weak_operation(ctx, op, (a, b), span)


def _weak_elements(ctx: Context, op: str, a: Operand, b: Operand, span: Span) -> Value | None:
    """``[1, 2] * 0.5`` among weak numbers: the literal of the results, which stay weak."""
    if not (isinstance(a, Sequence) or isinstance(b, Sequence)) or isinstance(a, Typed) or isinstance(b, Typed):
        return None
    if any(not isinstance(leaf, Weak) for leaf in (*leaves(a), *leaves(b))):
        return None
    shapes = shape_of(ctx, a), shape_of(ctx, b)
    if shapes[0] != shapes[1] and () not in shapes:
        return None  # the types will say that the shapes do not fit
    return _mapped(ctx, op, a, b, span)


def _mapped(ctx: Context, op: str, a: Value, b: Value, span: Span) -> Value:
    match a, b:
        case Sequence(), Sequence():
            pairs = list(zip(a.elements, b.elements, strict=True))
        case Sequence(), _:
            pairs = [(element, b) for element in a.elements]
        case _, Sequence():
            pairs = [(a, element) for element in b.elements]
        case _:
            return binary(ctx, op, a, b, span)
    results = tuple(_mapped(ctx, op, left, right, span) for left, right in pairs)
    return next((result for result in results if isinstance(result, Poison)), Sequence(results, span))


def _typed_pair(ctx: Context, a: Operand, b: Operand) -> tuple[kir.Expr, kir.Expr] | None:
    """Both operands typed, weak ones beside the other."""
    left = beside(ctx, a, _scalar_of(b))
    right = beside(ctx, b, _scalar_of(a))
    return None if left is None or right is None else (left, right)


def beside(ctx: Context, value: Operand, other: Element | None) -> kir.Expr | None:
    """``value`` typed; a weak one takes the type that it has beside ``other``."""
    if other is None or isinstance(value, Typed):
        return typed(ctx, value)
    if isinstance(value, Sequence):
        scalars = [weak_beside(leaf, other) for leaf in leaves(value) if not isinstance(leaf, Typed)]
        return build(ctx, value, widest([*scalars]) if all_weak(value) else None)
    scalar = weak_beside(value, other)
    return adapted(ctx, value, scalar or lone_scalar(value))


def _scalar_of(value: Operand) -> Element | None:
    """The element type that a weak number beside ``value`` adapts to, None where that is weak too."""
    if isinstance(value, Typed):
        return value.expr.type.scalar
    strong = [leaf for leaf in leaves(value) if isinstance(leaf, Typed)]
    return common_scalar([*strong]) if strong else None


def _unary(ctx: Context, node: ast.UnaryOp) -> Value:
    op, span = _UNARY[type(node.op)], ctx.span(node)
    if op == "not":
        return _negated(ctx, node, span)
    return unary(ctx, op, ctx.value(node.operand), span)


def unary(ctx: Context, op: str, value: Value, span: Span) -> Value:
    """``-x``, ``+x`` or ``~x``."""
    match operand(ctx, value):
        case None:
            return Poison(span)
        case Weak() as weak:
            types = unary_type(op, lone_scalar(weak))
            if isinstance(types, Mismatch):
                return ctx.poison(OperandTypes(span, types, ()))
            return weak_operation(ctx, _HOST_UNARY[op], (weak,), span)
        case Sequence() as sequence if all(isinstance(leaf, Weak) for leaf in leaves(sequence)):
            return replace(sequence, elements=tuple(unary(ctx, op, each, span) for each in sequence.elements))
        case found:
            expr = typed(ctx, found)
    if expr is None:
        return Poison(span)
    types = unary_type(op, expr.type)
    if isinstance(types, Mismatch):
        return ctx.poison(OperandTypes(span, types, ()))
    return Typed(expr if op == "+" else kir.Unary(op, expr, types, span))


def _binary(ctx: Context, node: ast.BinOp) -> Value:
    left, right = ctx.values((node.left, node.right))
    return binary(ctx, BINARY[type(node.op)], left, right, ctx.span(node))


# ---- Logic: the right side is evaluated only where the left one does not decide ----


def condition(ctx: Context, value: Value, construct: str) -> kir.Expr | None:
    """``value`` as the one bool that decides ``construct``; None, and an error, where it is none."""
    found = operand(ctx, value)
    expr = None if found is None else typed(ctx, found)
    if expr is None or found is None:
        return None
    mismatch = condition_mismatch(construct, expr.type)
    if mismatch is None:
        return expr
    ctx.report(ConditionType(found.span, construct, noun(found), mismatch.hint))
    return None


def _negated(ctx: Context, node: ast.UnaryOp, span: Span) -> Value:
    value = ctx.value(node.operand)
    if isinstance(value, Weak) and isinstance(value.value, bool):
        return weak_operation(ctx, "not", (value,), span)
    expr = condition(ctx, value, "not")
    return Poison(span) if expr is None else Typed(kir.Unary("not", expr, bool_, span))


def _logic(ctx: Context, node: ast.BoolOp) -> Value:
    op = "and" if isinstance(node.op, ast.And) else "or"
    return _logic_of(ctx, op, node.values, ctx.span(node))


def _logic_of(ctx: Context, op: str, nodes: list[ast.expr], span: Span) -> Value:
    left = condition(ctx, ctx.value(nodes[0]), op)
    if len(nodes) == 1:
        return Poison(span) if left is None else Typed(left)
    return lazily(ctx, op, left, lambda: _logic_of(ctx, op, nodes[1:], span), span)


def lazily(ctx: Context, op: str, left: kir.Expr | None, right_of: Callable[[], Value], span: Span) -> Value:
    """``left op right``, where what ``right`` emits must run only if ``left`` does not decide."""
    with ctx.nested() as body:
        value = right_of()
        right = None if isinstance(value, Poison) else condition(ctx, value, op)
    if left is None or right is None:
        return Poison(span)
    if not body:
        return Typed(kir.Logic(op, left, right, bool_, span))
    result = ctx.new_local(op, bool_)
    ctx.emit(kir.Assign(result, (), left, left.span))
    decided = kir.ReadLocal(result, bool_, left.span)
    body.append(kir.Assign(result, (), right, right.span))
    run, skip = (tuple(body), ()) if op == "and" else ((), tuple(body))
    ctx.emit(kir.If(decided, run, skip, span))
    return Typed(kir.ReadLocal(result, bool_, span))


# ---- Comparison ----


def _compare(ctx: Context, node: ast.Compare) -> Value:
    for op in node.ops:
        if type(op) in _REJECTED_COMPARE:
            for each in (node.left, *node.comparators):
                if not isinstance(each, ast.Constant):  # None, most often, and then it says nothing new
                    ctx.value(each)
            return ctx.poison(RejectedSyntax(ctx.span(node), *_REJECTED_COMPARE[type(op)]))
    if len(node.ops) == 1:
        left, right = ctx.values((node.left, node.comparators[0]))
        return binary(ctx, _COMPARE[type(node.ops[0])], left, right, ctx.span(node))
    return _chain(ctx, ctx.value(node.left), node.ops, node.comparators, node)


def _chain(ctx: Context, left: Value, ops: list[ast.cmpop], nodes: list[ast.expr], whole: ast.Compare) -> Value:
    """``a < b < c``: as ``a < b and b < c``, with ``b`` evaluated once."""
    mark = len(ctx.out)
    middle = ctx.value(nodes[0])
    (left,) = ctx.keep(mark, [left])
    span = ctx.span(whole)
    if len(ops) > 1 and isinstance(middle, Typed):
        middle = Typed(ctx.simple(middle.expr))
    first = binary(ctx, _COMPARE[type(ops[0])], left, middle, span)
    if len(ops) == 1:
        return first
    decided = None if isinstance(first, Poison) else condition(ctx, first, "and")
    return lazily(ctx, "and", decided, lambda: _chain(ctx, middle, ops[1:], nodes[1:], whole), span)


# ---- a if c else b ----


def _conditional(ctx: Context, node: ast.IfExp) -> Value:
    test = condition(ctx, ctx.value(node.test), "if")
    with ctx.nested() as then_body:
        then = operand(ctx, ctx.value(node.body))
    with ctx.nested() as else_body:
        other = operand(ctx, ctx.value(node.orelse))
    span = ctx.span(node)
    if test is None or then is None or other is None:
        return Poison(span)
    if not then_body and not else_body and _both_weak(then, other):
        assert isinstance(then, Weak | WeakChoice) and isinstance(other, Weak | WeakChoice)
        return WeakChoice(test, then, other, span)
    common = common_type_of(ctx, [then, other])
    if common is None:
        return no_common_type(ctx, "the two values of a conditional", [then, other], span)
    return _chosen(ctx, test, (then, then_body), (other, else_body), common, span)


def _chosen(
    ctx: Context,
    test: kir.Expr,
    then: tuple[Operand, list[kir.Stmt]],
    other: tuple[Operand, list[kir.Stmt]],
    common: Type,
    span: Span,
) -> Value:
    arms: list[tuple[kir.Expr, list[kir.Stmt]]] = []
    for value, body in (then, other):
        with ctx.nested() as more:
            expr = convert(ctx, value, common, "the other value")
        if expr is None:
            return Poison(span)
        arms.append((expr, [*body, *more]))
    (yes, yes_body), (no, no_body) = arms
    if not yes_body and not no_body:
        return Typed(kir.Choose(test, yes, no, common, span))
    result = ctx.new_local("chosen", common)
    run = (*yes_body, kir.Assign(result, (), yes, yes.span))
    skip = (*no_body, kir.Assign(result, (), no, no.span))
    ctx.emit(kir.If(test, run, skip, span))
    return Typed(kir.ReadLocal(result, common, span))


def _both_weak(then: Operand, other: Operand) -> bool:
    if not isinstance(then, Weak | WeakChoice) or not isinstance(other, Weak | WeakChoice):
        return False
    weak: tuple[WeakNumber, WeakNumber] = (then, other)
    return common_scalar([*weak]) is not None


def no_common_type(ctx: Context, what: str, values: list[Operand], span: Span) -> Poison:
    types = [(value.span, typed(ctx, value)) for value in values]
    found = tuple((where, repr(expr.type)) for where, expr in types if expr is not None)
    if len(found) == len(values):
        ctx.report(DifferentTypes(span, what, found))
    return Poison(span)


EXPRESSIONS: Mapping[type[ast.expr], Callable[[Context, Any], Value]] = {
    ast.BinOp: _binary,
    ast.UnaryOp: _unary,
    ast.BoolOp: _logic,
    ast.Compare: _compare,
    ast.IfExp: _conditional,
}
