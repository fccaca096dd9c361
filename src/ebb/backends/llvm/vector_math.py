"""The vector functions of glibc's libmvec, by the names of the x86-64 vector function ABI.

A call of a scalar function lists its vector forms, and LLVM's vectorisers take the one that fits. They are right within
4 units in the last place, where the scalar ones are within 1 or 2.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ebb.records import record

_SINCE = {
    (2, 22): {"sin": 1, "cos": 1, "exp": 1, "log": 1, "pow": 2},
    (2, 35): {
        "acos": 1, "acosh": 1, "asin": 1, "asinh": 1, "atan": 1, "atanh": 1, "cbrt": 1, "cosh": 1, "erf": 1, "erfc": 1,
        "exp2": 1, "expm1": 1, "log10": 1, "log1p": 1, "log2": 1, "sinh": 1, "tan": 1, "tanh": 1,
        "atan2": 2, "hypot": 2,
    },
}  # fmt: skip
"""How many operands each function takes, by the version of glibc that brought it."""

VERSIONS: Mapping[tuple[int, int], str] = {version: f"_ZGVbN2v_{min(names)}" for version, names in _SINCE.items()}
"""A symbol that tells whether libmvec is of a version, or later."""

_REGISTERS = {"+sse4.1": ("b", 128), "+avx2": ("d", 256), "+avx512f": ("e", 512)}
"""The letter of the ABI and the bits of a register, by the feature that has them."""


@record
class VectorForm:
    """A function that computes several values at once.

    Attributes:
        symbol: its name.
        lanes: how many values.
        operands: how many operands.
    """

    symbol: str
    lanes: int
    operands: int

    def variant(self, scalar: str) -> str:
        """How a call of the function ``scalar`` names this form of it."""
        return f"_ZGV_LLVM_N{self.lanes}{'v' * self.operands}_{scalar}({self.symbol})"


VectorForms = Mapping[tuple[str, int], tuple[VectorForm, ...]]
"""The forms of a function for floats of so many bits, narrow ones first."""


def vector_forms(features: str, versions: Iterable[tuple[int, int]]) -> VectorForms:
    """The forms that a processor with ``features``, as LLVM spells them, has in a libmvec of ``versions``."""
    named = features.split(",")
    registers = [register for feature, register in _REGISTERS.items() if feature in named]
    functions = {name: operands for version in versions for name, operands in _SINCE[version].items()}
    return {
        (name, bits): tuple(_form(name, operands, bits, *register) for register in registers)
        for name, operands in functions.items()
        for bits in (32, 64)
        if registers
    }


def _form(name: str, operands: int, bits: int, letter: str, register_bits: int) -> VectorForm:
    lanes = register_bits // bits
    symbol = f"_ZGV{letter}N{lanes}{'v' * operands}_{name}{'f' if bits == 32 else ''}"
    return VectorForm(symbol, lanes, operands)
