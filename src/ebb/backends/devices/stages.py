"""Programs for devices as text, with or without such a device."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ebb.backends.backend import CheckedKernel
from ebb.backends.compile import stage_text
from ebb.backends.kernel_code import Lowering, launched_as, precision_of
from ebb.backends.target import Target, nvptx, spirv
from ebb.compiler import lir
from ebb.compiler.lower import facts_of

_TARGETS: Mapping[str, Callable[[], Target]] = {"ptx": lambda: nvptx(80), "spirv": spirv}
"""What each stage of ``ANYWHERE`` is for where there is no device to ask."""


def text_without_device(checked: CheckedKernel, stage: str) -> str:
    """The stage ``ptx`` or ``spirv`` of a kernel for a launch on all rows, whatever the backend is.

    Raises:
        BackendError: what it takes to compile for such a device is not installed.
    """
    kernel = checked.kernel
    lowering = Lowering(precision_of(checked.hints), lir.Updates.ATOMIC, checked.hints.block_size)
    program = lowering.lower(checked.step, facts_of(kernel), launched_as(kernel.relation))
    return stage_text(program, _TARGETS[stage](), stage)
