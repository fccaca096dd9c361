"""The reference backend: kernels run in plain Python, row by row. It is the definition of the language."""

from __future__ import annotations

from ebb.backends.reference.backend import reference_backend
from ebb.backends.reference.interpreter import run

__all__ = ["reference_backend", "run"]
