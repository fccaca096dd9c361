"""What Krylov methods have in common: the residual at the start, the course of a solve, and how it ends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from math import isfinite, sqrt
from typing import Any, ClassVar

import numpy as np

import ebb
from ebb.solvers.iteration import Callback, Progress, Reason, Result
from ebb.solvers.kernels import dot_of, freedom_of, preconditioning, product_of
from ebb.solvers.options import Options, Preconditioner, check_preconditioner, checked_options
from ebb.solvers.system import LinearSystem, Product


class KrylovSolver(ABC):
    """The base of the iterative solvers; what is particular to a method are the kernels of its step.

    In kernels ``self._go`` is 1 while the solve goes on. Sums over rows are globals: ``self._product`` of the vector
    that has been multiplied and its product, ``self._inner`` of the vector that has been preconditioned and what came
    of it, ``self._square`` of the residual with itself.
    """

    prefix: ClassVar[str]
    """With which the names of work fields begin."""

    conditioned: ClassVar[str] = "z"
    """The work field that takes what the blocks of a preconditioner make of a residual."""

    doubted: ClassVar[frozenset[Reason]] = frozenset({Reason.ROUNDING})
    """The ends of a solve after which the residual is computed anew: its recurrence may be far from the truth there."""

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
        self._progress = Progress(self.prefix)
        self._rounding = float(np.finfo(system.scalar.dtype).eps)
        self._go, self._faults = ebb.Global(ebb.int32, 1), ebb.Global(ebb.int32, 0)
        self._product, self._inner, self._square, self._norm = (ebb.Global(ebb.float64, 0.0) for _ in range(4))
        # The vector that is preconditioned, at first the residual; that which is multiplied, and the product.
        self._r, self._p, self._q, self._saved = (self._work(name) for name in ("r", "p", "q", "start"))
        self._preconditioning = preconditioning(
            system, preconditioner, self.prefix, self._r, self.conditioned, self._faults
        )
        self._multiply = product_of(system, self._p, self._q, self._go, self._product)
        self._begin, self._find_residual, self._clear = self._kernels_of_start()
        self._measure = self._measuring_kernel()
        self._make_kernels()
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
        for another reason, ``x`` is what has been found so far; where numbers were not finite, it is what it was.

        Args:
            tolerance: relative to the norm of b; what is below 1e-30, such as 0, counts as that.
            absolute: in the unit of b.
            most_iterations: by default ten times the number of unknowns.
            callback: called after each iteration with their number and the norm of the residual; if it returns True,
                the solve ends. With it there is Python between iterations.

        Raises:
            RelationError: a tolerance or the limit is none (E551).
        """
        options = checked_options(self._system, tolerance, absolute, most_iterations)
        if self._captured is None or self._system.product is not None or self._preconditioning.compute is not None:
            self._captured = self._capture()
        start, step = self._captured
        self._progress.ask(options)
        start.run()
        early, square = self._over_at_start(options), self._square.value
        if self._norm.value == 0 and early is not Reason.CONVERGED:
            self._clear(self._system.rows)
            early, square = Reason.CONVERGED, 0.0
        if early is not None:
            return Result(0, np.sqrt(np.array([square])), early)
        result = self._progress.run(step, square, callback)
        if result.reason is Reason.NOT_FINITE:
            self._system.rows.copy(self._saved, self._system.x)
        return self._checked(result) if result.reason in self.doubted else result

    def _checked(self, result: Result) -> Result:
        """The result by the residual that ``x`` has in truth, not by that which the iteration takes it to have."""
        _clear(self._product, self._square, self._norm, self._inner)
        self._go.value = 1
        self._begin(self._system.rows)
        self._multiply()
        self._find_residual(self._system.rows)
        square, target = self._square.value, self._progress.target.value
        reason = result.reason
        if reason in (Reason.CONVERGED, Reason.ROUNDING):
            if square <= max(100 * target, self._rounding * self._norm.value):
                return Result(result.iterations, result.residuals, Reason.CONVERGED)
            reason = Reason.ROUNDING
        return Result(result.iterations, np.append(result.residuals[:-1], sqrt(square)), reason)

    def _over_at_start(self, options: Options) -> Reason | None:
        if not isfinite(self._square.value):
            return Reason.NOT_FINITE
        if self._square.value <= self._progress.target.value:
            return Reason.CONVERGED
        if self._faults.value or not self._inner.value > 0:
            return Reason.PRECONDITIONER
        return None if options.most_iterations else Reason.LIMIT

    def _work(self, name: str) -> str:
        return self._system.work(f"{self.prefix}_{name}")

    # ---- What a method adds ----

    @abstractmethod
    def _make_kernels(self) -> None:
        """Makes the kernels of the method, and its own globals and fields."""

    @abstractmethod
    def _first_vectors(self) -> None:
        """Launches what makes the vectors of the first step of the residual and what the preconditioner makes of it."""

    @abstractmethod
    def _set_out(self) -> None:
        """Launches a kernel on ``steps`` that calls its ``begin``, and sets the scalars of the first iteration."""

    @abstractmethod
    def _step(self) -> None:
        """Launches a step, which ends with a kernel that judges it."""

    # ---- What they share ----

    def _capture(self) -> tuple[Any, Any]:
        system, conditioning = self._system, self._preconditioning
        with ebb.capture() as start:
            _clear(self._product, self._square, self._norm, self._inner, self._faults)
            self._go.value = 1
            self._begin(system.rows)
            self._multiply()
            if conditioning.prepare is not None:
                conditioning.prepare()
            self._find_residual(system.rows)
            self._precondition()
            self._first_vectors()
            self._progress.target.value = 0
            self._set_out()
        with ebb.capture() as step:
            _clear(self._product, self._square, self._inner)
            self._step()
        return start, step

    def _precondition(self) -> None:
        """Where the preconditioner is launched by itself, it comes after its vector, and before the sum over both."""
        if self._preconditioning.compute is not None:
            self._preconditioning.compute()
            self._inner.value = 0
            self._measure(self._system.rows)

    def _kernels_of_start(self) -> tuple[ebb.Kernel, ebb.Kernel, ebb.Kernel]:
        x, b, r, p, q, saved = self._system.x.name, self._system.b.name, self._r, self._p, self._q, self._saved
        unknown, dot, is_free = self._system.x.type, dot_of(self._system), freedom_of(self._system)
        apply = self._preconditioning.apply
        square, norm, inner = self._square, self._norm, self._inner

        @ebb.kernel
        def begin(v: Any) -> None:
            v[saved] = v[x]
            v[p] = v[x] if is_free(v) else ebb.zeros(unknown)

        @ebb.kernel
        def find_residual(v: Any) -> None:
            free = is_free(v)
            residual = v[b] - v[q] if free else ebb.zeros(unknown)
            v[r] = residual
            square.value += dot(residual, residual)
            inner.value += dot(residual, apply(v, residual))
            if free:
                norm.value += dot(v[b], v[b])

        @ebb.kernel
        def clear(v: Any) -> None:
            if is_free(v):
                v[x] = ebb.zeros(unknown)

        return begin, find_residual, clear

    def _measuring_kernel(self) -> ebb.Kernel:
        r, inner, dot, again = self._r, self._inner, dot_of(self._system), self._preconditioning.again

        @ebb.kernel
        def measure(v: Any) -> None:
            inner.value += dot(v[r], again(v, v[r]))

        return measure


def _clear(*sums: ebb.Global) -> None:
    for each in sums:
        each.value = 0
