"""The systems by name: what they are called, where they are installed, and how a process is told its threads."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class System:
    """A system.

    Attributes:
        title: for tables.
        module: of ``benchmarks.systems``.
        package: what pip calls it; None where it comes with the driver's environment or the compiler.
        most_threads: None where it takes as many as it is given.
        notes: by code, what tables must say where it has several threads.
    """

    title: str
    module: str
    package: str | None = None
    most_threads: int | None = None
    notes: tuple[tuple[str, str], ...] = ()


ONE_THREAD = "no atomics on the CPU: the loop over edges on one thread"

SYSTEMS = {
    "ebb": System("Ebb", "ebb"),
    "cpp": System("C++", "cpp", notes=(("scatter", "OpenMP atomics"), ("both-ends", "OpenMP atomics"))),
    "numba": System("Numba", "numba", "numba", notes=(("scatter", ONE_THREAD), ("both-ends", ONE_THREAD))),
    "taichi": System("Taichi", "taichi_like", "taichi"),
    "quadrants": System("Quadrants", "taichi_like", "quadrants"),
    "warp": System("Warp", "warp", "warp-lang", most_threads=1),
    "reference": System("Ebb, reference interpreter", "ebb", most_threads=1),
}


def environment(system: str, threads: int, cache: Path) -> dict[str, str]:
    """The variables of a worker's process: its threads, and folders for compiled code that no other run uses."""
    root = str(Path(__file__).parents[2])
    path = os.environ.get("PYTHONPATH")
    inherited = dict(os.environ)
    inherited.pop("PYTHONDONTWRITEBYTECODE", None)  # Python keeps modules of the peers compiled, and shall keep ours
    return {
        **inherited,
        "PYTHONPATH": f"{root}{os.pathsep}{path}" if path else root,
        "BENCHMARKS_SYSTEM": system,
        "BENCHMARKS_THREADS": str(threads),
        "BENCHMARKS_CACHE": str(cache),
        "OMP_NUM_THREADS": str(threads),
        "EBB_NUM_THREADS": str(threads),
        "EBB_CACHE_DIR": str(cache / "ebb"),
        "NUMBA_NUM_THREADS": str(threads),
        "NUMBA_CACHE_DIR": str(cache / f"numba-{threads}"),  # whether loops are parallel is not part of Numba's key
        "TI_OFFLINE_CACHE_FILE_PATH": str(cache / "taichi"),
        "QD_OFFLINE_CACHE_FILE_PATH": str(cache / "quadrants"),
        "ENABLE_TAICHI_HEADER_PRINT": "0",
        "WARP_CACHE_PATH": str(cache / "warp"),
    }
