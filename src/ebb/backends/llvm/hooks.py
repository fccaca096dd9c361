"""What differs between targets in the LLVM IR that is emitted: a target is one row of hooks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum

from ebb.backends.llvm.vector_math import VectorForms, vector_forms
from ebb.records import record, replace

_INTRINSICS = (
    "sqrt", "exp", "exp2", "log", "log2", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh",
    "tanh", "floor", "ceil", "trunc", "pow", "atan2", "copysign",
)  # fmt: skip
_LIBM = ("cbrt", "expm1", "log1p", "asinh", "acosh", "atanh", "hypot", "erf", "erfc", "lgamma")


class Strips(Enum):
    """Whether loops run several turns at once, in vectors of the emitter's own making."""

    NONE = "none"
    MASKED = "masked"
    """Where vector loads under a mask are instructions."""


@record
class Hooks:
    """The names and attributes that one kind of target wants.

    Attributes:
        math: the function that computes each function of ``lir.MATH`` on floats; ``{type}`` stands for LLVM's ``f32``
            or ``f64``, ``{suffix}`` for C's ``f`` or nothing.
        attributes: the attributes of the functions that loop over rows.
        strips: which loops run in strips.
        vector_math: the functions that the target has for several values at once.
    """

    math: Mapping[str, str]
    attributes: str
    strips: Strips
    vector_math: VectorForms


CPU = Hooks(
    math={name: f"llvm.{name}.{{type}}" for name in _INTRINSICS}
    | {"abs": "llvm.fabs.{type}", "round": "llvm.rint.{type}", "gamma": "tgamma{suffix}"}
    | {name: f"{name}{{suffix}}" for name in _LIBM},
    attributes='nounwind "prefer-vector-width"="512" "no-trapping-math"="true"',
    strips=Strips.NONE,
    vector_math={},
)

STRIPS_FEATURE = "+avx2"
"""What a processor must have for strips to be quicker than plain loops."""


def cpu_hooks(features: str, vector_math: Iterable[tuple[int, int]]) -> Hooks:
    """The hooks of a processor.

    Args:
        features: what it has, as LLVM spells it.
        vector_math: the versions of the library of vector functions that are there.
    """
    strips = Strips.MASKED if STRIPS_FEATURE in features.split(",") else Strips.NONE
    return replace(CPU, strips=strips, vector_math=vector_forms(features, vector_math))
