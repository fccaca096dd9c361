"""What a solve is asked for: how small a residual, in how many iterations, and by which preconditioner."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from numbers import Integral, Real
from typing import Any, Literal, TypeAlias

from ebb.errors import RelationError
from ebb.records import record
from ebb.solvers.errors import BadOption, UnfitSystem
from ebb.solvers.system import LinearSystem

Preconditioner: TypeAlias = Literal["jacobi", "block-jacobi"] | Callable[[str, str], object]
"""The inverse of the diagonal of a stored matrix, or of its blocks; or ``f(source, target)``, which launches kernels
that compute the field ``target`` as an approximate inverse of the matrix times the field ``source``."""

STORED = ("jacobi", "block-jacobi")


@record
class Options:
    """When to stop."""

    tolerance: float
    absolute: float
    most_iterations: int


def checked_options(system: LinearSystem, tolerance: Any, absolute: Any, most_iterations: Any) -> Options:
    """What is asked for; by default ten times as many iterations as there are unknowns.

    Raises:
        RelationError: a tolerance is negative or no number, or the limit no count (E551).
    """
    for name, value in (("tolerance", tolerance), ("absolute", absolute)):
        if not isinstance(value, Real) or not isfinite(value) or value < 0:
            raise RelationError(BadOption(name, "a number from 0 on", repr(value)))
    if most_iterations is None:
        most_iterations = min(10 * system.unknowns, 2**31 - 1)
    if not isinstance(most_iterations, Integral) or most_iterations is True or most_iterations < 0:
        raise RelationError(BadOption("most_iterations", "a count of iterations", repr(most_iterations)))
    return Options(float(tolerance), float(absolute), min(int(most_iterations), 2**31 - 1))


def check_preconditioner(system: LinearSystem, given: Any) -> None:
    """Check that a preconditioner can be made.

    Raises:
        RelationError: there is none of that name (E551), or it is made of a matrix that is not stored (E550).
    """
    if given is None or callable(given):
        return
    if not isinstance(given, str) or given not in STORED:
        expected = " or ".join(map(repr, STORED)) + ", a function, or None"
        raise RelationError(BadOption("preconditioner", expected, repr(given)))
    if system.blocks is None:
        raise RelationError(
            UnfitSystem(f"the preconditioner {given!r} is made of a matrix, and only its product is known")
        )
