"""Random numbers in LIR: the Philox rounds of ``ebb.runtime.random``, on values of the row."""

from __future__ import annotations

import math

from ebb.compiler import kir, lir
from ebb.compiler.lower.builder import Builder, number
from ebb.compiler.lower.context import Context
from ebb.compiler.lower.keys import identity
from ebb.runtime.random import MULTIPLIERS, ROUNDS, WEYL
from ebb.types.types import ScalarType, float32, int64, uint64

_MASK = 0xFFFFFFFF


def draw(ctx: Context, node: kir.Random) -> lir.Value:
    """The row's next random number."""
    assert ctx.row is not None and ctx.drawn is not None and isinstance(node.type, ScalarType)
    b, scalar = ctx.build, node.type
    words = _philox(ctx)
    u = _uniform(b, words[0], words[1], scalar)
    if node.distribution == "rand":
        return u
    v = _uniform(b, words[2], words[3], scalar)
    logarithm = b.math("log", b.binary("-", number(1.0, scalar), u))
    radius = b.math("sqrt", b.binary("*", number(-2.0, scalar), logarithm))
    return b.binary("*", radius, b.math("cos", b.binary("*", number(2.0 * math.pi, scalar), v)))


def _philox(ctx: Context) -> list[lir.Value]:
    """Four 32-bit words, as uint64."""
    b = ctx.build
    assert ctx.row is not None and ctx.drawn is not None
    row = b.convert(identity(ctx, ctx.kernel.relation, ctx.row), uint64)
    drawn = b.load_var(ctx.drawn)
    b.store_var(ctx.drawn, 0, b.binary("+", drawn, _word(1)))
    counter = [_low(b, row), _high(b, row), ctx.random_word(lir.RandomWord.LAUNCH), _low(b, drawn)]
    key = [ctx.random_word(lir.RandomWord.SEED_LOW), ctx.random_word(lir.RandomWord.SEED_HIGH)]
    for _ in range(ROUNDS):
        first = b.binary("*", counter[0], _word(MULTIPLIERS[0]))
        second = b.binary("*", counter[2], _word(MULTIPLIERS[1]))
        counter = [
            b.binary("^", b.binary("^", _high(b, second), counter[1]), key[0]),
            _low(b, second),
            b.binary("^", b.binary("^", _high(b, first), counter[3]), key[1]),
            _low(b, first),
        ]
        key = [_low(b, b.binary("+", word, _word(step))) for word, step in zip(key, WEYL, strict=True)]
    return counter


def _uniform(b: Builder, first: lir.Value, second: lir.Value, scalar: ScalarType) -> lir.Value:
    if scalar == float32:
        bits, unit = b.binary(">>", first, _word(8)), 2.0**-24
    else:
        both = b.binary("|", b.binary("<<", first, _word(32)), second)
        bits, unit = b.binary(">>", both, _word(11)), 2.0**-53
    return b.binary("*", b.convert(b.convert(bits, int64), scalar), number(unit, scalar))


def _word(value: int) -> lir.Literal:
    return lir.Literal(value, uint64)


def _low(b: Builder, word: lir.Value) -> lir.Value:
    return b.binary("&", word, _word(_MASK))


def _high(b: Builder, word: lir.Value) -> lir.Value:
    return b.binary(">>", word, _word(32))
