"""Random kernels as Python text over the relations of ``worlds``.

Every kernel has a plan: a phase for each field and global, which its statements keep to; a share of the statements does
not, so that kernels on both sides of the phase check's border come out. Types nearly always fit.

Floats stay exact: each expression carries a bound of its magnitude and of its last bit, and where a product would not fit
it goes through ``small``, which keeps a few bits. So results do not depend on how sums are ordered or products fused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

from hypothesis import strategies as st

from .worlds import GLOBALS, KEYS, NUMBERS

T = TypeVar("T")

PRELUDE = """\
@ebb.func
def small(x):
    return ebb.float64(ebb.int32(x) % 64) * 0.25

@ebb.func
def small_s(x):
    return ebb.float32(ebb.int32(x) % 64) * 0.25

@ebb.func
def small_p(v):
    return [small(v[0]), small(v[1]), small(v[2])]

@ebb.func
def pick(c, a, b):
    if c:
        return a
    return b

@ebb.func
def bump(k, amount):
    k.j += amount

"""

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
"""The bits that the values of a float field span, whatever a kernel does to it: |value| < 2**high, a multiple of 2**low."""

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


@dataclass(frozen=True)
class KernelText:
    """A kernel to compile: its text, the name of its relation, and whether every statement keeps to the plan."""

    text: str
    relation: str
    tame: bool


@st.composite
def kernels(draw: Any, grouped: tuple[str, ...]) -> KernelText:
    """Kernels named ``k`` on one of the relations of a world in which ``links`` is grouped by the keys ``grouped``."""
    return _Writer(draw, grouped).kernel()


class _Writer:
    def __init__(self, draw: Any, grouped: tuple[str, ...]) -> None:
        self.draw = draw
        self.grouped = grouped
        self.relation = self.pick(("nodes", "nodes", "links", "links", "cells"))
        self.wild = self.chance(1, 2)
        self.plan: dict[tuple[str, str], str] = {}
        self.lines: list[str] = []
        self.indent = 1
        self.names = 0
        self.budget = self.number(3, 12)
        self.loops = 0

    # ---- Choices ----

    def number(self, low: int, high: int) -> int:
        return self.draw(st.integers(low, high))

    def pick(self, options: Sequence[T]) -> T:
        return options[self.draw(st.integers(0, len(options) - 1))]

    def chance(self, one: int, of: int) -> bool:
        return self.draw(st.integers(1, of)) > of - one

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
            self.plan[place] = self.pick(options)
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

    # ---- Keys ----

    def keys(self, scope: Scope, relation: str | None = None, deep: int = 1) -> list[Key]:
        """The keys that can be written at this point: names, and what one step leads to from them."""
        found = list(scope.keys)
        for _ in range(deep):
            found += [step for key in scope.keys for step in self.steps(key)]
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
            found += [Code(f"{key.text}.{name}", *bits) for name in FIELDS_OF[kind] if self.may_read(key, name)] * 2
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
                divisor = self.pick(("3", "-2", "7", *(name for name, kind in scope.numbers.items() if kind == "int")))
                return Code(f"({a} {self.pick(('//', '%'))} {divisor})")
            case 5:
                return Code(f"{self.pick(('-', '~', '+'))}({a})")
            case 6:
                return Code(f"{self.pick(('min', 'max'))}({a}, {self.expr(scope, 'int', depth).text})")
            case 7:
                return Code(f"({a} if {self.expr(scope, 'bool', depth).text} else {self.expr(scope, 'int', depth).text})")
            case 8:
                return Code(f"ebb.int32({self.expr(scope, self.pick(('double', 'single', 'long')), depth).text})")
            case 9:
                return Code(f"({a} {self.pick(('<<', '>>', '**'))} {self.number(0, 3)})")
            case 10:
                cell = self.key(scope, "cells")
                return Code(f"ebb.coords({cell.text})[{self.number(0, 1)}]" if cell else f"abs({a})")
            case 11:
                node = self.key(scope, "nodes")
                return Code(f"len(ebb.where(links.{self.pick(self.grouped)}, {node.text}))" if node and self.grouped else a)
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

    # ---- Statements ----

    def kernel(self) -> KernelText:
        own = Key("r", self.relation, True)
        self.body(Scope({}, [own]), top=True)
        parameter = "r" if self.chance(1, 4) else f"r: {self.relation}"
        text = PRELUDE + f"@ebb.kernel\ndef k({parameter}):\n" + "\n".join(self.lines) + "\n"
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
        count = self.number(2, 7) if top else self.number(1, 3)
        before = len(self.lines)
        for _ in range(count):
            if self.budget <= 0:
                break
            self.budget -= 1
            self.statement(scope)
        if len(self.lines) == before:
            self.line("pass")

    def statement(self, scope: Scope) -> None:
        deep = self.indent >= 4
        match self.number(0, 17):
            case 0 | 1 | 2:
                self.change_field(scope)
            case 3 | 4 | 5 | 6:
                self.reduce_field(scope)
            case 7:
                self.reduce_global(scope)
            case 8 | 9:
                self.assign(scope)
            case 10:
                self.bind_key(scope)
            case 11 if not deep:
                self.branch(scope)
            case 12 | 13 | 14 if not deep and self.grouped:
                self.query_loop(scope)
            case 15 if not deep:
                self.range_loop(scope)
            case 16 if not deep:
                self.pick((self.while_loop, self.unrolled_loop, self.leave))(scope)
            case 17:
                self.write_key(scope)
            case _:
                self.reduce_field(scope)

    def change_field(self, scope: Scope) -> None:
        """A write, or where the plan has no field for it another statement."""
        places = [
            (key, name) for key in self.keys(scope, deep=0) for name in NUMBERS if self.may_write(key, name)
        ]
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
            for name in NUMBERS
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

    def global_phase(self, name: str) -> str:
        if ("", name) not in self.plan:
            kind = {ofs: of for of, ofs in GLOBAL_OF.items()}[name]
            self.plan["", name] = self.pick(("read", *(PHASE_OF.get(op, op) for op in OPERATORS[kind])))
        return "read" if self.breaks_plan() else self.plan["", name]

    def reduce_global(self, scope: Scope) -> None:
        name = self.pick(tuple(GLOBALS))
        phase = self.global_phase(name)
        kind = {ofs: of for of, ofs in GLOBAL_OF.items()}[name]
        if phase == "read":
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
        key = self.key(scope)
        if key is None:
            return
        name = self.fresh("k")
        self.line(f"{name} = {key.text}")
        scope.keys.append(Key(name, key.relation, key.centered))

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
