"""Random kernels as Python text over the relations of ``worlds``. Types always fit; phases mostly do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from random import Random

from .kernel_expressions import CUT, KIND_OF_GLOBAL, OPERATORS, TERM_HIGH, TYPE_OF, Expressions, Key, Scope
from .worlds import KEYS

STATEMENTS = 16
"""How many statements a kernel has at most."""


@dataclass(frozen=True)
class KernelText:
    """A kernel to compile: its text, the name of its relation, and whether every statement keeps to the plan."""

    text: str
    relation: str
    tame: bool


def write_kernel(seed: int, mask: int, grouped: tuple[str, ...]) -> KernelText:
    """A kernel named ``k`` on one of the relations of a world.

    Args:
        seed: decides all choices.
        mask: statement n of the kernel is left out where bit n is 0; the others stay the same.
        grouped: the key fields by which ``links`` is grouped.
    """
    return _Writer(seed, mask, grouped).kernel()


class _Writer(Expressions):
    def __init__(self, seed: int, mask: int, grouped: tuple[str, ...]) -> None:
        super().__init__(seed, grouped)
        self.mask = mask
        self.lines: list[str] = []
        self.indent = 1
        self.statements = 0
        self.loops = 0

    def kernel(self) -> KernelText:
        own = Key("r", self.relation, True)
        self.body(Scope({}, [own]), top=True)
        parameter = "r" if self.chance(1, 4) else f"r: {self.relation}"
        text = f"@ebb.kernel\ndef k({parameter}):\n" + "\n".join(self.lines) + "\n"
        return KernelText(text, self.relation, not self.wild)

    def line(self, text: str) -> None:
        self.lines.append("    " * self.indent + text)

    @contextmanager
    def indented(self, head: str) -> Iterator[None]:
        self.line(head)
        self.indent += 1
        yield
        self.indent -= 1

    def body(self, scope: Scope, top: bool = False) -> None:
        count = self.number(4, 12) if top else self.number(1, 5)
        before = len(self.lines)
        for _ in range(count):
            if self.statements >= STATEMENTS:
                break
            number, self.statements = self.statements, self.statements + 1
            if self.mask >> number & 1:
                self.random = Random(f"{self.seed} {number}")
                self.statement(scope)
        if len(self.lines) == before:
            self.line("pass")

    def statement(self, scope: Scope) -> None:
        nested = [self.query_loop] * 3 if self.grouped else []
        nested += [self.branch, self.range_loop, self.while_loop, self.unrolled_loop, self.leave]
        plain = [self.reduce_field] * 4 + [self.change_field] * 3 + [self.assign] * 2
        plain += [self.reduce_global, self.bind_key, self.write_key]
        write = self.pick(plain + nested if self.indent < 4 else plain)
        write(scope)

    def change_field(self, scope: Scope) -> None:
        """A write, or where the plan has no field for it another statement."""
        places = [(key, name) for key in self.keys(scope, deep=0) for name in self.fields if self.may_write(key, name)]
        if not places:
            return self.assign(scope)
        key, name = self.pick(places)
        kind = TYPE_OF[name]
        if kind == "vec" and self.chance(1, 2):
            value = self.held(self.expr(scope, "double"), "double", 20)
            return self.line(f"{key.text}.{name}[{self.number(0, 2)}] = {value.text}")
        if kind == "mat" and self.chance(1, 2):
            at = f"{self.number(0, 1)}, {self.number(0, 1)}"
            return self.line(f"{key.text}.{name}[{at}] = {self.expr(scope, 'int').text}")
        self.line(f"{key.text}.{name} = {self.held(self.expr(scope, kind), kind, 20 if kind != 'single' else 10).text}")

    def reduce_field(self, scope: Scope) -> None:
        keys = self.keys(scope)
        places = [
            (key, name, op)
            for key in (self.pick(keys), self.pick(keys))
            for name in self.fields
            for op in set(OPERATORS[TYPE_OF[name]])
            if self.may_reduce(key, name, op)
        ]
        if not places:
            return self.assign(scope)
        key, name, op = self.pick(sorted(places, key=lambda place: (place[0].text, *place[1:])))
        kind = TYPE_OF[name]
        if name == "j" and op == "+" and self.chance(1, 4):
            return self.line(f"bump({key.text}, {self.expr(scope, 'int').text})")
        if key.relation == "nodes" and name == "i" and op == "+" and self.chance(1, 4):
            return self.line(f"{key.text}.weight += {self.expr(scope, 'int').text}")
        place = f"{key.text}.{name}"
        if kind == "vec" and self.chance(1, 3):
            place, kind = f"{place}[{self.number(0, 2)}]", "double"
        if kind == "mat" and self.chance(1, 3):
            place, kind = f"{place}[{self.number(0, 1)}, {self.number(0, 1)}]", "int"
        self.reduce(scope, place, kind, op)

    def reduce(self, scope: Scope, place: str, kind: str, op: str) -> None:
        value = self.term(scope, kind, op)
        if op in ("min", "max"):
            arguments = (place, value) if self.chance(1, 2) else (value, place)
            return self.line(f"{place} = {op}({', '.join(arguments)})")
        self.line(f"{place} {op}= {value}")

    def term(self, scope: Scope, kind: str, op: str) -> str:
        """What is reduced: for float products 1 or -1, for sums something small, so that all orders agree."""
        if op == "*" and kind in CUT:
            return self.pick(("-1.0", f"pick({self.expr(scope, 'bool', 1).text}, 1.0, -1.0)"))
        high = TERM_HIGH if op in ("+", "-") else {"double": 20, "vec": 20, "single": 10}
        return self.held(self.expr(scope, kind), kind, high.get(kind, 0)).text

    def reduce_global(self, scope: Scope) -> None:
        name = self.pick(self.globals)
        phase = self.global_phase(name)
        kind = KIND_OF_GLOBAL[name]
        if phase == "read" or (kind == "bool" and phase not in OPERATORS["bool"]):
            return self.assign(scope)
        place = f"{name}.value"
        if kind == "vec" and self.chance(1, 3):
            place, kind = f"{place}[{self.number(0, 2)}]", "double"
        self.reduce(scope, place, kind, phase)

    def assign(self, scope: Scope) -> None:
        kind = self.pick(("int", "int", "double", "double", "single", "vec", "bool", "mat", "long"))
        value = self.held(self.expr(scope, kind), kind, 8).text
        known = [name for name, of in scope.numbers.items() if of == kind and name not in scope.fixed]
        if known and self.chance(1, 2):
            return self.line(f"{self.pick(known)} = {value}")
        name = self.fresh("a")
        if kind == "mat" and value.startswith("[["):
            value = f"({value}) + 0"
        if kind == "vec" and value.startswith("["):
            value = f"{value} + shift"
        self.line(f"{name} = {value}")
        scope.numbers[name] = kind

    def bind_key(self, scope: Scope) -> None:
        key = scope.keys[0] if self.chance(1, 4) else self.key(scope)
        if key is None:
            return None
        known = [
            old for old in scope.keys if old.text[0] == "k" and old.text.isidentifier() and old.relation == key.relation
        ]
        if known and self.chance(1, 3):
            # A name that is bound twice is not centered, whatever it is bound to; wild kernels take it for what it was.
            old = self.pick(known)
            scope.keys[scope.keys.index(old)] = Key(old.text, old.relation, old.centered and self.wild)
            return self.line(f"{old.text} = {key.text}")
        name = self.fresh("k")
        self.line(f"{name} = {key.text}")
        return scope.keys.append(Key(name, key.relation, key.centered))

    def write_key(self, scope: Scope) -> None:
        own = scope.keys[0]
        name = self.pick(tuple(KEYS[own.relation]))
        value = self.key(scope, KEYS[own.relation][name])
        if value is None or not self.may_write(own, name):
            return self.change_field(scope)
        self.line(f"{own.text}.{name} = {value.text}")

    def branch(self, scope: Scope) -> None:
        with self.indented(f"if {self.expr(scope, 'bool').text}:"):
            self.body(scope.inner())
        if self.chance(1, 2):
            with self.indented(f"elif {self.expr(scope, 'bool', 1).text}:" if self.chance(1, 3) else "else:"):
                self.body(scope.inner())

    def query_loop(self, scope: Scope) -> None:
        node = self.key(scope, "nodes")
        if node is None or self.loops >= 2:
            return self.branch(scope)
        self.loops += 1
        name, by = self.fresh("e"), self.pick(self.grouped)
        inner = scope.inner()
        if by == "a" and self.chance(1, 3):
            over, relation = f"{node.text}.out", "links"
        elif self.chance(1, 4) and self.phase_of("links", "b") == "read":
            over, relation = f"ebb.where(links.{by}, {node.text}).b", "nodes"
        else:
            over, relation = f"ebb.where(links.{by}, {node.text})", "links"
        inner.keys.append(Key(name, relation, False))
        with self.indented(f"for {name} in {over}:"):
            self.body(inner)
        self.loops -= 1

    def range_loop(self, scope: Scope) -> None:
        name = self.fresh("n")
        bounds = self.pick(("2", "3", "1, 4", "3, 0, -1", "ebb.int32(ebb.id(r)) % 3", "three"))
        inner = scope.inner()
        inner.numbers[name] = "int"
        inner.fixed.add(name)
        with self.indented(f"for {name} in range({bounds}):"):
            self.body(inner)
            if self.chance(1, 4):
                self.line(f"if {self.expr(inner, 'bool', 1).text}:")
                self.line(f"    {self.pick(('break', 'continue'))}")

    def while_loop(self, scope: Scope) -> None:
        name = self.fresh("n")
        self.line(f"{name} = 0")
        inner = scope.inner()
        inner.numbers[name] = "int"
        inner.fixed.add(name)
        with self.indented(f"while {name} < {self.number(1, 3)}:"):
            self.line(f"{name} += 1")
            self.body(inner)

    def unrolled_loop(self, scope: Scope) -> None:
        cell = self.key(scope, "cells")
        inner = scope.inner()
        if cell is None:
            first, second = self.fresh("n"), self.fresh("n")
            with self.indented(f"for {first}, {second} in turns:"):
                inner.numbers |= {first: "int", second: "int"}
                inner.fixed |= {first, second}
                return self.body(inner)
        step = self.fresh("n")
        with self.indented(f"for {step} in (1, -1):"):
            inner.keys.append(Key(f"{cell.text}({step}, 0)", "cells", False))
            self.body(inner)
        return None

    def leave(self, scope: Scope) -> None:
        self.line(f"if {self.expr(scope, 'bool', 1).text}:")
        self.line("    return")
