"""Solvers of linear systems on relations, written with the public API alone, as users can too."""

from __future__ import annotations

from ebb.solvers.conjugate_gradients import ConjugateGradients
from ebb.solvers.iteration import Reason, Result

__all__ = ["ConjugateGradients", "Reason", "Result"]
