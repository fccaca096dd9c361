"""The method of conjugate gradients, for symmetric positive definite systems."""

from __future__ import annotations

from math import inf
from typing import Any, ClassVar

import ebb
from ebb.solvers.iteration import (
    CONVERGED,
    CURVATURE,
    DOUBTFUL,
    NOT_FINITE,
    PRECONDITIONER,
    RUNNING,
    is_finite,
    judge,
)
from ebb.solvers.kernels import dot_of
from ebb.solvers.krylov import KrylovSolver


class ConjugateGradients(KrylovSolver):
    """Solves ``A x = b`` for a symmetric positive definite matrix A.

    It is made once for its fields, and solves as often as they have changed. A is stored in the rows of a relation,
    each with the row and the column where its entry (or square block) stands; or it is known by a function that
    multiplies by it. The solver keeps fields of its own in the relation of ``x``; their names begin with ``cg_``.

    The iteration is the usual one (Saad, "Iterative Methods for Sparse Linear Systems", algorithm 9.1). It runs with no
    Python between iterations, and sums have the same bits for any number of threads.
    """

    prefix: ClassVar[str] = "cg"
    conditioned: ClassVar[str] = "q"  # it has been read for the last time, and is at hand

    def _make_kernels(self) -> None:
        x, r, p, q = self._system.x.name, self._r, self._p, self._q
        dot, number = dot_of(self._system), self._system.scalar
        apply, again = self._preconditioning.apply, self._preconditioning.again
        go, curvature, after, square = self._go, self._product, self._inner, self._square
        begin, norm = self._progress.begin, self._norm
        self._before = before = ebb.Global(ebb.float64, 0.0)  # r.z of the iteration before

        @ebb.func
        def length() -> Any:
            return number(before.value / curvature.value) if curvature.value > 0 else number(0)

        # The solution waits for the second kernel, which reads p anyway.
        @ebb.kernel
        def update(v: Any) -> None:
            if go.value > 0:
                residual = v[r] - length() * v[q]
                v[r] = residual
                square.value += dot(residual, residual)
                after.value += dot(residual, apply(v, residual))

        @ebb.kernel
        def turn(v: Any) -> None:
            if go.value > 0:
                direction = v[p]
                v[x] += length() * direction
                v[p] = again(v, v[r]) + number(after.value / before.value) * direction

        # Of row 0: r.z, the lengths of steps, and the square of the largest residual.
        for name in ("inner", "shortest", "longest", "largest"):
            self._progress.steps.new_field(name, ebb.float64)

        @ebb.kernel
        def begin_steps(s: Any) -> None:
            begin(s, norm.value)
            if ebb.id(s) == 0:
                before.value += after.value
                s.inner, s.shortest, s.longest, s.largest = after.value, inf, 0.0, square.value

        self._update, self._turn, self._begin_steps = update, turn, begin_steps
        self._judge = self._judging_kernel(before)

    def _judging_kernel(self, before: ebb.Global) -> ebb.Kernel:
        go, curvature, after, square = self._go, self._product, self._inner, self._square
        target, limit, norm = self._progress.target, self._progress.limit, self._norm
        rounding = self._rounding

        @ebb.func
        def is_doubtful(s: Any) -> Any:
            """Whether rounding may have parted the residual that the iteration knows from that of the solution.

            How far it can depends on how large the solution has been, so on the residuals, and on the matrix
            (Greenbaum, "Estimating the attainable accuracy of recursively computed residual methods", 1997): the
            lengths of steps lie between the inverses of its least and its largest eigenvalue. It does where the matrix
            is singular, and the right-hand side no product of it.
            """
            parted = (rounding * s.longest / s.shortest) ** 2 * s.largest
            return parted > 1e-8 * max(100 * target.value, rounding * norm.value)

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
                if curvature.value > 0:
                    length = s.inner / curvature.value
                    s.inner, s.shortest, s.longest = after.value, min(s.shortest, length), max(s.longest, length)
                    s.largest = max(s.largest, square.value)
                    if status == CONVERGED and is_doubtful(s):
                        s.status = DOUBTFUL
                if status == RUNNING:
                    go.value += 1

        return judge_step

    def _first_vectors(self) -> None:
        self._before.value, self._product.value = inf, 0  # so that the first direction is the residual's, and x stays
        self._turn(self._system.rows)

    def _set_out(self) -> None:
        self._before.value = 0
        self._begin_steps(self._progress.steps)

    def _step(self) -> None:
        rows = self._system.rows
        self._multiply()
        self._update(rows)
        self._precondition()
        self._turn(rows)
        self._before.value = 0
        self._go.value = 0
        self._judge(self._progress.steps)
