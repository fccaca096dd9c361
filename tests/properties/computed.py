"""Random expressions of kernels, each with what it comes to in NumPy, on all rows at once, and how exact that is.

Conditions compare integers, or floats that nothing has rounded yet, so that all sides agree on them. Other floats agree
within an error that is carried along: see ``Value.size``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

Array = np.ndarray[Any, Any]

MOST = 1e4
"""Values beyond this are made smaller: so that nothing overflows, and errors stay what they are."""


@dataclass
class Value:
    """An expression: its text, and what it comes to on every row.

    Attributes:
        text: Python, as it stands in a kernel.
        of: the values, of the shape (rows,) or (rows, 3), in float64 or int64.
        size: of floats: an error is at most some roundings of so much.
    """

    text: str
    of: Array
    size: Array

    @property
    def is_vector(self) -> bool:
        return self.of.ndim == 2


def exact(text: str, of: Array) -> Value:
    """What is known as it is."""
    return Value(text, of, np.abs(of).astype(np.float64))


class Writer:
    """Writes expressions of the leaves that it is given.

    Args:
        seed: decides all choices.
        scalar: ``float32`` or ``float64``.
        rows: how many rows there are.
    """

    def __init__(self, seed: int, scalar: str, rows: int) -> None:
        self.random, self.scalar, self.rows = Random(seed), scalar, rows
        self.arithmetic = False  # whether numbers are nothing but arithmetic on floats
        self.numbers: list[Value] = []
        self.vectors: list[Value] = []
        self.integers: list[Value] = []
        self.conditions: list[Callable[[], Value]] = []

    # ---- Choices ----

    def pick(self, options: Sequence[T]) -> T:
        return self.random.choice(options)

    def chance(self, one: int, of: int) -> bool:
        return self.random.randrange(of) < one

    def literal(self) -> Value:
        value = self.random.randint(-12, 12) / 4
        return exact(f"ebb.{self.scalar}({value})", np.full(self.rows, value))

    # ---- Numbers ----

    def number(self, depth: int) -> Value:
        if depth <= 0 or self.chance(1, 6):
            return self.pick(self.numbers) if self.numbers and self.chance(5, 6) else self.literal()
        forms = [self._sum, self._sum, self._sum, self._product, self._product, self._quotient, self._root, self._sign]
        if not self.arithmetic:
            forms += [self._extreme, self._choice, self._converted, self._component, self._dot]
        return self._small(self.pick(forms)(depth - 1))

    def _small(self, value: Value) -> Value:
        if value.size.max(initial=0) < MOST:
            return value
        return Value(f"({value.text} * {2**-12})", value.of * 2**-12, value.size * 2**-12)

    def _sum(self, depth: int) -> Value:
        a, b = self.number(depth), self.number(depth)
        op = self.pick("+-")
        return Value(f"({a.text} {op} {b.text})", a.of + b.of if op == "+" else a.of - b.of, a.size + b.size)

    def _product(self, depth: int) -> Value:
        a, b = self.number(depth), self.number(depth)
        return Value(f"({a.text} * {b.text})", a.of * b.of, a.size * b.size)

    def _positive(self, depth: int) -> Value:
        a = self.number(depth)
        return Value(f"(0.5 + {a.text} * {a.text})", 0.5 + a.of * a.of, 0.5 + a.size * a.size)

    def _quotient(self, depth: int) -> Value:
        a, b = self.number(depth), self._positive(depth)
        quotient = a.of / b.of
        return Value(f"({a.text} / {b.text})", quotient, (a.size + np.abs(quotient) * b.size) / b.of)

    def _root(self, depth: int) -> Value:
        a = self._positive(depth)
        root = np.sqrt(a.of)
        return Value(f"ebb.sqrt({a.text})", root, np.maximum(root, a.size / root))

    def _extreme(self, depth: int) -> Value:
        a, b = self.number(depth), self.number(depth)
        name = self.pick(("min", "max"))
        of = np.minimum(a.of, b.of) if name == "min" else np.maximum(a.of, b.of)
        return Value(f"{name}({a.text}, {b.text})", of, np.maximum(a.size, b.size))

    def _choice(self, depth: int) -> Value:
        a, b, c = self.number(depth), self.number(depth), self.condition()
        return Value(
            f"({a.text} if {c.text} else {b.text})", np.where(c.of, a.of, b.of), np.where(c.of, a.size, b.size)
        )

    def _converted(self, depth: int) -> Value:
        if not self.integers:
            return self.number(depth)
        a = self.integer(depth)
        return exact(f"ebb.{self.scalar}({a.text})", a.of.astype(np.float64))

    def _component(self, depth: int) -> Value:
        if not self.vectors:
            return self.number(depth)
        a, k = self.vector(depth), self.random.randrange(3)
        text = f"({a.text}).{'xyz'[k]}" if self.chance(1, 2) else f"({a.text})[{k}]"
        return Value(text, a.of[:, k], a.size[:, k])

    def _dot(self, depth: int) -> Value:
        if not self.vectors:
            return self.number(depth)
        a, b = self.vector(depth - 1), self.vector(depth - 1)
        return Value(f"ebb.dot({a.text}, {b.text})", (a.of * b.of).sum(axis=1), (a.size * b.size).sum(axis=1))

    def _sign(self, depth: int) -> Value:
        a = self.number(depth)
        text, of = self.pick(((f"(-{a.text})", -a.of), (f"abs({a.text})", np.abs(a.of))))
        return Value(text, of, a.size)

    # ---- Vectors ----

    def vector(self, depth: int) -> Value:
        if depth <= 0 or self.chance(1, 4):
            return self.pick(self.vectors)
        a = self.vector(depth - 1)
        match self.random.randrange(5):
            case 0 | 1:
                b, op = self.vector(depth - 1), self.pick("+-")
                made = Value(f"({a.text} {op} {b.text})", a.of + b.of if op == "+" else a.of - b.of, a.size + b.size)
            case 2:
                s = self.number(depth - 1)
                made = Value(f"({s.text} * {a.text})", s.of[:, None] * a.of, s.size[:, None] * a.size)
            case 3:
                b = self.vector(depth - 1)
                sizes = np.stack([a.size[:, i - 2] * b.size[:, i - 1] + a.size[:, i - 1] * b.size[:, i - 2]
                                  for i in range(3)], axis=1)  # fmt: skip
                made = Value(f"ebb.cross({a.text}, {b.text})", np.cross(a.of, b.of), sizes)
            case _:
                s = self._positive(depth - 1)
                of = a.of / s.of[:, None]
                made = Value(f"({a.text} / {s.text})", of, (a.size + np.abs(of) * s.size[:, None]) / s.of[:, None])
        return self._small(made)

    # ---- Integers and conditions ----

    def integer(self, depth: int) -> Value:
        """An int32 of a few bits."""
        if depth <= 0 or self.chance(1, 3):
            return self.pick(self.integers)
        a, b = self.integer(depth - 1), self.integer(depth - 1)
        match self.random.randrange(4):
            case 0:
                op = self.pick("&|^")
                of = {"&": a.of & b.of, "|": a.of | b.of, "^": a.of ^ b.of}[op]
                return exact(f"({a.text} {op} {b.text})", of)
            case 1:
                name = self.pick(("min", "max"))
                return exact(f"{name}({a.text}, {b.text})", np.minimum(a.of, b.of) if name == "min"
                             else np.maximum(a.of, b.of))  # fmt: skip
            case 2:
                op = self.pick("+-*")
                of = {"+": a.of + b.of, "-": a.of - b.of, "*": a.of * b.of}[op]
                return exact(f"(({a.text} {op} {b.text}) & 15)", of & 15)
            case _:
                return exact(f"({a.text} >> 1)", a.of >> 1)

    def condition(self) -> Value:
        if not self.conditions:
            held = self.chance(1, 2)
            return exact(str(held), np.full(self.rows, held))
        a = self.pick(self.conditions)()
        match self.random.randrange(5):
            case 0:
                return Value(f"(not {a.text})", ~a.of, a.size)
            case 1:
                b = self.pick(self.conditions)()
                word = self.pick(("and", "or"))
                return Value(f"({a.text} {word} {b.text})", a.of & b.of if word == "and" else a.of | b.of, a.size)
            case _:
                return a

    def compared(self, left: Value, levels: Sequence[float]) -> Value:
        """``left``, which is exact, compared with one of the levels."""
        op, level = self.pick(("<", ">", "<=", ">=", "==", "!=")), self.pick(levels)
        of = {
            "<": left.of < level, ">": left.of > level, "<=": left.of <= level, ">=": left.of >= level,
            "==": left.of == level, "!=": left.of != level,
        }[op]  # fmt: skip
        return exact(f"({left.text} {op} {level})", of)
