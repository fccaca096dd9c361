"""LLVM's own passes over an emitted module, by the form that a target takes."""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm

from ebb.backends.llvm.writer import SERIAL, VECTORS
from ebb.backends.target import Form, Target
from ebb.compiler.kir_verify import CompilerBug
from ebb.records import record


class BadModule(CompilerBug):
    """LLVM does not take the IR that was emitted: a fault of the compiler, never of the user."""


def optimize(text: str, target: Target) -> Any:
    """The module of ``text`` after LLVM's passes, for the machine of ``target``.

    Raises:
        BadModule: the text is no valid module.
        BackendError: a library that it calls is not installed.
    """
    machine = target.machine
    try:
        module = llvm.parse_assembly(text)
        module.triple = target.triple
        module.data_layout = str(machine.target_data)
        module.verify()
    except RuntimeError as error:
        raise BadModule(f"{error}\n{text}") from None
    match target.form:
        case Form.OBJECT:
            _run(_passes(text), module, machine)
        case Form.PTX:
            from ebb.backends.llvm.libdevice import link

            link(module)
            _run(_OF_GROUPS, module, machine)
        case Form.SPIRV:
            from ebb.backends.llvm.spirv_passes import simplified

            module = simplified(module, machine)
    return module


@record
class _Passes:
    """What LLVM looks for.

    Attributes:
        level: of 3, how much it does besides.
        loops: whether it makes vectors of loops.
        straight: whether it makes vectors of straight code.
        unrolls: whether it unrolls other loops than those that ask for it (``unroll``).
    """

    level: int
    loops: bool
    straight: bool
    unrolls: bool


_OF_GROUPS = _Passes(level=3, loops=False, straight=False, unrolls=True)
"""The threads of a group are vectors already."""

_PASSES = {
    VECTORS: _Passes(level=3, loops=True, straight=False, unrolls=False),
    SERIAL: _Passes(level=2, loops=False, straight=True, unrolls=False),
}
"""By the mark of the module, the first that it has. What is left out takes a third of the time, or half."""

_OF_ROWS = _Passes(level=3, loops=True, straight=True, unrolls=True)
"""Loops over what a query finds may gain a fifth by being unrolled."""


def _passes(text: str) -> _Passes:
    return next((passes for mark, passes in _PASSES.items() if mark in text), _OF_ROWS)


def _run(passes: _Passes, module: Any, machine: Any) -> None:
    """LLVM's own pipeline."""
    options = llvm.create_pipeline_tuning_options(speed_level=passes.level)
    options.loop_vectorization = passes.loops
    options.loop_interleaving = passes.loops
    options.slp_vectorization = passes.straight
    options.loop_unrolling = passes.unrolls
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
