"""Values that the host computes at each launch and passes to the kernel as uniforms.

A captured number is read when the kernel is launched, as Python reads it, and arithmetic among Python numbers stays
Python's: ``0.5 * dt * dt`` is evaluated in Python and then converted to the type that its surroundings need.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from types import CellType
from typing import Any, TypeAlias

from ebb.records import field, record
from ebb.types.types import Type


@record
class HostConst:
    """A literal."""

    value: Any


@record
class HostCell:
    """A captured variable of an enclosing function."""

    name: str
    cell: CellType


@record(eq=False)
class HostGlobal:
    """A global variable of the module that defines the kernel."""

    name: str
    namespace: Mapping[str, Any] = field(repr=False)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HostGlobal) and other.name == self.name and other.namespace is self.namespace

    def __hash__(self) -> int:
        return hash((self.name, id(self.namespace)))


@record
class HostParameter:
    """A further parameter of the kernel, by its position after the row."""

    name: str
    position: int


@record
class HostAttribute:
    base: HostExpr
    name: str


@record
class HostItem:
    base: HostExpr
    index: int | str | tuple[int, ...]


@record
class HostOperation:
    """An operator of ``HOST_OPERATORS``, or a call of the Python function ``op`` (of ``math``, say)."""

    op: str | Callable[..., Any]
    operands: tuple[HostExpr, ...]


@record
class HostAttempt:
    """An operation that rows may never come to: ``otherwise`` where Python would raise, or gives no real number."""

    operation: HostOperation
    otherwise: int | float


HostExpr: TypeAlias = (
    HostConst | HostCell | HostGlobal | HostParameter | HostAttribute | HostItem | HostOperation | HostAttempt
)


@record
class HostValue:
    """A uniform: what the host evaluates, and the type as which the kernel gets it."""

    expr: HostExpr
    type: Type


_NAMES = {
    "+": "add",
    "-": "sub",
    "*": "mul",
    "/": "truediv",
    "//": "floordiv",
    "%": "mod",
    "**": "pow",
    "&": "and_",
    "|": "or_",
    "^": "xor",
    "<<": "lshift",
    ">>": "rshift",
    "==": "eq",
    "!=": "ne",
    "<": "lt",
    "<=": "le",
    ">": "gt",
    ">=": "ge",
    "neg": "neg",
    "pos": "pos",
    "invert": "invert",
    "not": "not_",
}

#: The operators of Python by their symbols.
HOST_OPERATORS: Mapping[str, Callable[..., Any]] = {symbol: getattr(operator, name) for symbol, name in _NAMES.items()}

_PREFIXES = {"neg": "-", "pos": "+", "invert": "~", "not": "not "}


def evaluate(expr: HostExpr, parameters: tuple[Any, ...]) -> Any:
    """The value of ``expr`` now.

    Raises:
        NameError: a captured name is unset.
        AttributeError, IndexError, ArithmeticError: as Python would.
    """
    match expr:
        case HostConst(value):
            return value
        case HostCell(name, cell):
            try:
                return cell.cell_contents
            except ValueError:
                raise NameError(f"name {name!r} has no value yet") from None
        case HostGlobal(name, namespace):
            return _global(name, namespace)
        case HostParameter(_, position):
            return parameters[position]
        case HostAttribute(base, name):
            return getattr(evaluate(base, parameters), name)
        case HostItem(base, index):
            return evaluate(base, parameters)[index]
        case HostOperation():
            return _operate(expr, parameters)
        case HostAttempt(operation, otherwise):
            return _attempt(operation, otherwise, parameters)


def _global(name: str, namespace: Mapping[str, Any]) -> Any:
    if name in namespace:
        return namespace[name]
    raise NameError(f"name {name!r} is not defined")


def _operate(operation: HostOperation, parameters: tuple[Any, ...]) -> Any:
    function = HOST_OPERATORS[operation.op] if isinstance(operation.op, str) else operation.op
    return function(*(evaluate(operand, parameters) for operand in operation.operands))


def _attempt(operation: HostOperation, otherwise: int | float, parameters: tuple[Any, ...]) -> int | float:
    try:
        value = _operate(operation, parameters)
    except (ArithmeticError, ValueError):
        return otherwise
    return value if isinstance(value, int | float) else otherwise


def describe(expr: HostExpr) -> str:
    """``expr`` as Python source, for IR dumps and messages."""
    match expr:
        case HostAttempt(operation, _):
            return describe(operation)
        case HostConst(value):
            return repr(value)
        case HostCell(name, _) | HostGlobal(name, _) | HostParameter(name, _):
            return name
        case HostAttribute(base, name):
            return f"{describe(base)}.{name}"
        case HostItem(base, index):
            return f"{describe(base)}[{index!r}]"
        case HostOperation(op, (operand,)) if isinstance(op, str):
            return f"{_PREFIXES[op]}{describe(operand)}"
        case HostOperation(op, (left, right)) if isinstance(op, str):
            return f"({describe(left)} {op} {describe(right)})"
        case HostOperation(op, operands):
            name = op if isinstance(op, str) else op.__name__
            return f"{name}({', '.join(describe(operand) for operand in operands)})"
