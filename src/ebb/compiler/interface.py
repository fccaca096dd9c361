"""What a launch must know of a program to run it: without its body, and small enough to be kept with its code."""

from __future__ import annotations

import marshal

from ebb.compiler import lir
from ebb.compiler.kir_key import KernelKey
from ebb.compiler.packing import Packing
from ebb.records import record


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
    return marshal.dumps((code, _PACKING.pack(interface, lambda thing: (_NAMED, numbers[id(thing)]))))


def unpacked(content: bytes, key: KernelKey) -> tuple[Interface, str]:
    """What was packed for some kernel of the text of ``key``, for the kernel that ``key`` is of."""
    code, tree = marshal.loads(content)
    return _PACKING.unpack(tree, {_NAMED: key.named.__getitem__}), code


_NAMED = "named"

_PACKING = Packing(
    (
        Interface, lir.Slot, lir.Argument, lir.Var, lir.FieldData, lir.GroupOffsets, lir.GroupRows, lir.RowOrder,
        lir.GlobalData, lir.Partials, lir.LaunchPositions, lir.PrintRecords, lir.UniformComponent, lir.Extent,
        lir.ColumnStride, lir.BlockCount,
    ),
    (lir.Space, lir.Access, lir.Memory, lir.RandomWord),
)  # fmt: skip
