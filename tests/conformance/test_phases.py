"""The phase table: every use of a field is a read, a write or a reduction, centered (C) or not (U)."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import define, rejects

OTHER = np.array([2, 0, 1, 4, 3, 3])
A = np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0])
B = np.array([0.5, 1.5, 2.5, 3.5, 4.5, 5.5])


def world():
    """Vertices that point to one another, edges between them, and a periodic ring of cells."""
    vertices = ebb.Relation("vertices", size=6)
    vertices.new_field("other", vertices, init=OTHER)
    vertices.new_field("a", ebb.float64, init=A)
    vertices.new_field("b", ebb.float64, init=B)
    vertices.new_field("n", ebb.int32, init=[1, 2, 3, 4, 5, 6])
    vertices.new_field("w", ebb.vec3d, init=1.0)
    edges = ebb.Relation("edges", size=6)
    edges.new_field("tail", vertices, init=np.arange(6))
    edges.new_field("head", vertices, init=OTHER)
    edges.new_field("rest", ebb.float64, init=B)
    edges.group_by("tail")
    cells = ebb.Relation("cells", shape=(6,), periodic=(True,))
    cells.new_field("a", ebb.float64, init=A)
    cells.new_field("b", ebb.float64, init=B)

    @cells.member("__call__")
    def offset(c, d):
        return ebb.affine(cells, [[1, d]], c)

    @vertices.member
    def edges_out(v):
        return ebb.where(edges.tail, v)

    @vertices.member
    def partner(v):
        return v.other

    @ebb.func
    def read_a(v):
        return v.a

    @ebb.func
    def add_a(v, x):
        v.a += x

    return {
        "vertices": vertices,
        "edges": edges,
        "cells": cells,
        "E": ebb.Global(ebb.float64, 0.0),
        "F": ebb.Global(ebb.float64, 1.0),
        "V": ebb.Global(ebb.vec3d, 0.0),
        "read_a": read_a,
        "add_a": add_a,
    }


def prepare(signature, body):
    names = world()
    text = f"@ebb.kernel\ndef program({signature}):\n" + "".join(f"    {line}\n" for line in body.splitlines())
    kernel = define(text, **names)["program"]
    return names, kernel, names[signature.split(": ")[1]]


V, E, C = "v: vertices", "e: edges", "c: cells"


def scattered(values, start=0.0):
    out = np.full(6, start) if np.isscalar(start) else start.copy()
    np.add.at(out, OTHER, values)
    return out


#: signature, body, relation and field to look at, what it holds afterwards
ACCEPTED = {
    "C read": (V, "v.b = v.a", "b", A),
    "C read and write": (V, "v.a = 2 * v.a + v.b", "a", 2 * A + B),
    "C read, write and reductions, mixed": (
        V,
        "v.a = v.a + 1\nv.a += v.b\nv.a *= 2\nv.a = max(v.a, v.b)\nv.a -= v.a / 2",
        "a",
        np.maximum(2 * (A + 1 + B), B) / 2,
    ),
    "C reductions with different operators": (V, "v.a += 1\nv.a *= 3", "a", (A + 1) * 3),
    "C division": (V, "v.a /= 4", "a", A / 4),
    "C floor division and power": (V, "v.a //= 2\nv.a **= 2", "a", (A // 2) ** 2),
    "C component write and read": (V, "v.w[1] = v.a\nv.a = v.w[1] + v.w[0]", "a", A + 1),
    "U read": (V, "v.b = v.other.a", "b", A[OTHER]),
    "U read and C read": (V, "v.b = v.other.a + v.a", "b", A[OTHER] + A),
    "U reads through several keys": (V, "v.b = v.other.other.a - v.other.a", "b", A[OTHER[OTHER]] - A[OTHER]),
    "U reduce": (V, "v.other.a += v.b", "a", scattered(B, A)),
    "U reduce and C reduce with the same operator": (V, "v.other.a += v.b\nv.a += 1", "a", scattered(B, A) + 1),
    "U -= with U +=": (V, "v.other.a += 3 * v.b\nv.other.a -= v.b", "a", scattered(2 * B, A)),
    "U -= with C +=": (V, "v.other.a -= v.b\nv.a += 1", "a", scattered(-B, A) + 1),
    "reading one field, reducing another": (E, "e.head.a += e.tail.b", "a", scattered(B, A)),
    "both ends of an edge": (E, "e.head.a += e.rest\ne.tail.a += e.rest", "a", scattered(B, A) + B),
    "a local bound once to the row is centered": (V, "k = v\nk.a = k.b", "a", B),
    "a local of a local": (V, "k = v\nm = k\nm.a = v.a + 1", "a", A + 1),
    "a func of the row": (V, "v.a = read_a(v) + 1", "a", A + 1),
    "a func that reduces through a key": (V, "add_a(v.other, v.b)", "a", scattered(B, A)),
    "the keys of a query read the grouping": (
        V,
        "for e in ebb.where(edges.tail, v):\n    v.a += e.rest",
        "a",
        A + B,
    ),
    "a query reads other rows": (V, "for e in v.edges_out:\n    v.a += e.head.b", "a", A + B[OTHER]),
    "writing the row's key without following it elsewhere": (V, "v.other = v\nv.a = 1", "a", np.ones(6)),
    "following a key and writing it, both centered": (V, "v.b = v.other.a\nv.other = v", "b", A[OTHER]),
    "identity affine is centered": (C, "c(0).a = c.b", "a", B),
    "identity affine as a member's default": (C, "c.a = c(0).a + 1\nc(0).a += c.b", "a", A + 1 + B),
    "U read of a neighbour": (C, "c.b = c(1).a - c(-1).a", "b", np.roll(A, -1) - np.roll(A, 1)),
    "U reduce into neighbours": (C, "c(1).a += c.b\nc(-1).a += c.b", "a", A + np.roll(B, 1) + np.roll(B, -1)),
    "one branch writes what the other reads, centered": (
        V,
        "if v.b > 2:\n    v.a = 0\nelse:\n    v.a = v.a * v.b",
        "a",
        np.where(B > 2, 0, A * B),
    ),
    "U min": (V, "v.other.a = min(v.other.a, v.b - 5)", "a", None),
    "U max and C max": (V, "v.other.a = max(v.other.a, v.b)\nv.a = max(v.a, 0)", "a", None),
    "a reduction by a component": (V, "v.other.w[1] += v.b", "w", None),
    "U reduce of two components": (V, "v.other.w[0] += v.b\nv.other.w.z += v.a", "w", None),
}


@pytest.mark.parametrize("program", ACCEPTED)
def test_a_kernel_with_one_phase_a_field_runs(backend, program):
    signature, body, field, expected = ACCEPTED[program]
    names, kernel, relation = prepare(signature, body)
    kernel(relation)
    fields = (names["vertices"] if relation is names["edges"] else relation).fields
    np.testing.assert_allclose(fields[field].to_numpy(), expected if expected is not None else special(program))


def special(program):
    if program == "U min":
        out = A.copy()
        np.minimum.at(out, OTHER, B - 5)
        return out
    if program == "U max and C max":
        out = np.maximum(A, 0)
        np.maximum.at(out, OTHER, B)
        return out
    out = np.ones((6, 3))
    if program == "a reduction by a component":
        np.add.at(out, (OTHER, 1), B)
        return out
    np.add.at(out, (OTHER, 0), B)
    np.add.at(out, (OTHER, 2), A)
    return out


GLOBALS = {
    "read": (V, "v.a = F.value * v.b", lambda n: n["vertices"].a.to_numpy(), B),
    "read without value": (V, "v.a = F * v.b", lambda n: n["vertices"].a.to_numpy(), B),
    "reduced": (V, "E.value += v.a", lambda n: n["E"].value, A.sum()),
    "reduced twice with one operator": (V, "E.value += v.a\nE.value -= v.b", lambda n: n["E"].value, (A - B).sum()),
    "one read, the other reduced": (V, "E.value += F * v.b", lambda n: n["E"].value, B.sum()),
    "two reduced with different operators": (
        V,
        "E.value += v.b\nF.value = max(F.value, v.b)",
        lambda n: (n["E"].value, n["F"].value),
        (B.sum(), 5.5),
    ),
    "by component": (V, "V.value[1] += v.a\nV.value[2] += v.b", lambda n: n["V"].value, [0, A.sum(), B.sum()]),
}


@pytest.mark.parametrize("program", GLOBALS)
def test_globals_in_one_phase(backend, program):
    signature, body, result, expected = GLOBALS[program]
    names, kernel, relation = prepare(signature, body)
    kernel(relation)
    np.testing.assert_allclose(result(names), expected)


def test_three_globals_in_one_kernel(backend):
    names = world()
    vertices = names["vertices"]
    low, high, total = (ebb.Global(ebb.float64, x) for x in (np.inf, -np.inf, 0.0))

    @ebb.kernel
    def measure(v: vertices):
        low.value = min(low.value, v.a)
        high.value = max(high.value, v.a)
        total.value += v.a

    measure(vertices)
    assert (low.value, high.value, total.value) == (A.min(), A.max(), A.sum())


#: signature, body, code
REJECTED = {
    "U write": (V, "v.other.a = 1", "E303"),
    "U write and C write": (V, "v.other.a = 1\nv.a = 2", "E303"),
    "U write of a component": (V, "v.other.w[0] = 1", "E303"),
    "U write through a head": (E, "e.head.a = e.rest", "E303"),
    "U write in a dead branch": (V, "if False and v.a > 0:\n    v.other.a = 1", "E303"),
    "U write through a member": (V, "v.partner.a = 1", "E303"),
    "U write in a query loop": (V, "for e in v.edges_out:\n    e.rest = 1", "E303"),
    "U write to a neighbour": (C, "c(1).a = 0", "E303"),
    "U /=": (V, "v.other.a /= 2", "E303"),
    "U //=": (V, "v.other.a //= 2", "E303"),
    "U **=": (V, "v.other.a **= 2", "E303"),
    "U %=": (V, "v.other.n %= 2", "E303"),
    "U <<=": (V, "v.other.n <<= 2", "E303"),
    "U x = x + e": (V, "v.other.a = v.other.a + 1", "E303"),
    "U read and C write": (V, "v.a = v.other.a", "E301"),
    "U read and C write of a component": (V, "v.w[0] = v.other.w[1]", "E301"),
    "U read and C reduce": (V, "v.a += v.other.a", "E301"),
    "U read of a neighbour and C write": (C, "c.a = c(1).a", "E301"),
    "U reduce and C read": (V, "v.other.a += v.a", "E301"),
    "U reduce and C read in a condition": (V, "if v.a > 0:\n    v.other.a += 1", "E301"),
    "U reduce and C write": (V, "v.other.a += 1\nv.a = 0", "E301"),
    "U reduce and U read": (E, "e.head.a += e.tail.a", "E301"),
    "U + and U *": (V, "v.other.a += 1\nv.other.a *= 2", "E301"),
    "U + and C *": (V, "v.other.a += 1\nv.a *= 2", "E301"),
    "U min and U max": (V, "v.other.a = min(v.other.a, 1)\nv.other.a = max(v.other.a, 0)", "E301"),
    "U & and U |": (V, "v.other.n &= 1\nv.other.n |= 2", "E301"),
    "reduced by component and read by another": (V, "v.other.w[0] += v.w[1]", "E301"),
    "in two branches": (V, "if v.b > 0:\n    v.other.a += 1\nelse:\n    v.a = 0", "E301"),
    "read inside a func": (V, "v.a = read_a(v.other)", "E301"),
    "reduced inside a func and read": (V, "add_a(v.other, v.a)", "E301"),
    "a key from another row is not centered": (E, "k = e.head\nk.a = 1", "E303"),
    "a key bound twice is not centered": (V, "k = v\nk = v.other\nk.a = 1", "E303"),
    "a chosen key is not centered": (V, "k = v if v.b > 1 else v.other\nk.a = 1", "E303"),
    "a key that equals the row is not centered": (V, "if v.other == v:\n    v.other.a = 1", "E303"),
    "writing the key that is followed through another row": (V, "v.b = v.other.other.a\nv.other = v", "E301"),
    "writing the grouped field while querying": (
        E,
        "for f in ebb.where(edges.tail, e.head):\n    e.tail = e.head",
        "E301",
    ),
    "a query reads its grouping": (E, "e.tail = e.head\nfor f in ebb.where(edges.tail, e.head):\n    pass", "E301"),
    "a query that projects reads the projected field": (
        E,
        "for u in ebb.where(edges.tail, e.tail).head:\n    e.head = u",
        "E301",
    ),
    "a global read and reduced": (V, "E.value += v.a * E.value", "E304"),
    "a global read, another way, and reduced": (V, "v.a = E\nE.value += 1", "E304"),
    "a global reduced with two operators": (V, "E.value += 1\nE.value *= 2", "E304"),
    "a global reduced with min and max": (V, "E.value = min(E.value, v.a)\nE.value = max(E.value, v.b)", "E304"),
    "a global assigned": (V, "E.value = v.a", "E302"),
    "a global's component assigned": (V, "V.value[0] = v.a", "E302"),
    "a global divided": (V, "E.value /= 2", "E302"),
}


@pytest.mark.parametrize("program", REJECTED)
def test_a_kernel_with_two_phases_is_rejected(program):
    signature, body, code = REJECTED[program]
    names, kernel, relation = prepare(signature, body)
    before = {f: field.to_numpy() for r in ("vertices", "edges", "cells") for f, field in names[r].fields.items()}
    rejects(ebb.PhaseError, code, lambda: kernel(relation))
    rejects(ebb.PhaseError, code, lambda: kernel.check(relation))
    after = {f: field.to_numpy() for r in ("vertices", "edges", "cells") for f, field in names[r].fields.items()}
    for name, values in before.items():
        np.testing.assert_array_equal(after[name], values)
    assert names["E"].value == 0


def spring_mass():
    vertices = ebb.Relation("vertices", size=3)
    edges = ebb.Relation("edges", size=4)
    edges.new_field("tail", vertices, init=[0, 1, 1, 2])
    edges.new_field("head", vertices, init=[1, 0, 2, 1])
    edges.new_field("rest_len", ebb.float32, init=1.0)
    edges.group_by("tail")
    for name in ("q", "qd", "force"):
        vertices.new_field(name, ebb.vec3f, init=0.0)
    vertices.new_field("mass", ebb.float32, init=1.0)
    return vertices, edges


def test_the_merged_spring_mass_kernel_fails_on_q_and_not_on_force():
    vertices, edges = spring_mass()
    K, dt = 1.0, 1e-4

    @ebb.kernel
    def step(v: vertices):
        for e in ebb.where(edges.tail, v):
            dq = e.head.q - v.q
            v.force += K * (e.rest_len * ebb.normalize(dq) - dq)
        qdd = v.force / v.mass
        v.q += v.qd * dt + 0.5 * qdd * dt * dt
        v.qd += qdd * dt
        v.force = [0, 0, 0]

    error = rejects(ebb.PhaseError, "E301", lambda: step(vertices))
    assert len(error.diagnostics) == 1
    assert "'vertices.q'" in str(error) and "vertices.force" not in str(error)


def test_the_error_shows_both_sides_of_the_conflict():
    _, kernel, vertices = prepare(V, "v.b = v.other.a\nv.a = 1")
    error = rejects(ebb.PhaseError, "E301", lambda: kernel(vertices))
    assert "v.other.a" in str(error) and "v.a = 1" in str(error)
    assert "line 3" in str(error) or "3 |" in str(error)


def test_every_conflict_is_reported_at_once():
    _, kernel, vertices = prepare(V, "v.a = v.other.a\nv.other.b = 1\nE.value = 1\nv.n += v.other.n")
    with pytest.raises(ebb.EbbError) as caught:
        kernel(vertices)
    assert set(caught.value.codes) >= {"E302"} or set(caught.value.codes) >= {"E301", "E303"}
