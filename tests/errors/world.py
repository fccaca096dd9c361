"""The relations that the wrong programs use."""

from __future__ import annotations

import numpy as np

import ebb


def make_mesh() -> tuple[ebb.Relation, ebb.Relation]:
    """A square of four vertices, with an edge each way along its sides, and ``v.edges``."""
    vertices = ebb.Relation("vertices", size=4)
    vertices.new_field("pos", ebb.vec3f, init=[[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    vertices.new_field("q", ebb.vec3f, init=vertices.pos)
    vertices.new_field("qd", ebb.vec3f, init=0.0)
    vertices.new_field("force", ebb.vec3f, init=0.0)
    vertices.new_field("mass", ebb.float32, init=1.0)
    vertices.new_field("count", ebb.int32, init=0)
    vertices.new_field("fixed", ebb.bool_, init=False)
    vertices.new_field("frame", ebb.mat3f, init=np.eye(3))
    edges = ebb.Relation("edges", size=8)
    edges.new_field("tail", vertices, init=[0, 0, 1, 1, 2, 2, 3, 3])
    edges.new_field("head", vertices, init=[1, 3, 0, 2, 1, 3, 2, 0])
    edges.new_field("rest_len", ebb.float32, init=1.0)
    edges.group_by("tail")

    @vertices.member("edges")
    def edges_of(v):
        return ebb.where(edges.tail, v)

    return vertices, edges


def make_grid(periodic: tuple[bool, bool] = (False, False)) -> ebb.Relation:
    """A grid of 4 x 5 cells with a temperature, and ``c(di, dj)``."""
    cells = ebb.Relation("cells", shape=(4, 5), periodic=periodic)
    cells.new_field("T", ebb.float64, init=0.0)
    cells.new_field("new_T", ebb.float64, init=0.0)
    cells.new_field("flag", ebb.bool_, init=False)

    @cells.member("__call__")
    def offset(c, di, dj):
        return ebb.affine(cells, [[1, 0, di], [0, 1, dj]], c)

    return cells
