"""The code of the README, the tutorial and the reference runs, and prints or raises what stands under it.

The blocks marked ``python`` of a page are one program. A ``text`` block right after one is what that block prints;
after a block marked ``python raises`` it is the error. ``--update-golden`` writes these texts, and the extracts of what
the compiler makes (``dumps.py``).
"""

from __future__ import annotations

import contextlib
import io
import linecache
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from dumps import refreshed

import ebb
from backends import require
from ebb.types.builtins import BUILTINS

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("tutorial/*.md")),
    *sorted((ROOT / "docs").glob("reference/*.md")),
    ROOT / "docs" / "design" / "devices.md",
]
BLOCK = re.compile(
    r"^```(?P<kind>python(?: raises)?)\n(?P<code>.*?)^```\n(?:\n```text\n(?P<text>.*?)^```\n)?", re.M | re.S
)


@dataclass(frozen=True)
class Block:
    code: str
    raises: bool
    text: str | None
    place: tuple[int, int]


def blocks_of(page: str) -> Iterator[Block]:
    for found in BLOCK.finditer(page):
        yield Block(found["code"], found["kind"].endswith("raises"), found["text"], found.span("text"))


def run_block(block: Block, filename: str, line: int, namespace: dict[str, Any]) -> str:
    """What the block prints, or the error that it raises. Its lines count from ``line``."""
    program = compile("\n" * line + block.code, filename, "exec")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        if not block.raises:
            exec(program, namespace)
            return printed.getvalue()
        with pytest.raises(ebb.EbbError) as caught:
            exec(program, namespace)
    return f"{caught.value}\n"


@pytest.fixture(autouse=True)
def same_backend() -> Iterator[None]:
    """Pages choose backends, which is nobody else's business."""
    with ebb.backend("cpu"):
        yield


@pytest.mark.filterwarnings("ignore:Non-empty compiler output")  # of what pyopencl itself compiles
@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_page(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    page = path.read_text(encoding="utf-8")
    blocks = tuple(blocks_of(page))
    if any('backend("opencl"' in block.code for block in blocks):
        require("opencl")
    name = re.sub(r"^\d+[-_]", "", path.stem).lower().replace("-", "_") + ".py"
    monkeypatch.chdir(tmp_path)
    Path(name).write_text("".join(block.code for block in blocks), encoding="utf-8")
    linecache.checkcache(name)
    namespace: dict[str, Any] = {"__name__": "__main__", "__file__": name}
    line, found = 0, page
    for block in blocks:
        text = run_block(block, name, line, namespace)
        line += block.code.count("\n")
        if block.text is not None:
            start, end = (place - len(page) for place in block.place)  # from the end, since what is before changes
            found = found[: len(found) + start] + text + found[len(found) + end :]
    update = request.config.getoption("--update-golden")
    found = refreshed(found, namespace, update=update)
    if update:
        path.write_text(found, encoding="utf-8")
    assert found == path.read_text(encoding="utf-8")


def test_pages_link_to_files_that_are_there() -> None:
    pages = [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("**/*.md")]
    dead = [
        f"{page.relative_to(ROOT)}: {target}"
        for page in pages
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert dead == []


def builtin_table() -> str:
    """The table of the reference, a row a builtin."""
    rows = [(name, row.doc) for name, row in BUILTINS.items() if "." not in name]
    lines = (f"| `{name}` | {doc.replace('|', chr(92) + '|')} |" for name, doc in rows)
    return "\n".join(("| name | meaning |", "| --- | --- |", *lines))


def test_reference_lists_every_builtin(request: pytest.FixtureRequest) -> None:
    path = ROOT / "docs" / "reference" / "language.md"
    page = path.read_text(encoding="utf-8")
    before, _, rest = page.partition("<!-- builtins -->\n")
    found = f"{before}<!-- builtins -->\n{builtin_table()}\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
    if request.config.getoption("--update-golden"):
        path.write_text(found, encoding="utf-8")
    assert found == path.read_text(encoding="utf-8")
