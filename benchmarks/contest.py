"""Contests: the systems that have a program run it in turn, each in a process of its own, on the same input."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import data
from benchmarks.data import Arrays
from benchmarks.programs import Program
from benchmarks.systems.registry import SYSTEMS, environment

PATIENCE = 180.0  # seconds for any one answer
PAUSE = 0.01  # between two systems: threads of OpenMP spin for some milliseconds after they have finished


class WorkerError(Exception):
    """A worker could not do what it was asked; ``status`` is ``missing``, ``failed`` or ``wrong``."""

    def __init__(self, status: str, text: str) -> None:
        super().__init__(text)
        self.status = status


@dataclass(frozen=True, slots=True)
class Settings:
    """What all contests of a run share.

    Attributes:
        pythons: the interpreter of each system.
        cache: a folder for compiled code.
        folder: a folder for inputs and outputs.
        processors: how many workers prepare at once.
        rounds: how often each is timed.
        batch: for about how many seconds each time.
    """

    pythons: Mapping[str, str]
    cache: Path
    folder: Path
    processors: int
    rounds: int
    batch: float


class WorkerProcess:
    """A worker, and the socket to it."""

    def __init__(self, system: str, threads: int, python: str, cache: Path, log: Path) -> None:
        self._connection, theirs = Pipe()
        self._log = log
        cache.mkdir(parents=True, exist_ok=True)
        with log.open("wb") as stderr:
            self._process = subprocess.Popen(
                [python, "-m", "benchmarks.worker", str(theirs.fileno()), system],
                env=environment(system, threads, cache),
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
            )
        theirs.close()

    def ask(self, *request: object) -> Any:
        """The answer to a request.

        Raises:
            WorkerError: it has none.
        """
        try:
            self._connection.send(request)
            if not self._connection.poll(PATIENCE):
                raise WorkerError("failed", f"no answer in {PATIENCE:.0f} s")
            status, value = self._connection.recv()
        except (EOFError, OSError):
            lines = self._log.read_text(errors="replace").strip().splitlines()
            raise WorkerError("failed", f"the process ended: {lines[-1] if lines else 'silently'}") from None
        if status != "ok":
            raise WorkerError(status, value)
        return value

    def stop(self) -> None:
        self._connection.close()
        try:
            self._process.wait(2)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@dataclass(slots=True)
class Contestant:
    """A system with a program and a number of threads, and what came of it.

    Attributes:
        status: ``ok``, ``missing``, ``failed`` or ``wrong``.
        text: what went wrong, or a note.
        error: of its outputs, relative to the largest number in them.
        seconds: of a step, in each round.
    """

    system: str
    threads: int
    program: Program
    inputs: Path
    status: str = "ok"
    text: str = ""
    error: float = 0.0
    version: str = ""
    steps: int = 0
    seconds: list[float] = field(default_factory=list)
    worker: WorkerProcess | None = None

    def to_json(self) -> dict[str, Any]:
        return {
            "system": self.system,
            "threads": self.threads,
            "program": self.program.name,
            "status": self.status,
            "text": self.text,
            "error": float(f"{self.error:.2g}"),
            "version": self.version,
            "steps": self.steps,
            "seconds": [float(f"{seconds:.5g}") for seconds in self.seconds],
        }


def contest(
    settings: Settings,
    contestants: Sequence[Contestant],
    truths: Mapping[str, Arrays],
    rounds: int,
    tell: Callable[[], None],
) -> None:
    """Prepares the contestants, compares what they compute with the truth, then times them in turn.

    Args:
        settings: of the run.
        contestants: their ``status``, ``text``, ``error``, ``version``, ``steps`` and ``seconds`` are set.
        truths: the outputs of each program after its ``check_steps``.
        rounds: how often each is timed.
        tell: called after each step of the work: once a contestant, once a round.
    """

    def prepare_one(numbered: tuple[int, Contestant]) -> None:
        number, contestant = numbered
        with excluded(contestant):
            prepare(settings, contestant, truths[contestant.program.name], number)
        tell()

    try:
        with ThreadPoolExecutor(settings.processors) as pool:
            list(pool.map(prepare_one, enumerate(contestants)))
        for contestant in present(contestants):
            with excluded(contestant):
                contestant.steps = asked(contestant, "warm", settings.batch)
        for number in range(rounds):
            time_round(contestants, number)
            tell()
    finally:
        for contestant in contestants:
            if contestant.worker is not None:
                contestant.worker.stop()


def prepare(settings: Settings, contestant: Contestant, truth: Arrays, number: int) -> None:
    """Starts its process, has it compute what the truth is known of, and compares."""
    system, program = contestant.system, contestant.program
    python, log = settings.pythons[system], settings.folder / f"{number}.log"
    contestant.worker = WorkerProcess(system, contestant.threads, python, settings.cache, log)
    contestant.version = asked(contestant, "prepare", program.code, contestant.inputs)["version"]
    asked(contestant, "run", program.check_steps)
    path = settings.folder / f"{number}-outputs.npz"
    asked(contestant, "outputs", path)
    contestant.error = largest_error(data.load(path), truth)
    path.unlink()
    if not contestant.error <= program.tolerance:  # also where it is no number
        raise WorkerError("wrong", f"its results are off by {contestant.error:.1e}")
    if contestant.threads > 1:
        contestant.text = dict(SYSTEMS[system].notes).get(program.code, "")


def largest_error(found: Arrays, truth: Arrays) -> float:
    """Relative to the largest number of the same output."""
    errors = (np.abs(found[name] - truth[name]).max() / max(np.abs(truth[name]).max(), 1e-30) for name in truth)
    return float(max(errors))


def time_round(contestants: Sequence[Contestant], number: int) -> None:
    """Times each once; every round begins with another, so that none always follows the same."""
    taking_part = present(contestants)
    first = number % max(1, len(taking_part))
    for contestant in taking_part[first:] + taking_part[:first]:
        time.sleep(PAUSE)
        with excluded(contestant):
            contestant.seconds.append(asked(contestant, "run", contestant.steps) / contestant.steps)


def present(contestants: Iterable[Contestant]) -> list[Contestant]:
    return [contestant for contestant in contestants if contestant.status == "ok"]


def asked(contestant: Contestant, *request: object) -> Any:
    assert contestant.worker is not None
    return contestant.worker.ask(*request)


@contextmanager
def excluded(contestant: Contestant) -> Iterator[None]:
    """Takes a contestant that gives no answer out of the contest, and the reason down."""
    try:
        yield
    except WorkerError as error:
        contestant.status, contestant.text = error.status, str(error)
        if contestant.status == "failed":
            print(f"{contestant.system} failed in {contestant.program.name}:\n{error}", file=sys.stderr)
