"""What differs between targets in the LLVM IR that is emitted: a target is one row of hooks."""

from __future__ import annotations

from collections.abc import Mapping

from ebb.records import record

_INTRINSICS = (
    "sqrt", "exp", "exp2", "log", "log2", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh",
    "tanh", "floor", "ceil", "trunc", "pow", "atan2", "copysign",
)  # fmt: skip
_LIBM = ("cbrt", "expm1", "log1p", "asinh", "acosh", "atanh", "hypot", "erf", "erfc", "lgamma")


@record
class Hooks:
    """The names and attributes that one kind of target wants.

    Attributes:
        name: the kind of target.
        math: the function that computes each function of ``lir.MATH`` on floats; ``{type}`` stands for LLVM's ``f32``
            or ``f64``, ``{suffix}`` for C's ``f`` or nothing.
        attributes: the attributes of the functions that loop over rows.
    """

    name: str
    math: Mapping[str, str]
    attributes: str


CPU = Hooks(
    name="cpu",
    math={name: f"llvm.{name}.{{type}}" for name in _INTRINSICS}
    | {"abs": "llvm.fabs.{type}", "round": "llvm.rint.{type}", "gamma": "tgamma{suffix}"}
    | {name: f"{name}{{suffix}}" for name in _LIBM},
    attributes='nounwind "prefer-vector-width"="512" "no-trapping-math"="true"',
)
