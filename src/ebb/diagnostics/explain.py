"""The pages of the error codes: what the error means, a wrong program and the right one. For ``ebb explain``."""

from __future__ import annotations

import difflib
from importlib.resources import files

PAGES = files("ebb.diagnostics") / "pages"


def known_codes() -> tuple[str, ...]:
    """The codes that have a page, in order."""
    names = (entry.name for entry in PAGES.iterdir())
    return tuple(sorted(name.removesuffix(".md") for name in names if name.endswith(".md")))


def normalised(code: str) -> str:
    """``code`` as the pages are named: ``301``, ``e301`` and ``error[E301]`` are all ``E301``."""
    bare = code.strip().lower().removeprefix("error").strip("[]:() ").upper()
    return bare if bare.startswith("E") else f"E{bare}"


def find_page(code: str) -> str | None:
    """The page of ``code`` as Markdown, or None where no such code is known."""
    code = normalised(code)
    return (PAGES / f"{code}.md").read_text(encoding="utf-8") if code in known_codes() else None


def page_title(code: str) -> str:
    """The first line of the page of the known ``code``, without the mark of a heading."""
    return (find_page(code) or code).partition("\n")[0].lstrip("# ")


def nearest_codes(code: str) -> tuple[str, ...]:
    """The known codes most like ``code``, the nearest first."""
    return tuple(difflib.get_close_matches(normalised(code), known_codes(), n=3, cutoff=0.5))
