"""Random kernels in the forms that the processor runs in ways of their own.

Lines of grids (past the cache, in registers, with their ends split off), rows that follow keys and change other rows
(strips), rows of lists (runs), rows that may fail (rare loops), loops over groups (strips of turns).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

import ebb

from .computed import Value, Writer, exact
from .large_kernels import LEVELS, LargeKernel

_REACH = 2
"""How far away neighbours are, at most."""

_MOST = 99
"""What a least value begins at."""


class Lines(LargeKernel):
    """Rows of a grid, which read their neighbours."""

    def __init__(self, seed: int, mask: int) -> None:
        draw = np.random.default_rng(seed)
        shapes = [(9,), (40,), (1300,), (3, 40), (20, 70), (4, 300), (9, 150)]
        shapes += [(2, 3, 20), (5, 12, 60), (3, 4, 260), (8, 9, 130)]
        shape = tuple(int(draw.integers(max(n // 2, 1), n + 1)) for n in shapes[draw.integers(len(shapes))])
        super().__init__(seed, mask, int(np.prod(shape)))
        self.shape, self.edge = shape, self.pick(("wrap", "clamp", "none"))
        self.relation = self.names["cells"] = ebb.Relation(
            "cells", shape=shape, periodic=(self.edge == "wrap",) * len(shape)
        )
        self.inputs()
        self.at_hand = {value.text[2:]: value for value in (*self.numbers, *self.vectors)}
        self.arithmetic = self.chance(1, 2)
        for _ in range(4):
            self.leaf(self.neighbor(self.pick("xy" if self.arithmetic else "xyp"), self.offset(_REACH)))
        if self.edge == "none":
            self.launch_inside()
        else:
            self.launch_on(("runs", "halves") if self.chance(1, 3) else ())
        if self.arithmetic:
            return self.statements(self.random.randint(2, 4), [self.set_number, self.set_number, self.stencil])
        writers = [self.write, self.set_number, self.stencil] * 2 + [self.write_integer, self.local, self.add_up]
        writers += [self.branch, self.read] * self.pick((0, 0, 1)) + [self.check] * self.pick((0, 0, 4))
        return self.statements(self.random.randint(2, 7), writers)

    def launch_inside(self) -> None:
        """Chooses a box from which no neighbour leads out of the grid."""
        low = [self.random.randint(_REACH, _REACH + 2) for _ in self.shape]
        high = [max(n - self.random.randint(_REACH, _REACH + 2), k) for n, k in zip(self.shape, low, strict=True)]
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        inside = np.zeros(self.shape, dtype=bool)
        inside[box] = True
        self.active = inside.ravel()
        self.launched = self.relation.new_subset("inside", box)

    def offset(self, reach: int) -> tuple[int, ...]:
        return tuple(self.random.randint(-reach, reach) for _ in self.shape)

    def neighbor(self, name: str, offset: Sequence[int]) -> Value:
        """A field of the row so far away."""
        index = np.indices(self.shape)
        for axis, (step, extent) in enumerate(zip(offset, self.shape, strict=True)):
            moved = index[axis] + step
            index[axis] = moved % extent if self.edge == "wrap" else np.clip(moved, 0, extent - 1)
        at = np.ravel_multi_index(tuple(index), self.shape).ravel()
        rows = [[*(int(i == j) for j in range(len(offset))), step] for i, step in enumerate(offset)]
        edge = ', edge="clamp"' if self.edge == "clamp" else ""
        return exact(f"ebb.affine(cells, {rows}, r{edge}).{name}", self.at_hand[name].of[at])

    def stencil(self) -> None:
        """A weighted sum over neighbours, lines and planes of them first."""
        name, place = self.pick("xy"), self.relation.fields[self.pick("fg")]
        total = exact("0.0", np.zeros(self.rows))
        text = list[str]()
        for plane in itertools.product((-1, 0, 1), repeat=len(self.shape) - 1):
            parts = [self.neighbor(name, (*plane, step)) for step in (-1, 0, 1)]
            weight = self.random.randint(-3, 3) / 4
            text.append(f"{weight} * ({' + '.join(part.text for part in parts)})")
            of, size = sum(part.of for part in parts), sum(part.size for part in parts)
            total = Value("", total.of + weight * of, total.size + abs(weight) * size)
        old = self.state[place]
        self.line(f"{old.text} = {' + '.join(text)}")
        self.state[place] = self.blended(total, old)


class Rows(LargeKernel):
    """Rows with keys, which read and change other rows."""

    def __init__(self, seed: int, mask: int) -> None:
        draw = np.random.default_rng(seed)
        size = int(draw.choice((5, 33, 300, 2500)))
        size, count = int(draw.integers(size // 2, size + 1)), int(draw.integers(1, size + 1))
        super().__init__(seed, mask, size)
        nodes = ebb.Relation("nodes", size=count)
        self.relation = ebb.Relation("rows", size=size)
        keys = self.draw.integers(0, count, (size, 2))
        if self.chance(1, 3):  # as along a mesh
            keys = np.minimum(np.arange(size)[:, None] * count // size + [0, 1], count - 1)
        self.relation.new_field("v", ebb.vector(nodes, 2), init=keys)
        self.relation.new_field("a", nodes, init=keys[:, 0])
        self.inputs()
        given = {name: self.loaded(nodes, name, kind) for name, kind in
                 (("w", self.type), ("pos", ebb.vector(self.type, 3)), ("c", ebb.int32))}  # fmt: skip
        self.ways = (("r.v[0]", keys[:, 0]), ("r.v[1]", keys[:, 1]), ("r.a", keys[:, 0]))
        for (key, at), name in itertools.product(self.ways, given):
            if self.chance(2, 3):
                self.leaf(exact(f"{key}.{name}", given[name][at]))
        self.nodes, self.ops = nodes, {"push": "+", "low": self.pick(("min", "max")), "hits": "+", "load": "+"}
        kinds = {"push": ebb.vector(self.type, 3), "low": self.type, "hits": ebb.int32, "load": self.type}
        for name, kind in kinds.items():
            self.state[nodes.new_field(name, kind, init=0)] = exact(name, np.zeros((count, *kind.shape), dtype=int))
        self.launch_on(("runs", "short runs", "sparse", "halves"))
        writers = [self.write] * 4 + [self.local] * 2 + [self.write_integer, self.add_up]
        writers += [self.change] * self.pick((0, 3, 6)) + [self.branch, self.read] * self.pick((0, 1, 2))
        self.statements(self.random.randint(2, 8), writers + [self.check] * self.pick((0, 0, 6)))

    def change(self) -> None:
        """Reduces into the row that a key leads to."""
        name = self.pick(tuple(self.ops))
        (key, at), op = self.pick(self.ways), self.ops[name]
        value = self.vector(2) if name == "push" else self.integer(2) if name == "hits" else self.number(2)
        place = self.nodes.fields[name]
        old, on = self.state[place], self.active
        of, size = old.of.astype(value.of.dtype), old.size.copy()
        if op == "+":
            sign = self.pick((1, -1))
            self.line(f"{key}.{name} {'+' if sign == 1 else '-'}= {value.text}")
            np.add.at(of, at[on], sign * value.of[on])
            np.add.at(size, at[on], value.size[on])
        else:
            self.line(f"{key}.{name} = {op}({key}.{name}, {value.text})")
            (np.minimum if op == "min" else np.maximum).at(of, at[on], value.of[on])
            np.maximum.at(size, at[on], value.size[on])
        self.state[place] = Value(old.text, of, size)


class Places(LargeKernel):
    """Rows without keys, which may fail, and find others by computed coordinates."""

    def __init__(self, seed: int, mask: int) -> None:
        draw = np.random.default_rng(seed)
        super().__init__(seed, mask, int(draw.integers(1, int(draw.choice((20, 1100, 5000))))))
        self.relation = ebb.Relation("rows", size=self.rows)
        self.inputs()
        self.vectors.clear()
        extent = int(draw.integers(1, self.rows + 1))
        line = self.names["line"] = ebb.Relation("line", shape=(extent,), periodic=True)
        given = self.loaded(line, "value", self.type)
        for _ in range(2):
            start = self.random.randint(-extent, extent)
            number, at = self.pick((("r.n", self.integers[0].of), ("ebb.id(r)", np.arange(self.rows))))
            place = f"ebb.row_at(line, [ebb.int64({number}) + ({start})])"
            self.leaf(exact(f"{place}.value", given[(at + start) % extent]))
        self.launch_on(("runs", "sparse"))
        writers = [self.set_number] * 3 + [self.local, self.write_integer, self.add_up]
        self.statements(self.random.randint(2, 6), writers + [self.check] * 3)


class Groups(LargeKernel):
    """Rows with loops over the rows that refer to them."""

    def __init__(self, seed: int, mask: int) -> None:
        draw = np.random.default_rng(seed)
        size = int(draw.choice((3, 40, 600)))
        super().__init__(seed, mask, size)
        self.relation = ebb.Relation("rows", size=size)
        lengths = draw.integers(0, int(draw.choice((4, 12, 40))), size)
        tail, count = np.repeat(np.arange(size), lengths), int(lengths.sum())
        links = self.names["links"] = ebb.Relation("links", size=count)
        self.inputs()
        if self.chance(1, 3):
            tail = draw.permutation(tail)
        links.new_field("tail", self.relation, init=tail)
        head = draw.integers(0, size, count)
        links.new_field("head", self.relation, init=head)
        own = {value.text: value for value in (*self.numbers, *self.vectors, *self.integers)}
        self.turns = Writer(seed, self.scalar, count)
        for text, value in own.items():
            self.turn_leaf(exact(text, value.of[tail]))
            if self.chance(1, 2):
                self.turn_leaf(exact(f"e.head{text[1:]}", value.of[head]))
        for name, kind in (("s", self.type), ("o", ebb.vector(self.type, 3)), ("i", ebb.int32)):
            self.turn_leaf(exact(f"e.{name}", self.loaded(links, name, kind)))
        links.group_by("tail")
        self.tail, self.count = tail, count
        self.launch_on(("short runs",))
        self.statements(self.random.randint(1, 3), [self.loop])
        self.statements(self.random.randint(1, 4), [self.write, self.write, self.local, self.add_up])

    def turn_leaf(self, value: Value) -> None:
        turns = self.turns
        if value.is_vector:
            return turns.vectors.append(value)
        (turns.integers if value.of.dtype.kind == "i" else turns.numbers).append(value)
        return turns.conditions.append(lambda: turns.compared(value, LEVELS))

    def loop(self) -> None:
        """A loop over the group of the row, which adds up numbers and vectors, and takes the least."""
        kinds = self.random.sample(("number", "vector", "least"), self.pick((1, 2, 3)))
        names = [(f"{self.fresh()}_{kind}", kind) for kind in kinds]
        starts = {"number": f"ebb.{self.scalar}(0)", "vector": "0 * r.p", "least": f"ebb.{self.scalar}({_MOST})"}
        for name, kind in names:
            self.line(f"{name} = {starts[kind]}")
        self.line("for e in ebb.where(links.tail, r):")
        around = self.indent
        for name, kind in names:
            self.indent = around + "    "
            self.name(name, self.summed(name, kind))
        self.indent = around

    def summed(self, name: str, kind: str) -> Value:
        """Adds to a sum in each turn, or in some; gives what it comes to."""
        value, on = self.turns.vector(4) if kind == "vector" else self.turns.number(5), np.ones(self.count, dtype=bool)
        if self.chance(1, 3):
            condition = self.turns.condition()
            self.line(f"if {condition.text}:")
            on, self.indent = condition.of, self.indent + "    "
        at, shape = self.tail[on], (self.rows, 3) if kind == "vector" else (self.rows,)
        if kind == "least":
            self.line(f"{name} = min({name}, {value.text})")
            of, size = np.full(shape, float(_MOST)), np.full(shape, float(_MOST))
            np.minimum.at(of, at, value.of[on])
            np.maximum.at(size, at, value.size[on])
            return Value(name, of, size)
        self.line(f"{name} += {value.text}")
        of, size = np.zeros(shape), np.ones(shape)
        np.add.at(of, at, value.of[on])
        np.add.at(size, at, value.size[on])
        return Value(name, of, size)
