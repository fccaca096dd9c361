"""Kernels on thousands of rows as Python text: each knows from NumPy what it leaves, and which row fails first."""

from __future__ import annotations

import itertools
import linecache
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

import ebb

from .computed import Array, Value, Writer, exact

_numbers = itertools.count()

LEVELS = (-2, 0, 1, 3)


@dataclass
class Program:
    """A kernel named ``k``, what it runs on, and what comes of it.

    Attributes:
        text: of the kernel.
        names: what it may name.
        rows: a relation or a subset.
        expected: what fields and globals hold after a launch.
        fails: the position of the first row that fails, or None.
        epsilon: by how much numbers are rounded.
    """

    text: str
    names: dict[str, Any]
    rows: Any
    expected: dict[Any, Value]
    fails: int | None
    epsilon: float

    @property
    def relation(self) -> ebb.Relation:
        return getattr(self.rows, "relation", self.rows)

    def __repr__(self) -> str:
        return f"a program on {self.rows!r}:\n{self.text}"

    @contextmanager
    def defined(self) -> Iterator[ebb.Kernel]:
        """The kernel, while Python keeps its source."""
        filename = f"<large kernel {next(_numbers)}>"
        linecache.cache[filename] = (len(self.text), None, self.text.splitlines(keepends=True), filename)
        names = {"ebb": ebb} | self.names
        try:
            exec(compile(self.text, filename, "exec"), names)
            yield names["k"]
        finally:
            del linecache.cache[filename]


class LargeKernel(Writer):
    """What all forms share: fields, statements under conditions, checks, sums.

    The row is ``r``; what is written belongs to it.
    """

    relation: ebb.Relation

    def __init__(self, seed: int, mask: int, size: int) -> None:
        super().__init__(seed, "", size)
        self.mask, self.draw = mask, np.random.default_rng(seed)
        self.scalar = self.pick(("float32", "float64"))
        self.type = getattr(ebb, self.scalar)
        self.lines: list[str] = []
        self.indent = "    "
        self.state: dict[Any, Value] = {}
        self.names: dict[str, Any] = {}
        self.launched: Any = None
        self.active = np.ones(size, dtype=bool)
        self.fails: int | None = None

    # ---- Places ----

    def loaded(self, relation: ebb.Relation, name: str, type_: Any) -> Array:
        """Adds a field of small numbers without rounding, and gives them row by row."""
        values = self.draw.integers(-8, 9, relation.shape + type_.shape)
        if type_.dtype.kind == "f":
            values = values / 4
        relation.new_field(name, type_, init=values.astype(type_.dtype))
        return values.reshape(relation.size, *type_.shape)

    def inputs(self) -> None:
        """The fields of the own row."""
        for name, kind in (("x", self.type), ("y", self.type), ("n", ebb.int32), ("p", ebb.vector(self.type, 3))):
            self.leaf(exact(f"r.{name}", self.loaded(self.relation, name, kind)))
        for name, kind in (("f", self.type), ("g", self.type), ("q", ebb.vector(self.type, 3)), ("m", ebb.int32)):
            values = self.loaded(self.relation, name, kind)
            self.state[self.relation.fields[name]] = exact(f"r.{name}", values)
        self.total = self.names["total"] = ebb.Global(ebb.float64, 0.0)
        self.state[self.total] = exact("", np.zeros(()))

    def leaf(self, value: Value) -> None:
        """Something that expressions may name."""
        if value.is_vector:
            return self.vectors.append(value)
        if value.of.dtype.kind == "i":
            self.integers.append(value)
        else:
            self.numbers.append(value)
        return self.conditions.append(lambda: self.compared(value, LEVELS))

    def launch_on(self, masks: Sequence[str]) -> None:
        """Chooses the rows: all, or in half of the programs a subset of one of these kinds."""
        self.launched = self.relation
        if masks and self.chance(1, 2):
            self.active = self.chosen_rows(self.pick(masks))
            self.launched = self.relation.new_subset("some", self.active.reshape(self.relation.shape))

    def chosen_rows(self, kind: str) -> Array:
        size, draw = self.rows, self.draw.random
        match kind:
            case "runs":
                return np.repeat(draw(size // 23 + 1) < 0.6, 23)[:size]
            case "short runs":
                return draw(size) < 0.6
            case "sparse":
                return draw(size) < 0.05
            case _:
                return (np.arange(size) // 700) % 2 == 0

    # ---- Statements ----

    def line(self, text: str) -> None:
        self.lines.append(self.indent + text)

    def statements(self, count: int, writers: Sequence[Callable[[], None]]) -> None:
        """So many statements; the mask leaves some out."""
        for number in range(count):
            write = self.pick(writers)
            if self.mask >> number & 1:
                write()

    def blended(self, new: Value, old: Value) -> Value:
        """``new`` in the rows that come here, elsewhere ``old``."""
        on = self.active[:, None] if new.is_vector else self.active
        return Value(old.text, np.where(on, new.of, old.of), np.where(on, new.size, old.size))

    def write(self) -> None:
        """Sets or changes a number or vector of the own row."""
        place = self.relation.fields[self.pick("fgq")]
        old = self.state[place]
        if old.is_vector and self.chance(1, 3):
            k, part = self.random.randrange(3), self.number(2)
            of, size = old.of.copy(), old.size.copy()
            of[:, k], size[:, k] = part.of, part.size
            self.line(f"{old.text}[{k}] = {part.text}")
            new = Value("", of, size)
        else:
            new, op = self.vector(2) if old.is_vector else self.number(3), self.pick(("=", "=", "+="))
            self.line(f"{old.text} {op} {new.text}")
            if op == "+=":
                new = Value("", old.of + new.of, old.size + new.size)
        self.state[place] = self.blended(new, old)

    def set_number(self) -> None:
        """Sets a number of the own row."""
        place, new = self.relation.fields[self.pick("fg")], self.number(3)
        self.line(f"{self.state[place].text} = {new.text}")
        self.state[place] = self.blended(new, self.state[place])

    def write_integer(self) -> None:
        place, new = self.relation.fields["m"], self.integer(2)
        self.line(f"r.m = {new.text}")
        self.state[place] = self.blended(new, self.state[place])

    def read(self) -> None:
        """Names what has been written."""
        place = self.relation.fields[self.pick("fgq")]
        value, name = self.state[place], self.fresh()
        self.line(f"{name} = {value.text}")
        self.name(name, value)

    def local(self) -> None:
        """Names a number, which rows under a condition may change."""
        name, value = self.fresh(), self.number(3)
        self.line(f"{name} = {value.text}")
        if self.chance(1, 2):
            condition, other = self.condition(), self.number(3)
            self.line(f"if {condition.text}:")
            self.line(f"    {name} = {other.text}")
            on = condition.of
            value = Value("", np.where(on, other.of, value.of), np.where(on, other.size, value.size))
        self.name(name, value)

    def fresh(self) -> str:
        return f"a{len(self.lines)}"

    def name(self, name: str, value: Value) -> None:
        (self.vectors if value.is_vector else self.numbers).append(Value(name, value.of, value.size))

    def branch(self) -> None:
        """Writes under a condition, and perhaps others for the other rows."""
        condition, around = self.condition(), self.active
        sides = [(f"if {condition.text}:", condition.of), ("else:", ~condition.of)]
        for head, holds in sides[: self.pick((1, 2))]:
            self.line(head)
            self.indent, self.active = self.indent + "    ", around & holds
            for _ in range(self.random.randint(1, 2)):
                self.pick((self.write, self.write, self.write_integer, self.add_up))()
            self.indent, self.active = self.indent[4:], around

    def add_up(self) -> None:
        value, old = self.number(2), self.state[self.total]
        self.line(f"total.value += ebb.float64({value.text})")
        of, size = value.of[self.active].sum(), value.size[self.active].sum()
        self.state[self.total] = Value("", old.of + of, old.size + size)

    def check(self) -> None:
        """A check, which some rows fail in one program of three."""
        if "t" in self.relation.fields:
            return
        fails = np.zeros(self.rows, dtype=np.int32)
        if self.chance(1, 3):
            fails[self.draw.integers(0, self.rows, 2)] = 1
        self.relation.new_field("t", ebb.int32, init=fails.reshape(self.relation.shape))
        self.line("assert r.t < 1")
        failing = np.flatnonzero(self.active & (fails > 0))
        self.fails = int(failing[0]) if failing.size else None

    def program(self) -> Program:
        text = "@ebb.kernel\ndef k(r):\n" + "\n".join(self.lines or ["    pass"]) + "\n"
        epsilon = float(np.finfo(self.type.dtype).eps)
        return Program(text, self.names, self.launched, self.state, self.fails, epsilon)
