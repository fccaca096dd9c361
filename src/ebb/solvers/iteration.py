"""What iterative solvers have in common: how far one has come, when it stops, and what it returns.

A step of a solver is captured once and run many times with no Python in between. So the decision to stop is taken by a
kernel; once it is taken, the steps that follow do nothing, and the counts of iterations are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum, StrEnum
from math import inf, sqrt
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import ebb
from ebb.records import record
from ebb.solvers.options import Options

Callback: TypeAlias = Callable[[int, float], object]
"""Called after each iteration with the number of iterations so far and the norm of the residual; True stops."""

_SMALLEST = 1e-30
"""The least tolerance: far below what residuals mean in double precision, but their squares are still numbers."""

_MOST_STEPS = 128
"""The iterations of one run of the captured step, each of which has a row for its residual."""

_FIRST_STEPS = 16
"""The iterations of the first run of a solver that has not solved yet."""


class Reason(StrEnum):
    """Why a solve has ended."""

    CONVERGED = "converged"
    LIMIT = "iteration limit"
    CURVATURE = "non-positive curvature"
    BREAKDOWN = "breakdown"
    NOT_FINITE = "not finite"
    PRECONDITIONER = "preconditioner not positive definite"
    ROUNDING = "lost to rounding"
    STOPPED = "stopped by the callback"


class Status(IntEnum):
    """What the kernels know of a solve."""

    RUNNING = 0
    CONVERGED = 1
    LIMIT = 2
    CURVATURE = 3
    BREAKDOWN = 4
    NOT_FINITE = 5
    PRECONDITIONER = 6
    DOUBTFUL = 7


# Plain numbers, for kernels.
RUNNING, CONVERGED, LIMIT, CURVATURE, BREAKDOWN, NOT_FINITE, PRECONDITIONER, DOUBTFUL = (int(each) for each in Status)

_REASONS = {
    Status.CONVERGED: Reason.CONVERGED,
    Status.LIMIT: Reason.LIMIT,
    Status.CURVATURE: Reason.CURVATURE,
    Status.BREAKDOWN: Reason.BREAKDOWN,
    Status.NOT_FINITE: Reason.NOT_FINITE,
    Status.PRECONDITIONER: Reason.PRECONDITIONER,
    Status.DOUBTFUL: Reason.ROUNDING,
}


@record(eq=False)
class Result:
    """What came of a solve.

    Attributes:
        iterations: how many there were.
        residuals: the norms of b - A x, as the iteration knows them: at the start and after each iteration. Where the
            solve is lost to rounding, or MINRES has not converged, the last is what the norm is in truth.
        converged: whether the last of them is small enough.
        reason: why the solve ended: a ``Reason``, which is a string.
    """

    iterations: int
    residuals: npt.NDArray[np.float64]
    reason: Reason

    @property
    def converged(self) -> bool:
        """Whether the last residual is small enough."""
        return self.reason is Reason.CONVERGED

    def __str__(self) -> str:
        first, last = self.residuals[0], self.residuals[-1]
        return f"{self.reason} after {self.iterations} iterations: the residual went from {first:.3g} to {last:.3g}"


@ebb.func
def is_finite(value: Any) -> Any:
    """Whether a number is neither infinite nor NaN."""
    return abs(value) < inf


@ebb.func
def judge(s: Any, square: Any, fault: Any, target: Any, limit: Any) -> Any:
    """The status of a row of ``Progress.steps`` after one more iteration, which it takes down if that counts.

    Args:
        s: the row.
        square: of the norm of the residual now.
        fault: the status that the iteration found, or RUNNING.
        target: the square of the norm at which to stop.
        limit: the most iterations.
    """
    status = s.status
    if status == RUNNING:
        if fault != RUNNING:
            status = fault
        elif not is_finite(square):
            status = NOT_FINITE
        else:
            if s.taken % _MOST_STEPS == ebb.int32(ebb.id(s)):
                s.square = square
            s.taken += 1
            if square <= target:
                status = CONVERGED
            elif s.taken >= limit:
                status = LIMIT
    s.status = status
    return status


class Progress:
    """How far a solver has come.

    Attributes:
        steps: a relation with a row for each iteration of a run: each has the ``status`` of the solve and the count of
            iterations ``taken``, alike in all but that row 0 alone may be ``DOUBTFUL`` instead of ``CONVERGED``, and
            the ``square`` of the residual of its own iteration.
        relative: the square of the tolerance relative to the right-hand side.
        absolute: the square of the absolute tolerance.
        target: the square of the norm of the residual at which to stop.
        limit: the most iterations.
        begin: ``f(s, norm)`` of kernels sets a row of ``steps`` as it is before the first iteration, and adds to
            ``target``, by the square of the norm of the right-hand side.
    """

    def __init__(self, name: str) -> None:
        self.steps = ebb.Relation(f"{name}_steps", size=_MOST_STEPS)
        self.steps.new_field("status", ebb.int32)
        self.steps.new_field("taken", ebb.int32)
        self.steps.new_field("square", ebb.float64)
        self.relative, self.absolute, self.target = (ebb.Global(ebb.float64, 0.0) for _ in range(3))
        self.limit = ebb.Global(ebb.int32, 0)
        self.begin = _beginning(self)
        self._asked: Options | None = None
        self._expected = _FIRST_STEPS

    def ask(self, options: Options) -> None:
        """Says when the next solve is to stop."""
        if options != self._asked:
            self.relative.value = max(options.tolerance, _SMALLEST) ** 2
            self.absolute.value = options.absolute**2
            self.limit.value = options.most_iterations
            self._asked = options

    def run(self, step: Any, square: float, callback: Callback | None) -> Result:
        """Runs the captured ``step`` until the solve ends.

        Args:
            step: which ends with a kernel on ``steps`` that calls ``judge``.
            square: of the norm of the residual at the start.
            callback: called after each iteration.
        """
        squares: list[float] = [square]
        count = self._expected if callback is None else 1
        reason = None
        while reason is None:
            step.run(min(count, _MOST_STEPS))
            status, taken = Status(int(self.steps.status.view()[0])), int(self.steps.taken.view()[0])
            ring: list[float] = self.steps.square.view().tolist()
            before = len(squares) - 1
            squares += [ring[each % _MOST_STEPS] for each in range(before, taken)]
            reason = _REASONS.get(status)
            if callback is not None and taken > before and callback(taken, sqrt(squares[-1])) is True:
                reason = reason or Reason.STOPPED
            if callback is None:
                count = max(_FIRST_STEPS, taken // 8)
        self._expected = max(_FIRST_STEPS, len(squares) - 1)
        return Result(len(squares) - 1, np.sqrt(squares), reason)


def _beginning(progress: Progress) -> Any:
    relative, absolute, target = progress.relative, progress.absolute, progress.target

    @ebb.func
    def begin(s: Any, norm: Any) -> None:
        s.status = RUNNING
        s.taken = 0
        if ebb.id(s) == 0:
            target.value += max(relative.value * norm, absolute.value)

    return begin
