"""Evaluates operators whose operands are constants, as the reference interpreter would."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ebb.compiler import kir
from ebb.compiler.kir_walk import expressions, map_body, map_children
from ebb.records import replace
from ebb.types import arithmetic
from ebb.types.types import Type


def fold_constants(kernel: kir.Kernel) -> kir.Kernel:
    """``kernel`` with every operator, cast and choice of constants replaced by its value."""
    # Python has done the arithmetic of literals, so that there is seldom any left.
    if not any(map(_is_constant, expressions(kernel.body))):
        return kernel
    with np.errstate(all="ignore"):
        return replace(kernel, body=map_body(kernel.body, _fold))


_DECIDING: Mapping[type[kir.Expr], Callable[[Any], tuple[kir.Expr, ...]]] = {
    kir.Unary: lambda expr: (expr.operand,),
    kir.Binary: lambda expr: (expr.left, expr.right),
    kir.Compare: lambda expr: (expr.left, expr.right),
    kir.Cast: lambda expr: (expr.operand,),
    kir.Splat: lambda expr: (expr.operand,),
    kir.Logic: lambda expr: (expr.left,),
    kir.Choose: lambda expr: (expr.condition,),
    kir.Build: lambda expr: expr.elements,
    kir.Component: lambda expr: (expr.operand, *expr.indices),
}
"""What of an expression must be constant so that ``_fold`` does without it."""


def _is_constant(expr: kir.Expr) -> bool:
    """Whether ``_fold`` has another expression for ``expr``, whose parts are as they are."""
    deciding = _DECIDING.get(type(expr))
    return deciding is not None and all([isinstance(part, kir.Const) for part in deciding(expr)])


def _fold(expr: kir.Expr) -> kir.Expr:
    folded = map_children(expr, _fold)
    if not _is_constant(folded):
        return folded
    match folded:
        case kir.Binary(op, kir.Const() as left, kir.Const() as right):
            return _const(arithmetic.BINARY[op](_numpy(left), _numpy(right)), folded)
        case kir.Unary(op, kir.Const() as operand):
            return _const(arithmetic.UNARY[op](_numpy(operand)), folded)
        case kir.Compare(op, kir.Const() as left, kir.Const() as right):
            return _const(arithmetic.COMPARE[op](_numpy(left), _numpy(right)), folded)
        case kir.Cast(kir.Const() as operand) | kir.Splat(kir.Const() as operand):
            return _const(arithmetic.convert(_numpy(operand), folded.type), folded)
        case kir.Logic() | kir.Choose():
            return _decide(folded)
        case kir.Build() | kir.Component():
            return _fold_parts(folded)
        case _:
            return folded


def _decide(expr: kir.Logic | kir.Choose) -> kir.Expr:
    """The operand that a constant condition leaves. What is dropped would not have been evaluated."""
    match expr:
        case kir.Choose(kir.Const(value), then, other):
            return then if value else other
        case kir.Logic("and", kir.Const(value) as left, right):
            return right if value else left
        case kir.Logic("or", kir.Const(value) as left, right):
            return left if value else right
        case _:
            return expr


def _fold_parts(expr: kir.Build | kir.Component) -> kir.Expr:
    match expr:
        case kir.Build(elements):
            values = [element.value for element in elements if isinstance(element, kir.Const)]
            if len(values) < len(elements):
                return expr
            return _const(np.array(values, dtype=expr.type.dtype).reshape(expr.type.shape), expr)
        case kir.Component(kir.Const() as operand, indices):
            places = [index.value for index in indices if isinstance(index, kir.Const)]
            if len(places) < len(indices):
                return expr
            return _const(_numpy(operand)[tuple(places)], expr)
        case _:
            return expr


def _numpy(constant: kir.Const) -> Any:
    return _of_type(constant.value, constant.type)


def _of_type(value: Any, type_: Type) -> Any:
    return np.array(value, dtype=type_.dtype)[()]


def _const(value: Any, instead_of: kir.Expr) -> kir.Const:
    """``value`` as a constant of the type and in the place of an expression."""
    array = np.asarray(value, dtype=instead_of.type.dtype)
    return kir.Const(_nested(array.tolist()), instead_of.type, instead_of.span)


def _nested(value: Any) -> Any:
    return tuple(map(_nested, value)) if isinstance(value, list) else value  # pyright: ignore
