"""A small world, and kernels on it given as text: their KIR, or the codes and the places of their errors."""

from __future__ import annotations

import itertools
import linecache
import textwrap
from dataclasses import dataclass

import pytest

import ebb
from ebb.compiler.elaborate.elaborate import Elaborated, elaborate
from ebb.compiler.elaborate.source import find_source
from ebb.compiler.kir_print import text as kir_text
from ebb.compiler.kir_verify import verify_kernel

_numbers = itertools.count()


def define(text, **names):
    """Runs ``text`` with its source where Python keeps it; returns its names."""
    text = textwrap.dedent(text)
    filename = f"<unit program {next(_numbers)}>"
    linecache.cache[filename] = (len(text), None, text.splitlines(keepends=True), filename)
    namespace = {"ebb": ebb, "__name__": "program", **names}
    exec(compile(text, filename, "exec", dont_inherit=True), namespace)
    return namespace


@dataclass
class World:
    """Relations and what kernels capture, by name."""

    names: dict[str, object]

    def __getattr__(self, name):
        return self.names[name]

    def function(self, body, signature="v"):
        """The Python function whose body is ``body``; it sees the world as its globals."""
        lines = textwrap.indent(textwrap.dedent(body).strip("\n"), "    ")
        namespace = define(f"def step({signature}):\n{lines}\n")
        function = namespace["step"]
        # The namespace of the world itself, so that tests can change a captured name.
        return type(function)(function.__code__, self.names, "step", function.__defaults__, function.__closure__)

    def elaborate(self, body, signature="v", types=(), relation="V") -> Elaborated:
        found = elaborate(find_source(self.function(body, signature)), self.names[relation], types)
        verify_kernel(found.kernel)
        return found

    def kir(self, body, signature="v", types=(), relation="V"):
        """The statements of the kernel as text, without the first line and its indentation."""
        lines = kir_text(self.elaborate(body, signature, types, relation).kernel).split("\n")[1:]
        return textwrap.dedent("\n".join(lines)).strip("\n")

    def errors(self, body, signature="v", types=(), relation="V"):
        """For each error its code and the source under its caret."""
        with pytest.raises(ebb.EbbError) as caught:
            self.elaborate(body, signature, types, relation)
        return [(each.code, each.primary.span.text) for each in caught.value.diagnostics]

    def error(self, body, signature="v", types=(), relation="V"):
        """The exception."""
        with pytest.raises(ebb.EbbError) as caught:
            self.elaborate(body, signature, types, relation)
        return caught.value


WORLD = """
import math
import numpy as np

V, E, C = ebb.Relation("V", size=4), ebb.Relation("E", size=6), ebb.Relation("C", shape=(4, 5))
for name, type_ in dict(
    f=ebb.float32, d=ebb.float64, i=ebb.int32, l=ebb.int64, u=ebb.uint32, b=ebb.bool_,
    p=ebb.vec3f, q=ebb.vec3d, m=ebb.mat3f,
    w=ebb.vec3i, next=V, es=ebb.vector(E, 2),
).items():
    V.new_field(name, type_)
for name, type_ in dict(head=V, tail=V, x=ebb.float32).items():
    E.new_field(name, type_)
C.new_field("t", ebb.float64)
C.new_field("new_t", ebb.float64)
E.group_by("tail")
G, GV, GB = ebb.Global(ebb.float64, 0.0), ebb.Global(ebb.vec3d, 0.0), ebb.Global(ebb.bool_, False)
K = ebb.constant(2.5, ebb.float32)

gravity, count, flag = 9.81, 3, True
offsets, weights = ((1, 0), (-1, 0)), (0.5, 1.0, 2)
axis, table = np.array([0.0, 0.0, 1.0]), np.array([[1, 0, 1], [0, 1, 0]])
small, single = np.float32(0.5), np.int64(2)

class settings:
    dt = 0.1
    n = 2

@V.member
def edges(v):
    return ebb.where(E.tail, v)

@V.member
def mate(v):
    return v.next

@V.member
def double(v):
    return v.d * 2

@double.setter
def double(v, value):
    v.d = value / 2

@double.reducer("+")
def double(v, value):
    v.d += value / 2

@C.member("__call__")
def moved(c, di, dj):
    return ebb.affine(C, [[1, 0, di], [0, 1, dj]], c)

@ebb.func
def square(x):
    return x * x

@ebb.func
def positive(x):
    if x > 0:
        return x
    return 0

@ebb.func
def pair(x):
    return x, 1

@ebb.func
def reset(v):
    v.f = 0

@ebb.func
def bump(v):
    v.f += 1
    return v.f

@ebb.func
def move_field(c, dst: str, src: str):
    c[dst] = c[src]

@ebb.func
def narrow(x: ebb.float32, y=2):
    return x * y

@ebb.func
def ping(x):
    return pong(x)

@ebb.func
def pong(x):
    return ping(x)

def python_function(x):
    return x
"""


def make_world() -> World:
    return World(define(WORLD))
