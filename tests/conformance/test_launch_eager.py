# This module has no ``from __future__ import annotations``: annotations are objects here, not text.
"""Kernels in a module whose annotations are evaluated at once."""

import numpy as np

import ebb

vertices = ebb.Relation("vertices", size=3)
vertices.new_field("x", ebb.float64, init=[1, 2, 3])


@ebb.kernel
def scale(v: vertices, factor: ebb.float64 = 2.0):
    v.x *= factor


@ebb.func
def half(x: ebb.float64) -> ebb.float64:
    return x / 2


def test_a_kernel_of_the_module(backend):
    vertices.x.load([1, 2, 3])
    scale(vertices)
    scale(vertices, 10)
    np.testing.assert_array_equal(vertices.x.to_numpy(), [20, 40, 60])


def test_a_kernel_within_a_function(backend):
    rows = ebb.Relation("rows", size=2)
    rows.new_field("x", ebb.float64, init=8.0)
    rows.new_field("k", rows, init=[1, 0])

    @ebb.func
    def other(r: rows):
        return r.k

    @ebb.kernel
    def program(r: rows, n: ebb.int32):
        r.x = half(r.x) + n + ebb.id(other(r))

    program(rows, 3)
    np.testing.assert_array_equal(rows.x.to_numpy(), [8, 7])


def test_a_text_annotation_among_objects(backend):
    rows = ebb.Relation("rows", size=2)
    rows.new_field("x", ebb.float64, init=8.0)

    @ebb.kernel
    def program(r: "rows", a: "ebb.float64"):
        r.x += a

    program(rows, 1)
    np.testing.assert_array_equal(rows.x.to_numpy(), [9, 9])
