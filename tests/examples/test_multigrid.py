"""The equations of examples/multigrid.py: against SciPy, and how fast each method gets there."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import ebb
import multigrid
from ebb.domains import Grid2D, Grid3D
from multigrid import Hierarchy, Solver, Walls


def line(count, wraps, walls):
    """The second derivative along an axis, with cells of the length 1."""
    matrix = sp.diags([np.ones(count - 1), -2 * np.ones(count), np.ones(count - 1)], [-1, 0, 1]).tolil()
    if wraps:
        matrix[0, -1] += 1
        matrix[-1, 0] += 1
    else:
        beyond = 1 if walls is Walls.INSULATED else -1
        matrix[0, 0] += beyond
        matrix[-1, -1] += beyond
    return matrix.tocsr()


def laplacian(shape, periodic, walls):
    lines = [line(n, wraps, walls) for n, wraps in zip(shape, periodic, strict=True)]
    total = lines[0]
    for each in lines[1:]:
        total = sp.kron(total, sp.identity(each.shape[0])) + sp.kron(sp.identity(total.shape[0]), each)
    return total


def make(shape, periodic, precision=ebb.float64, extent=None, components=()):
    grid = (Grid2D if len(shape) == 2 else Grid3D)(shape, extent=extent, periodic=periodic, precision=precision)
    kind = ebb.vector(precision, components[0]) if components else precision
    grid.cells.new_field("x", kind, init=0.0)
    grid.cells.new_field("b", kind, init=np.random.default_rng(0).standard_normal((*shape, *components)))
    return grid


@pytest.mark.parametrize("method", multigrid.METHODS)
@pytest.mark.parametrize(
    ("shape", "periodic", "walls", "shift", "components"),
    [
        ((8, 12), (True, True), Walls.INSULATED, 0.0, ()),
        ((8, 6), (False, False), Walls.INSULATED, 0.0, ()),
        ((5, 7), (True, False), Walls.INSULATED, 0.0, ()),
        ((8, 8), (False, False), Walls.HELD, 0.0, ()),
        ((8, 8), (False, True), Walls.HELD, 0.25, (2,)),
        ((4, 6, 8), (False, True, False), Walls.INSULATED, 0.0, ()),
        ((4, 4, 4), (False, False, False), Walls.HELD, 0.5, (3,)),
    ],
    ids=str,
)
def test_solutions(method, shape, periodic, walls, shift, components):
    grid = make(shape, periodic, components=components)
    solver = Solver(Hierarchy(grid), "x", "b", walls=walls, method=method, shift=shift)
    b = grid.cells.b.to_numpy()
    solved = solver.solve(1e-11, 300)
    assert solved.converged and solved.residuals[0] > 0.5
    x = grid.cells.x.to_numpy()
    if solver.singular:
        b -= b.mean()
        assert abs(x.mean()) < 1e-12
    flat = x.reshape(-1, *components)
    found = shift * flat - laplacian(shape, periodic, walls) @ flat
    np.testing.assert_allclose(found, b.reshape(flat.shape), atol=1e-10)


@pytest.mark.parametrize(
    ("shape", "periodic", "walls", "factor"),
    [
        ((64, 64), True, Walls.INSULATED, 0.12),
        ((128, 128), True, Walls.INSULATED, 0.12),
        ((64, 96), False, Walls.INSULATED, 0.12),
        ((64, 64), (True, False), Walls.INSULATED, 0.12),
        ((64, 64), False, Walls.HELD, 0.18),
        ((16, 16, 16), True, Walls.INSULATED, 0.14),
        ((16, 32, 16), False, Walls.INSULATED, 0.14),
    ],
    ids=str,
)
def test_every_cycle_of_multigrid_takes_the_same_share_of_the_error(shape, periodic, walls, factor):
    grid = make(shape, periodic)
    solved = Solver(Hierarchy(grid), "x", "b", walls=walls).solve(1e-9)
    assert solved.converged and solved.turns <= 13
    ratios = np.divide(solved.residuals[1:], solved.residuals[:-1])
    assert ratios[-3:].mean() < factor


def test_the_plain_methods_slow_down_on_finer_grids():
    turns = {}
    for method in ("jacobi", "gauss-seidel"):
        for count in (16, 32):
            grid = make((count, count), False)
            wave = np.cos(np.pi * (np.arange(count) + 0.5) / count)
            grid.cells.b.load(np.add.outer(wave, wave))
            solver = Solver(Hierarchy(grid), "x", "b", method=method)
            turns[method, count] = solver.solve(1e-3, 1000).turns
        assert 3 < turns[method, 32] / turns[method, 16] < 6
    assert 1.5 < turns["jacobi", 32] / turns["gauss-seidel", 32] < 4


def test_float32_stops_where_rounding_begins():
    solver = Solver(Hierarchy(make((128, 128), False, ebb.float32, (1.0, 1.0))), "x", "b")
    solved = solver.solve(1e-12)
    assert not solved.converged and solved.turns < 15 and solved.residuals[-1] < 1e-4


def test_nothing_to_solve():
    grid = make((8, 8), True)
    solver = Solver(Hierarchy(grid), "x", "b")
    grid.cells.b.fill(0.0)
    grid.cells.x.fill(3.0)
    assert solver.solve().turns == 0 and not grid.cells.x.to_numpy().any()


def test_solvers_may_share_a_hierarchy_and_change_their_shift():
    grid = make((16, 16), False)
    grid.cells.new_field("y", ebb.float64)
    hierarchy = Hierarchy(grid)
    first, second = Solver(hierarchy, "x", "b"), Solver(hierarchy, "y", "b", walls=Walls.HELD, shift=1.0)
    assert first.solve(1e-10).converged
    for shift in (1.0, 50.0):
        second.shift.value = shift
        assert second.solve(1e-10).converged
        y, b = grid.cells.y.to_numpy().ravel(), grid.cells.b.to_numpy().ravel()
        np.testing.assert_allclose(shift * y - laplacian(grid.shape, (False, False), Walls.HELD) @ y, b, atol=1e-8)


def test_a_chessboard_becomes_its_mean_on_the_coarser_grid():
    grid = make((8, 4), True)
    solver = Solver(Hierarchy(grid), "x", "b")
    board = np.indices(grid.shape).sum(axis=0) % 2
    grid.cells.new_x.load(board)
    solver._restrict(grid.coarse.cells)
    assert (grid.coarse.cells.b.to_numpy() == 0.5).all()
