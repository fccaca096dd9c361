"""Numbers, vectors and matrices written out in a kernel."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import evaluate, kernel_of, rejects, rows_with

LITERALS = {
    "[1, 2, 3] + 4.0": (ebb.vec3d, [5, 6, 7]),
    "[1, 2, 3]": (ebb.vec3i, [1, 2, 3]),
    "[1, 2.5, 3]": (ebb.vec3d, [1, 2.5, 3]),
    "[True, False, True]": (ebb.vec3b, [True, False, True]),
    "[-1, +2, -(3)]": (ebb.vec3i, [-1, 2, -3]),
    "[5]": (ebb.vector(ebb.int32, 1), [5]),
    "[1, 2, 3, 4, 5, 6, 7][4]": (ebb.int32, 5),
    "[[1, 2], [3, 4]]": (ebb.mat2i, [[1, 2], [3, 4]]),
    "[[1, 2.5, 3], [4, 5, 6]]": (ebb.mat2x3d, [[1, 2.5, 3], [4, 5, 6]]),
    "[[1, 2], [3, 4]][1, 0]": (ebb.int32, 3),
    "[[1, 2], [3, 4]] @ [1, 1]": (ebb.vec2i, [3, 7]),
    "2 * [1, 2] - [0.5, 0.5]": (ebb.vec2d, [1.5, 3.5]),
    "[[7]]": (ebb.matrix(ebb.int32, 1, 1), [[7]]),
    "0x10 + 0b11 + 0o7 + 1_000": (ebb.int32, 1026),
    "1e3 + 1.5e-1": (ebb.float64, 1000.15),
    "not False": (ebb.bool_, True),
    "-2**2": (ebb.int32, -4),
    "(-2)**2": (ebb.int32, 4),
    "2**-1": (ebb.float64, 0.5),
    "2**3**2": (ebb.int32, 512),
    "10 - 4 - 3": (ebb.int32, 3),
    "7 if True else 8": (ebb.int32, 7),
}


@pytest.mark.parametrize("literal", LITERALS)
def test_a_literal_has_its_value(backend, literal):
    result, expected = LITERALS[literal]
    np.testing.assert_array_equal(evaluate(literal, result)[0], expected)


def test_a_literal_takes_the_type_of_its_strong_element(backend):
    rows = rows_with(x=(ebb.float32, [0.1]), out=(ebb.vec3f, [[0, 0, 0]]))

    @ebb.kernel
    def build(r: rows):
        w = [r.x, 0.1, 1]
        r.out = w * 3

    build(rows)
    tenth = np.float32(0.1)
    np.testing.assert_array_equal(rows.out.to_numpy(), [[tenth * np.float32(3), tenth * np.float32(3), 3]])


def test_a_literal_beside_float32_is_float32(backend):
    rows = rows_with(v=(ebb.vec3f, [[1, 2, 3]]))

    @ebb.kernel
    def shift(r: rows):
        r.v += [0.1, 0.2, 0.3]

    shift(rows)
    np.testing.assert_array_equal(
        rows.v.to_numpy(), np.array([[1, 2, 3]], np.float32) + np.array([0.1, 0.2, 0.3], np.float32)
    )


def test_a_literal_of_ints_fills_a_float_field(backend):
    rows = rows_with(force=(ebb.vec3f, [[1, 2, 3]] * 4))

    @ebb.kernel
    def clear(r: rows):
        r.force = [0, 0, 0]

    clear(rows)
    assert not rows.force.to_numpy().any()


def test_a_literal_of_mixed_fields_has_their_common_type(backend):
    out = evaluate("[r.i, r.f, r.d]", ebb.vec3d, i=(ebb.int32, [1]), f=(ebb.float32, [0.5]), d=(ebb.float64, [0.1]))
    np.testing.assert_array_equal(out, [[1, 0.5, 0.1]])


def test_a_literal_of_keys(backend):
    vertices = ebb.Relation("vertices", size=3)
    edges = ebb.Relation("edges", size=2)
    vertices.new_field("x", ebb.float64, init=[1, 10, 100])
    edges.new_field("head", vertices, init=[0, 1])
    edges.new_field("tail", vertices, init=[2, 0])
    edges.new_field("ends", ebb.vector(vertices, 2), init=[[0, 0], [0, 0]])
    edges.new_field("difference", ebb.float64)

    @ebb.kernel
    def store_ends(e: edges):
        ends = [e.head, e.tail]
        e.ends = ends
        e.difference = ends[0].x - ends[1].x

    store_ends(edges)
    np.testing.assert_array_equal(edges.ends.to_numpy(), [[0, 2], [1, 0]])
    np.testing.assert_array_equal(edges.difference.to_numpy(), [-99, 9])


def test_a_matrix_from_computed_rows(backend):
    rows = rows_with(theta=(ebb.float64, [0.0, np.pi / 2]), out=(ebb.vec2d, [[0, 0]] * 2))

    @ebb.kernel
    def rotate(r: rows):
        c, s = ebb.cos(r.theta), ebb.sin(r.theta)
        r.out = [[c, -s], [s, c]] @ [1.0, 2.0]

    rotate(rows)
    np.testing.assert_allclose(rows.out.to_numpy(), [[1, 2], [-2, 1]], atol=1e-15)


def test_a_literal_is_indexed_by_a_variable(backend):
    rows = rows_with(i=(ebb.int32, [2, 0, 1]), out=(ebb.float64, [0, 0, 0]))

    @ebb.kernel
    def weight(r: rows):
        r.out = [0.25, 0.5, 0.75][r.i]

    weight(rows)
    np.testing.assert_array_equal(rows.out.to_numpy(), [0.75, 0.25, 0.5])


@pytest.mark.parametrize(
    "literal",
    [
        "[1, 2, True]",
        "[1, 2, [2, 3]]",
        "[[1, 2], [3]]",
        "[[1, 2], 3]",
        "[[True, 1], [2, 3]]",
        "[[[1, 2]]]",
        "[]",
        "[r.k, 1]",
        "[r.k, r.o]",
        "[r.v, 1.0]",
        "[1, 2, 3][3]",
        "[1, 2, 3][1.0]",
        "[[1, 2], [3, 4]][2, 0]",
    ],
)
def test_what_is_no_literal(literal):
    rows, others = rows_with(v=(ebb.vec2d, [[1, 2]])), ebb.Relation("others", size=1)
    rows.new_field("k", rows, init=[0])
    rows.new_field("o", others, init=[0])
    rejects(ebb.KernelTypeError, "E2", lambda: kernel_of(f"x = {literal}", rows=rows)(rows))


@pytest.mark.parametrize(
    "literal", ["'text'", "b'bytes'", "1j", "{1: 2}", "{1, 2}", "None", "...", "f'{1}'", "(*[1],)"]
)
def test_values_that_kernels_lack(literal):
    rows = rows_with(x=(ebb.float64, [0]))
    rejects(ebb.KernelSyntaxError, "E1", lambda: kernel_of(f"x = {literal}", rows=rows)(rows))
