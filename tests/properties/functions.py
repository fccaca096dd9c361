"""The functions and members that random kernels use."""

from __future__ import annotations

import ebb


@ebb.func
def small(x):
    return ebb.float64(ebb.int32(x) % 64) * 0.25


@ebb.func
def small_s(x):
    return ebb.float32(ebb.int32(x) % 64) * 0.25


@ebb.func
def small_p(v):
    return [small(v[0]), small(v[1]), small(v[2])]


@ebb.func
def pick(c, a, b):
    if c:
        return a
    return b


@ebb.func
def bump(k, amount):
    k.j += amount


FUNCTIONS = {"small": small, "small_s": small_s, "small_p": small_p, "pick": pick, "bump": bump}


def add_members(relations: dict[str, ebb.Relation]) -> None:
    """Gives the relations of a world their members."""
    links, cells, nodes = relations["links"], relations["cells"], relations["nodes"]

    @nodes.member
    def out(n):
        return ebb.where(links.a, n)

    @cells.member("__call__")
    def offset(c, di, dj):
        return ebb.affine(cells, [[1, 0, di], [0, 1, dj]], c)

    @cells.member
    def up(c):
        return ebb.affine(cells, [[1, 0, 0], [0, 1, 1]], c, edge="clamp")

    @nodes.member
    def weight(n):
        return n.i * 2

    @weight.reducer("+")
    def weight_add(n, value):
        n.i += value
