"""Ebb: a language and runtime for physical simulation on relations."""
