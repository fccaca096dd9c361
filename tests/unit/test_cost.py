from __future__ import annotations

import ebb
from ebb.compiler.cost import cost_of
from ebb.compiler.elaborate.elaborate import elaborate

rows = ebb.Relation("rows", size=100)
rows.new_field("x", ebb.float32)
rows.new_field("y", ebb.float32)


def cost(kernel):
    return cost_of(elaborate(kernel.source, rows, (), ()).kernel)


def test_what_takes_long_is_told_from_arithmetic():
    @ebb.kernel
    def scale(r: rows):
        r.y = 2.0 * r.x

    @ebb.kernel
    def wave(r: rows):
        r.y = 2.0 * ebb.sin(r.x)

    @ebb.kernel
    def noise(r: rows):
        for _ in range(10):
            r.y += ebb.float32(ebb.rand()) ** r.x

    assert (cost(scale).series, cost(wave).series, cost(noise).series) == (0, 1, 20)
    assert cost(scale).nanoseconds < cost(wave).nanoseconds < cost(noise).nanoseconds
