"""Conjugate gradients: against NumPy, by every preconditioner, and how a solve ends."""

from __future__ import annotations

import numpy as np
import pytest
from linear_systems import System, symmetric

import ebb
from ebb.solvers import ConjugateGradients, Reason


def elastic(shift: float = 0.5) -> System:
    """Twenty rows of 3 x 3 blocks."""
    return System(symmetric(20, 3, shift), np.random.default_rng(1).normal(size=(20, 3)))


def textbook(system: System, inverse: np.ndarray, tolerance: float) -> list[float]:
    """The norms of the residuals by the algorithm as it is printed, in NumPy."""
    a, r = system.dense, system.right.copy()
    z = inverse @ r
    p, norms = z.copy(), [float(np.linalg.norm(r))]
    while norms[-1] > tolerance * norms[0]:
        q = a @ p
        alpha = (r @ z) / (p @ q)
        new = r - alpha * q
        new_z = inverse @ new
        beta = (new @ new_z) / (r @ z)
        r, z = new, new_z
        p = z + beta * p
        norms.append(float(np.linalg.norm(r)))
    return norms


def block_diagonal(system: System) -> np.ndarray:
    mask = np.kron(np.eye(system.rows.size), np.ones((3, 3)))
    return system.dense * mask


@pytest.mark.parametrize("preconditioner", [None, "jacobi", "block-jacobi"])
def test_it_is_the_textbook_iteration(preconditioner, backend):
    system = elastic()
    inverse = {
        None: np.eye(60),
        "jacobi": np.diag(1 / np.diag(system.dense)),
        "block-jacobi": np.linalg.inv(block_diagonal(system)),
    }[preconditioner]
    result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a, preconditioner=preconditioner).solve(
        1e-3
    )
    expected = textbook(system, inverse, 1e-3)
    assert result.reason is Reason.CONVERGED and result.converged
    assert result.iterations == len(expected) - 1
    np.testing.assert_allclose(result.residuals, expected, rtol=1e-6)
    assert system.residual() <= 1.001e-3


@pytest.mark.parametrize("scalar", [ebb.float32, ebb.float64])
def test_matrices_of_numbers(scalar):
    laplacian = 2.01 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1)
    system = System(laplacian, np.sin(np.arange(40.0)), scalar)
    result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a, preconditioner="jacobi").solve(1e-5)
    assert result.converged
    assert system.residual() < (2e-5 if scalar is ebb.float64 else 1e-4)


def test_rows_that_are_not_free_are_removed(backend):
    system = elastic()
    free = np.arange(20) % 3 != 0
    start = np.random.default_rng(2).normal(size=(20, 3))
    start[free] = 0
    system.rows.x.load(start)
    subset = system.rows.new_subset("free", free)
    solver = ConjugateGradients(
        system.rows.x, system.rows.b, system.entries.a, preconditioner="block-jacobi", rows=subset
    )
    assert solver.solve(1e-9).converged
    kept = np.repeat(free, 3)
    expected = start.ravel()
    expected[kept] = np.linalg.solve(system.dense[np.ix_(kept, kept)], system.right[kept])
    np.testing.assert_allclose(system.x, expected, rtol=1e-6, atol=1e-9)
    assert (system.x[~kept] == start.ravel()[~kept]).all()


def test_a_product_and_a_preconditioner_by_functions(backend):
    system = elastic()
    rows, diagonal = system.rows, np.diag(system.dense).reshape(-1, 3)
    system.entries.group_by("tail")
    rows.new_field("inverse", ebb.vec3d, init=1 / diagonal)
    entries = system.entries

    @ebb.kernel
    def multiply(v, source: str, target: str):
        y = ebb.zeros(ebb.vec3d)
        for e in ebb.where(entries.tail, v):
            y += e.a @ e.head[source]
        v[target] = y

    @ebb.kernel
    def scale(v, source: str, target: str):
        v[target] = v.inverse * v[source]

    result = ConjugateGradients(
        rows.x,
        rows.b,
        product=lambda source, target: multiply(rows, source, target),
        preconditioner=lambda source, target: scale(rows, source, target),
    ).solve(1e-3)
    expected = textbook(system, np.diag(1 / diagonal.ravel()), 1e-3)
    assert result.iterations == len(expected) - 1
    np.testing.assert_allclose(result.residuals, expected, rtol=1e-6)


def test_iterations_are_exact_however_they_are_run():
    """With a callback there is a run for each, without one many; a second solve begins with as many as the first."""
    counts = []
    for callback in (None, lambda count, norm: None):
        system = elastic(1e-3)
        solver = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a)
        results = []
        for _ in range(2):
            system.rows.x.fill(0.0)
            results.append(solver.solve(1e-7, callback=callback))
        counts += [each.iterations for each in results]
        assert all(each.converged for each in results)
        assert (results[0].residuals == results[1].residuals).all()
    assert len(set(counts)) == 1
    assert counts[0] > 33


def test_it_stops_at_the_limit():
    for limit in (0, 1, 7, 40):
        system = elastic(1e-4)
        result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a).solve(1e-12, most_iterations=limit)
        assert result.reason is Reason.LIMIT and not result.converged
        assert result.iterations == limit == len(result.residuals) - 1
        last = np.linalg.norm(system.dense @ system.x - system.right)
        assert result.residuals[-1] == pytest.approx(last, rel=1e-9, abs=1e-11)


def test_the_absolute_tolerance():
    system = elastic()
    result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a).solve(0.0, absolute=0.01)
    assert result.converged
    assert result.residuals[-1] <= 0.01 < result.residuals[-2]


def test_a_callback_sees_each_iteration_and_may_stop():
    system, seen = elastic(), []

    def look(count: int, norm: float) -> bool:
        seen.append((count, norm))
        return count == 5

    result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a).solve(1e-9, callback=look)
    assert result.reason is Reason.STOPPED
    assert [count for count, _ in seen] == [1, 2, 3, 4, 5]
    assert [norm for _, norm in seen] == result.residuals[1:].tolist()


def test_it_starts_from_what_x_holds():
    system = elastic()
    solver = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a)
    system.rows.x.load(np.linalg.solve(system.dense, system.right).reshape(-1, 3))
    assert solver.solve().iterations == 0
    system.rows.b.fill(0.0)
    assert solver.solve().converged
    assert (system.x == 0).all()


def test_an_indefinite_matrix_is_reported_and_x_stays_finite():
    system = elastic(-2.0)
    result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a).solve(1e-12)
    assert result.reason is Reason.CURVATURE
    assert np.isfinite(system.x).all()
    last = np.linalg.norm(system.dense @ system.x - system.right)
    assert result.residuals[-1] == pytest.approx(last)


@pytest.mark.parametrize("preconditioner", ["jacobi", "block-jacobi"])
def test_a_preconditioner_that_is_not_positive_definite_is_reported(preconditioner):
    system = elastic(-20.0)
    result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a, preconditioner=preconditioner).solve()
    assert result.reason is Reason.PRECONDITIONER
    assert (system.x == 0).all()


def test_blocks_of_much_stiffer_directions_stay_positive_definite():
    """As contact by penalties makes them: an inverse rounded to float32 would not be positive definite."""
    blocks = symmetric(20, 3, 0.5)
    normals = np.random.default_rng(3).normal(size=(20, 3))
    for i, normal in enumerate(normals / np.linalg.norm(normals, axis=1)[:, None]):
        blocks[i, i] += 1e9 * np.outer(normal, normal)
    system = System(blocks, np.random.default_rng(4).normal(size=(20, 3)))
    rows = system.rows
    result = ConjugateGradients(rows.x, rows.b, system.entries.a, preconditioner="block-jacobi").solve(1e-9)
    assert result.converged
    assert result.iterations <= 70
    np.testing.assert_allclose(system.x, np.linalg.solve(system.dense, system.right), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("scalar", [ebb.float32, ebb.float64])
@pytest.mark.parametrize("preconditioner", [None, "jacobi"])
def test_a_singular_system_converges_if_and_only_if_it_has_a_solution(preconditioner, scalar):
    random, found = np.random.default_rng(0), []
    half = random.normal(size=(10, 5))
    for matrix in (2 * np.eye(10) - np.roll(np.eye(10), 1, axis=0) - np.roll(np.eye(10), -1, axis=0), half @ half.T):
        system = System(matrix, np.zeros(10), scalar)
        solver = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a, preconditioner=preconditioner)
        for right in random.normal(size=(8, 10)):
            for solvable in (False, True):
                system.right = matrix @ right if solvable else right
                system.rows.b.load(system.right)
                system.rows.x.fill(0.0)
                result = solver.solve(1e-5, most_iterations=30)
                found.append(result.reason)
                assert result.converged == solvable, result
                assert not solvable or system.residual() < 1e-3
                # It is itself a matter of rounding, where x is as large as 1e16.
                assert result.reason is not Reason.ROUNDING or result.residuals[-1] > 1e-4 * np.linalg.norm(right)
    assert Reason.ROUNDING in found


@pytest.mark.parametrize("where", ["b", "matrix", "overflow"])
def test_numbers_that_are_not_finite_leave_x_as_it_was(where):
    system = elastic()
    system.rows.x.fill(0.25)
    if where == "b":
        system.rows.b.load(np.where(np.arange(20)[:, None] == 3, np.nan, np.ones((20, 3))))
    else:
        a = system.entries.a.to_numpy()
        a[7] = np.nan if where == "matrix" else 1e200
        system.entries.a.load(a)
    result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a).solve()
    assert not result.converged
    assert result.reason in (Reason.NOT_FINITE, Reason.CURVATURE)
    assert np.isfinite(system.x).all()
    if result.reason is Reason.NOT_FINITE:
        assert (system.x == 0.25).all()


def test_the_same_bits_for_any_number_of_threads():
    found = []
    for threads in (1, 2, 3):
        with ebb.backend("cpu", threads=threads):
            laplacian = 2.001 * np.eye(300) - np.eye(300, k=1) - np.eye(300, k=-1)
            system = System(laplacian, np.cos(np.arange(300.0)))
            result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a).solve(1e-8)
            found.append((system.x.tobytes(), result.residuals.tobytes()))
    assert found[0] == found[1] == found[2]


def test_two_solvers_of_one_relation():
    """They share their fields of work, of which each solve begins anew; backends may change in between."""
    system = elastic()
    one = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a)
    other = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a, preconditioner="jacobi")
    for backend in ("cpu", "reference", "cpu"):
        for solver in (one, other):
            with ebb.backend(backend):
                system.rows.x.fill(0.0)
                assert solver.solve(1e-4).converged
                assert system.residual() < 1.001e-4
    assert sorted(name for name in system.rows.fields if name.startswith("cg_")) == [
        "cg_inverse", "cg_p", "cg_q", "cg_r", "cg_start",
    ]  # fmt: skip


def test_no_rows_at_all():
    rows = ebb.Relation("rows", size=0)
    entries = ebb.Relation("entries", size=0)
    for key in ("tail", "head"):
        entries.new_field(key, rows)
    entries.new_field("a", ebb.float64)
    for name in ("x", "b"):
        rows.new_field(name, ebb.float64)
    assert ConjugateGradients(rows.x, rows.b, entries.a).solve().converged


def test_without_a_tolerance_it_goes_as_far_as_numbers_do():
    system = System(symmetric(8, 3, 1.0), np.random.default_rng(2).normal(size=(8, 3)))
    result = ConjugateGradients(system.rows.x, system.rows.b, system.entries.a).solve(0.0, most_iterations=1000)
    assert result.converged and 0 < result.residuals[-1] <= 1e-30 * np.linalg.norm(system.right)
    assert system.residual() < 1e-13
