"""What the kernels of a fluid do at an element of its grid, once in two dimensions and once in three.

Dual cells ``d`` have the values of the cells around them, at their corners; ``f`` is a face and ``c`` a cell.
"""

from __future__ import annotations

import ebb


@ebb.func
def sample_2d(d, pos, field):
    x, y = ebb.clamp(d.local(pos), 0, 1)
    low = (1 - x) * d.cell(0, 0)[field] + x * d.cell(1, 0)[field]
    high = (1 - x) * d.cell(0, 1)[field] + x * d.cell(1, 1)[field]
    return (1 - y) * low + y * high


@ebb.func
def sample_3d(d, pos, field):
    x, y, z = ebb.clamp(d.local(pos), 0, 1)
    south = (1 - x) * d.cell(0, 0, 0)[field] + x * d.cell(1, 0, 0)[field]
    north = (1 - x) * d.cell(0, 1, 0)[field] + x * d.cell(1, 1, 0)[field]
    low = (1 - y) * south + y * north
    south = (1 - x) * d.cell(0, 0, 1)[field] + x * d.cell(1, 0, 1)[field]
    north = (1 - x) * d.cell(0, 1, 1)[field] + x * d.cell(1, 1, 1)[field]
    return (1 - z) * low + z * ((1 - y) * south + y * north)


@ebb.func
def held_2d(value, d, field):
    low = min(min(d.cell(0, 0)[field], d.cell(1, 0)[field]), min(d.cell(0, 1)[field], d.cell(1, 1)[field]))
    high = max(max(d.cell(0, 0)[field], d.cell(1, 0)[field]), max(d.cell(0, 1)[field], d.cell(1, 1)[field]))
    return max(low, min(high, value))


@ebb.func
def held_3d(value, d, field):
    low, high = d.cell(0, 0, 0)[field], d.cell(0, 0, 0)[field]
    for i, j, k in ((1, 0, 0), (0, 1, 0), (1, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1), (1, 1, 1)):
        low, high = min(low, d.cell(i, j, k)[field]), max(high, d.cell(i, j, k)[field])
    return max(low, min(high, value))


@ebb.func
def outflow_2d(c):
    return c.xpos_face.flow - c.xneg_face.flow + c.ypos_face.flow - c.yneg_face.flow


@ebb.func
def outflow_3d(c):
    flat = c.xpos_face.flow - c.xneg_face.flow + c.ypos_face.flow - c.yneg_face.flow
    return flat + c.zpos_face.flow - c.zneg_face.flow


@ebb.func
def difference_2d(c):
    x = c.clamped(1, 0).pressure - c.clamped(-1, 0).pressure
    return [x, c.clamped(0, 1).pressure - c.clamped(0, -1).pressure]


@ebb.func
def difference_3d(c):
    x = c.clamped(1, 0, 0).pressure - c.clamped(-1, 0, 0).pressure
    y = c.clamped(0, 1, 0).pressure - c.clamped(0, -1, 0).pressure
    return [x, y, c.clamped(0, 0, 1).pressure - c.clamped(0, 0, -1).pressure]


@ebb.func
def beyond(c, near, field, axis):
    # The velocity through a wall is 0: so that on its other side is opposite.
    return near[field][axis] if near != c else -near[field][axis]


@ebb.func
def ripple_2d(c, field):
    x = 2 * c[field].x - beyond(c, c.clamped(1, 0), field, 0) - beyond(c, c.clamped(-1, 0), field, 0)
    return [x, 2 * c[field].y - beyond(c, c.clamped(0, 1), field, 1) - beyond(c, c.clamped(0, -1), field, 1)]


@ebb.func
def ripple_3d(c, field):
    x = 2 * c[field].x - beyond(c, c.clamped(1, 0, 0), field, 0) - beyond(c, c.clamped(-1, 0, 0), field, 0)
    y = 2 * c[field].y - beyond(c, c.clamped(0, 1, 0), field, 1) - beyond(c, c.clamped(0, -1, 0), field, 1)
    return [x, y, 2 * c[field].z - beyond(c, c.clamped(0, 0, 1), field, 2) - beyond(c, c.clamped(0, 0, -1), field, 2)]


@ebb.func
def below_2d(f, unit):
    return f.cell(-unit[0], -unit[1])


@ebb.func
def below_3d(f, unit):
    return f.cell(-unit[0], -unit[1], -unit[2])
