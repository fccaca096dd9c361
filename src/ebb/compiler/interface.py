"""What a launch must know of a program to run it: without its body, and small enough to be kept with its code."""

from __future__ import annotations

import marshal
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, cast

from ebb.compiler import lir
from ebb.compiler.kir_key import KernelKey
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import SCALARS, ScalarType


@record
class Interface:
    """What stands behind the slots and arguments of a program, and what else its launches depend on.

    Attributes:
        space: how the rows are given.
        slots, arguments: those of the program.
        can_fail: whether some row may stop the launch.
        ahead_bytes: what a row reads of those of other lines, where rows go through more memory than caches hold.
    """

    space: lir.Space
    slots: tuple[lir.Slot, ...]
    arguments: tuple[lir.Argument, ...]
    can_fail: bool
    ahead_bytes: int


def interface_of(program: lir.Program) -> Interface:
    """What a launch must know of ``program``."""
    ahead = () if program.streams is None else program.streams.ahead
    ahead_bytes = sum(place.size * place.slot.type.bits // 8 for place in ahead)
    return Interface(program.space, program.slots, program.arguments, bool(program.sites), ahead_bytes)


def packed(interface: Interface, code: str, key: KernelKey) -> bytes:
    """``interface`` and the name of the code as bytes, which have numbers of ``key`` for fields, relations, globals."""
    numbers = {id(each): number for number, each in enumerate(key.named)}
    return marshal.dumps((code, _pack(interface, numbers)))


def unpacked(content: bytes, key: KernelKey) -> tuple[Interface, str]:
    """What was packed for some kernel of the text of ``key``, for the kernel that ``key`` is of."""
    code, tree = marshal.loads(content)
    return _unpack(tree, key.named), code


# What is packed is a tree: a tuple begins with what makes the thing of the rest, a list stands for a tuple.

_NAMED = "named"
_SCALAR = "scalar"

_RECORDS: tuple[type[Any], ...] = (
    Interface, lir.Slot, lir.Argument, lir.Var, lir.FieldData, lir.GroupOffsets, lir.GroupRows, lir.RowOrder,
    lir.GlobalData, lir.Partials, lir.LaunchPositions, lir.PrintRecords, lir.UniformComponent, lir.Extent,
    lir.ColumnStride, lir.BlockCount,
)  # fmt: skip

_OPTIONS: tuple[type[Enum], ...] = (lir.Space, lir.Access, lir.Memory, lir.RandomWord)

_MAKERS: Mapping[str, Callable[..., Any]] = {
    **{kind.__name__: kind for kind in _RECORDS},
    **{kind.__name__: {option.value: option for option in kind}.__getitem__ for kind in _OPTIONS},
    _SCALAR: {scalar.name: scalar for scalar in SCALARS}.__getitem__,
}


def _pack(thing: Any, numbers: Mapping[int, int]) -> Any:
    match thing:
        case bool() | int() | str():
            return thing
        case tuple():
            return [_pack(part, numbers) for part in cast("tuple[Any, ...]", thing)]
        case Field() | Relation() | Global():
            return _NAMED, numbers[id(thing)]
        case ScalarType():
            return _SCALAR, thing.name
        case Enum():
            return type(thing).__name__, thing.value
        case _:
            return type(thing).__name__, *[_pack(getattr(thing, name), numbers) for name in thing.__match_args__]


def _unpack(tree: Any, named: tuple[Any, ...]) -> Any:
    if isinstance(tree, list):
        return tuple([_unpack(part, named) for part in cast("list[Any]", tree)])
    if not isinstance(tree, tuple):
        return tree
    maker, *rest = cast("tuple[Any, ...]", tree)
    if maker == _NAMED:
        return named[rest[0]]
    return _MAKERS[maker](*[_unpack(part, named) if isinstance(part, list | tuple) else part for part in rest])
