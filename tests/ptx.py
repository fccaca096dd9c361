"""A backend for tests that makes PTX of every kernel that it is asked to run, and has cpu run the kernel.

What ``ptxas`` says of each is a row of a table: registers, bytes spilled, shared memory, atomic operations.
"""

from __future__ import annotations

import fcntl
import re
import subprocess
from collections import Counter
from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import llvmlite
import numpy as np
import pytest

import ebb
from backends import HAS_WHEELS
from ebb.backends import select
from ebb.backends.backend import Backend, Bound, CheckedKernel, Executable, How
from ebb.backends.cache import ObjectCache, cache_directory
from ebb.backends.cpu import cpu_backend
from ebb.backends.devices.backend import DeviceBackend
from ebb.backends.target import nvptx
from ebb.relations.field import Field
from ebb.relations.subset import RowSet
from ebb.runtime.device import Entry, Feature, KernelArgument, Memory

CAPABILITIES = (70, 80, 90)
PTXAS_PACKAGE = "nvidia-cuda-nvcc-cu12"

_RESOURCES = re.compile(
    r"Function properties for (?P<entry>\w+)\n"
    r"\s*(?P<stack>\d+) bytes stack frame, (?P<stores>\d+) bytes spill stores, (?P<loads>\d+) bytes spill loads\n"
    r".*?Used (?P<registers>\d+) registers(?:.*?(?P<shared>\d+) bytes smem)?"
)
_ENTRY = re.compile(r"\.entry (?P<entry>\w+)\(.*?^\}", re.M | re.S)
_ATOMIC = re.compile(r"\b(?:atom|red)\.[\w.]*?\b(?P<name>(?:add|min|max|and|or|xor|exch|cas|inc|dec)\.\w+)")


@dataclass(frozen=True)
class Resources:
    """What an entry takes on one kind of GPU: registers of a thread, bytes, and how often which atomic operation."""

    registers: int
    spilled: int
    stack: int
    shared: int
    atomics: str


@cache
def ptxas() -> Path | None:
    """The assembler of the wheel, or None."""
    found = find_spec("nvidia")
    folders = [] if found is None else [Path(folder) for folder in found.submodule_search_locations or ()]
    return next((path for folder in folders for path in folder.glob("*/bin/ptxas*") if path.stem == "ptxas"), None)


def require() -> None:
    """Skips the test where there is no assembler."""
    if ptxas() is None and not HAS_WHEELS:
        pytest.skip("there is no ptxas")


def versions() -> str:
    """What the registers depend on beside the compiler of this repository."""
    try:
        return f"llvmlite {llvmlite.__version__}, ptxas {version(PTXAS_PACKAGE)}"
    except PackageNotFoundError:
        return f"llvmlite {llvmlite.__version__}, ptxas of another package"


@cache
def assembled(text: str, capability: int) -> dict[str, Resources]:
    """What each entry of ``text`` takes. Fails where ``ptxas`` does not take it."""
    process = subprocess.run(
        [str(ptxas()), f"-arch=sm_{capability}", "--verbose", "-", "--output-file", "/dev/null"],
        input=text,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, f"{process.stderr}\n{text}"
    bodies = {found["entry"]: found[0] for found in _ENTRY.finditer(text)}
    table = {}
    for found in _RESOURCES.finditer(process.stderr):
        if found["entry"] in bodies:
            registers, stores, stack = int(found["registers"]), int(found["stores"]), int(found["stack"])
            atomics = atomics_of(bodies[found["entry"]])
            table[found["entry"]] = Resources(registers, stores, stack, int(found["shared"] or 0), atomics)
    assert table.keys() == bodies.keys(), process.stderr
    return table


def atomics_of(ptx: str) -> str:
    """The atomic operations in the text of an entry, and how many of each."""
    counts = Counter(found["name"] for found in _ATOMIC.finditer(ptx))
    return " ".join(f"{name} x {count}" if count > 1 else name for name, count in sorted(counts.items())) or "-"


# ---- The backend ----


@dataclass(frozen=True)
class NoMemory:
    """Memory that nobody reads or writes."""

    nbytes: int


class NoGpu:
    """A device that keeps the images that it is given to load, and runs nothing."""

    lacks = frozenset[Feature]()
    dlpack_device = None

    def __init__(self, capability: int, images: list[tuple[int, str]]) -> None:
        self.name = f"no GPU of the kind sm_{capability}"
        self.capability = capability
        self.images = images

    def allocate(self, nbytes: int) -> Memory:
        return NoMemory(nbytes)

    def upload(self, target: Memory, source: np.ndarray) -> None:
        pass

    def download(self, source: Memory, target: np.ndarray) -> None:
        raise AssertionError("there is nothing to read")

    def load(self, kernel: str, image: bytes, entries: tuple[str, ...]) -> tuple[Entry, ...]:
        self.images.append((self.capability, image.rstrip(b"\0").decode()))
        return entries

    def launch(self, entry: Entry, groups: int, group_size: int, arguments: Sequence[KernelArgument]) -> None:
        raise AssertionError("it runs nothing")

    def wait(self) -> None:
        pass


class PtxExecutable:
    """A kernel on cpu, of which PTX is made whenever it is bound."""

    def __init__(self, cpu: Executable, gpus: list[Executable]) -> None:
        self._cpu = cpu
        self._gpus = gpus

    def bind(self, rows: RowSet, changing: AbstractSet[Field] = frozenset()) -> Bound:
        for gpu in self._gpus:
            gpu.bind(rows, changing)
        return self._cpu.bind(rows, changing)

    def how(self, rows: RowSet) -> How:
        return self._cpu.how(rows)

    def inspect(self, stage: str) -> str | None:
        return self._cpu.inspect(stage)


class PtxBackend:
    """Makes PTX for each of ``CAPABILITIES``; kernels run on cpu.

    Attributes:
        checked: the kernels that it was asked to run, if it is to keep them.
        images: the capability and the text of all that it made.
    """

    def __init__(self, *, keep: bool = False, deterministic: bool = False) -> None:
        self.name = "ptx"
        self.device = None
        self.checked: list[CheckedKernel] = []
        self._keep = keep
        self.images: list[tuple[int, str]] = []
        self._cpu: Backend = cpu_backend(threads=1)
        self.stages, self.reorders = self._cpu.stages, self._cpu.reorders
        self.facts_cache = None
        self._gpus = [
            DeviceBackend(
                "ptx",
                NoGpu(capability, self.images),
                nvptx(capability),
                ObjectCache(cache_directory()),
                deterministic,
                self.reorders,
            )
            for capability in CAPABILITIES
        ]

    def prepare(self, checked: CheckedKernel) -> PtxExecutable:
        if self._keep:
            self.checked.append(checked)
        return PtxExecutable(self._cpu.prepare(checked), [gpu.prepare(checked) for gpu in self._gpus])

    def replay(self, operations: Any) -> Any:
        return self._cpu.replay(operations)


@contextmanager
def emitting(monkeypatch: pytest.MonkeyPatch, **options: Any) -> Iterator[PtxBackend]:
    """Kernels run on the backend ``ptx`` within a ``with`` statement."""
    backend = PtxBackend(**options)
    with monkeypatch.context() as patch:
        patch.setattr(select, "BACKENDS", {**select.BACKENDS, "ptx": (lambda: backend, ())})
        with ebb.backend("ptx"):
            yield backend


# ---- The table ----

COLUMNS = ("registers", "spilled", "stack", "shared", "atomics")
NAME_WIDTH, CELL_WIDTH = 44, 12


def rows_of(images: Sequence[tuple[int, str]]) -> list[str]:
    """A row an entry, in the order in which they were made; what differs between GPUs stands there for each of them."""
    found: dict[str, dict[int, list[Resources]]] = {}
    for capability, text in dict.fromkeys(images):
        for entry, resources in assembled(text, capability).items():
            found.setdefault(entry, {}).setdefault(capability, []).append(resources)
    return [
        _row(entry, [[getattr(one, column) for one in each] for column in COLUMNS])
        for entry, by_capability in found.items()
        for each in zip(*(by_capability[capability] for capability in CAPABILITIES), strict=True)
    ]


def header() -> list[str]:
    """The first lines of a table."""
    kinds = ", ".join(f"sm_{capability}" for capability in CAPABILITIES)
    return [f"{versions()}; three values are those for {kinds}", _row("kernel", [[column] for column in COLUMNS])]


def _row(name: str, cells: list[list[Any]]) -> str:
    texts = ("/".join(map(str, cell if len(set(cell)) > 1 else cell[:1])) for cell in cells)
    return f"{name:{NAME_WIDTH}}{''.join(f'{text:{CELL_WIDTH}}' for text in texts)}".rstrip()


def check_section(path: Path, name: str, rows: list[str], *, update: bool) -> None:
    """Compares ``rows`` with those that the table ``path`` has under ``name``, or puts them there.

    Where the table is of other versions of LLVM and ``ptxas``, what these choose is not compared.
    """
    if update:
        _update_section(path, name, rows)
    table = path.read_text(encoding="utf-8") if path.exists() else ""
    recorded = _sections(table).get(name, [])
    if table and not table.startswith(versions()):
        recorded, rows = list(map(_without_choices, recorded)), list(map(_without_choices, rows))
    assert rows == recorded, "if they are to be so, say --update-golden"


def _update_section(path: Path, name: str, rows: list[str]) -> None:
    path.parent.mkdir(exist_ok=True)
    with open(path, "a+", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # test processes run side by side
        file.seek(0)
        sections = {**_sections(file.read()), name: rows}
        texts = ["\n".join((title, *sections[title])) for title in sorted(sections) if sections[title]]
        file.truncate(0)
        file.write("\n\n".join(("\n".join(header()), *texts)) + "\n")


def _sections(table: str) -> dict[str, list[str]]:
    _, *sections = table.rstrip("\n").split("\n\n")
    return {title: rows for title, *rows in map(str.splitlines, sections)}


def _without_choices(row: str) -> str:
    return row[:NAME_WIDTH] + row[NAME_WIDTH + 3 * CELL_WIDTH :]
