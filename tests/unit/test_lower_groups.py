"""Programs for groups of threads: which rows a thread takes, how a group combines, and what is malformed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from kir_forms import HERE, OnRows, const, read, reduce, reduce_global, write

import ebb
from ebb.compiler import kir, lir, lir_verify, lir_walk
from ebb.compiler.lower import Launched, facts_of, lower
from ebb.compiler.phases.check import check_phases
from ebb.records import replace
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import bool_, float32, float64, int32, int64, matrix, uint32, vector


def grouped(kernel, size=64, updates=lir.Updates.PLAIN, phases=None):
    phases = check_phases(kernel) if phases is None else phases
    facts = facts_of(kernel)
    program = lower(kernel, phases, (), facts, Launched.ALL, lir.Precision.CONTRACT, updates, size)
    lir_verify.verify(program)
    return program


def grouped_source(kernel, relation, *arguments):
    """The program of a kernel that is written in the language."""
    checked = kernel._find_launch(relation, arguments).specialisation.checked
    return grouped(checked.kernel, phases=checked.phases)


def rows_with(**fields):
    relation = Relation("rows", size=3)
    for name, type_ in fields.items():
        relation.new_field(name, type_, init=0)
    return relation, OnRows(relation)


def reducing(*globals_and_ops):
    """A kernel that reduces into each of the globals."""
    _, on = rows_with()
    zeros = [const((0,) * g.type.size, g.type) for g, _ in globals_and_ops]
    return on.kernel(*(reduce_global(g, op, zero) for (g, op), zero in zip(globals_and_ops, zeros, strict=True)))


def writing():
    relation, on = rows_with(x=float32)
    return on.kernel(write(relation.x, on.row, const(2.0, float32)))


def scattering(*more):
    """A kernel that reduces into rows that others reduce into."""
    targets = Relation("targets", size=2)
    targets.new_field("n", float32)
    relation, on = rows_with(key=targets)
    return on.kernel(reduce(targets.n, read(relation.key, on.row), "+", const(1.0, float32)), *more)


def row_loop(program):
    return next(stmt for stmt in program.block if isinstance(stmt, lir.RowLoop))


def found(body, kind):
    return [stmt for stmt in lir_walk.statements(body) if isinstance(stmt, kind)]


def group_vars(body):
    return [stmt.var for stmt in found(body, lir.Declare) if stmt.var.memory is lir.Memory.GROUP]


# ---- Rows ----


def test_a_row_is_one_thread():
    program = grouped(writing(), 128)
    assert program.group_size == 128 and program.coverage is lir.Coverage.ONE and not program.in_order
    assert row_loop(program).rows is lir.Rows.INDEPENDENT and program.block == (row_loop(program),)
    assert program.entries == ("ebb_step",)


def test_sums_of_globals_stride_over_the_rows():
    program = grouped(reducing((Global(float64, 0.0), "+")), 32)
    assert program.group_size == 32 and program.coverage is lir.Coverage.STRIDED and not program.in_order
    assert program.entries == ("ebb_step", "ebb_step_finish")


def test_shared_sums_run_in_order_unless_they_are_atomic():
    for size in (1, 64):
        program = grouped(scattering(), size)
        assert program.group_size == 1 and program.coverage is lir.Coverage.STRIDED and program.in_order
    program = grouped(scattering(), 64, lir.Updates.ATOMIC)
    assert program.group_size == 64 and program.coverage is lir.Coverage.ONE and not program.in_order
    assert found(program.block, lir.AtomicUpdate)


def test_prints_do_not_order_the_rows_of_groups():
    shown = kir.Print(("x",), HERE)
    _, on = rows_with()
    assert not grouped(on.kernel(shown)).in_order
    assert grouped(scattering(shown)).in_order
    assert not grouped(scattering(shown), updates=lir.Updates.ATOMIC).in_order


def test_entries_have_names_that_every_target_takes():
    for name, entry in (("größe", "ebb_gr__e"), ("<lambda>", "ebb__lambda_"), ("step_2", "ebb_step_2")):
        assert replace(grouped(writing()), name=name).entries == (entry,)


# ---- What a group combines ----


def takings(body):
    """The stretches of a tree: how many threads take what the thread so much further has, or None for a barrier."""
    for position, stmt in enumerate(body):
        match stmt:
            case lir.Barrier():
                yield None
            case lir.If(_, (lir.Let(_, lir.Binary("+", _, lir.Literal(further, _))), *_)):
                yield body[position - 1].operation.right.value, further
            case _:
                pass


@pytest.mark.parametrize("size", [2, 3, 5, 7, 32, 63, 64, 65, 100, 1023, 1024])
def test_a_tree_takes_every_thread_once_and_waits_between(size):
    program = grouped(reducing((Global(float64, 0.0), "+")), size)
    for body in (program.block, program.finish):
        held = [{thread} for thread in range(size)]
        waited = False
        for taking in takings(body):
            if taking is None:
                waited = True
                continue
            assert waited
            count, further = taking
            assert 0 < count <= further and count + further <= size
            for thread in range(count):
                assert held[thread].isdisjoint(held[thread + further])
                held[thread] |= held[thread + further]
            waited = False
        assert waited and held[0] == set(range(size))


def test_one_thread_combines_nothing():
    program = grouped(reducing((Global(vector(float64, 3), [0.0] * 3), "+")), 1)
    assert not found((*program.block, *program.finish), lir.Barrier | lir.If)
    assert not group_vars((*program.block, *program.finish))


def test_components_and_globals_of_one_type_share_an_array():
    globals_ = [
        (Global(matrix(float64, 4, 4), np.zeros((4, 4))), "+"),
        (Global(float64, 0.0), "min"),
        (Global(vector(int32, 3), [0] * 3), "max"),
        (Global(bool_, False), "|"),
    ]
    program = grouped(reducing(*globals_), 256)
    for body in (program.block, program.finish):
        assert [(var.type, var.size) for var in group_vars(body)] == [(t, 256) for t in (float64, int32, bool_)]
    assert len(found(program.block, lir.Store)) == len(found(program.finish, lir.Store)) == 16 + 1 + 3 + 1
    assert program.private_bytes == 2 * (17 * 8 + 3 * 4 + 1)


IDENTITIES = [
    ("+", float32, 0.0),
    ("*", float64, 1.0),
    ("min", float32, math.inf),
    ("max", float64, -math.inf),
    ("min", int32, 2**31 - 1),
    ("max", int64, -(2**63)),
    ("min", uint32, 2**32 - 1),
    ("max", uint32, 0),
    ("&", int32, -1),
    ("&", uint32, 2**32 - 1),
    ("|", int64, 0),
    ("&", bool_, True),
    ("|", bool_, False),
    ("^", bool_, False),
]


@pytest.mark.parametrize("op, scalar, identity", IDENTITIES)
def test_sums_begin_with_the_identity(op, scalar, identity):
    program = grouped(reducing((Global(scalar, identity), op)))
    for body in (program.block, program.finish):
        first = next(stmt for stmt in body if isinstance(stmt, lir.StoreVar))
        assert first.value == lir.Literal(identity, scalar) and type(first.value.value) is type(identity)


# ---- What is malformed ----


def temp(number, scalar=int64):
    return lir.Temp(number, scalar)


ZERO = lir.Literal(0, int64)
SHARED = lir.Var(900, "shared", float32, 2, lir.Memory.GROUP)
ALWAYS = lir.Literal(True, bool_)


def in_row(program, *stmts):
    loop = row_loop(program)
    return tuple(replace(loop, body=(*loop.body, *stmts)) if stmt is loop else stmt for stmt in program.block)


MALFORMED = {
    "waits where not all": lambda p: {"block": (*p.block, lir.If(ALWAYS, (lir.Barrier(),), ()))},
    "waits where not all threads": lambda p: {"block": in_row(p, lir.Barrier())},
    "declares a variable of a group here": lambda p: {"block": in_row(p, lir.Declare(SHARED))},
    "uses shared of the group in a row": lambda p: {
        "block": (lir.Declare(SHARED), *in_row(p, lir.StoreVar(SHARED, ZERO, lir.Literal(0.0, float32))))
    },
    "accumulates where other threads do": lambda p: {
        "finish": (lir.Declare(SHARED), lir.Accumulate(SHARED, ZERO, "+", lir.Literal(0.0, float32)))
    },
    "a thread's number that is no int64": lambda p: {"finish": (lir.Let(temp(900, int32), lir.ThreadNumber()),)},
    "a thread's number where there are no groups": lambda p: {
        "group_size": None,
        "finish": (lir.Let(temp(900), lir.ThreadNumber()),),
    },
    "waits": lambda p: {"group_size": None, "finish": (lir.Barrier(),)},
    "1 to 1024 threads, not 0": lambda p: {"group_size": 0},
    "1 to 1024 threads, not 1025": lambda p: {"group_size": 1025},
    "groups of one thread": lambda p: {"block": (replace(row_loop(p), rows=lir.Rows.IN_ORDER),)},
    "as many groups as the rows need": lambda p: {"finish": (lir.Barrier(),), "coverage": lir.Coverage.ONE},
}


@pytest.mark.parametrize("text", MALFORMED)
def test_faults_of_groups_are_found(text):
    program = replace(grouped(writing()), coverage=lir.Coverage.STRIDED)
    with pytest.raises(lir_verify.MalformedLir, match=text):
        lir_verify.verify(replace(program, **MALFORMED[text](program)))


# ---- float32 stays float32 ----


def test_float32_programs_have_no_float64():
    rows = ebb.Relation("rows", size=4)
    for name, type_ in (("x", ebb.float32), ("n", ebb.int32), ("k", ebb.int64), ("v", ebb.vec3f), ("m", ebb.mat3f)):
        rows.new_field(name, type_, init=1)
    rows.new_field("on", ebb.bool_, init=True)
    total, lowest = ebb.Global(ebb.float32, 0.0), ebb.Global(ebb.vec3f, [0.0] * 3)
    dt, half = 0.1, ebb.constant(0.5, ebb.float32)

    @ebb.kernel
    def numbers(r: rows, w: ebb.float32):
        x = r.x
        y = x / 3 + 2 * x**2 + x**0.5 - dt * x // 2 + x % 1.5 + 1e-3 + half * w
        y += (x if x > 0.5 else -1.0) + ebb.float32(r.n) / ebb.float32(r.k) + r.n * half
        y = min(y, 1.0) + max(x, 0) + ebb.clamp(y, 0.0, 1.0) + ebb.sign(y) + abs(y) + ebb.select(r.on, x, 0.0)
        y += math.degrees(x) + ebb.sqrt(x) + ebb.sin(x) + ebb.pow(x, 3.0) + ebb.atan2(x, 1.0) + ebb.fmod(x, 2.0)
        r.n = ebb.int32(y * 2.5) + ebb.int32(round(y) + math.floor(y))
        r.on = math.isnan(y) or math.isinf(y)
        for _ in range(3):
            y += 0.5
        r.x = y
        total.value += y

    @ebb.kernel
    def vectors(r: rows):
        a = ebb.normalize(r.v) * 0.5 + ebb.cross(r.v, r.v) / 2 - [1, 0.5, 0]
        m = ebb.inverse(r.m) * 2.0 + ebb.outer(a, a) + ebb.transpose(r.m)
        r.x = ebb.length(a) + ebb.det(m) + ebb.trace(m) + ebb.dot(a, a)
        r.v = m @ a
        lowest.value = min(lowest.value, a)

    @ebb.kernel
    def drawn(r: rows):
        r.x = ebb.rand(ebb.float32) + ebb.randn(ebb.float32)

    programs = [grouped_source(numbers, rows, 0.5), grouped_source(vectors, rows), grouped_source(drawn, rows)]
    for program in programs:
        assert any(slot.type == float32 for slot in program.slots)
        assert float64 not in types_of(program)


def types_of(program):
    """The types of all slots, arguments, variables and values."""
    types = {place.type for place in (*program.slots, *program.arguments)}
    for stmt in lir_walk.statements((*program.block, *program.finish)):
        types |= {value.type for value in lir_walk.values(stmt)}
        match stmt:
            case lir.Let(temp_, _):
                types.add(temp_.type)
            case lir.Declare(var):
                types.add(var.type)
            case _:
                pass
    return types
