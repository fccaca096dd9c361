"""What starting costs: the import, the preparations, the first launch of a small kernel, cold and from the cache."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks import data
from benchmarks.contest import WorkerError, WorkerProcess

SYSTEMS = ("ebb", "cpp", "numba", "taichi", "quadrants", "warp")
ROWS = 1000


def measure_startup(
    pythons: Mapping[str, str], systems: tuple[str, ...], rounds: int, tell: Callable[[], None]
) -> list[dict[str, Any]]:
    """Starts each system in turn, ``rounds`` times with an empty cache and as often with a filled one."""
    found: dict[str, dict[str, Any]] = {system: {"system": system, "cold": [], "cached": []} for system in systems}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        inputs = folder / "inputs.npz"
        data.save(data.rows(ROWS), inputs)
        for number in range(rounds):
            for system, row in found.items():
                if "text" in row:
                    continue
                cache = folder / f"{system}-{number}"
                try:
                    for kind in ("cold", "cached"):
                        row[kind].append(start_once(system, pythons[system], cache, inputs, folder / "log"))
                except WorkerError as error:
                    row["status"], row["text"] = error.status, str(error)
                tell()
    return list(found.values())


def start_once(system: str, python: str, cache: Path, inputs: Path, log: Path) -> dict[str, float]:
    """Seconds of each part, in a fresh process."""
    worker = WorkerProcess(system, 1, python, cache, log)
    try:
        times = worker.ask("prepare", "streaming", inputs)
        times["launch"] = worker.ask("run", 1)
        times["second launch"] = worker.ask("run", 1)
    finally:
        worker.stop()
    return {name: float(f"{value:.4g}") for name, value in times.items() if name != "version"}
