"""Solvers of linear systems on relations, written with the public API alone, as users can too."""

from __future__ import annotations

from ebb.solvers.conjugate_gradients import ConjugateGradients
from ebb.solvers.direct import direct
from ebb.solvers.iteration import Reason, Result
from ebb.solvers.minres import MINRES

__all__ = ["MINRES", "ConjugateGradients", "Reason", "Result", "direct"]
