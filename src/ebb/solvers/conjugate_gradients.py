"""The method of conjugate gradients, preconditioned, for symmetric positive definite systems."""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import Any

import numpy as np

import ebb
from ebb.solvers.iteration import (
    CURVATURE,
    NOT_FINITE,
    PRECONDITIONER,
    RUNNING,
    Callback,
    Progress,
    Reason,
    Result,
    is_finite,
    judge,
)
from ebb.solvers.kernels import dot_of, freedom_of, preconditioning, product_of
from ebb.solvers.options import Options, Preconditioner, check_preconditioner, checked_options
from ebb.solvers.system import LinearSystem, Product


class ConjugateGradients:
    """Solves ``A x = b`` for a symmetric positive definite matrix A.

    It is made once for its fields, and solves as often as they have changed. A is stored in the rows of a relation,
    each with the row and the column where its entry (or square block) stands; or it is known by a function that
    multiplies by it. The solver keeps fields of its own in the relation of ``x``; their names begin with ``cg_``.

    The iteration is the usual one (Saad, "Iterative Methods for Sparse Linear Systems", algorithm 9.1). It runs with no
    Python between iterations, and sums have the same bits for any number of threads.
    """

    def __init__(
        self,
        x: ebb.Field,
        b: ebb.Field,
        matrix: ebb.Field | None = None,
        *,
        product: Product | None = None,
        row: str = "tail",
        column: str = "head",
        preconditioner: Preconditioner | None = None,
        rows: ebb.Subset | None = None,
    ) -> None:
        """A solver of ``matrix @ x = b``, or of ``product(x) = b``.

        Args:
            x: the unknowns: numbers or vectors of floats. What it holds is where the iteration starts.
            b: the right-hand side, a field of the same relation and type.
            matrix: the entries of the matrix, or its blocks; what stands at one place is added up. Or
            product: ``product(source, target)`` launches kernels that compute the field ``target`` (a name) as the
                matrix times the field ``source``. They are recorded at each ``solve``, and replayed.
            row: the key field of the matrix's relation that says in which row an entry stands. It is grouped by it.
            column: the key field that says in which column.
            preconditioner: ``"jacobi"`` (the inverse of the diagonal), ``"block-jacobi"`` (that of its blocks), or a
                function as ``product``, which applies a symmetric positive definite approximation of the inverse.
            rows: the rows to solve for, by default all. The others keep their ``x``, which counts as 0: their rows and
                columns are removed from the system.

        Raises:
            RelationError: the fields make no linear system (E550), or there is no such preconditioner (E551).
        """
        self._system = system = LinearSystem(x, b, matrix, product, row, column, rows)
        check_preconditioner(system, preconditioner)
        self._progress = Progress("cg")
        self._go, self._faults = ebb.Global(ebb.int32, 1), ebb.Global(ebb.int32, 0)
        # p.Ap; r.z of the iteration before and of this; r.r; b.b.
        self._curvature, self._before, self._after = (ebb.Global(ebb.float64, 0.0) for _ in range(3))
        self._square, self._norm = ebb.Global(ebb.float64, 0.0), ebb.Global(ebb.float64, 0.0)
        r, p, q, start = (system.work(f"cg_{name}") for name in ("r", "p", "q", "start"))
        self._saved = start
        self._names = (x.name, b.name, r, p, q, start)
        self._preconditioning = preconditioning(system, preconditioner, "cg", r, self._faults)
        self._multiply = product_of(system, p, q, self._go, self._curvature)
        self._make_start()
        self._make_step()
        self._make_judge()
        self._captured: tuple[Any, Any] | None = None

    def solve(
        self,
        tolerance: float = 1e-6,
        absolute: float = 0.0,
        most_iterations: int | None = None,
        callback: Callback | None = None,
    ) -> Result:
        """Solves the system as it is now; the solution is in ``x``.

        It ends when the norm of b - A x is at most ``tolerance`` times that of b, or at most ``absolute``. If it ends
        for another reason, ``x`` is the best that has been found; where numbers were not finite, what it was.

        Args:
            tolerance: relative to the norm of b.
            absolute: in the unit of b.
            most_iterations: by default ten times the number of unknowns.
            callback: called after each iteration with their number and the norm of the residual; if it returns True,
                the solve ends. With it there is Python between iterations.

        Raises:
            RelationError: a tolerance or the limit is none (E551).
        """
        options = checked_options(self._system, tolerance, absolute, most_iterations)
        rows = self._system.rows
        if self._captured is None or self._system.product is not None or self._preconditioning.compute is not None:
            self._captured = self._capture()
        start, step = self._captured
        start.run()
        square, norm, after = self._square.value, sqrt(self._norm.value), self._after.value
        target = options.target(norm) if isfinite(norm) else 0.0
        early = self._over_at_start(square, target, after, options)
        if norm == 0 and early is not Reason.CONVERGED:
            self._clear(rows)
            square, early = 0.0, Reason.CONVERGED
        if early is not None:
            return Result(0, np.sqrt(np.array([square])), early)
        self._before.value = after
        self._go.value = 1
        result = self._progress.run(step, square, target, options.most_iterations, callback)
        if result.reason is Reason.NOT_FINITE:
            rows.copy(self._saved, self._system.x)
        return result

    def _over_at_start(self, square: float, target: float, after: float, options: Options) -> Reason | None:
        if not isfinite(square):
            return Reason.NOT_FINITE
        if square <= target:
            return Reason.CONVERGED
        if self._faults.value or not after > 0:
            return Reason.PRECONDITIONER
        return None if options.most_iterations else Reason.LIMIT

    def _capture(self) -> tuple[Any, Any]:
        system, conditioning = self._system, self._preconditioning
        with ebb.capture() as start:
            for zero in (self._curvature, self._square, self._norm, self._after, self._faults):
                zero.value = 0
            self._before.value = inf  # so that the first direction is the residual's
            self._go.value = 1
            self._begin(system.rows)
            self._multiply()
            if conditioning.prepare is not None:
                conditioning.prepare()
            self._find_residual(system.rows)
            self._finish_residual()
            self._turn(system.rows)
        with ebb.capture() as step:
            for zero in (self._curvature, self._square, self._after):
                zero.value = 0
            self._multiply()
            self._update(system.rows)
            self._finish_residual()
            self._turn(system.rows)
            self._before.value = 0
            self._go.value = 0
            self._judge(self._progress.steps)
        return start, step

    def _finish_residual(self) -> None:
        """Where the preconditioner is launched by itself, it comes after the residual, and before the sum over both."""
        if self._preconditioning.compute is not None:
            self._preconditioning.compute()
            self._after.value = 0
            self._measure(self._system.rows)

    def _make_start(self) -> None:
        x, b, r, p, q, start = self._names
        unknown, dot, is_free = self._system.x.type, dot_of(self._system), freedom_of(self._system)
        apply = self._preconditioning.apply
        square, norm, after = self._square, self._norm, self._after

        @ebb.kernel
        def begin(v: Any) -> None:
            v[start] = v[x]
            v[p] = v[x] if is_free(v) else ebb.zeros(unknown)

        @ebb.kernel
        def find_residual(v: Any) -> None:
            free = is_free(v)
            residual = v[b] - v[q] if free else ebb.zeros(unknown)
            v[r] = residual
            square.value += dot(residual, residual)
            after.value += dot(residual, apply(v, residual))
            if free:
                norm.value += dot(v[b], v[b])

        @ebb.kernel
        def clear(v: Any) -> None:
            if is_free(v):
                v[x] = ebb.zeros(unknown)

        self._begin, self._find_residual, self._clear = begin, find_residual, clear

    def _make_step(self) -> None:
        x, _, r, p, q, _ = self._names
        dot, apply, number = dot_of(self._system), self._preconditioning.apply, self._system.scalar
        go, curvature, before, after, square = self._go, self._curvature, self._before, self._after, self._square

        @ebb.kernel
        def update(v: Any) -> None:
            if go.value > 0:
                alpha = number(before.value / curvature.value) if curvature.value > 0 else number(0)
                v[x] += alpha * v[p]
                residual = v[r] - alpha * v[q]
                v[r] = residual
                square.value += dot(residual, residual)
                after.value += dot(residual, apply(v, residual))

        @ebb.kernel
        def measure(v: Any) -> None:
            after.value += dot(v[r], apply(v, v[r]))

        @ebb.kernel
        def turn(v: Any) -> None:
            if go.value > 0:
                v[p] = apply(v, v[r]) + number(after.value / before.value) * v[p]

        self._update, self._measure, self._turn = update, measure, turn

    def _make_judge(self) -> None:
        go, curvature, before, after, square = self._go, self._curvature, self._before, self._after, self._square
        target, limit = self._progress.target, self._progress.limit

        @ebb.kernel
        def judge_step(s: Any) -> None:
            fault = RUNNING
            if not (is_finite(curvature.value) and is_finite(after.value)):
                fault = NOT_FINITE
            elif curvature.value <= 0:
                fault = CURVATURE
            elif after.value <= 0 and square.value > target.value:
                fault = PRECONDITIONER
            status = judge(s, square.value, fault, target.value, limit.value)
            if ebb.id(s) == 0:
                before.value += after.value
                if status == RUNNING:
                    go.value += 1

        self._judge = judge_step
