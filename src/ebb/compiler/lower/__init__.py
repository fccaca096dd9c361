"""KIR to LIR: addresses, loops, strategies."""

from __future__ import annotations

from ebb.compiler.lower.context import Launched
from ebb.compiler.lower.facts import facts_of, sources_of
from ebb.compiler.lower.kernel import lower, variable_bytes
from ebb.compiler.lower.sites import error_at

__all__ = ["Launched", "error_at", "facts_of", "lower", "sources_of", "variable_bytes"]
