"""Every code has one kind of error, a page and a golden case."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

import ebb
from ebb.diagnostics.diagnostic import Diagnostic
from ebb.diagnostics.explain import find_page, known_codes

GOLDEN = "\n".join(path.read_text(encoding="utf-8") for path in (Path(__file__).parent / "cases").glob("*/*.err"))
# What a machine lacks cannot be taken away from it in a case.
OF_THE_MACHINE = frozenset({"E604"})


def kinds(base: type[Diagnostic] = Diagnostic) -> Iterator[type[Diagnostic]]:
    for kind in base.__subclasses__():
        yield kind
        yield from kinds(kind)


def defined() -> dict[str, set[str]]:
    """The names of the kinds of error that the package defines, by code."""
    for module in pkgutil.walk_packages(ebb.__path__, "ebb."):
        with suppress(ModuleNotFoundError):  # a package of an extra; what uses it defines no errors
            importlib.import_module(module.name)
    found: dict[str, set[str]] = {}
    for kind in kinds():
        if kind.__module__.startswith("ebb.") and "code" in vars(kind):
            found.setdefault(kind.code, set()).add(f"{kind.__module__}.{kind.__name__}")
    return found


DEFINED = defined()


def test_a_code_has_one_kind() -> None:
    assert {code: names for code, names in DEFINED.items() if len(names) > 1} == {}


def test_pages_and_codes_are_the_same() -> None:
    assert set(known_codes()) == set(DEFINED)


@pytest.mark.parametrize("code", known_codes())
def test_page_says_what_it_means_and_shows_both_programs(code: str) -> None:
    page = find_page(code) or ""
    assert re.match(rf"# {code}: [^\n]*[^.\n]\n\n\S", page)
    assert page.count("```") >= 4, "a wrong program and the right one"
    assert 8 <= page.count("\n") <= 50


@pytest.mark.parametrize("code", sorted(set(DEFINED) - OF_THE_MACHINE))
def test_code_has_a_golden_case(code: str) -> None:
    assert f"error[{code}]" in GOLDEN
