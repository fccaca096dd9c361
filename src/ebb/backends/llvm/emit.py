"""LIR to LLVM IR, as text."""

from __future__ import annotations

from ebb.backends.llvm.block import write_block
from ebb.backends.llvm.group import write_kernels
from ebb.backends.llvm.hooks import Hooks
from ebb.backends.llvm.writer import ModuleWriter
from ebb.compiler import lir


def emit(program: lir.Program, hooks: Hooks) -> str:
    """The LLVM module of ``program`` for the target of ``hooks``.

    Its entries are those of ``write_entries`` where a thread takes a block, and ``program.entries`` where a group does.
    """
    module = ModuleWriter(hooks)
    if program.group_size is None:
        write_block(program, module)
    else:
        write_kernels(program, module)
    return module.text()
