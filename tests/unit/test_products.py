"""Loops over groups that add up inner products, in registers: they give what the reference gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ebb
from ebb.backends.llvm.hooks import Strips
from ebb.backends.target import host

pytestmark = pytest.mark.skipif(host().hooks.strips is not Strips.MASKED, reason="the processor has no strips")

GROUPS = [3, 0, 1, 2, 17, 0, 1]
"""The sizes of the groups; the last row of the relation is read to its very end, and a little beyond."""


class System:
    """Blocks that refer to nodes; the numbers are small and whole, so that sums are exact."""

    def __init__(self, scalar: Any, size: int) -> None:
        rng = np.random.default_rng(11)
        n, m = len(GROUPS), sum(GROUPS)
        draw = lambda *shape: rng.integers(-4, 5, shape).astype(scalar.dtype)  # noqa: E731
        self.nodes = ebb.Relation("nodes", size=n)
        self.links = ebb.Relation("links", size=m)
        for name in ("x", "y"):
            self.nodes.new_field(name, ebb.vector(scalar, size), init=draw(n, size))
        self.nodes.new_field("s", scalar, init=0)
        self.links.new_field("tail", self.nodes, init=np.repeat(np.arange(n), GROUPS))
        self.links.new_field("head", self.nodes, init=rng.integers(0, n, m))
        self.links.head.load(np.where(np.arange(m) == m - 1, n - 1, self.links.head.to_numpy()))
        self.links.new_field("a", ebb.matrix(scalar, size, size), init=draw(m, size, size))
        self.links.new_field("b", ebb.vector(scalar, size), init=draw(m, size))
        self.links.group_by("tail")


def both(kernel: Any, system: System, *names: str) -> str:
    """Checks that a launch on ``cpu`` leaves what one on the reference does; its LLVM IR."""
    found: list[list[np.ndarray]] = []
    before = [system.nodes.fields[name].to_numpy().copy() for name in names]
    for backend in ("reference", "cpu"):
        for name, values in zip(names, before, strict=True):
            system.nodes.fields[name].load(values)
        with ebb.backend(backend):
            kernel(system.nodes)
        found.append([system.nodes.fields[name].to_numpy().copy() for name in names])
    for expected, got in zip(*found, strict=True):
        np.testing.assert_array_equal(got, expected)
    return kernel.inspect(system.nodes, "llvm")


def in_registers(text: str, lanes: int, scalar: Any = ebb.float64) -> bool:
    """Whether sums are kept in registers of so many lanes."""
    return f"phi <{lanes} x {'double' if scalar is ebb.float64 else 'float'}>" in text


@pytest.mark.parametrize("scalar", [ebb.float32, ebb.float64])
@pytest.mark.parametrize(("size", "lanes"), [(2, 2), (3, 4), (4, 4), (5, 8)])
def test_matrices_times_vectors(scalar, size, lanes):
    system = System(scalar, size)
    links, zero = system.links, ebb.vector(scalar, size)

    @ebb.kernel
    def multiply(v):
        y = ebb.zeros(zero)
        for e in ebb.where(links.tail, v):
            y += e.a @ e.head.x
        v.y = y

    assert in_registers(both(multiply, system, "y"), lanes, scalar)
    expected = np.zeros((len(GROUPS), size))
    tail, head = links.tail.to_numpy(), links.head.to_numpy()
    np.add.at(expected, tail, np.einsum("eij,ej->ei", links.a.to_numpy(), system.nodes.x.to_numpy()[head]))
    np.testing.assert_array_equal(system.nodes.y.to_numpy(), expected)


def test_inner_products_beside_each_other():
    system = System(ebb.float64, 3)
    links = system.links

    @ebb.kernel
    def add(v):
        s = 2.0
        t = 0.0
        for e in ebb.where(links.tail, v):
            s += ebb.dot(e.head.x, e.b)
            t += ebb.dot(e.b, e.b)
        v.s = s + 100 * t

    assert in_registers(both(add, system, "s"), 4)


def test_a_product_of_the_own_row():
    """What is beyond its numbers is that of the next row, which other turns of the loop over rows change."""
    system = System(ebb.float64, 3)
    links = system.links

    @ebb.kernel
    def add(v):
        y = ebb.zeros(ebb.vec3d)
        for e in ebb.where(links.tail, v):
            y += e.a @ v.y
        v.y = y

    assert in_registers(both(add, system, "y"), 4)


def test_numbers_that_do_not_follow_one_another_are_left_to_others():
    system = System(ebb.float64, 3)
    links = system.links

    @ebb.kernel
    def transposed(v):
        y = ebb.zeros(ebb.vec3d)
        for e in ebb.where(links.tail, v):
            y += ebb.transpose(e.a) @ e.head.x
        v.y = y

    @ebb.kernel
    def gaps(v):
        s = 0.0
        for e in ebb.where(links.tail, v):
            s += e.b[0] * e.head.x[0] + e.b[2] * e.head.x[2]
        v.s = s

    for kernel, name in ((transposed, "y"), (gaps, "s")):
        assert not in_registers(both(kernel, system, name), 4)


def test_a_sum_that_turns_look_at_is_left_to_others():
    system = System(ebb.float64, 3)
    links = system.links

    @ebb.kernel
    def looks(v):
        s = 0.0
        t = 0.0
        for e in ebb.where(links.tail, v):
            s += ebb.dot(e.b, e.head.x)
            t += s
        v.s = t

    both(looks, system, "s")


def test_what_is_not_finite_stays_in_its_row():
    """The lane beyond the numbers of a row holds the next one's, which may be anything."""
    system = System(ebb.float64, 3)
    links = system.links
    x, a = system.nodes.x.to_numpy(), links.a.to_numpy()
    x[2], a[5] = np.nan, np.inf
    system.nodes.x.load(x)
    links.a.load(a)

    @ebb.kernel
    def multiply(v):
        y = ebb.zeros(ebb.vec3d)
        for e in ebb.where(links.tail, v):
            y += e.a @ e.head.x
        v.y = y

    both(multiply, system, "y")
