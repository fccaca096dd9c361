"""One system with one program, in a process of its own, waiting for what the driver asks.

The driver starts it as ``python -m benchmarks.worker DESCRIPTOR SYSTEM`` and sends tuples over that socket, the name of
a request and its arguments. Each gets one answer: ("ok", value), ("missing", what is not installed) or ("failed", why).
What systems print goes to the standard error.
"""

from __future__ import annotations

import gc
import importlib
import os
import sys
import time
import traceback
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from benchmarks import data
from benchmarks.systems import Prepared
from benchmarks.systems.registry import SYSTEMS

LEAST_STEPS = 12  # before any is timed: a system may take decisions in its first launches


class Worker:
    """The requests: a method each."""

    prepared: Prepared

    def __init__(self, system: str) -> None:
        self.system = system

    def prepare(self, code: str, inputs: Path) -> dict[str, Any]:
        """Imports the system and readies the program; says how long that took, beyond NumPy."""
        arrays = data.load(inputs)
        below = time.perf_counter()
        if self.system == "ebb":
            importlib.import_module("llvmlite.binding")
        start = time.perf_counter()
        module = importlib.import_module(f"benchmarks.systems.{SYSTEMS[self.system].module}")
        imported = time.perf_counter()
        if code not in module.PROGRAMS:
            raise LookupError(f"{self.system} {module.version()} has no program '{code}'")
        self.prepared = module.PROGRAMS[code](arrays)
        done = time.perf_counter()
        return {
            "version": module.version(),
            "import": imported - start,
            "prepare": done - imported,
            **({"llvmlite": start - below} if self.system == "ebb" else {}),
        }

    def run(self, steps: int) -> float:
        """Makes so many steps, and says how many seconds they took."""
        start = time.perf_counter()
        self.prepared.run(steps)
        return time.perf_counter() - start

    def warm(self, seconds: float) -> int:
        """Runs until everything is compiled and in place, and says how many steps take about so long."""
        gc.collect()
        gc.disable()
        steps, done = 1, 0
        while True:
            taken, done = self.run(steps), done + steps
            wanted = max(1, round(steps * seconds / max(taken, 1e-7)))
            if taken > seconds / 2 and (done >= LEAST_STEPS or taken > 5 * seconds):
                return wanted
            steps = max(steps, min(wanted, 20 * steps))

    def outputs(self, path: Path) -> None:
        data.save(self.prepared.outputs(), path)


def main() -> None:
    connection = Connection(int(sys.argv[1]))
    os.dup2(2, 1)
    worker = Worker(sys.argv[2])
    while True:
        try:
            request, *arguments = connection.recv()
        except EOFError:
            return
        try:
            answer = ("ok", getattr(worker, request)(*arguments))
        except ModuleNotFoundError as error:
            answer = ("missing", str(error.name))
        except FileNotFoundError as error:
            answer = ("missing", str(error.filename))
        except Exception:
            answer = ("failed", traceback.format_exc())
        connection.send(answer)


if __name__ == "__main__":
    main()
