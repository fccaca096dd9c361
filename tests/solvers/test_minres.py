"""MINRES: against NumPy and SciPy, on indefinite matrices."""

from __future__ import annotations

import numpy as np
import pytest
from linear_systems import System, symmetric

import ebb
from ebb.solvers import MINRES, Reason


def indefinite(n: int = 20, shift: float = -6.0) -> System:
    system = System(symmetric(n, 3, shift), np.random.default_rng(1).normal(size=(n, 3)))
    values = np.linalg.eigvalsh(system.dense)
    assert values[0] < -0.1 and values[-1] > 0.1 and np.abs(values).min() > 1e-3
    return system


def best_residuals(system: System, count: int) -> list[float]:
    """The least norms of b - A x with x in the Krylov spaces, by their definition."""
    norms, basis, vector = [float(np.linalg.norm(system.right))], np.zeros((len(system.right), 0)), system.right
    for _ in range(count):
        vector = vector - basis @ (basis.T @ vector)
        vector -= basis @ (basis.T @ vector)
        basis = np.column_stack([basis, vector / np.linalg.norm(vector)])
        image = system.dense @ basis
        found = np.linalg.lstsq(image, system.right)[0]
        norms.append(float(np.linalg.norm(system.right - image @ found)))
        vector = system.dense @ basis[:, -1]
    return norms


def test_residuals_are_the_least_in_the_krylov_spaces(backend):
    system = indefinite(8)
    result = MINRES(system.rows.x, system.rows.b, system.entries.a).solve(0.1)
    assert result.converged and result.iterations > 10
    np.testing.assert_allclose(result.residuals, best_residuals(system, result.iterations), rtol=1e-5)
    assert np.linalg.norm(system.right - system.dense @ system.x) == pytest.approx(result.residuals[-1], rel=1e-6)


def test_it_solves_to_small_residuals():
    system = indefinite(60)
    result = MINRES(system.rows.x, system.rows.b, system.entries.a).solve(1e-8)
    assert result.converged
    np.testing.assert_allclose(system.x, np.linalg.solve(system.dense, system.right), rtol=1e-4, atol=1e-6)


def test_with_a_preconditioner(backend):
    system = indefinite(8)
    rows = system.rows
    size = np.abs(np.linalg.eigvalsh(system.dense)).max()
    weights = 1 / (0.2 * size + np.abs(np.diag(system.dense)).reshape(-1, 3))
    rows.new_field("weight", ebb.vec3d, init=weights)

    @ebb.kernel
    def scale(v, source: str, target: str):
        v[target] = v.weight * v[source]

    result = MINRES(
        rows.x, rows.b, system.entries.a, preconditioner=lambda source, target: scale(rows, source, target)
    ).solve(1e-4)
    assert result.converged
    # The norms are those of the residual itself, also where another norm is minimal.
    assert np.linalg.norm(system.right - system.dense @ system.x) == pytest.approx(result.residuals[-1], rel=1e-4)


def test_positive_definite_and_with_rows_removed():
    system = System(symmetric(20, 3, 0.5), np.random.default_rng(1).normal(size=(20, 3)))
    free = np.arange(20) % 4 != 1
    subset = system.rows.new_subset("free", free)
    solver = MINRES(system.rows.x, system.rows.b, system.entries.a, preconditioner="block-jacobi", rows=subset)
    assert solver.solve(1e-9).converged
    kept = np.repeat(free, 3)
    expected = np.linalg.solve(system.dense[np.ix_(kept, kept)], system.right[kept])
    np.testing.assert_allclose(system.x[kept], expected, rtol=1e-6, atol=1e-8)


def test_a_solution_that_is_reached_exactly():
    system = System(np.diag([2.0, 2.0, 2.0, -2.0]), np.ones(4))
    result = MINRES(system.rows.x, system.rows.b, system.entries.a).solve(1e-12)
    assert result.converged and result.iterations == 2
    np.testing.assert_allclose(system.x, [0.5, 0.5, 0.5, -0.5])


def test_limit_and_faults():
    system = indefinite()
    result = MINRES(system.rows.x, system.rows.b, system.entries.a).solve(1e-12, most_iterations=7)
    assert result.reason is Reason.LIMIT and result.iterations == 7
    assert np.linalg.norm(system.right - system.dense @ system.x) == pytest.approx(result.residuals[-1], rel=1e-9)
    jacobi = MINRES(system.rows.x, system.rows.b, system.entries.a, preconditioner="jacobi")
    assert jacobi.solve().reason in (Reason.PRECONDITIONER, Reason.CONVERGED)
    a = system.entries.a.to_numpy()
    a[3] = np.nan
    system.entries.a.load(a)
    system.rows.x.fill(0.5)
    assert MINRES(system.rows.x, system.rows.b, system.entries.a).solve().reason is Reason.NOT_FINITE
    assert (system.x == 0.5).all()


@pytest.mark.parametrize("matrix", [np.zeros((2, 2)), np.array([[1.0, -1.0], [-1.0, 1.0]])])
def test_a_matrix_with_nothing_to_go_on_with_leaves_x(matrix):
    system = System(np.where(matrix == 0, 1.0, matrix), np.array([1.0, 1.0]))
    tail, head = system.entries.tail.to_numpy(), system.entries.head.to_numpy()
    system.entries.a.load(matrix[tail, head])
    result = MINRES(system.rows.x, system.rows.b, system.entries.a).solve()
    assert result.reason is Reason.BREAKDOWN and not system.x.any()


@pytest.mark.parametrize("tolerance", [1e-5, 0.3])
def test_what_is_said_of_a_singular_system_is_true_of_x(tolerance):
    random, found = np.random.default_rng(0), []
    matrix = 2 * np.eye(10) - np.roll(np.eye(10), 1, axis=0) - np.roll(np.eye(10), -1, axis=0)
    system = System(matrix, np.zeros(10))
    solver = MINRES(system.rows.x, system.rows.b, system.entries.a)
    for right in random.normal(size=(8, 10)):
        for solvable in (False, True):
            system.right = matrix @ right if solvable else right
            system.rows.b.load(system.right)
            system.rows.x.fill(0.0)
            result = solver.solve(tolerance, most_iterations=200)
            found.append(result.converged)
            # Without a solution x grows beyond all bounds, and with it the rounding of what is compared.
            truth, allowed = system.residual() * np.linalg.norm(system.right), 1e-14 * np.linalg.norm(system.x)
            assert result.converged or truth == pytest.approx(result.residuals[-1], rel=1e-6, abs=allowed)
            assert not result.converged or truth <= 10 * tolerance * np.linalg.norm(system.right)
            assert result.converged or not solvable
    assert set(found) == {True, False} if tolerance < 0.1 else True in found
