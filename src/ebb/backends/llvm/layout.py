"""Where the slots and arguments of a program stand in the argument block of ``ebb.runtime.cpu``."""

from __future__ import annotations

from ebb.compiler import lir
from ebb.compiler.interface import Interface
from ebb.records import record
from ebb.runtime.cpu import HEADER_WORDS


@record
class BlockLayout:
    """The words of one program's argument block: where the slots and the arguments begin, and how many there are."""

    slots: int
    arguments: int
    words: int


def layout_of(program: lir.Program | Interface) -> BlockLayout:
    """The layout of the argument block of ``program``."""
    arguments = HEADER_WORDS + len(program.slots)
    return BlockLayout(slots=HEADER_WORDS, arguments=arguments, words=arguments + len(program.arguments))
