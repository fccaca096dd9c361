"""From a Python object that a kernel captures to the value that it denotes, and the guard on what was assumed of it."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np

from ebb.compiler import kir
from ebb.compiler.elaborate.context import Context
from ebb.compiler.elaborate.errors_names import NoMeaning, UnknownAttribute
from ebb.compiler.elaborate.function import Func
from ebb.compiler.elaborate.intrinsics import Intrinsic
from ebb.compiler.elaborate.values import Poison, Sequence, Static, Typed, Value, Weak, static_noun
from ebb.compiler.host import HostAttribute, HostConst, HostExpr, HostItem, describe
from ebb.diagnostics.span import Span
from ebb.relations.field import Field
from ebb.relations.globals import Constant, Global
from ebb.relations.member import Member
from ebb.relations.relation import Relation
from ebb.relations.subset import Subset
from ebb.types.builtins import Builtin, Form
from ebb.types.types import KeyType, MatrixType, ScalarType, VectorType, from_dtype, shaped_type

OBJECTS = (Relation, Field, Global, Constant, Func, Member, Subset)
"""What the user makes of Ebb: a kernel cannot have locals that hide these."""

_FIXED = (*OBJECTS, Builtin, Form, Intrinsic, ModuleType, ScalarType, KeyType, VectorType, MatrixType, type)
_LARGEST = 1024


def captured(ctx: Context, host: HostExpr, value: Any, span: Span) -> Value:
    """The value of ``host``, which is ``value`` now, where it is read at ``span``."""
    ctx.trail.captured(host, value)
    match value:
        case np.generic() | np.ndarray():
            return _array(ctx, host, value, span)
        case bool() | int() | float():
            ctx.guard_type(host, type(value))
            return Weak(host, value, span)
        case Constant():
            ctx.guard_identity(host, value)
            return Typed(kir.Const(value.value, value.type, span))
        case str():
            ctx.guard_value(host, value)
        case _ if isinstance(value, _FIXED) or callable(value):
            ctx.guard_identity(host, value)
        case _:
            pass  # its attributes and elements are looked at one by one
    return Static(value, host, span)


def attribute_of(ctx: Context, owner: Static, name: str, span: Span, name_span: Span) -> Value:
    """An attribute of a captured object."""
    match owner.object:
        case Relation() as relation if relation.attribute(name) is not None:
            # A relation keeps what it has: the guard on the relation is enough.
            return Static(relation.attribute(name), HostAttribute(owner.host, name), span)
        case Relation() as relation if name not in _RELATION_FACTS:
            known = (*relation._attributes, *_RELATION_FACTS)  # pyright: ignore[reportPrivateUsage]
            return ctx.poison(UnknownAttribute(name_span, f"relation '{relation.name}'", name, known))
        case Global() as globl if name == "value":
            return Typed(kir.ReadGlobal(globl, globl.type, span))
        case found if not _has(found, name):
            known = tuple(each for each in dir(found) if not each.startswith("_"))
            return ctx.poison(UnknownAttribute(name_span, f"'{owner.name}', {static_noun(found)},", name, known))
        case found if _is_fixed_module(found):
            return _of_module(ctx, found, owner, name, span)
        case _:
            host = HostAttribute(owner.host, name)
            has_value, value = ctx.evaluate(host, span)
            return captured(ctx, host, value, span) if has_value else Poison(span)


def elements_of(ctx: Context, static: Static) -> Sequence:
    """The elements of a captured tuple or list, each captured by itself."""
    ctx.guard_structure(static.host, static.object)
    return Sequence(
        tuple(
            captured(ctx, item_of(static.host, position, element), element, static.span)
            for position, element in enumerate(static.object)
        ),
        static.span,
    )


def item_of(host: HostExpr, index: int | str, element: Any) -> HostExpr:
    """The element of a captured object at ``index``; of a constant, such as a default argument, the element itself."""
    return HostConst(element) if isinstance(host, HostConst) else HostItem(host, index)


def _has(found: Any, name: str) -> bool:
    """Whether an object has an attribute, be it one that raises when it is read."""
    try:
        getattr(found, name)
    except AttributeError:
        return False
    except Exception:  # whatever the user's own property raises: reading it will say
        return True
    return True


_RELATION_FACTS = ("size", "shape", "ndim", "periodic", "name")


def _is_fixed_module(found: Any) -> bool:
    return found is math or (isinstance(found, ModuleType) and found.__name__ in ("ebb", "numpy"))


def _of_module(ctx: Context, module: ModuleType, owner: Static, name: str, span: Span) -> Value:
    """What ``math``, ``numpy`` or ``ebb`` has under a name. They do not change, so that nothing needs to be guarded."""
    value = getattr(module, name)
    if isinstance(value, bool | int | float):
        return Weak(HostConst(value), value, span)
    if isinstance(value, np.generic | np.ndarray):
        return captured(ctx, HostAttribute(owner.host, name), value, span)
    return Static(value, HostAttribute(owner.host, name), span)


def _array(ctx: Context, host: HostExpr, array: Any, span: Span) -> Value:
    scalar = from_dtype(array.dtype)
    if scalar is None:
        what, advice = f"an array of {array.dtype}", "convert it to a type that kernels have, such as float64"
        return ctx.poison(NoMeaning(span, describe(host), what, advice))
    if array.ndim > 2 or not 1 <= array.size <= _LARGEST:
        what = f"an array of the shape {array.shape}"
        advice = "load it into a field; a captured array is a small vector or matrix"
        return ctx.poison(NoMeaning(span, describe(host), what, advice))
    ctx.guard_array(host, array)
    return Typed(ctx.uniform(host, shaped_type(scalar, array.shape), span))
