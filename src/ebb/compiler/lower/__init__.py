"""KIR to LIR: addresses, loops, strategies."""

from __future__ import annotations

from ebb.compiler.lower.context import Launched
from ebb.compiler.lower.facts import facts_of, sources_of
from ebb.compiler.lower.kernel import lower, most_variable_bytes, variable_bytes
from ebb.compiler.lower.sites import error_at

__all__ = ["Launched", "error_at", "facts_of", "lower", "most_variable_bytes", "sources_of", "variable_bytes"]
