"""Sums of globals by groups of threads of any size, also one that is no power of two or larger than the launch."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

SIZES = (1, 2, 63, 65, 1025, 70_001)
"""The last are more than the threads of 1024 groups of 64, so that some take two rows."""

ROWS = max(SIZES)


@pytest.fixture(scope="module")
def rows():
    random = np.random.default_rng(5)
    made = ebb.Relation("rows", size=ROWS)
    made.new_field("x", ebb.int64, init=random.integers(-(2**40), 2**40, ROWS))
    made.new_field("f", ebb.float32, init=random.standard_normal(ROWS))
    made.new_field("u", ebb.uint32, init=random.integers(0, 2**32, ROWS))
    made.new_field("b", ebb.bool_, init=random.random(ROWS) < 0.5)
    made.new_field("v", ebb.vec3d, init=random.standard_normal((ROWS, 3)))
    for size in SIZES:
        made.new_subset(f"first_{size}", range(size))
    return made


@pytest.mark.parametrize("block_size", [1, 3, 64, 100, 1024])
def test_each_operator_at_each_size(backend, rows, block_size):
    total, product, highest = ebb.Global(ebb.int64, 1), ebb.Global(ebb.int64, 1), ebb.Global(ebb.int64, -(2**62))
    lowest, odd, least = ebb.Global(ebb.float32, np.inf), ebb.Global(ebb.uint32, 0), ebb.Global(ebb.uint32, 2**32 - 1)
    every, some, parity = ebb.Global(ebb.bool_, True), ebb.Global(ebb.bool_, False), ebb.Global(ebb.bool_, False)
    vector = ebb.Global(ebb.vec3d, 0.0)

    @ebb.kernel
    def measure(r: rows):
        total.value += r.x
        product.value *= 2 * r.x + 1
        highest.value = max(highest.value, r.x)
        lowest.value = min(lowest.value, r.f)
        odd.value ^= r.u
        least.value = min(least.value, r.u)
        every.value &= r.b
        some.value |= r.b
        parity.value ^= r.b
        vector.value += r.v

    starts = [(g, g.value) for g in (total, product, highest, lowest, odd, least, every, some, parity, vector)]
    x, f, u, b, v = (rows.attribute(name).to_numpy() for name in "xfubv")
    for size in SIZES:
        if backend == "reference" and size > 2000:
            continue  # row after row in Python takes too long
        for globl, start in starts:
            globl.value = start
        measure(rows.attribute(f"first_{size}"), block_size=block_size)
        n = slice(size)
        assert total.value == 1 + x[n].sum() and product.value == np.multiply.reduce(2 * x[n] + 1)
        assert highest.value == x[n].max() and lowest.value == f[n].min() and least.value == u[n].min()
        assert odd.value == np.bitwise_xor.reduce(u[n]) and parity.value == np.bitwise_xor.reduce(b[n])
        assert every.value == b[n].all() and some.value == b[n].any()
        np.testing.assert_allclose(vector.value, v[n].sum(0), rtol=0, atol=1e-9)


def test_sums_of_floats_have_the_same_bits_at_each_launch(backend, rows):
    total, vector = ebb.Global(ebb.float32, 0.0), ebb.Global(ebb.vec3d, 0.0)

    @ebb.kernel
    def add(r: rows):
        total.value += r.f
        vector.value += r.v

    def bits():
        total.value, vector.value = 0.0, 0.0
        add(rows.first_1025 if backend == "reference" else rows)
        return total.value, tuple(vector.value)

    assert len({bits() for _ in range(5)}) == 1
