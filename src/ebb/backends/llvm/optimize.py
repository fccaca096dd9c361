"""LLVM's own passes over an emitted module, by the form that a target takes."""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm

from ebb.backends.llvm.writer import VECTORS
from ebb.backends.target import Form, Target
from ebb.compiler.kir_verify import CompilerBug


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
            _pipeline(module, machine, loops=True, straight=VECTORS not in text)
        case Form.PTX:
            from ebb.backends.llvm.libdevice import link

            link(module)
            _pipeline(module, machine, loops=False, straight=False)
        case Form.SPIRV:
            from ebb.backends.llvm.spirv_passes import simplified

            module = simplified(module, machine)
    return module


def _pipeline(module: Any, machine: Any, *, loops: bool, straight: bool) -> None:
    """LLVM's O3; it makes vectors of ``loops``, and of ``straight`` code, which takes a third of the time.

    The threads of a group are vectors already. Where rows are, loops need not be unrolled but for those that ask for it
    (``unroll``). Other loops over what a query finds may gain a fifth by it.
    """
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = loops
    options.loop_interleaving = loops
    options.slp_vectorization = straight
    options.loop_unrolling = straight or not loops
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
