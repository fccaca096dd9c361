"""The functions of the C library that machine code may call: mathematics, and what LLVM itself brings in."""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Mapping
from functools import cache

import llvmlite.binding as llvm

_MATH = (
    "sqrt", "cbrt", "exp", "exp2", "exp10", "expm1", "log", "log2", "log10", "log1p", "pow", "sin", "cos",
    "sincos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "hypot",
    "fmod", "floor", "ceil", "trunc", "rint", "round", "roundeven", "nearbyint", "fma", "fmin", "fmax", "ldexp",
    "frexp", "copysign", "fabs", "erf", "erfc", "tgamma", "lgamma",
)  # fmt: skip
_MEMORY = ("memcpy", "memmove", "memset")


@cache
def external_symbols() -> Mapping[str, int]:
    """The address of each function, by the name under which object code refers to it."""
    names = [*_MEMORY, *(name + suffix for name in _MATH for suffix in ("", "f"))]
    found = {name: _address(name) for name in names}
    return {name: address for name, address in found.items() if address is not None}


def _address(name: str) -> int | None:
    for library in _libraries():
        function = getattr(library, name, None)
        if function is not None:
            return ctypes.cast(function, ctypes.c_void_p).value
    address: int | None = llvm.address_of_symbol(name)
    return address


@cache
def _libraries() -> tuple[ctypes.CDLL, ...]:
    names = [ctypes.util.find_library("m"), None]
    result: list[ctypes.CDLL] = []
    for name in names:
        try:
            result.append(ctypes.CDLL(name))
        except (OSError, TypeError):
            continue
    return tuple(result)
