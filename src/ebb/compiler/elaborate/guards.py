"""What a specialisation assumes of the host: checked before each launch, so it must be cheap to check.

A captured name is read at each launch. Where the kernel's code depends on more than the value of a number, a guard says
on what; when it no longer holds, the kernel is elaborated anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, cast

import numpy as np

from ebb.compiler.host import (
    HostAttempt,
    HostAttribute,
    HostCell,
    HostConst,
    HostExpr,
    HostGlobal,
    HostItem,
    HostOperation,
    HostParameter,
    evaluate,
)
from ebb.records import record
from ebb.types.rules import fits
from ebb.types.types import ScalarType

Reader: TypeAlias = Callable[[tuple[Any, ...]], Any]


@record
class IdentityGuard:
    """The expression still is that very object: a relation, a field, a function."""

    expr: HostExpr
    read: Reader
    value: Any

    def holds(self, parameters: tuple[Any, ...]) -> bool:
        try:
            return self.read(parameters) is self.value
        except Exception:  # whatever the host's attributes raise: elaborating again will say
            return False


@record
class TypeGuard:
    """A number still has that Python type."""

    expr: HostExpr
    read: Reader
    type: type

    def holds(self, parameters: tuple[Any, ...]) -> bool:
        try:
            return type(self.read(parameters)) is self.type
        except Exception:
            return False


@record
class ValueGuard:
    """A value that was needed at compile time still is that value."""

    expr: HostExpr
    read: Reader
    value: Any

    def holds(self, parameters: tuple[Any, ...]) -> bool:
        try:
            found = self.read(parameters)
            is_array = isinstance(found, np.ndarray)
            same: Any = np.array_equal(cast(Any, found), self.value) if is_array else found == self.value
            return type(found) is type(self.value) and bool(same)
        except Exception:
            return False


@record
class RangeGuard:
    """A Python integer still fits the type that it was given."""

    expr: HostExpr
    read: Reader
    type: ScalarType

    def holds(self, parameters: tuple[Any, ...]) -> bool:
        try:
            return fits(self.read(parameters), self.type)
        except Exception:
            return False


@record
class ArrayGuard:
    """A NumPy scalar or array still has that dtype and shape."""

    expr: HostExpr
    read: Reader
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    def holds(self, parameters: tuple[Any, ...]) -> bool:
        try:
            found = self.read(parameters)
            return found.dtype == self.dtype and found.shape == self.shape
        except Exception:
            return False


@record
class StructureGuard:
    """A tuple or list still has that many elements, of those types, at every depth."""

    expr: HostExpr
    read: Reader
    structure: Any

    def holds(self, parameters: tuple[Any, ...]) -> bool:
        try:
            return structure_of(self.read(parameters)) == self.structure
        except Exception:
            return False


Guard: TypeAlias = IdentityGuard | TypeGuard | ValueGuard | RangeGuard | ArrayGuard | StructureGuard


def structure_of(value: Any) -> Any:
    """The type of ``value``, for tuples and lists together with the structures of their elements."""
    if isinstance(value, tuple | list):
        elements = cast("tuple[Any, ...]", value)
        return (type(elements), *map(structure_of, elements))
    return cast("type[Any]", type(value))


def reader(expr: HostExpr) -> Reader:
    """A function that evaluates ``expr``, with the work of looking at its form done once."""
    match expr:
        case HostGlobal(name, namespace):
            return lambda parameters: namespace[name]
        case HostCell(_, cell):
            return lambda parameters: cell.cell_contents
        case HostParameter(_, position):
            return lambda parameters: parameters[position]
        case HostAttribute(base, name):
            owner = reader(base)
            return lambda parameters: getattr(owner(parameters), name)
        case HostItem(base, index):
            container = reader(base)
            return lambda parameters: container(parameters)[index]
        case _:
            return lambda parameters: evaluate(expr, parameters)


def host_identity(expr: HostExpr) -> Any:
    """What tells ``expr`` from other host expressions; unlike ``==`` it tells 1 from 1.0, True and -0.0 from 0.0."""
    match expr:
        case HostConst(value):
            return ("const", type(value), repr(value))
        case HostGlobal(name, namespace):
            return ("global", name, id(namespace))
        case HostCell(_, cell):
            return ("cell", id(cell))
        case HostParameter(_, position):
            return ("parameter", position)
        case HostAttribute(base, name):
            return ("attribute", host_identity(base), name)
        case HostItem(base, index):
            return ("item", host_identity(base), index)
        case HostOperation(op, operands):
            return ("operation", op, *map(host_identity, operands))
        case HostAttempt(operation, _):
            return ("attempt", host_identity(operation))
