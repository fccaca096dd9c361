"""Assignments, control flow, reductions and the order of evaluation in KIR."""

from __future__ import annotations

import pytest
from elaborated import make_world

import ebb
from ebb.compiler.elaborate.parameters import FieldName


@pytest.fixture(scope="module")
def world():
    return make_world()


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("v.f += v.f", "V.f[v] += V.f[v]"),
        ("v.f -= v.f", "V.f[v] += -V.f[v]"),
        ("v.i ^= 3", "V.i[v] ^= 3"),
        ("v.f /= 2", "V.f[v] = V.f[v] / 2.0f32"),
        ("v.f = min(v.f, 2, 3)", "V.f[v] min= 2.0f32"),
        ("v.next.f = max(v.f, v.next.f)", "V.f[V.next[v]] max= V.f[v]"),
        ("v.p.x = min(v.p.x, v.f)", "V.p[v][0] min= V.f[v]"),
        ("v.f = min(v.next.f, 1)", "V.f[v] = min(V.f[V.next[v]], 1.0f32)"),
        ("G.value += v.d", "global0 += V.d[v]"),
        ("G += v.d", "global0 += V.d[v]"),
        ("G -= v.d", "global0 += -V.d[v]"),
        ("G.value = min(G, v.d)", "global0 min= V.d[v]"),
        ("G = max(v.d, G.value)", "global0 max= V.d[v]"),
        ("GV.value[0] += v.f", "global0[0] += float64(V.f[v])"),
        ("GV.x *= 2", "global0[0] *= 2.0"),
        ("GB |= v.b", "global0 |= V.b[v]"),
        ("v.d = G + G.value", "V.d[v] = global0 + global0"),
    ],
)
def test_reductions(world, body, expected):
    assert world.kir(body) == expected


def test_assignments(world):
    assert world.kir("a, b = 1, 2\na, b = b, a\nv.i = a - b").split("\n")[2:] == [
        "value: int32 = a",
        "a = b",
        "b = value",
        "V.i[v] = a - b",
    ]
    assert world.kir("k = v\nk.f = 1") == "k: V = v\nV.f[k] = 1.0f32"
    assert world.kir("x: ebb.float32 = 0\nv.f = x") == "x: float32 = 0.0f32\nV.f[v] = x"
    assert world.kir("v.f = v.d = 1 + v.f").split("\n")[0] == "value: float32 = 1.0f32 + V.f[v]"


def test_members(world):
    assert world.kir("v.double = 3") == "V.d[v] = 1.5"
    assert world.kir("v.double += 3") == "V.d[v] += 1.5"
    assert world.kir("v.double *= 2") == "value: float64 = (V.d[v] * 2.0) * 2.0\nV.d[v] = value / 2.0"
    assert world.kir("v.mate.f += 1") == "V.f[V.next[v]] += 1.0f32"
    assert world.kir("v.d = v.double") == "V.d[v] = V.d[v] * 2.0"
    assert world.kir("c.new_t = c(0, 1).t", "c", relation="C") == (
        "C.new_t[c] = C.t[affine(C, [[1, 0, 0], [0, 1, 1]], c)]"
    )


def test_queries(world):
    expected = "for e: E in where(E.tail, v):\n  V.f[v] += E.x[e]"
    assert world.kir("for e in v.edges: v.f += e.x") == expected
    assert world.kir("for u in v.edges.head: v.i += u.i") == (
        "for row: E in where(E.tail, v):\n  u: V = E.head[row]\n  V.i[v] += V.i[u]"
    )
    assert world.kir("spokes = v.edges\nfor e in spokes: v.f += e.x").endswith("V.f[v] += E.x[e]")


def test_functions(world):
    assert world.kir("v.f = square(v.f)") == "x: float32 = V.f[v]\nV.f[v] = x * x"
    assert world.kir("v.f = narrow(2)") == "V.f[v] = 2.0f32 * 2.0f32"
    assert world.kir("reset(v)") == "V.f[v] = 0.0f32"
    assert world.kir("a, b = pair(v.i)\nv.i = a + b").startswith("x: int32 = V.i[v]\na: int32 = x\nb: int32 = 1")
    assert world.kir("v.f = positive(v.f)") == (
        "x: float32 = V.f[v]\n"
        "block positive:\n"
        "  if x > 0.0f32:\n"
        "    positive: float32 = x\n"
        "    leave positive\n"
        "  positive = 0.0f32\n"
        "  leave positive\n"
        "V.f[v] = positive"
    )


def test_names_of_fields(world):
    types = (FieldName("d"), FieldName("f"))
    assert world.kir("v[dst] = v[src]", "v, dst: str, src: str", types) == "V.d[v] = float64(V.f[v])"
    assert "V.d[c] = float64(V.f[c])" in world.kir("move_field(v, dst, src)", "v, dst, src", types)


def test_what_a_call_does_stays_in_its_place(world):
    assert world.kir("v.f = v.f + bump(v)") == "value: float32 = V.f[v]\nV.f[v] += 1.0f32\nV.f[v] = value + V.f[v]"
    assert world.kir("v.b = v.b and bump(v) > 0") == (
        "and: bool_ = V.b[v]\nif and:\n  V.f[v] += 1.0f32\n  and = V.f[v] > 0.0f32\nV.b[v] = and"
    )
    assert world.kir("v.f = bump(v) if v.b else 0.0") == (
        "if V.b[v]:\n  V.f[v] += 1.0f32\n  chosen: float32 = V.f[v]\nelse:\n  chosen = 0.0f32\nV.f[v] = chosen"
    )
    assert world.kir("while bump(v) < 3: v.d += 1") == (
        "while True:\n  V.f[v] += 1.0f32\n  if not (V.f[v] < 3.0f32):\n    break\n  V.d[v] += 1.0"
    )
    assert world.kir("v.b = v.d < v.f < bump(v)").split("\n")[:2] == [
        "value: float32 = V.f[v]",
        "and: bool_ = V.d[v] < float64(value)",
    ]
    assert world.kir("v.f **= bump(v)").startswith("value: float32 = V.f[v]\n")
    assert world.kir("v.d = ebb.rand() + ebb.randn(ebb.float32)").startswith("rand: float64 = rand(float64)\nrandn")


def test_loops(world):
    assert world.kir("for i in range(count): v.i += i").startswith(
        "uniform $0: int32 = count\nfor i: int32 in range(0, $0, 1)"
    )
    assert world.kir("for i in range(v.l): v.l += i").startswith("for i: int64 in range(0i64, V.l[v], 1i64)")
    assert world.kir("for di, dj in offsets: c.new_t += c(di, dj).t", "c", relation="C") == (
        "C.new_t[c] += C.t[affine(C, [[1, 0, 1], [0, 1, 0]], c)]\n"
        "C.new_t[c] += C.t[affine(C, [[1, 0, -1], [0, 1, 0]], c)]"
    )
    assert world.kir("for e in v.es: e.x += 1").count("E.x[") == 2
    assert world.kir("for name in ('f', 'd'): v[name] = 0") == "V.f[v] = 0.0f32\nV.d[v] = 0.0"
    assert world.kir("for i in range(3): x = i\nv.i = x + i").endswith("V.i[v] = x + i")


def test_unrolled_loops_are_left_and_continued(world):
    found = world.kir(
        "for x in (1.0, 2.0):\n    if v.b: break\n    if v.i > 0: continue\n    y = x * v.f\n    v.f += y"
    )
    assert found.count("leave loop") == 2
    assert found.count("block turn") == 2
    assert found.count("y.") >= 2, "each turn has its own y"


def test_a_loop_over_a_tuple_takes_its_elements_first(world):
    assert world.kir("a = 1\nfor x in (a, a + 1): a = x * 2\nv.i = a").split("\n")[:3] == [
        "a: int32 = 1",
        "value.2: int32 = a",
        "value.3: int32 = a + 1",
    ]


def test_returns_end_the_row(world):
    assert world.kir("if v.b: return\nv.f = 1") == ("block step:\n  if V.b[v]:\n    leave step\n  V.f[v] = 1.0f32")


def test_print_and_assert(world):
    assert world.kir("print('x', v.i, f'{v.f:.3f}|{v.p}', sep=', ')") == (
        "print('x, ', V.i[v], ', ', V.f[v]:.3f, '|', V.p[v])"
    )
    assert world.kir("assert v.i > 0, 'positive'") == "assert V.i[v] > 0, 'positive'"


def test_a_global_can_be_given_to_a_function():
    world = make_world()
    world.names["add"] = ebb.func(world.function("g.value += x", "g, x"))
    assert world.kir("add(G, v.d)").endswith("global0 += x")


def test_a_loop_in_one_branch_does_not_change_a_local_in_the_other(world):
    body = "x = v.d\nif v.b:\n    for x in (1.0, 2.0): v.f += 1\nelse:\n    x *= 2\nv.d = x"
    assert world.kir(body) == (
        "x: float64 = V.d[v]\n"
        "if V.b[v]:\n"
        "  x = 1.0\n"
        "  V.f[v] += 1.0f32\n"
        "  x = 2.0\n"
        "  V.f[v] += 1.0f32\n"
        "else:\n"
        "  x = x * 2.0\n"
        "V.d[v] = x"
    )


def test_what_an_unrolled_loop_leaves_is_not_known_after_a_branch_or_in_the_next_turn(world):
    first = "for x in (1, 2): pass\n"
    assert world.errors(first + "if v.b:\n    for x in (3, 4): pass\nv.i = x") == [("E121", "x")]
    assert world.errors(first + "for i in range(3):\n    v.i += x\n    for x in (3, 4): pass") == [("E121", "x")]
    assert world.kir(first + "for x in (3, 4): pass\nv.i = x") == "V.i[v] = 4"


def test_a_jump_after_a_return_is_dead_code(world):
    assert (
        world.kir("for x in (1, 2):\n    if v.b:\n        return\n        continue\n    v.i = x").count("leave turn")
        == 2
    )
