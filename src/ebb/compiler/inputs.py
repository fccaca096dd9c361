"""What a launch takes of the host, in few steps: whether its guards hold, and the values of its uniforms.

Each launch of a program does this in Python, so what it has to do is compiled once into a list of checks and a list of
readers. The forms of most launches have some of their own: a captured number, a number as a parameter, captured
relations. Whatever has no simple form, and every error, is left to the way that a first launch takes.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from ebb.compiler.arguments import uniform_value
from ebb.compiler.elaborate.guards import Guard, IdentityGuard, Reader, TypeGuard, host_identity, reader
from ebb.compiler.elaborate.parameters import FieldName, ParameterType
from ebb.compiler.host import HostCell, HostExpr, HostGlobal, HostParameter, HostValue
from ebb.types.types import Kind, ScalarType, Type, bool_, float64, int32

_Parameters: TypeAlias = tuple[Any, ...]
_Check: TypeAlias = Callable[[_Parameters], bool]
_Declared: TypeAlias = Type | type[str] | None

_PYTHON_TYPES = {Kind.BOOL: bool, Kind.SIGNED: int, Kind.UNSIGNED: int, Kind.FLOAT: float}
_BARE = (bool_, int32, float64)
"""The types that bare parameters have by the Python type of their argument alone, in its range."""

_ROUNDED_ONCE = range(-(2**53), 2**53 + 1)
"""The integers that become a float of any width as if rounded once."""

_FLOATS: Mapping[type, range | None] = {float: None, np.float64: None, np.float32: None, int: _ROUNDED_ONCE}
"""What a float is made of without further ado, and the limits of what is."""


class _UnmetError(Exception):
    """A value is not of the form that its reader was made for."""


class Inputs:
    """The parameters, guards and uniforms of one specialisation."""

    __slots__ = ("_checks", "_count", "_readers")

    def __init__(
        self,
        kernel: str,
        parameters: tuple[tuple[ParameterType, _Declared], ...],
        guards: tuple[Guard, ...],
        uniforms: tuple[HostValue, ...],
    ) -> None:
        """Compiles what the launches of ``kernel`` take.

        Args:
            kernel: the name.
            parameters: the type of each, and what it was declared as.
            guards: what the specialisation assumes.
            uniforms: what the host evaluates.
        """
        floats = {host_identity(guard.expr) for guard in guards if isinstance(guard, TypeGuard) and guard.type is float}
        floats.update([("parameter", i) for i, each in enumerate(parameters) if each == (float64, None)])
        asked = {host_identity(each.expr) for each in uniforms if _is_float(each.type)}
        read = floats & asked
        self._count = len(parameters)
        self._readers = [_reader(kernel, each, host_identity(each.expr) in read) for each in uniforms]
        # The reader of a float looks at its type itself, and that of a declared float at what it takes.
        left = [g for g in guards if not (isinstance(g, TypeGuard) and host_identity(g.expr) in read)]
        read |= asked & {("parameter", i) for i, each in enumerate(parameters) if _is_declared_float(*each)}
        self._checks = (
            *[_parameter_check(i, *each) for i, each in enumerate(parameters) if ("parameter", i) not in read],
            *_identity_checks(left),
            *[guard.holds for guard in left if not _is_of_global(guard)],
        )

    def take(self, parameters: _Parameters) -> list[Any] | None:
        """The values of the uniforms, or None: a guard fails, or something has no simple form or cannot be evaluated.

        Returns:
            For a scalar a number of the kind of its type, a Python float perhaps with more digits; else an array.
        """
        if len(parameters) != self._count:
            return None
        try:
            for holds in self._checks:
                if not holds(parameters):
                    return None
            return [read(parameters) for read in self._readers]
        except Exception:  # whatever the host's attributes raise: the long way will say
            return None


# ---- Checks. ----


def _parameter_check(position: int, type_: ParameterType, declared: _Declared) -> _Check:
    """Whether the argument at ``position`` surely has the type ``type_``, as ``argument_type`` and its like say."""
    if isinstance(type_, FieldName):
        return lambda parameters: type(parameters[position]) is str and parameters[position] == type_.name
    if not isinstance(type_, ScalarType) or (declared is None and type_ not in _BARE):
        return lambda parameters: False
    python_type = _PYTHON_TYPES[type_.kind]
    if python_type is not int:
        return lambda parameters: type(parameters[position]) is python_type
    limits = _limits(type_)
    return lambda parameters: type(parameters[position]) is int and parameters[position] in limits


def _identity_checks(guards: list[Guard]) -> list[_Check]:
    """The guards that global names still are what they were, those of one namespace in one check."""
    expected: dict[int, tuple[Mapping[str, Any], dict[str, Any]]] = {}
    for guard in guards:
        if isinstance(guard, IdentityGuard) and isinstance(guard.expr, HostGlobal):
            namespace = guard.expr.namespace
            expected.setdefault(id(namespace), (namespace, {}))[1][guard.expr.name] = guard.value
    return [_same_objects(namespace, objects) for namespace, objects in expected.values()]


def _same_objects(namespace: Mapping[str, Any], expected: dict[str, Any]) -> _Check:
    if len(expected) == 1:
        ((name, value),) = expected.items()
        return lambda parameters: namespace[name] is value
    find, values = operator.itemgetter(*expected), tuple(expected.values())
    return lambda parameters: all(map(operator.is_, find(namespace), values))


def _is_of_global(guard: Guard) -> bool:
    return isinstance(guard, IdentityGuard) and isinstance(guard.expr, HostGlobal)


def _is_declared_float(type_: ParameterType, declared: _Declared) -> bool:
    """Whether a parameter takes all numbers that its uniform, which a declared parameter has, takes without ado."""
    return declared is not None and isinstance(type_, ScalarType) and type_.kind is Kind.FLOAT


# ---- Readers. ----


def _reader(kernel: str, uniform: HostValue, is_float: bool) -> Reader:
    """What gives the value of ``uniform``, whose expression is a Python float or, if not ``is_float``, anything."""
    type_ = uniform.type
    if not isinstance(type_, ScalarType):
        return lambda parameters: uniform_value(kernel, uniform, parameters)
    if is_float:
        return _float_reader(uniform.expr)
    match type_.kind:
        case Kind.BOOL:
            return _number_reader(uniform.expr, {bool: None})
        case Kind.FLOAT:
            return _number_reader(uniform.expr, _FLOATS)
        case Kind.SIGNED | Kind.UNSIGNED:
            return _number_reader(uniform.expr, {int: _limits(type_)})


def _float_reader(expr: HostExpr) -> Reader:
    """What gives the value of ``expr`` as long as it is a Python float; the forms of most programs have their own."""

    def from_global(parameters: _Parameters) -> float:
        value = namespace[name]
        if type(value) is float:
            return value
        raise _UnmetError

    def from_cell(parameters: _Parameters) -> float:
        value = cell.cell_contents
        if type(value) is float:
            return value
        raise _UnmetError

    def from_parameter(parameters: _Parameters) -> float:
        value = parameters[position]
        if type(value) is float:
            return value
        raise _UnmetError

    match expr:
        case HostGlobal(name, namespace):
            return from_global
        case HostCell(_, cell):
            return from_cell
        case HostParameter(_, position):
            return from_parameter
        case _:
            return _number_reader(expr, {float: None})


def _number_reader(expr: HostExpr, accepted: Mapping[type, range | None]) -> Reader:
    """What gives the value of ``expr`` as long as it is of one of these very types, and within its limits."""
    read = reader(expr)

    def from_anything(parameters: _Parameters) -> Any:
        value = read(parameters)
        limits = accepted[type(value)]
        if limits is None or value in limits:
            return value
        raise _UnmetError

    return from_anything


def _is_float(type_: Type) -> bool:
    return isinstance(type_, ScalarType) and type_.kind is Kind.FLOAT


def _limits(type_: ScalarType) -> range:
    """The integers that the type holds."""
    found = np.iinfo(type_.dtype)
    return range(int(found.min), int(found.max) + 1)
