"""Hierarchies of grids: restriction and prolongation by affine maps."""

from __future__ import annotations

import numpy as np
import pytest
from grid_model import GRIDS

import ebb
from ebb.domains import Grid1D, Grid2D, Grid3D


@pytest.mark.parametrize(
    ("shape", "periodic"), [((8,), False), ((4, 6), (True, False)), ((2, 4, 2), (False, True, False))]
)
def test_up_and_down(backend, shape, periodic):
    fine = GRIDS[len(shape)](shape, periodic=periodic)
    coarse = fine.coarsen()

    @ebb.kernel
    def rise(e):
        e.at = ebb.coords(e.up)

    @ebb.kernel
    def sink(e):
        e.at = ebb.coords(e.down)

    names = ["cells", "vertices", "dual_vertices", *(f"{axis}{kind}s" for kind in ("edge", "face") for axis in "xyz")]
    relations = {getattr(fine, name): getattr(coarse, name) for name in names if hasattr(fine, name)}
    for lower, upper in relations.items():
        for relation, kernel in ((lower, rise), (upper, sink)):
            relation.new_field("at", ebb.vector(ebb.int32, len(shape)))
            kernel(relation)
        np.testing.assert_array_equal(lower.at.to_numpy(), np.stack(np.indices(lower.shape), -1) // 2)
        np.testing.assert_array_equal(upper.at.to_numpy(), np.stack(np.indices(upper.shape), -1) * 2)


def test_levels():
    fine = Grid2D((8, 12), (1, 2), (3, 4), (False, True), (3, 1), precision=ebb.float64)
    assert fine.coarse is None and fine.fine is None
    coarse = fine.coarsen()
    assert coarse is fine.coarsen() is fine.coarse and coarse.fine is fine and type(coarse) is Grid2D
    assert (coarse.shape, coarse.origin, coarse.extent) == ((4, 6), fine.origin, fine.extent)
    assert (coarse.periodic, coarse.boundary_depth) == (fine.periodic, (3, 0))
    coarsest = coarse.coarsen()
    assert (coarsest.shape, coarsest.boundary_depth) == ((2, 3), (2, 0))
    with pytest.raises(ebb.RelationError, match="E534"):
        coarsest.coarsen()
    assert coarsest.coarse is None


@pytest.mark.parametrize("shape", [(1,), (2, 3), (4, 4, 5)])
def test_odd_grids_have_no_coarser_ones(shape):
    grid = GRIDS[len(shape)](shape)
    with pytest.raises(ebb.RelationError, match="E534"):
        grid.coarsen()
    assert grid.coarse is None


def test_a_point_lies_in_the_coarser_cell(backend):
    fine = Grid2D((8, 4), extent=(2, 3), precision=ebb.float64)
    coarse = fine.coarsen()

    @ebb.kernel
    def check(c: fine.cells):
        assert coarse.locate(c.center) == c.up
        assert ebb.length(c.up.center - c.center) < 1.0

    @ebb.kernel
    def check_vertices(v: coarse.vertices):
        assert v.down.pos.x == v.pos.x and v.down.pos.y == v.pos.y
        assert v.down.up == v

    check(fine.cells)
    check_vertices(coarse.vertices)


def fill(relation, function):
    """Sets ``u`` to a function of the place."""
    relation.new_field("u", ebb.float64)

    @ebb.kernel
    def set_values(e):
        e.u = function[0] + ebb.dot(ebb.vec2d([function[1], function[2]]), e.center)

    set_values(relation)


CONSTANT, LINEAR = (3.0, 0.0, 0.0), (1.0, 2.0, -5.0)


@pytest.mark.parametrize("function", [CONSTANT, LINEAR], ids=["constant", "linear"])
def test_restriction_of_cells(backend, function):
    fine = Grid2D((8, 6), extent=(2, 3), precision=ebb.float64)
    coarse = fine.coarsen()
    fill(fine.cells, function)
    fill(coarse.cells, function)
    expected = coarse.cells.u.to_numpy()

    @ebb.kernel
    def restrict(C: coarse.cells):
        C.u = 0.0
        for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
            C.u += 0.25 * C.down(i, j).u

    restrict(coarse.cells)
    np.testing.assert_allclose(coarse.cells.u.to_numpy(), expected, 1e-13, 1e-13)


@pytest.mark.parametrize("function", [CONSTANT, LINEAR], ids=["constant", "linear"])
def test_prolongation_to_cells(backend, function):
    fine = Grid2D((8, 6), extent=(2, 3), boundary_depth=1, precision=ebb.float64)
    coarse = fine.coarsen()
    fill(fine.cells, function)
    fill(coarse.cells, function)
    fine.cells.new_field("v", ebb.float64)

    @ebb.kernel
    def prolong(c: fine.cells):
        near = c.up
        odd = ebb.coords(c) % 2
        x = near.clamped(1, 0).u if odd.x == 1 else near.clamped(-1, 0).u
        y = near.clamped(0, 1).u if odd.y == 1 else near.clamped(0, -1).u
        c.v = near.u + 0.25 * (x - near.u) + 0.25 * (y - near.u)

    prolong(fine.cells)
    inside = np.s_[1:-1, 1:-1] if function == LINEAR else np.s_[:, :]
    np.testing.assert_allclose(fine.cells.v.to_numpy()[inside], fine.cells.u.to_numpy()[inside], 1e-13, 1e-13)


@pytest.mark.parametrize("function", [CONSTANT, LINEAR], ids=["constant", "linear"])
def test_prolongation_to_vertices(backend, function):
    fine = Grid2D((8, 6), extent=(2, 3), precision=ebb.float64)
    coarse = fine.coarsen()
    fill(fine.vertices, function)
    fill(coarse.vertices, function)
    fine.vertices.new_field("v", ebb.float64, init=0.0)

    @ebb.kernel
    def spread(V: coarse.vertices):
        for i, j in ((-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1), (1, 1)):
            V.down(i, j).v += V.u * 0.5 ** (abs(i) + abs(j))

    spread(coarse.vertices.interior)
    expected = fine.vertices.u.to_numpy()
    np.testing.assert_allclose(fine.vertices.v.to_numpy()[2:-2, 2:-2], expected[2:-2, 2:-2], 1e-13, 1e-13)


def test_two_levels_solve_faster_than_one(backend):
    """A V-cycle on a line: the error of a smooth mode, which relaxation hardly sees, goes down by much."""
    fine = Grid1D(32, extent=1.0, precision=ebb.float64)
    coarse = fine.coarsen()
    for grid in (fine, coarse):
        for name in ("u", "new_u", "f", "r"):
            grid.vertices.new_field(name, ebb.float64, init=0.0)
    fine.vertices.u.load(lambda i: np.sin(np.pi * i / 32))

    @ebb.kernel
    def relax(v, hh: ebb.float64):
        v.new_u = v.u / 3 + (v.xneg.u + v.xpos.u + hh * v.f) / 3

    @ebb.kernel
    def residual(v, hh: ebb.float64):
        v.r = v.f - (2 * v.u - v.xneg.u - v.xpos.u) / hh

    @ebb.kernel
    def restrict(V: coarse.vertices):
        V.f = 0.25 * (V.down(-1).r + 2 * V.down.r + V.down(1).r)

    @ebb.kernel
    def correct(V: coarse.vertices):
        V.down.u += V.u
        V.down(1).u += 0.5 * V.u
        V.down(-1).u += 0.5 * V.u

    def smooth(grid, times):
        for _ in range(times):
            relax(grid.vertices.interior, grid.spacing[0] ** 2)
            grid.vertices.swap("u", "new_u")

    for _ in range(3):
        smooth(fine, 2)
        residual(fine.vertices.interior, fine.spacing[0] ** 2)
        restrict(coarse.vertices.interior)
        coarse.vertices.u.fill(0.0)
        coarse.vertices.new_u.fill(0.0)
        smooth(coarse, 400)
        correct(coarse.vertices.interior)
        smooth(fine, 2)
    assert np.abs(fine.vertices.u.to_numpy()).max() < 1e-3


def test_three_dimensions_conserve_what_they_restrict(backend):
    fine = Grid3D((4, 2, 6), periodic=(True, False, False))
    coarse = fine.coarsen()
    fine.cells.new_field("m", ebb.int32, init=np.random.default_rng(0).integers(0, 99, (4, 2, 6)))
    coarse.cells.new_field("m", ebb.int32, init=0)

    @ebb.kernel
    def gather(c: fine.cells):
        c.up.m += c.m

    gather(fine.cells)
    m = fine.cells.m.to_numpy()
    np.testing.assert_array_equal(coarse.cells.m.to_numpy(), m.reshape(2, 2, 1, 2, 3, 2).sum(axis=(1, 3, 5)))
