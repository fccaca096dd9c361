"""The direct solve, and that all solvers agree on an elastic body."""

from __future__ import annotations

import numpy as np
import pytest
from linear_systems import System, symmetric

import ebb
from ebb.domains import TetMesh
from ebb.solvers import MINRES, ConjugateGradients, Reason, direct

pytest.importorskip("scipy")


def test_it_agrees_with_numpy():
    system = System(symmetric(20, 3, -3.0), np.random.default_rng(1).normal(size=(20, 3)))
    result = direct(system.rows.x, system.rows.b, system.entries.a)
    assert result.converged and result.iterations == 0
    np.testing.assert_allclose(system.x, np.linalg.solve(system.dense, system.right), rtol=1e-9)


def test_rows_that_are_not_free_stay():
    system = System(symmetric(20, 3, 0.5), np.random.default_rng(1).normal(size=(20, 3)))
    system.rows.x.fill(7.0)
    free = np.arange(20) < 13
    direct(system.rows.x, system.rows.b, system.entries.a, rows=system.rows.new_subset("free", free))
    kept = np.repeat(free, 3)
    expected = np.linalg.solve(system.dense[np.ix_(kept, kept)], system.right[kept])
    np.testing.assert_allclose(system.x[kept], expected, rtol=1e-9)
    assert (system.x[~kept] == 7.0).all()


def test_a_singular_matrix():
    system = System(np.diag([1.0, 0.0, 2.0]) + np.diag([0.0, 0.0], 1), np.ones(3))
    assert direct(system.rows.x, system.rows.b, system.entries.a).reason is Reason.BREAKDOWN
    assert (system.x == 0).all()


def test_all_solvers_agree_on_a_body():
    mesh = TetMesh.box(4, 3, 2, self_edges=True, precision=ebb.float64)
    vertices, edges, tetrahedra = mesh.vertices, mesh.edges, mesh.tetrahedra
    edges.new_field("a", ebb.mat3d, init=0.0)
    vertices.new_field("b", ebb.vec3d, init=(0.0, 0.0, -1.0))
    vertices.new_field("x", ebb.vec3d, init=0.0)

    @ebb.kernel
    def assemble(t):
        """Linear elasticity with both constants of Lame equal to 1."""
        d = ebb.inverse(ebb.transpose([t.v[1].pos - t.v[0].pos, t.v[2].pos - t.v[0].pos, t.v[3].pos - t.v[0].pos]))
        g = [-(d[0] + d[1] + d[2]), d[0], d[1], d[2]]
        for i in range(4):
            for j in range(4):
                k = ebb.outer(g[i], g[j]) + ebb.outer(g[j], g[i])
                s = ebb.dot(g[i], g[j])
                t.e[i, j].a += t.volume * (k + s * ebb.identity(ebb.mat3d))

    assemble(tetrahedra)
    free = vertices.new_subset("free", mesh.vertices.pos.to_numpy()[:, 0] > 0)
    found = {}
    for name, solve in {
        "cg": ConjugateGradients(vertices.x, vertices.b, edges.a, preconditioner="block-jacobi", rows=free).solve,
        "minres": MINRES(vertices.x, vertices.b, edges.a, preconditioner="jacobi", rows=free).solve,
        "direct": lambda tolerance: direct(vertices.x, vertices.b, edges.a, rows=free),
    }.items():
        vertices.x.fill(0.0)
        assert solve(tolerance=1e-10).converged, name
        found[name] = vertices.x.to_numpy()
    np.testing.assert_allclose(found["cg"], found["direct"], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found["minres"], found["direct"], rtol=1e-6, atol=1e-9)
