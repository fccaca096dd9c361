"""Literals, captured values, operators and coercions in KIR."""

from __future__ import annotations

import pytest
from elaborated import make_world

import ebb


@pytest.fixture(scope="module")
def world():
    return make_world()


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("v.f = 3", "V.f[v] = 3.0f32"),
        ("v.d = 1 / 6", "V.d[v] = 0.16666666666666666"),
        ("v.i = 1 // 6 + -7 % 3", "V.i[v] = 2"),
        ("v.f = 0.5 * v.f", "V.f[v] = 0.5f32 * V.f[v]"),
        ("v.d = v.f * v.d", "V.d[v] = float64(V.f[v]) * V.d[v]"),
        ("v.f = v.f * v.i", "V.f[v] = V.f[v] * float32(V.i[v])"),
        ("v.l = v.i + v.l", "V.l[v] = int64(V.i[v]) + V.l[v]"),
        ("v.d = v.i + 0.5", "V.d[v] = float64(V.i[v]) + 0.5"),
        ("v.d = v.i / 2", "V.d[v] = float64(V.i[v]) / float64(2)"),
        ("v.l = 2 ** 40", "V.l[v] = 1099511627776i64"),
        ("v.u -= 1", "V.u[v] += -1u32"),
        ("v.f = 2 ** 0.5 * v.f", "V.f[v] = 1.4142135623730951f32 * V.f[v]"),
        ("v.f = v.f * (1.0 if v.b else -1.0)", "V.f[v] = V.f[v] * (1.0f32 if V.b[v] else -1.0f32)"),
        ("v.l = v.i if v.b else v.l", "V.l[v] = int64(V.i[v]) if V.b[v] else V.l[v]"),
        ("v.b = v.i < 3 < v.l", "V.b[v] = (V.i[v] < 3) and (3i64 < V.l[v])"),
        ("v.b = not v.b or v.d > 1 and v.b", "V.b[v] = (not V.b[v]) or ((V.d[v] > 1.0) and V.b[v])"),
        ("v.b = v.next == v", "V.b[v] = V.next[v] == v"),
        ("v.f = K * v.f", "V.f[v] = 2.5f32 * V.f[v]"),
        ("v.f = ebb.clamp(v.f, 0, 1)", "V.f[v] = clamp(V.f[v], 0.0f32, 1.0f32)"),
        ("v.d = math.pi + abs(-3) + max(1, 2)", "V.d[v] = 8.141592653589793"),
        ("v.d = math.sqrt(v.d)", "V.d[v] = sqrt(V.d[v])"),
        ("v.i = ebb.int32(2.7)", "V.i[v] = 2"),
        ("v.i = ebb.int32(v.d)", "V.i[v] = int32(V.d[v])"),
        ("v.f = ebb.float32(True)", "V.f[v] = 1.0f32"),
        ("v.i = len(v.p) + len(offsets)", "V.i[v] = 5"),
        ("v.i = len(v.edges)", "V.i[v] = len(where(E.tail, v))"),
        ("v.l = ebb.id(v)", "V.l[v] = id(v)"),
    ],
)
def test_scalars(world, body, expected):
    assert world.kir(body) == expected


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("v.q = [1, 2, 3] + 4.0", "V.q[v] = [5.0, 6.0, 7.0]"),
        ("v.p = [0, 0, 1.5] * v.f", "V.p[v] = [0.0, 0.0, 1.5]f32 * vector(float32, 3)(V.f[v])"),
        ("v.p = [v.f, 0, 0.5]", "V.p[v] = [V.f[v], 0.0f32, 0.5f32]"),
        ("v.p = v.p + [1, 0, 0]", "V.p[v] = V.p[v] + [1.0, 0.0, 0.0]f32"),
        ("v.p += 1", "V.p[v] += vector(float32, 3)(1.0f32)"),
        ("v.p = ebb.vec3f(v.q)", "V.p[v] = vector(float32, 3)(V.q[v])"),
        ("v.p = ebb.vec3f(1, 2, 3)", "V.p[v] = [1.0, 2.0, 3.0]f32"),
        ("v.p = v.m @ v.p", "V.p[v] = matmul(V.m[v], V.p[v])"),
        ("v.m = v.m.T", "V.m[v] = transpose(V.m[v])"),
        ("v.f = v.p[-1] + v.p.x", "V.f[v] = V.p[v][2] + V.p[v][0]"),
        ("v.f = v.m[0][1] + v.m[0, 1]", "V.f[v] = V.m[v][0, 1] + V.m[v][0, 1]"),
        ("v.p = v.m[2]", "V.p[v] = V.m[v][2]"),
        ("v.f = v.p[v.i]", "V.f[v] = V.p[v][V.i[v]]"),
        (
            "v.m = [[1, 0, 0], [0, 1, 0], v.p]",
            "value: vector(float32, 3) = V.p[v]\n"
            "V.m[v] = [[1.0f32, 0.0f32, 0.0f32], [0.0f32, 1.0f32, 0.0f32], [value[0], value[1], value[2]]]",
        ),
        ("v.m[0, 1] += v.f", "V.m[v][0, 1] += V.f[v]"),
        ("v.m[0][1] = 2", "V.m[v][0, 1] = 2.0f32"),
        ("v.p.y = 1", "V.p[v][1] = 1.0f32"),
        (
            "v.f = min(v.p)",
            "value: vector(float32, 3) = V.p[v]\nV.f[v] = min(min(value[0], value[1]), value[2])",
        ),
        ("v.p = -v.p", "V.p[v] = -V.p[v]"),
    ],
)
def test_vectors(world, body, expected):
    assert world.kir(body) == expected


def test_captured_values_are_read_at_each_launch(world):
    assert world.kir("v.f = gravity * settings.dt * v.f") == (
        "uniform $0: float32 = (gravity * settings.dt)\nV.f[v] = $0 * V.f[v]"
    )
    assert world.kir("v.q = axis * small") == (
        "uniform $0: vector(float64, 3) = axis\nuniform $1: float32 = small\n"
        "V.q[v] = $0 * vector(float64, 3)(float64($1))"
    )
    assert world.kir("v.d = gravity\nv.f = gravity\nv.d = gravity").count("uniform") == 2


def test_what_is_needed_at_compile_time_is_read_then(world):
    assert world.kir("v.f = v.p[settings.n]") == "V.f[v] = V.p[v][2]"
    assert world.kir("c.new_t = c(-count, settings.n).t", "c", relation="C") == (
        "C.new_t[c] = C.t[affine(C, [[1, 0, -3], [0, 1, 2]], c)]"
    )
    assert "[[1, 0, 1], [0, 1, 0]]" in world.kir("c.new_t = ebb.affine(C, table, c).t", "c", relation="C")
    assert "[[1/2, 0, 0], [0, 1/3, 1]], c, clamp" in world.kir(
        "c.new_t = ebb.affine(C, [[.5, 0, 0], [0, 1 / 3, table[0, 2]]], c, edge='clamp').t", "c", relation="C"
    )


def test_parameters_are_uniforms(world):
    found = world.elaborate("v.f = dt * v.f\nn += 1\nv.i = n", "v, dt, n", (ebb.float32, ebb.int32))
    assert [value.type for value in found.kernel.uniforms] == [ebb.float32, ebb.int32]
    assert found.guards == ()


@pytest.mark.parametrize(
    ("body", "change"),
    [
        ("v.f = gravity * v.f", {"gravity": 1}),
        ("v.f = v.p[count - 1]", {"count": 2}),
        ("v.i = count", {"count": 2**40}),
        ("v.q = axis", {"axis": [1.0, 2.0]}),
        ("for w in weights: v.d += w", {"weights": (1.0,)}),
        ("for w in weights: v.d += w", {"weights": (1.0, 1.0, 1.0)}),
        ("for e in ebb.where(E.tail, v): v.f += e.x", {"E": None}),
        ("v.f = square(v.f)", {"square": None}),
        ("v.f = settings.dt", {"settings": None}),
    ],
)
def test_a_guard_notices_what_the_code_depends_on(body, change):
    world = make_world()
    guards = world.elaborate(body).guards
    assert guards and all(guard.holds(()) for guard in guards)
    world.names.update(change)
    assert not all(guard.holds(()) for guard in guards)


def test_another_number_of_the_same_type_holds():
    world = make_world()
    guards = world.elaborate("v.f = gravity * v.f\nfor i in range(count): v.d += weights[1]").guards
    world.names.update(gravity=1.5, count=100, weights=(1.5, 2.5, 7))
    assert all(guard.holds(()) for guard in guards)
