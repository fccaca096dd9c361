"""Kernels that are found in the cache: what they look at of the host has to be the same, and what came of it is right.

Each case is a program and a change of the world around it. The program runs in its world twice, each time with new
objects, as in another process: the second time nothing is elaborated. In the changed world it must do what it does
without a cache.
"""

from __future__ import annotations

import linecache
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

import ebb
from ebb.backends import known

HERE = Path(__file__).parent


class Case(NamedTuple):
    """The body of a kernel ``step(r: rows)``, the names around it, and those that change.

    ``text`` stands before the kernel. ``elaborated`` says whether the change has to be noticed by the elaboration.
    """

    body: str
    names: Callable[[], dict[str, Any]] = dict
    changed: Callable[[], dict[str, Any]] = dict
    text: str = ""
    changed_text: str | None = None
    elaborated: bool = True


def rows(dtype=ebb.float64, size=6, **fields):
    found = ebb.Relation("rows", size=size)
    found.new_field("x", dtype, init=np.arange(size))
    found.new_field("y", ebb.float64, init=1.0)
    found.new_field("v", ebb.vec3d, init=np.arange(3 * size).reshape(size, 3))
    for name, type_ in fields.items():
        found.new_field(name, type_)
    return found


def linked(group=True, factor=2, reducer=1, near=None):
    """Rows that point to rows of ``others``, which have a member; also by ``near``, to those or to other rows."""
    found, others = rows(), rows()
    found.new_field("to", others, init=np.arange(6)[::-1] // 2)
    if group:
        found.group_by("to")
    found.new_field("near", others if near is None else near, init=np.arange(6) // 2)
    text = f"def scaled(v):\n    return v.x * {factor}\ndef add(v, value):\n    v.y += {reducer} * value\n"
    functions = compiled(text, "members.py")
    others.member(functions["scaled"]).reducer("+")(functions["add"])
    return {"rows": found, "others": others}


def grid(shape=(4, 3), periodic=(True, True)):
    found = ebb.Relation("rows", shape=shape, periodic=periodic)
    found.new_field("x", ebb.float64, init=np.arange(np.prod(shape)).reshape(shape))
    found.new_field("y", ebb.float64)
    return {"rows": found}


def compiled(text: str, filename: str, **names: Any) -> dict[str, Any]:
    """The names of a program in a file of this text."""
    filename = f"/kept/{filename}"
    linecache.cache[filename] = (len(text), None, text.splitlines(keepends=True), filename)
    namespace: dict[str, Any] = {"__name__": "kept", "ebb": ebb, "np": np, **names}
    exec(compile(text, filename, "exec"), namespace)
    return namespace


def func(text: str, filename: str = "funcs.py", **names: Any) -> Any:
    """The func ``f`` of a file of this text."""
    return ebb.func(compiled(text, filename, **names)["f"])


def module(**names: Any) -> ModuleType:
    found = ModuleType("parameters")
    vars(found).update(names)
    return found


class Number(int):
    """An integer of a class of its own."""


ENCLOSED = """
def make(rows, k, T):
    def g(a: T):
        return a / k
    f = ebb.func(g)
    @ebb.kernel
    def step(r: rows):
        r.y = f(r.id)
    return step
step = make(rows, k, T)
"""

CASES = {
    "the type of a field": Case("r.y = r.x / 3", lambda: {"rows": rows()}, lambda: {"rows": rows(ebb.float32)}),
    "a number, which is none of the kernel's": Case(
        "r.y = r.x * k", lambda: {"k": 0.5}, lambda: {"k": 0.25}, elaborated=False
    ),
    "how many rows there are": Case(
        "r.y = r.x + len(rows)", lambda: {"rows": rows()}, lambda: {"rows": rows(size=9)}, elaborated=False
    ),
    "the type of a number": Case("r.y = r.x + 7 // k", lambda: {"k": 2}, lambda: {"k": 2.5}),
    "a number of a class of its own": Case("r.y = r.x + k", lambda: {"k": 2}, lambda: {"k": Number(3)}),
    "a bool for a number": Case("r.y = 1.0 if k else 2.0", lambda: {"k": True}, lambda: {"k": False}, elaborated=False),
    "the type of a NumPy number": Case(
        "r.y = r.x * k", lambda: {"k": np.float64(0.1)}, lambda: {"k": np.float32(0.1)}
    ),
    "an index": Case("r.y = r.v[k]", lambda: {"k": 1}, lambda: {"k": 2}),
    "an attribute of an object": Case(
        "r.y = r.v[k.a.b]", lambda: {"k": SimpleNamespace(a=SimpleNamespace(b=1))},
        lambda: {"k": SimpleNamespace(a=SimpleNamespace(b=2))},
    ),
    "the type of an attribute": Case(
        "r.y = r.x + k.n * 7 // 2", lambda: {"k": SimpleNamespace(n=1)}, lambda: {"k": SimpleNamespace(n=1.5)}
    ),
    "what a module has": Case("r.y = r.v[k.axis]", lambda: {"k": module(axis=0)}, lambda: {"k": module(axis=1)}),
    "an element of a dictionary": Case("r.y = r.v[k['a']]", lambda: {"k": {"a": 0}}, lambda: {"k": {"a": 2}}),
    "the name of a field": Case("r.y = r[k] * 2", lambda: {"k": "x"}, lambda: {"k": "y"}),
    "the length of a list": Case(
        "for each in k:\n        r.y += each", lambda: {"k": [1.0, 2.0]}, lambda: {"k": [1.0, 2.0, 3.0]}
    ),
    "the type in a list": Case(
        "for each in k:\n        r.y += each * 5 // 2", lambda: {"k": (1, 2)}, lambda: {"k": (1, 2.5)}
    ),
    "a constant": Case(
        "r.y = k * 3", lambda: {"k": ebb.constant(0.1, ebb.float32)}, lambda: {"k": ebb.constant(0.2, ebb.float32)}
    ),
    "the type of a constant": Case(
        "r.y = k * 3", lambda: {"k": ebb.constant(0.1, ebb.float32)}, lambda: {"k": ebb.constant(0.1, ebb.float64)}
    ),
    "the type of a global": Case(
        "r.y = k.value / 3", lambda: {"k": ebb.Global(ebb.float32, 1.0)}, lambda: {"k": ebb.Global(ebb.float64, 1.0)}
    ),
    "a name that hides a builtin": Case(
        "r.y = abs(r.x - 3)", dict, lambda: {"abs": func("def f(x):\n    return x * x\n")}
    ),
    "a captured type": Case("r.y = T(r.x / 3)", lambda: {"T": ebb.float32}, lambda: {"T": ebb.float64}),
    "the body of a func": Case(
        "r.y = f(r.x)", lambda: {"f": func("def f(x):\n    return x + 1\n")},
        lambda: {"f": func("def f(x):\n    return x + 2\n")},
    ),
    "what a func captures": Case(
        "r.y = f(r.v)", lambda: {"f": func("def f(v):\n    return v[k]\n", k=0)},
        lambda: {"f": func("def f(v):\n    return v[k]\n", k=1)},
    ),
    "a func of a func": Case(
        "r.y = f(r.v)",
        lambda: {"f": func("def f(v):\n    return g(v)\n", g=func("def f(v):\n    return v[0]\n", "inner.py"))},
        lambda: {"f": func("def f(v):\n    return g(v)\n", g=func("def f(v):\n    return v[1]\n", "inner.py"))},
    ),
    "a default argument": Case(
        "r.y = f(r.x)", lambda: {"f": func("def f(x, a=k):\n    return x * a\n", k=2)},
        lambda: {"f": func("def f(x, a=k):\n    return x * a\n", k=3)},
    ),
    "an array as a default argument": Case(
        "r.y = f(r.v)", lambda: {"f": func("def f(v, a=k):\n    return ebb.dot(v, a)\n", k=np.array([1.0, 0, 0]))},
        lambda: {"f": func("def f(v, a=k):\n    return ebb.dot(v, a)\n", k=np.array([0, 1.0, 0]))},
    ),
    "the annotation of a func": Case(
        "r.y = f(r.x)", lambda: {"f": func("def f(x: T):\n    return x / 3\n", T=ebb.float64)},
        lambda: {"f": func("def f(x: T):\n    return x\n", T=ebb.float32)},
    ),
    "the name of an annotation": Case(
        "", lambda: {"rows": rows(id=ebb.float32), "k": 3.0, "T": ebb.float32},
        lambda: {"rows": rows(id=ebb.float32), "k": 3.0, "T": ebb.float64},
        text=f"from __future__ import annotations\n{ENCLOSED}",
    ),
    "the text of the kernel": Case("r.y = r.x + 1", text="# one", changed_text="# two"),
    "a member": Case("r.y = r.to.scaled", linked, lambda: linked(factor=3)),
    "a reducer of a member": Case(
        "r.to.scaled += r.x", linked, lambda: linked(reducer=3)
    ),
    "a grouping": Case("r.to.y += r.x", linked, lambda: linked(group=False)),
    "two relations for one": Case(
        "r.y = 1.0 if r.to == r.near else 2.0", linked, lambda: linked(near=rows())
    ),
    "whose field it is": Case(
        "r.y = r[field]", lambda: (lambda names: {**names, "field": names["rows"].x})(linked()),
        lambda: (lambda names: {**names, "field": names["others"].x})(linked()),
    ),
    "the extents of a grid": Case(
        "r.y = ebb.affine(rows, [[1, 0, 1], [0, 1, 0]], r).x", grid, lambda: grid((5, 2))
    ),
    "the ends of a grid": Case(
        "r.y = ebb.affine(rows, [[1, 0, 1], [0, 1, 0]], r).x", grid, lambda: grid(periodic=(False, True))
    ),
    "the matrix of a map": Case(
        "r.y = ebb.affine(rows, k, r).x", lambda: {**grid(), "k": np.array([[1, 0, 1], [0, 1, 0]])},
        lambda: {**grid(), "k": np.array([[1, 0, 0], [0, 1, 1]])},
    ),
    "the edge of a map": Case(
        "r.y = ebb.affine(rows, [[1, 0, 1], [0, 1, 0]], r, edge=k).x",
        lambda: {**grid(periodic=(False, True)), "k": "clamp"}, lambda: {**grid(periodic=(False, True)), "k": "check"},
    ),
}  # fmt: skip


@pytest.fixture
def elaborations(monkeypatch, tmp_path):
    """The names of the kernels that were elaborated, with a cache of its own and the package as if it were settled."""
    made = list[str]()
    kernels = sys.modules["ebb.kernel"]
    make = kernels.make_whole

    def counting(source, *rest):
        made.append(source.name)
        return make(source, *rest)

    monkeypatch.setattr(kernels, "make_whole", counting)
    monkeypatch.setattr(known, "package_state", lambda: "these")
    monkeypatch.setenv("EBB_CACHE_DIR", str(tmp_path))
    with ebb.backend("cpu"):
        yield made


def outcome(text: str, body: str, names: Mapping[str, Any]) -> Any:
    """What the program makes of its fields, or which error it ends with."""
    names = {"rows": rows()} | dict(names)
    if body:
        text = f"{text}\n@ebb.kernel\ndef step(r: rows):\n    {body}\n"
    try:
        compiled(text, "program.py", **names)["step"](names["rows"])
    except ebb.EbbError as error:
        return str(error)
    relations = [each for each in names.values() if isinstance(each, ebb.Relation)]
    return [(path, field.to_numpy().tolist()) for each in relations for path, field in each.fields.items()]


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_change_of_the_world(case, elaborations) -> None:
    changed_text = case.text if case.changed_text is None else case.changed_text
    first = outcome(case.text, case.body, case.names())
    assert elaborations == ["step"]
    assert outcome(case.text, case.body, case.names()) == first
    assert elaborations == ["step"], "the same world, of other objects"
    found = outcome(changed_text, case.body, {**case.names(), **case.changed()})
    assert len(elaborations) == 1 + case.elaborated
    with ebb.backend("reference"):
        assert outcome(changed_text, case.body, {**case.names(), **case.changed()}) == found
    assert outcome(case.text, case.body, case.names()) == first
    assert len(elaborations) <= 3 + case.elaborated  # an error is found anew each time


PROCESS = """
import sys
import ebb
from ebb.backends import known
known.package_state = lambda: "these"
kernels = sys.modules["ebb.kernel"]
made, make = [], kernels.make_whole
kernels.make_whole = lambda source, *rest: (made.append(source.name), make(source, *rest))[1]

import cached_program
from ebb.domains import HexMesh

cached_program.main()
mesh = HexMesh.box(2, 2, 2)
mesh.elements.new_field("sum", ebb.vec3f)
mesh.vertices.new_field("sum", ebb.float32)

@ebb.kernel
def gather(e: mesh.elements):
    for i in range(8):
        e.sum += e.v[i].pos

@ebb.kernel
def look(v: mesh.vertices):
    for e in v.elements:
        v.sum += ebb.length(e.sum)

gather(mesh.elements)
look(mesh.vertices)
print(mesh.vertices.sum.to_numpy().sum())
print(made)
"""


def test_another_process_elaborates_nothing(tmp_path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROCESS, encoding="utf-8")
    said = list[list[str]]()
    for seed in ("1", "2"):
        environment = {"EBB_CACHE_DIR": str(tmp_path / "kept"), "PYTHONHASHSEED": seed, "PYTHONPATH": str(HERE)}
        done = subprocess.run(
            [sys.executable, str(program)], env=os.environ | environment, capture_output=True, text=True, check=True
        )
        said.append(done.stdout.splitlines())
    assert said[0][:-1] == said[1][:-1]
    assert said[0][-1] == "['double', 'shift', 'clamp', 'count', 'gather', 'look']"
    assert said[1][-1] == "[]"
