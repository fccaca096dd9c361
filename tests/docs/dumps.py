"""The extracts of ``kernel.inspect`` in pages, which are what the compiler makes now.

A comment before a block says what it shows: ``dump KERNEL STAGE``, then a line for each stretch of lines, by what its
first line and its last line have in them, ``FIRST ... LAST``; a stretch of one line has no dots. The first stretch
begins at the first such line of the text, each of the others behind the one before it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from textwrap import dedent
from typing import Any

_DUMP = re.compile(
    r"^<!-- dump (?P<kernel>\w+) (?P<stage>\w+)\n(?P<stretches>.*?)\n-->\n```(?P<language>\w+)\n(?P<text>.*?)^```$",
    re.M | re.S,
)
_MAKER = re.compile(r"llvmlite (\d[\w.]*)")
_OURS = ("kir", "lir")
"""The stages in which LLVM has had no part."""

WIDTH = 150
"""Longer lines are cut."""


def refreshed(page: str, namespace: Mapping[str, Any], *, update: bool) -> str:
    """The page with the extracts as they are now; of another LLVM, what LLVM makes stays, unless ``update`` is set."""
    made = _MAKER.search(page)
    if made is None:
        return page
    here = version("llvmlite")
    if update:
        page = page.replace(made[0], f"llvmlite {here}")

    def extract(found: re.Match[str]) -> str:
        if found["stage"] not in _OURS and made[1] != here and not update:
            return found[0]
        text = namespace[found["kernel"]].inspect(_relation(namespace, found["kernel"]), found["stage"])
        before, _, _ = found[0].rpartition(f"{found['text']}```")
        return f"{before}{_extract(text, found['stretches'].splitlines())}```"

    return _DUMP.sub(extract, page)


def _relation(namespace: Mapping[str, Any], kernel: str) -> Any:
    """The relation that the kernel's row is annotated with."""
    text = next(iter(namespace[kernel].__wrapped__.__annotations__.values()))
    return namespace[text] if isinstance(text, str) else text


def _extract(text: str, stretches: Sequence[str]) -> str:
    lines = [line.rstrip().expandtabs(4) for line in text.splitlines()]
    chosen, shown = list[str](), 0
    for number, stretch in enumerate(stretches):
        start, end = _bounds(lines, stretch, shown)
        if number and start > shown:
            indent = len(lines[start]) - len(lines[start].lstrip())
            chosen.append(f"{' ' * indent}...")
        chosen += _cut(lines[start:end])
        shown = end
    return dedent("\n".join(chosen)) + "\n"


def _bounds(lines: Sequence[str], stretch: str, after: int) -> tuple[int, int]:
    first, _, last = stretch.partition(" ... ")
    start = _line_with(lines, first, after)
    return start, 1 + (_line_with(lines, last, start) if last else start)


def _line_with(lines: Sequence[str], part: str, after: int) -> int:
    for number in range(after, len(lines)):
        if part in lines[number]:
            return number
    raise AssertionError(f"no line has {part!r} in it, after line {after} of\n" + "\n".join(lines))


def _cut(lines: Sequence[str]) -> Iterator[str]:
    for line in lines:
        yield line if len(line) <= WIDTH else f"{line[: WIDTH - 4].rstrip()} ..."
