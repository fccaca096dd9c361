"""The method of minimal residuals, for symmetric systems that need not be positive definite."""

from __future__ import annotations

from typing import Any, ClassVar

import ebb
from ebb.solvers.iteration import BREAKDOWN, NOT_FINITE, PRECONDITIONER, RUNNING, Reason, is_finite, judge
from ebb.solvers.kernels import dot_of
from ebb.solvers.krylov import KrylovSolver

# What ``scalars`` holds: the norm of the Lanczos vector, and its share of the one before; the coefficients of the
# directions; the length of the step; how the residual changes.
_GAMMA, _RATIO, _FIRST, _SECOND, _THIRD, _LENGTH, _SHRINK, _TURN = range(8)


class MINRES(KrylovSolver):
    """Solves ``A x = b`` for a symmetric matrix A, indefinite or not, so that each residual is as small as it can be.

    It is made and used as ``ConjugateGradients`` is, and takes the same arguments. A preconditioner must be positive
    definite all the same: for an indefinite matrix it is a function. The names of its fields begin with ``minres_``.

    The iteration is that of Paige and Saunders as in Elman, Silvester and Wathen, "Finite Elements and Fast Iterative
    Solvers", 2nd edition, algorithm 4.1. What is minimal is the norm of the residual by the preconditioner; the solve
    ends by the usual norm, which is found from the residual's own recurrence. Of a singular system that has no solution
    ``x`` may drift where A is zero, which the recurrence does not see: so the residual is computed anew at the end.
    """

    prefix: ClassVar[str] = "minres"
    doubted: ClassVar[frozenset[Reason]] = frozenset(
        {Reason.CONVERGED, Reason.ROUNDING, Reason.LIMIT, Reason.BREAKDOWN}
    )

    def _make_kernels(self) -> None:
        # The vectors of Lanczos: ``_r`` is the newest, ``_p`` what the preconditioner made of it, divided by its norm.
        self._before, self._w, self._w_before, self._residual = (
            self._work(name) for name in ("before", "w", "w_before", "residual")
        )
        self._scalars = ebb.Global(ebb.vector(ebb.float64, 8), 0.0)
        for name in ("gamma", "gamma_before", "c", "c_before", "s", "s_before", "eta"):
            self._progress.steps.new_field(name, ebb.float64)
        self._start, self._lengthen = self._vector_kernels()
        self._move = self._moving_kernel()
        self._rotate, self._judge = self._rotating_kernel(), self._judging_kernel()
        self._begin_steps = self._beginning_kernel()

    def _beginning_kernel(self) -> ebb.Kernel:
        inner, scalars, begin, norm = self._inner, self._scalars, self._progress.begin, self._norm

        @ebb.kernel
        def begin_steps(s: Any) -> None:
            begin(s, norm.value)
            gamma = ebb.sqrt(inner.value)
            s.gamma, s.gamma_before, s.eta = gamma, 1.0, gamma
            s.c, s.c_before, s.s, s.s_before = 1.0, 1.0, 0.0, 0.0
            if ebb.id(s) == 0:
                scalars.value[_GAMMA] += gamma

        return begin_steps

    def _vector_kernels(self) -> tuple[ebb.Kernel, ebb.Kernel]:
        r, p, q, before, w, w_before = self._r, self._p, self._q, self._before, self._w, self._w_before
        residual, unknown, number = self._residual, self._system.x.type, self._system.scalar
        dot, apply, again = dot_of(self._system), self._preconditioning.apply, self._preconditioning.again
        go, delta, inner, scalars = self._go, self._product, self._inner, self._scalars

        @ebb.kernel
        def start(v: Any) -> None:
            v[residual] = v[r]
            v[p] = again(v, v[r]) / number(ebb.sqrt(inner.value))
            v[before] = ebb.zeros(unknown)
            v[w] = ebb.zeros(unknown)
            v[w_before] = ebb.zeros(unknown)

        @ebb.kernel
        def lengthen(v: Any) -> None:
            if go.value > 0:
                gamma, ratio = scalars.value[_GAMMA], scalars.value[_RATIO]
                new = v[q] - number(delta.value / gamma) * v[r] - number(ratio) * v[before]
                v[before] = v[r]
                v[r] = new
                inner.value += dot(new, apply(v, new))

        return start, lengthen

    def _moving_kernel(self) -> ebb.Kernel:
        x, r, p, w, w_before, residual = (
            self._system.x.name, self._r, self._p, self._w, self._w_before, self._residual,
        )  # fmt: skip
        number, dot, again = self._system.scalar, dot_of(self._system), self._preconditioning.again
        go, square, scalars = self._go, self._square, self._scalars

        @ebb.kernel
        def move(v: Any) -> None:
            k = scalars.value
            if go.value > 0 and is_finite(k[_FIRST]):
                new = number(k[_FIRST]) * v[p] + number(k[_SECOND]) * v[w] + number(k[_THIRD]) * v[w_before]
                v[w_before] = v[w]
                v[w] = new
                v[x] += number(k[_LENGTH]) * new
                left = number(k[_SHRINK]) * v[residual] + number(k[_TURN]) * v[r]
                v[residual] = left
                square.value += dot(left, left)
                v[p] = again(v, v[r]) / number(k[_GAMMA])

        return move

    def _rotating_kernel(self) -> ebb.Kernel:
        delta, inner, scalars = self._product, self._inner, self._scalars

        @ebb.kernel
        def rotate(s: Any) -> None:
            gamma = ebb.sqrt(max(inner.value, 0))
            first = s.c * delta.value - s.c_before * s.s * s.gamma
            # 0 where nothing is left to go on with: then there is no step, and the solve ends.
            length = ebb.sqrt(first * first + inner.value) if inner.value >= 0 else 0.0
            second = s.s * delta.value + s.c_before * s.c * s.gamma
            third = s.s_before * s.gamma
            c, sine = first / length, gamma / length
            eta = -sine * s.eta
            if ebb.id(s) == 0:
                turn = eta * c / gamma if gamma > 0 else 0.0
                # Where the vectors end, the solution is found, and the next one, which is 0, is of no account.
                divisor = gamma if gamma > 0 else 1.0
                first, second, third = 1 / length, -second / length, -third / length
                scalars.value += [divisor, gamma / s.gamma, first, second, third, c * s.eta, sine * sine, turn]
            s.gamma_before = s.gamma
            s.gamma = gamma
            s.c_before = s.c
            s.c = c
            s.s_before = s.s
            s.s = sine
            s.eta = eta

        return rotate

    def _judging_kernel(self) -> ebb.Kernel:
        go, inner, square, scalars = self._go, self._inner, self._square, self._scalars
        target, limit = self._progress.target, self._progress.limit

        @ebb.kernel
        def judge_step(s: Any) -> None:
            fault = RUNNING
            if not is_finite(inner.value):
                fault = NOT_FINITE
            elif inner.value < 0:
                fault = PRECONDITIONER
            elif not is_finite(scalars.value[_FIRST]):
                fault = BREAKDOWN
            status = judge(s, square.value, fault, target.value, limit.value)
            if ebb.id(s) == 0 and status == RUNNING:
                go.value += 1

        return judge_step

    def _first_vectors(self) -> None:
        self._start(self._system.rows)

    def _set_out(self) -> None:
        self._scalars.value = 0
        self._begin_steps(self._progress.steps)

    def _step(self) -> None:
        rows, steps = self._system.rows, self._progress.steps
        self._multiply()
        self._lengthen(rows)
        self._precondition()
        self._scalars.value = 0
        self._rotate(steps)
        self._move(rows)
        self._go.value = 0
        self._judge(steps)
