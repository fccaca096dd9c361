"""Rows that are computed eight at a time: what they give is what they give one by one."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.backends.llvm.hooks import Strips
from ebb.backends.target import host

SIZES = (1, 7, 8, 9, 15, 16, 17, 40, 1031)


def cells_of(size: int, scalar=ebb.float64) -> tuple[ebb.Relation, ebb.Relation]:
    """Cells with two keys of nodes each, which meet at random, and fields of several kinds."""
    rng = np.random.default_rng(size)
    nodes, cells = ebb.Relation("nodes", size=size + 3), ebb.Relation("cells", size=size)
    vector = ebb.vector(scalar, 3)
    nodes.new_field("pos", vector, init=rng.random((size + 3, 3)).astype(scalar.dtype))
    nodes.new_field("force", vector, init=0.0)
    nodes.new_field("count", ebb.int32, init=0)
    nodes.new_field("low", scalar, init=9.0)
    cells.new_field("v", ebb.vector(nodes, 2), init=rng.integers(0, size + 3, (size, 2)))
    cells.new_field("a", scalar, init=rng.random(size).astype(scalar.dtype) + 0.5)
    cells.new_field("b", vector, init=rng.random((size, 3)).astype(scalar.dtype))
    cells.new_field("m", ebb.matrix(scalar, 3, 3), init=rng.random((size, 3, 3)).astype(scalar.dtype))
    cells.new_field("n", ebb.int32, init=rng.integers(-5, 6, size))
    return nodes, cells


total = ebb.Global(ebb.float64, 0.0)
least = ebb.Global(ebb.float64, 9.0)


@ebb.kernel
def scatter(c):
    d = c.v[1].pos - c.v[0].pos
    f = d * (c.a / (ebb.sqrt(ebb.dot(d, d)) + 0.25)) + ebb.cross(d, c.b)
    c.v[0].force += f
    c.v[1].force -= f
    c.v[0].count += c.n
    c.v[1].low = min(c.v[1].low, c.a)


@ebb.kernel
def change_own(c):
    d = c.v[1].pos - c.v[0].pos
    e = ebb.cross(d, c.b) / (c.a + ebb.dot(d, d))
    if c.n > 0:
        c.b.y = e.y
        e = e * e.x
    elif c.n < -2:
        c.a = c.v[0].pos.z / 3
    c.m = ebb.outer(e, d) + c.m @ c.m
    c.a += ebb.length(e) + c.m[1, 2]
    c.n = ebb.int32(8 * c.a) >> 1


@ebb.kernel
def reduce(c):
    d = c.v[1].pos - c.v[0].pos
    value = ebb.float64(ebb.length(d) / c.a)
    if c.n >= 0:
        total.value += value
    least.value = min(least.value, value)


@ebb.kernel
def check(c):
    d = c.v[1].pos - c.v[0].pos
    c.b = c.b + d / (c.a + ebb.length(d))
    assert c.n < 6, "too many"
    c.a += 1


def outcome(kernel, size: int, backend: str, scalar=ebb.float64) -> list[np.ndarray]:
    nodes, cells = cells_of(size, scalar)
    total.value, least.value = 0.0, 9.0
    with ebb.backend(backend):
        kernel(cells)
        kernel(cells)
    fields = [*nodes.fields.values(), *cells.fields.values()]
    return [*[field.to_numpy() for field in fields], np.array([total.value, least.value])]


@pytest.mark.parametrize("kernel", [scatter, change_own, reduce, check], ids=["scatter", "own", "reduce", "check"])
@pytest.mark.parametrize("size", SIZES[:-1])
def test_strips_give_what_single_rows_give(kernel, size) -> None:
    for found, expected in zip(outcome(kernel, size, "cpu"), outcome(kernel, size, "reference"), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("kernel", [scatter, change_own], ids=["scatter", "own"])
def test_strips_of_float32(kernel) -> None:
    found, expected = (outcome(kernel, 21, backend, ebb.float32) for backend in ("cpu", "reference"))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-5)


@pytest.mark.parametrize("size", SIZES)
def test_many_rows_give_the_same_on_any_number_of_threads(size) -> None:
    results = []
    for threads in (1, 2, 3):
        nodes, cells = cells_of(size)
        with ebb.backend("cpu", threads=threads):
            scatter(cells)
        results.append(nodes.force.to_numpy())
    for other in results[1:]:
        np.testing.assert_array_equal(other, results[0])


@pytest.mark.parametrize("bad", [0, 7, 8, 12, 16])
def test_the_first_row_that_fails_is_named_and_nothing_is_done_twice(bad) -> None:
    _, cells = cells_of(17)
    numbers = cells.n.to_numpy()
    numbers[[bad, 16]] = 6
    cells.n.load(numbers)
    before = cells.a.to_numpy()
    with pytest.raises(ebb.KernelAssertionError, match=rf"cells\[{bad}\]: too many"):
        check(cells)
    done = cells.a.to_numpy() - before
    assert set(np.round(done).tolist()) <= {0.0, 1.0}
    np.testing.assert_array_equal(np.round(done[:bad]), 1)
    np.testing.assert_array_equal(np.round(done[bad:]), 0)


def give_kernel(cells: ebb.Relation, corners: ebb.Relation) -> ebb.Kernel:
    """What cells of a grid give to two of their corners."""

    @ebb.kernel
    def give(c: cells):
        low = ebb.affine(corners, [[1, 0, 0], [0, 1, 0]], c)
        high = ebb.affine(corners, [[1, 0, 1], [0, 1, 1]], c)
        d = high.pos - low.pos
        f = ebb.cross(d, low.pos) / (1 + ebb.dot(d, d))
        low.pull += f
        high.pull -= f
        high.mass += ebb.length(d)
        low.mass += ebb.length(f)

    return give


@pytest.mark.parametrize("side", [3, 8, 11, 20])
def test_lines_of_grids(side) -> None:
    results = []
    for backend in ("cpu", "reference"):
        cells, corners = ebb.Relation("cells", shape=(2, side)), ebb.Relation("corners", shape=(3, side + 1))
        corners.new_field("pos", ebb.vec3d, init=np.random.default_rng(side).random((3, side + 1, 3)))
        corners.new_field("mass", ebb.float64, init=0.0)
        corners.new_field("pull", ebb.vec3d, init=0.0)
        with ebb.backend(backend):
            give_kernel(cells, corners)(cells)
        results.append((corners.pull.to_numpy(), corners.mass.to_numpy()))
    for found, expected in zip(*results, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("kernel", [scatter, change_own, check], ids=["scatter", "own", "check"])
def test_these_rows_run_in_strips(kernel) -> None:
    _, cells = cells_of(40)
    hooks = host().hooks
    if hooks.strips is not Strips.MASKED:
        pytest.skip("this processor has no vector loads under masks")
    assert "llvm.masked.store" in kernel.inspect(cells, "llvm") or "<8 x double>" in kernel.inspect(cells, "llvm")
