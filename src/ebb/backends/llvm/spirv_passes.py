"""What LLVM does to a module before it becomes SPIR-V.

OpenCL's drivers optimise what they are given, so a few passes that make it small are enough. More would do harm: the
loop passes and vectorisers make integers of odd widths, vectors and overflow intrinsics, which LLVM's SPIR-V target
translates wrongly without a word, or ends the process. Where even the few make such things, fewer run.
"""

from __future__ import annotations

import re
from typing import Any

import llvmlite.binding as llvm

from ebb.compiler.kir_verify import CompilerBug


class Untranslatable(CompilerBug):
    """The module has what SPIR-V has not."""


_WIDTHS = frozenset({1, 8, 16, 32, 64})

_INTEGER = re.compile(r"(?<![\w%@.!-])i(\d+)(?![\w.:])")
_VECTOR = re.compile(r"<\d+ x \w+>")
_INTRINSIC = re.compile(r"@llvm\.([a-z.]+?)(?:\.[fip]\d|\()")

_METADATA = re.compile(r"^!.*$", re.MULTILINE)

_INTRINSICS = frozenset({
    "abs", "smin", "smax", "umin", "umax", "fabs", "sqrt", "floor", "ceil", "trunc", "rint", "copysign", "fma",
    "fshl", "fshr", "ctpop", "cttz", "ctlz", "bswap", "bitreverse", "uadd.sat", "usub.sat", "sadd.sat", "ssub.sat",
    "scmp", "ucmp", "memset", "assume", "minnum", "maxnum", "is.fpclass",
})  # fmt: skip
"""The intrinsics that were seen to be translated rightly."""


def simplified(module: Any, machine: Any) -> Any:
    """``module``, which is changed, or another one that does the same and becomes the same in SPIR-V.

    Raises:
        Untranslatable: there is no such module.
    """
    written = module.clone()
    _simplify(module, machine)
    if _faults(module):  # such as a test for an overflow, which LLVM knows, or six bytes turned round
        module = written
        _tidy(module, machine)
        check(module)
    return module


def _tidy(module: Any, machine: Any) -> None:
    """Inlines calls and puts variables into registers. Nothing else becomes of the instructions that were emitted."""
    passes = llvm.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_sroa_pass()
    passes.add_aggressive_dce_pass()
    passes.add_simplify_cfg_pass()
    passes.run(module, _builder(machine))


def _simplify(module: Any, machine: Any) -> None:
    """Inlines calls, puts variables into registers, unrolls small loops, and folds what follows."""
    passes = llvm.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.add_global_dead_code_eliminate_pass()
    for _ in range(2):
        passes.add_sroa_pass()
        passes.add_instruction_combine_pass()
        passes.add_simplify_cfg_pass()
        passes.add_loop_unroll_pass()
    passes.add_sroa_pass()
    passes.add_sccp_pass()
    passes.add_instruction_combine_pass()
    passes.add_dead_store_elimination_pass()
    passes.add_aggressive_dce_pass()
    passes.add_simplify_cfg_pass()
    passes.run(module, _builder(machine))


def _builder(machine: Any) -> Any:
    return llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))


def check(module: Any) -> None:
    """Refuses what would not become the same in SPIR-V.

    Raises:
        Untranslatable: there is such a thing in ``module``.
    """
    wrong = _faults(module)
    if wrong:
        raise Untranslatable(f"{', '.join(sorted(wrong))} in\n{module}")


def _faults(module: Any) -> set[str]:
    """What is in ``module`` that SPIR-V has not."""
    text = _METADATA.sub("", str(module))
    wrong = {f"i{width}" for width in _INTEGER.findall(text) if int(width) not in _WIDTHS}
    wrong.update(_VECTOR.findall(text))
    wrong.update(f"llvm.{name}" for name in _INTRINSIC.findall(text) if name not in _INTRINSICS)
    return wrong
