"""The name that a user may have meant."""

from __future__ import annotations

from collections.abc import Iterable


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most like ``name``, if any is like it at all."""
    from difflib import get_close_matches  # here: programs without errors do not wait for it

    close = get_close_matches(name, list(known), n=1)
    return close[0] if close else None
