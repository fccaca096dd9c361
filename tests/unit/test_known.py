"""Code that is found by the text of its kernel: never that of another, and with all that a launch must know."""

from __future__ import annotations

import os
from enum import Enum, IntEnum
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

import ebb
from ebb.backends import kernel_code, known
from ebb.backends.cache import ObjectCache
from ebb.backends.cpu import cpu_backend
from ebb.backends.kernel_code import Lowering, launched_as
from ebb.compiler import lir, lir_print
from ebb.compiler.interface import interface_of, packed, unpacked
from ebb.compiler.kir_key import kernel_key
from ebb.compiler.lower import facts_of
from ebb.diagnostics.span import Span
from ebb.records import replace
from ebb.relations.field import Field
from ebb.types.types import SCALARS, ScalarType

PLAIN = Lowering(lir.Precision.CONTRACT, lir.Updates.PLAIN)


@pytest.fixture(autouse=True)
def settled_sources(monkeypatch):
    monkeypatch.setattr(known, "package_state", lambda: "these")


@pytest.fixture
def lowerings(monkeypatch):
    """The names of the kernels that were lowered."""
    names = []
    lower = kernel_code.lower

    def counting(kernel, *rest):
        names.append(kernel.name)
        return lower(kernel, *rest)

    monkeypatch.setattr(kernel_code, "lower", counting)
    return names


def world(shape=(6, 5), periodic=(True, False), size=7, counted=ebb.int32, name="cells", column="x"):
    """Relations, and kernels on them that together have all that the lowering looks at."""
    cells = ebb.Relation(name, shape=shape, periodic=periodic)
    points = ebb.Relation("points", size=size)
    edges = ebb.Relation("edges", size=9)
    for relation in (cells, points):
        relation.new_field(column, ebb.float64, init=1.0)
        relation.new_field("z", ebb.float64)
        relation.new_field("y", ebb.vec3d)
        relation.new_field("n", counted)
    edges.new_field("tail", points, init=np.arange(9) % 7)
    edges.new_field("head", points, init=np.arange(1, 10) % 7)
    edges.group_by("tail")
    rows = {**grid_kernels(cells, column), **mesh_kernels(points, edges, column)}
    return SimpleNamespace(cells=cells, points=points, edges=edges, rows=rows)


def grid_kernels(cells, column):
    total = ebb.Global(ebb.float64, 0.0)
    scale = 2.0
    east, west = [[1, 0, 1], [0, 1, 0]], [[1, 0, -1], [0, 1, 0]]
    north, south = [[1, 0, 0], [0, 1, 1]], [[1, 0, 0], [0, 1, -1]]

    @ebb.kernel
    def smooth(c: cells):
        if ebb.affine(cells, east, c)[column] < c[column]:
            c.y = [c[column], ebb.affine(cells, west, c)[column], scale]
        total.value += c[column]

    @ebb.kernel
    def inner(c: cells):
        c.n = ebb.int32(ebb.affine(cells, north, c)[column] + ebb.affine(cells, south, c)[column])

    @ebb.kernel
    def beyond(c: cells):
        near = ebb.affine(cells, [[1, 0, 2], [0, 0.5, 0]], c, edge="clamp")
        c.z = near[column] + ebb.row_at(cells, [c.n, 2], edge="clamp")[column] + ebb.coords(c)[0] + ebb.id(c)

    return {smooth: cells, inner: cells.new_subset("most", np.s_[:, 1:-1]), beyond: cells}


def mesh_kernels(points, edges, column):
    most = ebb.Global(ebb.int32, 0)
    scale = 2.0

    @ebb.kernel
    def around(p: points):
        sum_ = 0.0
        for e in ebb.where(edges.tail, p):
            sum_ += e.head[column]
        p.y[1] = sum_ / 3.0
        most.value = max(most.value, len(ebb.where(edges.tail, p)))

    @ebb.kernel
    def spread(e: edges):
        assert e.tail[column] > -1.0, "positive"
        e.tail.n += 1
        e.head.y += [e.tail[column], e.tail.z, scale]

    @ebb.kernel
    def count(p: points):
        i = 0
        while i < 10:
            if i == p.n:
                break
            i += 2
        for k in range(3):
            p.y[k] = ebb.rand() + ebb.float64(i * k) + ebb.length(p.y)
        p[column] = -p[column] if p.n > 2 and not (p.n > 5) else p[column] ** 3
        if p.n > 1000:
            print(f"{p.n} is {p.z:.3f}")

    return {around: points, spread: edges, count: points}


def steps(made):
    """The steps of the kernels of a world."""
    found = {}
    for kernel, rows in made.rows.items():
        kernel.check(rows)
        (specialisation,) = rows.storage.compiled[kernel].specialisations[()]
        found[kernel.__name__] = specialisation.checked.step
    return found


def key_of_step(step):
    return kernel_key(step.kernel, step.phases, step.unchecked)


def keys(**how):
    return {name: key_of_step(step).text for name, step in steps(world(**how)).items()}


def programs(**how):
    made = world(**how)
    for relation in (made.points, made.edges):
        for field in relation.fields.values():
            if field.grouping is not None:
                field.grouping.refresh()
    rows = {kernel.__name__: rows for kernel, rows in made.rows.items()}
    return {
        name: (step, PLAIN.lower(step, facts_of(step.kernel), launched_as(rows[name])))
        for name, step in steps(made).items()
    }


def others(value):
    """Values that are not ``value``, and each with one thing in it that is another."""
    match value:
        case bool() | int() | float() | Fraction():
            yield not value if value is True or value is False else value + 1
        case str():
            yield value + "x"
        case Enum():
            yield next(each for each in type(value) if each is not value)
        case ScalarType():
            yield next(each for each in SCALARS if each != value)
        case Field():
            yield next(each for each in value.relation.fields.values() if each is not value)
        case tuple():
            for number, part in enumerate(value):
                yield from ((*value[:number], other, *value[number + 1 :]) for other in others(part))
            yield (*value, *value[-1:])
        case Span():
            pass
        case _:
            for name in getattr(value, "__match_args__", ()):
                yield from (replace(value, **{name: other}) for other in others(getattr(value, name)))


@pytest.mark.parametrize("name", ["smooth", "inner", "beyond", "around", "spread", "count"])
def test_whatever_changes_in_a_kernel_changes_its_key(name):
    step = steps(world())[name]
    known_keys = {key_of_step(step).text}
    changed = [replace(step.kernel, body=body) for body in others(step.kernel.body) if body != step.kernel.body]
    assert len(changed) > 30
    for kernel in changed:
        text = kernel_key(kernel, step.phases, step.unchecked).text
        assert text not in known_keys or text in known_keys - {key_of_step(step).text}
        known_keys.add(text)


def test_numbers_that_have_names_count_by_their_value():
    step = steps(world())["count"]
    assign = step.kernel.body[0]
    texts = set()
    for value in (1, 2):
        named = IntEnum("Named", {"ONE": value}).ONE
        body = (replace(assign, value=replace(assign.value, value=named)), *step.kernel.body[1:])
        texts.add(kernel_key(replace(step.kernel, body=body), step.phases, step.unchecked).text)
    assert len(texts) == 2


def test_where_a_kernel_stands_does_not_change_its_key():
    assert keys() == keys()


GRID, MESH = {"smooth", "inner", "beyond"}, {"around", "spread", "count"}


@pytest.mark.parametrize(
    ("how", "changed"),
    [
        ({"shape": (6, 6)}, GRID),
        ({"periodic": (True, True)}, GRID),
        ({"counted": ebb.int64}, {"inner", "beyond", "spread", "count"}),
        ({"name": "squares"}, GRID),
        ({"column": "w"}, GRID | MESH),
        ({"size": 9}, set()),
    ],
    ids=["shape", "periodic", "counted", "name", "column", "size"],
)
def test_what_a_kernel_runs_on_changes_its_key(how, changed):
    usual = keys()
    assert {name for name, key in keys(**how).items() if key != usual[name]} == changed


def test_the_size_of_a_mesh_does_not():
    assert keys(size=9) == keys()
    assert [lir_print.text(program) for _, program in programs(size=9).values()] == [
        lir_print.text(program) for _, program in programs().values()
    ]


def test_the_phases_and_what_the_launch_has_checked_change_it():
    inner, smooth = steps(world())["inner"], steps(world())["smooth"]
    assert inner.unchecked
    assert kernel_key(inner.kernel, inner.phases, ()).text != key_of_step(inner).text
    fields = {field: replace(phase, written=True) for field, phase in smooth.phases.fields.items()}
    assert kernel_key(smooth.kernel, replace(smooth.phases, fields=fields), ()).text != key_of_step(smooth).text


def test_an_interface_is_packed_and_unpacked_for_another_kernel_of_the_same_text():
    here, there = programs(), programs()
    for name, (step, program) in here.items():
        content = packed(interface_of(program), "code", key_of_step(step))
        assert unpacked(content, key_of_step(step)) == (interface_of(program), "code")
        other, its_program = there[name]
        assert unpacked(content, key_of_step(other)) == (interface_of(its_program), "code")
        assert other.kernel.relation is not step.kernel.relation


def run_all(made, cache):
    ebb.seed(1)
    backend = replace(cpu_backend(1), cache=cache)
    for kernel, rows in made.rows.items():
        (specialisation,) = rows.storage.compiled[kernel].specialisations[()]
        specialisation.refresh()
        backend.prepare(specialisation.checked).bind(rows).run(specialisation.uniforms(()))
    return {
        field.path: field.data.copy() for relation in (made.cells, made.points) for field in relation.fields.values()
    }


def test_what_is_known_is_not_lowered_and_computes_the_same(tmp_path, lowerings):
    first, second = world(), world()
    steps(first), steps(second)
    before = run_all(first, ObjectCache(tmp_path))
    assert len(lowerings) >= len(first.rows)
    lowerings.clear()
    after = run_all(second, ObjectCache(tmp_path))
    assert set(lowerings) == {"count"}, "what prints is lowered for what it prints"
    for path, values in before.items():
        assert np.array_equal(values, after[path]), path
    for path in tmp_path.glob("*.o"):
        os.remove(path)
    assert run_all(world_checked(), ObjectCache(tmp_path)).keys() == before.keys()


def world_checked():
    made = world()
    steps(made)
    return made
