"""The house: what may import what, how large things may be, what is public and what an import costs."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import ebb
import ebb.domains
import ebb.solvers

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "ebb"
FILES = sorted(SOURCE.rglob("*.py"))
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in FILES}

# Each room may import from itself and from the rooms before it.
ROOMS = (
    "records",
    "diagnostics",
    "types",
    "runtime",
    "relations",
    "compiler",
    "backends",
    "kernel",
    "domains",
    "solvers",
    "environment",
    "cli",
)
IN_ROOM = {"capture": "kernel", "errors": "diagnostics", "interop": "kernel", "launch": "kernel"}
# Not needed to run a program: the command line's packages, and those of the extras.
LATE = ("rich", "typer", "scipy", "meshio", "pyvista", "pymeshfix", "tetgen", "matplotlib", "pyopencl", "cuda")

# Only needed on errors, to compile what is not in the cache, or by another backend.
SLOW = (
    "numpy.ma",
    "numpy.typing",
    "concurrent.futures",
    "difflib",
    "fractions",
    "hashlib",
    "logging",
    "subprocess",
    "ebb.backends.devices",
    "ebb.backends.llvm.emit",
    "ebb.backends.reference",
    "ebb.compiler.explain",
    "ebb.diagnostics.render",
    "ebb.relations.device_view",
    "ebb.runtime.errors_devices",
    "ebb.runtime.opencl",
)


def room_of(module: str) -> str:
    """The room of a module of the package, ``ebb.types.rules`` -> ``types``."""
    part = module.split(".")[1]
    return IN_ROOM.get(part, part)


def module_of(path: Path) -> str:
    return ".".join(("ebb", *path.relative_to(SOURCE).with_suffix("").parts)).removesuffix(".__init__")


def imports(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """What a file imports when it runs, in functions too; what only the type checker sees does not count."""
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        match node:
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                continue
            case ast.Import(names=names):
                yield from ((node.lineno, alias.name) for alias in names)
            case ast.ImportFrom(module=str(module), names=names):
                yield from ((node.lineno, f"{module}.{alias.name}") for alias in names)
        pending += ast.iter_child_nodes(node)


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def test_imports_run_one_way() -> None:
    wrong: list[str] = []
    for path, tree in TREES.items():
        if path == SOURCE / "__init__.py":
            continue
        own = ROOMS.index(room_of(module_of(path)))
        for line, name in imports(tree):
            if name.startswith("ebb.") and ROOMS.index(room_of(name)) > own:
                wrong.append(f"{path.relative_to(ROOT)}:{line} imports {name}")
    assert wrong == []


def test_domains_and_solvers_are_written_with_the_public_api_alone() -> None:
    wrong = [
        f"{path.relative_to(ROOT)}:{line} imports {name}"
        for path, tree in TREES.items()
        if path.is_relative_to(SOURCE / "domains") or path.is_relative_to(SOURCE / "solvers")
        for line, name in imports(tree)
        if name.startswith("ebb.")
        and room_of(name) not in ("domains", "solvers", "diagnostics", "records")
        and name.count(".") > 1
    ]
    assert wrong == []


def test_no_file_is_long() -> None:
    lengths = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in FILES}
    assert {path: length for path, length in lengths.items() if length > 500} == {}


def test_no_function_is_long() -> None:
    long = [
        f"{path.relative_to(ROOT)}:{each.lineno} {each.name}"
        for path, tree in TREES.items()
        for each in functions(tree)
        if (each.end_lineno or 0) - each.lineno > 70
    ]
    assert long == []


def test_no_room_for_leftovers() -> None:
    banned = {"utils", "util", "helpers", "helper", "common", "misc", "tmp"}
    assert [str(path) for path in FILES if banned & set(path.relative_to(SOURCE).with_suffix("").parts)] == []


def test_no_machine_is_named() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("no checkout")
    absolute = re.compile(r"/(home|work|root|Users)/\w")
    wrong: list[str] = []
    for name in listed.stdout.splitlines():
        path = ROOT / name
        if path == Path(__file__) or path.suffix in (".png", ".npz") or not path.is_file():
            continue
        if absolute.search(path.read_text(encoding="utf-8")):
            wrong.append(name)
    assert wrong == []


def test_public_names_are_sorted_unique_and_there() -> None:
    assert len(set(ebb.__all__)) == len(ebb.__all__)
    assert [name for name in ebb.__all__ if not hasattr(ebb, name)] == []
    visible = {name for name, value in vars(ebb).items() if not name.startswith("_") and not inspect.ismodule(value)}
    assert visible - set(ebb.__all__) - {"annotations"} == set()


@pytest.mark.parametrize("module", [ebb, ebb.domains, ebb.solvers], ids=lambda module: module.__name__)
def test_public_names_are_documented(module) -> None:
    """Each has a docstring, and stands in the reference, where the aliases of types stand as a pattern."""
    reference = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "reference").glob("*.md"))
    missing = [
        name
        for name in module.__all__
        if not re.fullmatch(r"(vec|mat)\d(x\d)?[fdib]", name)
        and not (
            (inspect.getdoc(getattr(module, name)) or getattr(getattr(module, name), "doc", ""))
            and re.search(rf"\b{name}\b", reference)
        )
    ]
    assert missing == []


def test_public_classes_document_their_public_methods() -> None:
    missing = [
        f"{each.__name__}.{name}"
        for module in (ebb, ebb.domains, ebb.solvers)
        for each in vars(module).values()
        if inspect.isclass(each) and each.__module__.startswith("ebb.")
        for name, value in vars(each).items()
        if not name.startswith("_")
        and (inspect.isfunction(value) or isinstance(value, property | classmethod | staticmethod))
        and not inspect.getdoc(getattr(each, name))
    ]
    assert missing == []


def test_import_brings_in_nothing_that_a_program_may_not_need() -> None:
    check = f"import sys, ebb, ebb.domains; print([name for name in {LATE!r} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_import_ebb_is_quick() -> None:
    """What takes long to import, and is only needed by some, comes when it is."""
    check = (
        "import sys, numpy, llvmlite.binding; before = set(sys.modules); import ebb\n"
        f"print([name for name in {SLOW!r} if name in set(sys.modules) - before])"
    )
    found = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_records_are_no_dataclasses() -> None:
    """Those take thirty times as long to make: see ``ebb/records.py``."""
    wrong = [
        f"{path}:{line}"
        for path, tree in TREES.items()
        for line, name in imports(tree)
        if name.startswith("dataclasses")
    ]
    assert wrong == []
