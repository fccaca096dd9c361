"""Random expressions of random kernels: numbers, vectors and keys, as Python text.

A kernel has a plan: a phase for each field and global, which it keeps to; some kernels break it now and then, so that
kernels on both sides of the phase check's border come out.

Floats stay exact: each expression carries a bound of its magnitude and of its last bit, and where a product would not
fit it goes through ``small``, which keeps a few bits. So results depend neither on the order of sums nor on fusing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import TypeVar

from .worlds import GLOBALS, KEYS, NUMBERS

T = TypeVar("T")

FIELDS_OF = {
    "int": ("i", "j"),
    "long": ("w",),
    "double": ("x", "y"),
    "single": ("s",),
    "vec": ("p",),
    "bool": ("t",),
    "mat": ("m",),
}
TYPE_OF = {name: kind for kind, names in FIELDS_OF.items() for name in names}
GLOBAL_OF = {"int": "GI", "double": "GX", "vec": "GP", "bool": "GT"}
KIND_OF_GLOBAL = {name: kind for kind, name in GLOBAL_OF.items()}

OPERATORS = {
    "int": ("+", "+", "-", "*", "min", "max", "&", "|", "^"),
    "long": ("+", "*", "max"),
    "double": ("+", "+", "-", "*", "min", "max"),
    "single": ("+", "min"),
    "vec": ("+", "-", "max"),
    "bool": ("&", "|", "^"),
    "mat": ("+", "*", "min"),
}
PHASE_OF = {"-": "+"}
"""What an operator is to the phases where it is not itself."""

FIELD_BITS = {"double": (22, -2), "vec": (22, -2), "single": (16, -2)}
"""The bits that the values of a float field span whatever a kernel does: |value| < 2**high, a multiple of 2**low."""

WIDTH = {"double": 48, "vec": 48, "single": 22}
"""How many bits an expression may span before it is cut."""

TERM_HIGH = {"double": 10, "vec": 10, "single": 4}
"""The magnitude of what may be added to a field: a thousand such terms stay within FIELD_BITS."""

CUT = {"double": "small", "single": "small_s", "vec": "small_p"}


@dataclass(frozen=True)
class Code:
    """The text of an expression; for floats the bits that its value spans."""

    text: str
    high: int = 0
    low: int = 0


@dataclass(frozen=True)
class Key:
    """The text of a key expression, the relation it refers to, and whether it is the kernel's own row."""

    text: str
    relation: str
    centered: bool


@dataclass
class Scope:
    """The names that code may use at a point: numbers by kind, and keys."""

    numbers: dict[str, str]
    keys: list[Key]
    fixed: set[str] = field(default_factory=set)

    def inner(self) -> Scope:
        return Scope(dict(self.numbers), list(self.keys), set(self.fixed))


class Expressions:
    """Writes keys and expressions at random, by a plan.

    Args:
        seed: decides all choices.
        grouped: the key fields by which ``links`` is grouped.
    """

    def __init__(self, seed: int, grouped: tuple[str, ...]) -> None:
        self.seed = seed
        self.random = Random(seed)
        self.grouped = grouped
        self.relation = self.pick(("nodes", "nodes", "links", "links", "cells"))
        self.wild = self.chance(1, 3)
        # A few fields, so that statements meet in them.
        self.fields = tuple(self.random.sample(tuple(NUMBERS), 4))
        self.globals = tuple(self.random.sample(tuple(GLOBALS), 2))
        self.plan: dict[tuple[str, str], str] = {}
        self.names = 0

    # ---- Choices ----

    def number(self, low: int, high: int) -> int:
        return self.random.randint(low, high)

    def pick(self, options: Sequence[T]) -> T:
        return self.random.choice(options)

    def chance(self, one: int, of: int) -> bool:
        return self.random.randrange(of) < one

    def fresh(self, stem: str) -> str:
        self.names += 1
        return f"{stem}{self.names}"

    # ---- The plan ----

    def phase_of(self, relation: str, name: str) -> str:
        """The phase that the plan gives to a field: ``read``, ``own`` or an operator."""
        place = (relation, name)
        if place not in self.plan:
            options = ["read"]
            if relation == self.relation:
                options.append("own")
            if name in TYPE_OF:
                options += [PHASE_OF.get(op, op) for op in OPERATORS[TYPE_OF[name]]][: 4 if len(options) == 1 else 3]
            else:
                options.append("read")
            self.plan[place] = Random(f"{self.seed} {place}").choice(options)
        return self.plan[place]

    def breaks_plan(self) -> bool:
        return self.wild and self.chance(1, 5)

    def may_read(self, key: Key, name: str) -> bool:
        phase = self.phase_of(key.relation, name)
        return phase == "read" or (phase == "own" and key.centered) or self.breaks_plan()

    def may_write(self, key: Key, name: str) -> bool:
        return (self.phase_of(key.relation, name) == "own" and key.centered) or self.breaks_plan()

    def may_reduce(self, key: Key, name: str, op: str) -> bool:
        phase = self.phase_of(key.relation, name)
        return phase == PHASE_OF.get(op, op) or (phase == "own" and key.centered) or self.breaks_plan()

    def global_phase(self, name: str) -> str:
        """The phase that the plan gives to a global: ``read`` or an operator."""
        place = ("", name)
        if place not in self.plan:
            options = ("read", *(PHASE_OF.get(op, op) for op in OPERATORS[KIND_OF_GLOBAL[name]]))
            self.plan[place] = Random(f"{self.seed} {place}").choice(options)
        return self.pick(("read", *OPERATORS[KIND_OF_GLOBAL[name]])) if self.breaks_plan() else self.plan[place]

    # ---- Keys ----

    def keys(self, scope: Scope, relation: str | None = None, deep: int = 1) -> list[Key]:
        """The keys that can be written at this point: names, and what one step leads to from them."""
        found = list(scope.keys)
        for _ in range(deep):
            found += [step for key in found for step in self.steps(key)]
        if deep and self.chance(1, 3):
            found += [step for key in self.random.sample(found, min(3, len(found))) for step in self.steps(key)]
        return [key for key in found if relation is None or key.relation == relation]

    def steps(self, key: Key) -> Iterator[Key]:
        for name, target in KEYS[key.relation].items():
            if self.may_read(key, name):
                yield Key(f"{key.text}.{name}", target, False)
        if key.relation == "cells":
            yield Key(f"{key.text}.up", "cells", False)
            yield Key(f"{key.text}({self.number(-2, 2)}, 0)", "cells", False)
            if key.centered:
                yield Key(f"{key.text}(0, 0)", "cells", True)

    def key(self, scope: Scope, relation: str | None = None) -> Key | None:
        found = self.keys(scope, relation)
        return self.pick(found) if found else None

    # ---- Expressions ----

    def expr(self, scope: Scope, kind: str, depth: int = 2) -> Code:
        """An expression of a kind: int, long, double, single, vec, bool or mat."""
        options = self.leaves(scope, kind)
        if depth > 0 and self.chance(2, 3):
            build: Callable[[Scope, int], Code] = getattr(self, f"{kind}_expr")
            return self.cut(build(scope, depth - 1), kind)
        return options[self.number(0, len(options) - 1)]

    def leaves(self, scope: Scope, kind: str) -> list[Code]:
        found = [Code(name, 10, -2) for name, of in scope.numbers.items() if of == kind]
        key = self.key(scope)
        if key is not None:
            bits = FIELD_BITS.get(kind, (0, 0))
            names = [name for name in FIELDS_OF[kind] if name in self.fields and self.may_read(key, name)]
            found += [Code(f"{key.text}.{name}", *bits) for name in names] * 2
        globl = GLOBAL_OF.get(kind)
        if globl is not None and self.global_phase(globl) == "read":
            found.append(Code(f"{globl}.value" if self.chance(1, 2) else globl, *FIELD_BITS.get(kind, (0, 0))))
        return found + self.constants(scope, kind)

    def constants(self, scope: Scope, kind: str) -> list[Code]:
        match kind:
            case "int":
                return [Code(str(self.number(-3, 9))), Code("three")]
            case "long":
                return [Code(f"ebb.id({key.text})") for key in scope.keys] + [Code("ebb.int64(5)")]
            case "double":
                return [Code(self.pick(("0.5", "-1.25", "3.0", "2.0")), 2, -2), Code("half", 0, -1)]
            case "single":
                return [Code(f"ebb.float32({self.pick(('0.5', '-1.25', '3'))})", 2, -2)]
            case "vec":
                return [Code("[1.0, half, -2.5]", 2, -1), Code("shift", 0, -1)]
            case "bool":
                return [Code("True"), Code("False")]
            case _:
                return [Code("[[1, 2], [-1, 3]]")]

    def cut(self, code: Code, kind: str) -> Code:
        """``code`` with few enough bits."""
        if kind in CUT and code.high - code.low > WIDTH[kind]:
            return Code(f"{CUT[kind]}({code.text})", 4, -2)
        return code

    def held(self, code: Code, kind: str, high: int) -> Code:
        """``code`` where it may be stored: below 2**high, a multiple of a quarter."""
        if kind in CUT and (code.high > high or code.low < -2):
            return Code(f"{CUT[kind]}({code.text})", 4, -2)
        return code

    def int_expr(self, scope: Scope, depth: int) -> Code:
        a = self.expr(scope, "int", depth).text
        match self.number(0, 12):
            case 0 | 1 | 2 | 3:
                return Code(f"({a} {self.pick(('+', '-', '*', '&', '|', '^'))} {self.expr(scope, 'int', depth).text})")
            case 4:
                names = [name for name, kind in scope.numbers.items() if kind == "int" and name not in scope.fixed]
                divisor = self.pick(("3", "-2", "7", *names))
                return Code(f"({a} {self.pick(('//', '%'))} {divisor})")
            case 5:
                return Code(f"{self.pick(('-', '~', '+'))}({a})")
            case 6:
                return Code(f"{self.pick(('min', 'max'))}({a}, {self.expr(scope, 'int', depth).text})")
            case 7:
                return Code(
                    f"({a} if {self.expr(scope, 'bool', depth).text} else {self.expr(scope, 'int', depth).text})"
                )
            case 8:
                return Code(f"ebb.int32({self.expr(scope, self.pick(('double', 'single', 'long')), depth).text})")
            case 9:
                return Code(f"({a} {self.pick(('<<', '>>', '**'))} {self.number(0, 3)})")
            case 10:
                cell = self.key(scope, "cells")
                return Code(f"ebb.coords({cell.text})[{self.number(0, 1)}]" if cell else f"abs({a})")
            case 11:
                node = self.key(scope, "nodes")
                return Code(
                    f"len(ebb.where(links.{self.pick(self.grouped)}, {node.text}))" if node and self.grouped else a
                )
            case _:
                m = self.expr(scope, "mat", 0).text
                return Code(f"({m})[{self.number(0, 1)}, {self.number(0, 1)}]" if "[[" not in m else a)

    def long_expr(self, scope: Scope, depth: int) -> Code:
        a, b = self.expr(scope, "long", depth).text, self.expr(scope, self.pick(("long", "int")), depth).text
        return Code(f"({a} {self.pick(('+', '-', '*'))} {b})")

    def double_expr(self, scope: Scope, depth: int) -> Code:
        a = self.expr(scope, "double", depth)
        match self.number(0, 10):
            case 0 | 1 | 2:
                return self.sum(a, self.expr(scope, self.pick(("double", "double", "single")), depth))
            case 3:
                return self.product(a, self.expr(scope, "double", depth))
            case 4:
                return self.one_of(self.pick(("min({}, {})", "max({}, {})")), a, self.expr(scope, "double", depth))
            case 5:
                condition = self.expr(scope, "bool", depth).text
                return self.one_of(f"({{}} if {condition} else {{}})", a, self.expr(scope, "double", depth))
            case 6:
                return self.sum(a, Code(f"{self.expr(scope, 'int', depth).text}", 32, 0))
            case 7:
                return Code(f"({a.text} / {self.pick(('2', '2.0', '4'))})", a.high, a.low - 2)
            case 8:
                v = self.expr(scope, "vec", 0)
                return Code(f"({v.text})[{self.number(0, 2)}]", v.high, v.low)
            case 9:
                condition = self.expr(scope, "bool", depth).text
                return self.one_of(f"pick({condition}, {{}}, {{}})", a, self.expr(scope, "double", depth))
            case _:
                return Code(f"({a.text}) ** 2", 2 * a.high, 2 * a.low)

    def single_expr(self, scope: Scope, depth: int) -> Code:
        a = self.expr(scope, "single", depth)
        if self.chance(1, 4):
            return self.product(a, Code(self.pick(("0.5", "2", "-1.25")), 2, -2))
        return self.sum(a, self.expr(scope, "single", depth))

    def vec_expr(self, scope: Scope, depth: int) -> Code:
        a = self.expr(scope, "vec", depth)
        match self.number(0, 4):
            case 0 | 1:
                return self.sum(a, self.expr(scope, "vec", depth))
            case 2:
                return self.product(a, self.expr(scope, "double", depth))
            case 3:
                b = self.expr(scope, "vec", depth)
                return Code(f"ebb.cross({a.text}, {b.text})", a.high + b.high + 1, a.low + b.low)
            case _:
                return Code(f"-({a.text})", a.high, a.low)

    def bool_expr(self, scope: Scope, depth: int) -> Code:
        kind = self.pick(("int", "double", "single"))
        a, b = self.expr(scope, kind, depth).text, self.expr(scope, kind, depth).text
        match self.number(0, 4):
            case 0:
                return Code(f"({a} {self.pick(('<', '<=', '==', '!=', '>'))} {b})")
            case 1:
                left, right = self.expr(scope, "bool", depth).text, self.expr(scope, "bool", depth).text
                return Code(f"({left} {self.pick(('and', 'or'))} {right})")
            case 2:
                return Code(f"(not {self.expr(scope, 'bool', depth).text})")
            case 3:
                key = self.pick(scope.keys)
                other = self.key(scope, key.relation)
                return Code(f"({key.text} {self.pick(('==', '!='))} {other.text})" if other else "True")
            case _:
                return Code(f"({a} < {b} <= {self.expr(scope, kind, depth).text})")

    def mat_expr(self, scope: Scope, depth: int) -> Code:
        a = self.expr(scope, "mat", depth).text
        return Code(self.pick((f"({a}).T", f"({a} + {self.expr(scope, 'mat', depth).text})", f"({a} * 2)")))

    def sum(self, a: Code, b: Code) -> Code:
        return Code(f"({a.text} {self.pick(('+', '-'))} {b.text})", max(a.high, b.high) + 1, min(a.low, b.low))

    def product(self, a: Code, b: Code) -> Code:
        return Code(f"({a.text} * {b.text})", a.high + b.high, a.low + b.low)

    def one_of(self, form: str, a: Code, b: Code) -> Code:
        return Code(form.format(a.text, b.text), max(a.high, b.high), min(a.low, b.low))
