"""From what a Python expression denotes to a typed KIR expression: weak numbers, literals and implicit coercion."""

from __future__ import annotations

from functools import reduce
from typing import Any, TypeAlias

from ebb.compiler import kir
from ebb.compiler.elaborate.capture import elements_of
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.errors_calls import NoValue
from ebb.compiler.elaborate.errors_names import NoMeaning
from ebb.compiler.elaborate.errors_syntax import StringValue, UnknownConstant
from ebb.compiler.elaborate.errors_types import LiteralElements, NoCoercion, NumberRange
from ebb.compiler.elaborate.values import (
    BoundMember,
    Nothing,
    Poison,
    Query,
    Sequence,
    Static,
    Typed,
    Value,
    Weak,
    WeakChoice,
    noun,
)
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.rules import common_element, fits, lone_type, weak_element, widens
from ebb.types.types import Element, Kind, ScalarType, Type, int32, shaped_type

WeakNumber: TypeAlias = Weak | WeakChoice
Operand: TypeAlias = Typed | Weak | WeakChoice | Sequence

_ADVICE: tuple[tuple[Any, str], ...] = (
    (Relation, "use a row of it: a parameter, a key field, or the variable of a loop"),
    (Field, "use it of a row: v.mass"),
    ((list, dict, set), "capture numbers, tuples of numbers or small NumPy arrays"),
)


def operand(ctx: Context, value: Value) -> Operand | None:
    """``value`` as something to compute with; None, and an error, where it is no value."""
    match value:
        case Typed() | Weak() | WeakChoice():
            return value
        case Sequence():
            return _sequence(ctx, value)
        case Static(Global() as globl, _, span):
            return Typed(kir.ReadGlobal(globl, globl.type, span))
        case Static(tuple() | list(), _, _):
            return _sequence(ctx, elements_of(ctx, value))
        case Poison():
            return None
        case _:
            _no_value(ctx, value)
            return None


def _no_value(ctx: Context, value: Static | Query | BoundMember | Nothing) -> None:
    """The error that says why ``value`` cannot be computed with."""
    match value:
        case Static(str() as text, _, span):
            ctx.report(StringValue(span, text))
        case Static(None, _, span):
            ctx.report(UnknownConstant(span, "None"))
        case Static(found, _, span):
            advice = next((text for kind, text in _ADVICE if isinstance(found, kind)), "use its numbers or call it")
            ctx.report(NoMeaning(span, value.name, noun(value), advice))
        case Query(index, _, _, span):
            advice = f"loop over it: 'for row in ...' gives the rows whose '{index.name}' is the key"
            ctx.report(NoMeaning(span, span.text, noun(value), advice))
        case BoundMember(member, _, span):
            ctx.report(NoMeaning(span, member.name, noun(value), f"call it: {span.text}(...)"))
        case Nothing(function, span):
            ctx.report(NoValue(span, function))


def typed(ctx: Context, value: Value) -> kir.Expr | None:
    """``value`` by itself, as a KIR expression; None, and an error, where it is none."""
    match operand(ctx, value):
        case None:
            return None
        case Typed(expr):
            return expr
        case Sequence() as sequence:
            return build(ctx, sequence)
        case weak:
            return adapted(ctx, weak, lone_scalar(weak))


def convert(ctx: Context, value: Value, target: Type, place: str, spread: bool = False) -> kir.Expr | None:
    """``value`` as a ``target``, widened where it must be; None, and an error, where it does not become one.

    Args:
        place: what has the type, for the message.
        spread: whether a scalar fills a vector or matrix.
    """
    found = operand(ctx, value)
    if found is None:
        return None
    fitting = becomes(ctx, found, target, spread)
    if fitting:
        return converted(ctx, found, target)
    source = None if fitting is None else typed(ctx, found)
    if source is not None:
        ctx.report(NoCoercion(found.span, source.type, target, place))
    return None


def becomes(ctx: Context, found: Operand, target: Type, spread: bool = False) -> bool | None:
    """Whether a value widens to ``target``; None, and an error, for a literal that is no value."""
    shape = shape_of(ctx, found)
    if shape is None:
        return None
    fitting = shape == target.shape or (spread and shape == ())
    return fitting and all(_takes(leaf, target.scalar) for leaf in leaves(found))


def converted(ctx: Context, found: Operand, target: Type) -> kir.Expr | None:
    """A value that widens to ``target`` as one; None, and an error, for a number out of range."""
    match found:
        case Typed(expr):
            return fit(expr, target)
        case Sequence():
            return build(ctx, found, target.scalar)
        case _:
            assert isinstance(target.scalar, ScalarType)
            number = adapted(ctx, found, target.scalar)
            return None if number is None else fit(number, target)


def fit(expr: kir.Expr, target: Type) -> kir.Expr:
    """``expr`` cast, and where it is a scalar repeated, to ``target``, which the rules allow."""
    if expr.type == target:
        return expr
    if expr.type.scalar != target.scalar:
        expr = kir.Cast(expr, shaped_type(target.scalar, expr.type.shape), expr.span)
    return expr if expr.type == target else kir.Splat(expr, target, expr.span)


# ---- Weak numbers ----


def lone_scalar(weak: WeakNumber) -> ScalarType:
    """The type of a weak number by itself."""
    if isinstance(weak, Weak):
        return lone_type(weak.value)
    common = common_element(lone_scalar(weak.then), lone_scalar(weak.other))
    assert isinstance(common, ScalarType)
    return common


def weak_beside(weak: WeakNumber, other: Element) -> ScalarType | None:
    """The type of a weak number beside a value of ``other``, None where it takes none."""
    if isinstance(weak, Weak):
        return weak_element(weak.value, other)
    arms = weak_beside(weak.then, other), weak_beside(weak.other, other)
    common = None if None in arms else common_element(arms[0], arms[1])  # type: ignore[arg-type]
    return common if isinstance(common, ScalarType) else None


def adapted(ctx: Context, weak: WeakNumber, scalar: ScalarType) -> kir.Expr | None:
    """A weak number as a ``scalar``, which takes numbers of its kind; None, and an error, out of its range."""
    if isinstance(weak, WeakChoice):
        then, other = adapted(ctx, weak.then, scalar), adapted(ctx, weak.other, scalar)
        if then is None or other is None:
            return None
        return kir.Choose(weak.condition, then, other, scalar, weak.span)
    if scalar.kind in (Kind.SIGNED, Kind.UNSIGNED):
        if not fits(int(weak.value), scalar):
            ctx.report(NumberRange(weak.span, str(weak.value), scalar))
            return None
        ctx.guard_range(weak.host, scalar)
    if not weak.literal:
        return ctx.uniform(weak.host, scalar, weak.span)
    try:
        return kir.Const(float(weak.value) if scalar.kind is Kind.FLOAT else weak.value, scalar, weak.span)
    except OverflowError:
        ctx.report(NumberRange(weak.span, f"an integer of {len(str(weak.value))} digits", scalar))
        return None


# ---- Literals ----


def all_weak(sequence: Sequence) -> bool:
    """Whether a literal has numbers only, whose type its surroundings fix."""
    return all(not isinstance(leaf, Typed) for leaf in leaves(sequence))


def shape_of(ctx: Context, value: Operand) -> tuple[int, ...] | None:
    """The shape of a value; None, and an error, for a literal without one."""
    match value:
        case Typed(expr):
            return expr.type.shape
        case Sequence(elements, span):
            shapes = [shape_of(ctx, element) for element in elements if isinstance(element, Operand)]
            if None in shapes:
                return None
            reason = _shape_problem(shapes)
            if reason is not None:
                ctx.report(LiteralElements(span, reason))
                return None
            assert shapes[0] is not None
            return (len(shapes), *shapes[0])
        case _:
            return ()


def leaves(value: Operand) -> list[Typed | WeakNumber]:
    """The elements of a literal at the lowest level; a typed vector in it counts as one."""
    if not isinstance(value, Sequence):
        return [value]
    return [leaf for element in value.elements if isinstance(element, Operand) for leaf in leaves(element)]


def build(ctx: Context, sequence: Sequence, scalar: Element | None = None) -> kir.Expr | None:
    """A literal as a vector or matrix, of ``scalar`` or of the common type of its elements."""
    shape = shape_of(ctx, sequence)
    element = scalar or _common_leaf(ctx, sequence)
    if shape is None or element is None:
        return None
    target = shaped_type(element, shape)
    parts = [part for leaf in leaves(sequence) for part in _parts(ctx, leaf, element)]
    if len(parts) != target.size:
        return None  # a number out of range, which has been reported
    if all(isinstance(part, kir.Const) for part in parts):
        values = [part.value for part in parts if isinstance(part, kir.Const)]
        return kir.Const(_folded(values, shape), target, sequence.span)
    return kir.Build(tuple(parts), target, sequence.span)


def _sequence(ctx: Context, sequence: Sequence) -> Sequence | None:
    elements = [operand(ctx, element) for element in sequence.elements]
    if None in elements:
        return None
    return Sequence(tuple(element for element in elements if element is not None), sequence.span)


def _shape_problem(shapes: list[Any]) -> str | None:
    if not shapes:
        return "there are none"
    if len(shapes[0]) > 1 and all(len(shape) == len(shapes[0]) for shape in shapes):
        return "there are more than two levels"
    if any(len(shape) != len(shapes[0]) for shape in shapes):
        return "numbers and lists are mixed"
    if any(shape != shapes[0] for shape in shapes):
        return f"the rows have {' and '.join(dict.fromkeys(str(shape[0]) for shape in shapes))} elements"
    return None


def _common_leaf(ctx: Context, sequence: Sequence) -> Element | None:
    found = leaves(sequence)
    common = common_scalar(found)
    if common is None and found:
        types = [leaf.expr.type.scalar if isinstance(leaf, Typed) else lone_scalar(leaf) for leaf in found]
        listed = " and ".join(dict.fromkeys(map(repr, types)))
        ctx.report(LiteralElements(sequence.span, f"they have the types {listed}"))
    return common


def _parts(ctx: Context, leaf: Typed | WeakNumber, element: Element) -> list[kir.Expr]:
    if not isinstance(leaf, Typed):
        assert isinstance(element, ScalarType)
        number = adapted(ctx, leaf, element)
        return [] if number is None else [number]
    expr = leaf.expr
    if expr.type.shape == ():
        return [fit(expr, element)]
    whole = ctx.simple(expr)
    parts = [component(whole, index) for index in indices_of(expr.type.shape)]
    return [fit(part, element) for part in parts]


def indices_of(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    """All indices of a vector or matrix, row-major."""
    if not shape:
        return [()]
    return [(first, *rest) for first in range(shape[0]) for rest in indices_of(shape[1:])]


def component(expr: kir.Expr, index: tuple[int, ...]) -> kir.Expr:
    """A component, or a row, at a constant index."""
    type_ = shaped_type(expr.type.scalar, expr.type.shape[len(index) :])
    if isinstance(expr, kir.Const):
        return kir.Const(reduce(lambda value, i: value[i], index, expr.value), type_, expr.span)
    from_index = tuple(kir.Const(i, int32, expr.span) for i in index)
    return kir.Component(expr, from_index, type_, expr.span)


def _folded(values: list[Any], shape: tuple[int, ...]) -> Any:
    if len(shape) == 1:
        return tuple(values)
    return tuple(tuple(values[row * shape[1] : (row + 1) * shape[1]]) for row in range(shape[0]))


def _takes(leaf: Typed | WeakNumber, scalar: Element) -> bool:
    """Whether a leaf becomes a ``scalar`` without a cast."""
    match leaf:
        case Typed(expr):
            return widens(expr.type.scalar, scalar)
        case Weak(_, value, _):
            return weak_element(value, scalar) == scalar
        case WeakChoice(_, then, other):
            return _takes(then, scalar) and _takes(other, scalar)


def common_type_of(ctx: Context, values: list[Operand]) -> Type | None:
    """The type to which several values widen, weak numbers beside the others; None where there is none."""
    shapes = {shape_of(ctx, value) for value in values}
    element = common_scalar([leaf for value in values for leaf in leaves(value)])
    if element is None or len(shapes) != 1:
        return None
    (shape,) = shapes
    return None if shape is None else shaped_type(element, shape)


def common_scalar(found: list[Typed | WeakNumber]) -> Element | None:
    """The element type to which all leaves widen: that of the typed ones, beside which the weak ones take theirs."""
    strong = [leaf.expr.type.scalar for leaf in found if isinstance(leaf, Typed)]
    weak = [leaf for leaf in found if not isinstance(leaf, Typed)]
    common = widest([*strong])
    if strong:
        return None if common is None else widest([common, *(weak_beside(leaf, common) for leaf in weak)])
    return widest([lone_scalar(leaf) for leaf in weak])


def widest(elements: list[Any]) -> Element | None:
    """The element type to which all of ``elements`` widen; None if there is none, or one of them is None."""

    def widened(a: Element | None, b: Element | None) -> Element | None:
        return None if a is None or b is None else common_element(a, b)

    return reduce(widened, elements[1:], elements[0]) if elements else None
