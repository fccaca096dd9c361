"""Runs the benchmarks: Ebb and its peers in turn, on the same data, in one run.

make bench                                          all of it, in some minutes
python -m benchmarks.run --quick --only streaming   a first look
python -m benchmarks.run --report FILE.json         the table of an earlier run
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks import data, startup
from benchmarks.contest import Contestant, Settings, contest
from benchmarks.data import Arrays
from benchmarks.machine import BUSY, describe_machine, load
from benchmarks.programs import BY_NAME, FMA, PROGRAMS, Program, Scale, triad
from benchmarks.report import show, write_docs
from benchmarks.systems.registry import SYSTEMS

ROOT = Path(__file__).parents[1]
OUT = ROOT / "out" / "benchmarks"
RESULTS = ROOT / "benchmarks" / "results"
PEERS = ROOT / ".venv-bench" / "bin" / "python"
EXTRAS = ("fma", "startup")


def main(arguments: Sequence[str] | None = None) -> None:
    options = parse(arguments)
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 150)
    if options.report is not None:
        results = json.loads(options.report.read_text())
    else:
        if load() > BUSY:
            console.print(f"Others keep this machine busy (load {load():.1f}): expect noise.")
        results = run(options, console)
    show(results, console)
    if options.write_docs:
        path = RESULTS / f"{results['date'][:10]}.json"
        keep(results, path)
        write_docs(results, path.name, ROOT / "docs" / "benchmarks.md")


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.run", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [program.name for program in PROGRAMS] + list(EXTRAS)
    parser.add_argument("--only", type=names_of(names), default=names, help=", ".join(names))
    parser.add_argument("--systems", type=names_of(list(SYSTEMS)), default=list(SYSTEMS), help=", ".join(SYSTEMS))
    parser.add_argument("--threads", type=counts, default=default_threads(), help="such as 1,2")
    parser.add_argument("--rounds", type=int, help="how often each is timed, by default 15, or 5 under --quick")
    parser.add_argument("--batch", type=float, default=0.04, help="for about how many seconds each time")
    parser.add_argument("--scale", type=Scale, choices=list(Scale), default=Scale.FULL, help="of the inputs")
    parser.add_argument("--quick", action="store_true", help="small inputs and few rounds")
    parser.add_argument("--python", type=Path, default=PEERS, help="the interpreter that has the peers")
    parser.add_argument("--cache", type=Path, default=OUT / "cache", help="the folder for compiled code")
    parser.add_argument("--json", type=Path, default=OUT / "results.json", help="where the results are kept")
    parser.add_argument("--report", type=Path, help="shows the results of that file, and runs nothing")
    parser.add_argument(
        "--write-docs", action="store_true", help="keeps the results in benchmarks/results, writes docs/benchmarks.md"
    )
    options = parser.parse_args(arguments)
    if options.quick:
        options.scale = Scale.QUICK
    options.rounds = options.rounds or (5 if options.quick else 15)
    return options


def names_of(known: Sequence[str]) -> Callable[[str], list[str]]:
    def parse_names(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(f"{name!r} is none of {', '.join(known)}")
        return names

    return parse_names


def counts(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


def default_threads() -> list[int]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return sorted({1, min(2, cores), cores})


def keep(results: dict[str, Any], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=1) + "\n")


def run(options: argparse.Namespace, console: Console) -> dict[str, Any]:
    """All that was asked for; returns what is kept as JSON, after each program in case that it is cut short."""
    peers = str(options.python) if options.python.exists() else sys.executable
    pythons = {name: peers if system.package else sys.executable for name, system in SYSTEMS.items()}
    programs = [BY_NAME[name] for name in options.only if name in BY_NAME]
    results: dict[str, Any] = {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="minutes"),
        "machine": describe_machine(),
        "scale": options.scale.value,
        "rounds": options.rounds,
        "batch": options.batch,
        "programs": [],
    }
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with tempfile.TemporaryDirectory() as folder, Progress(*columns, console=console, transient=True) as progress:
        settings = Settings(
            pythons, options.cache.absolute(), Path(folder), os.cpu_count() or 1, options.rounds, options.batch
        )
        for program in [FMA, *programs] if "fma" in options.only else programs:
            results["programs"].append(run_program(program, settings, options, progress))
            keep(results, options.json)
        if "startup" in options.only:
            systems = tuple(system for system in startup.SYSTEMS if system in options.systems)
            rounds = min(5, options.rounds)
            task = progress.add_task("startup", total=rounds * len(systems))
            results["startup"] = startup.measure_startup(pythons, systems, rounds, lambda: progress.advance(task))
            keep(results, options.json)
    return results


def run_program(
    program: Program, settings: Settings, options: argparse.Namespace, progress: Progress
) -> dict[str, Any]:
    """The contest in a program, with Ebb's programs to compare with and the machine's triad."""
    task = progress.add_task(program.title, total=None)
    arrays = program.make(program.sizes[options.scale])
    work = program.work(arrays) if program.work else None
    working_set = sum(array.nbytes for array in arrays.values())
    own = [(program, arrays)]
    others = [(BY_NAME[name], BY_NAME[name].make(program.sizes[options.scale])) for name in program.against]
    if work is not None and work.bytes:
        bound = triad(program, working_set)
        others.append((bound, bound.make(0)))
    contestants: list[Contestant] = []
    truths: dict[str, Arrays] = {}
    for entry, inputs in own + others:
        path = settings.folder / f"{entry.name}.npz"
        data.save(inputs, path)
        truths[entry.name] = entry.expected(inputs, entry.check_steps)
        contestants += enter(entry, path, program, options)
    rounds = min(program.rounds, settings.rounds)
    progress.update(task, total=len(contestants) + rounds)
    contest(settings, contestants, truths, rounds, lambda: progress.advance(task))
    for path in settings.folder.glob("*.npz"):
        path.unlink()
    return {
        "name": program.name,
        "title": program.title,
        "work": None if work is None else {"bytes": work.bytes, "flops": work.flops},
        "triad_bytes": others[-1][0].work(others[-1][1]).bytes if work is not None and work.bytes else None,
        "working_set": working_set,
        "contestants": [contestant.to_json() for contestant in contestants],
    }


def enter(entry: Program, inputs: Path, program: Program, options: argparse.Namespace) -> list[Contestant]:
    """The contestants of a program: the program's own, or of one that it is compared with, Ebb alone."""
    systems = entry.systems if entry is program or entry.systems == ("cpp",) else ("ebb",)
    return [
        Contestant(system, threads, entry, inputs)
        for system in systems
        if system in options.systems
        for threads in program.threads or options.threads
        if threads <= (SYSTEMS[system].most_threads or threads)
    ]


if __name__ == "__main__":
    main()
