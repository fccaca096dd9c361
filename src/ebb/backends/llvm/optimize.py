"""LLVM's own pipeline over an emitted module, and the object code of a target."""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm

from ebb.backends.target import Target
from ebb.compiler.kir_verify import CompilerBug


class BadModule(CompilerBug):
    """LLVM does not take the IR that was emitted: a fault of the compiler, never of the user."""


def optimize(text: str, target: Target) -> Any:
    """The module of ``text`` after LLVM's O3 pipeline with both vectorisers, for the machine of ``target``.

    Raises:
        BadModule: the text is no valid module.
    """
    machine = target.machine
    try:
        module = llvm.parse_assembly(text)
        module.triple = target.triple
        module.data_layout = str(machine.target_data)
        module.verify()
    except RuntimeError as error:
        raise BadModule(f"{error}\n{text}") from None
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = True
    options.slp_vectorization = True
    options.loop_interleaving = True
    options.loop_unrolling = True
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return module
