"""From the results of a run to the figures of its tables: medians, quartiles, ratios."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.programs import BY_NAME, FMA_PER_STEP
from benchmarks.systems.registry import SYSTEMS

Results = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Spread:
    """A median and the quartiles about it."""

    median: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Row:
    """A contestant's row.

    Attributes:
        program: its name in the results.
        entry: the program it ran, another one where it is there to compare with.
        seconds: of a step; None where it did not run.
        ratio: to C++ with as many threads, round by round; above 1 it is slower.
        share: of what the machine could do at best, from 0 to 1; None where that is not known.
        text: why it did not run, or a remark.
    """

    program: str
    entry: str
    system: str
    threads: int
    seconds: Spread | None
    ratio: Spread | None
    share: float | None
    text: str

    @property
    def is_guest(self) -> bool:
        return self.entry != self.program

    @property
    def title(self) -> str:
        if self.entry.startswith("triad"):
            return "triad of the machine"
        return f"{SYSTEMS[self.system].title}, {self.entry}" if self.is_guest else SYSTEMS[self.system].title


def spread(values: Sequence[float]) -> Spread:
    if len(values) < 2:
        return Spread(values[0], values[0], values[0])
    low, median, high = statistics.quantiles(values, n=4, method="inclusive")
    return Spread(median, low, high)


def ratios(of: Mapping[str, Any], to: Mapping[str, Any] | None) -> Spread | None:
    """How long the one took as a multiple of the other in the same round."""
    if to is None or not of["seconds"] or len(of["seconds"]) != len(to["seconds"]):
        return None
    return spread([mine / other for mine, other in zip(of["seconds"], to["seconds"], strict=True)])


def find(program: Results, system: str, threads: int, entry: str | None = None) -> Mapping[str, Any] | None:
    """The contestant that ran ``entry`` (by default the program itself), if it did."""
    wanted = (system, threads, entry or program["name"])
    for contestant in program["contestants"]:
        if (contestant["system"], contestant["threads"], contestant["program"]) == wanted:
            return contestant if contestant["status"] == "ok" else None
    return None


def program_named(results: Results, name: str) -> Results | None:
    return next((program for program in results["programs"] if program["name"] == name), None)


def flops_a_second(results: Results, threads: int) -> float | None:
    """The machine's peak of multiply-adds, two operations each."""
    program = program_named(results, "fma")
    contestant = find(program, "cpp", threads) if program else None
    return 2 * FMA_PER_STEP / spread(contestant["seconds"]).median if contestant else None


def bytes_a_second(program: Results, threads: int) -> float | None:
    """The triad's bandwidth over the working set of that program, the reading of written lines included."""
    contestant = find(program, "cpp", threads, f"triad-{program['name']}")
    return program["triad_bytes"] / spread(contestant["seconds"]).median if contestant else None


def least_seconds(results: Results, program: Results, threads: int) -> float | None:
    """How long a step takes at least, by what it must move and compute."""
    bandwidth, flops = bytes_a_second(program, threads), flops_a_second(results, threads)
    if program["work"] is None or bandwidth is None:
        return None
    return max(program["work"]["bytes"] / bandwidth, program["work"]["flops"] / flops if flops else 0)


def rows_of(results: Results, program: Results) -> Iterator[Row]:
    """By threads, in the order of the systems."""
    for contestant in sorted(program["contestants"], key=lambda one: one["threads"]):
        threads, seconds = contestant["threads"], contestant["seconds"]
        measured = spread(seconds) if seconds and contestant["status"] == "ok" else None
        base = None if contestant["program"].startswith("triad") else find(program, "cpp", threads)
        ratio = ratios(contestant, base) if measured else None
        least = least_seconds(results, program, threads) if contestant["program"] == program["name"] else None
        share = least / measured.median if least and measured else None
        yield Row(
            program["name"],
            contestant["program"],
            contestant["system"],
            threads,
            measured,
            ratio,
            share,
            explain_status(contestant),
        )


def explain_status(contestant: Mapping[str, Any]) -> str:
    match contestant["status"]:
        case "missing":
            return f"not installed: {contestant['text']}"
        case "wrong":
            return f"wrong: {contestant['text']}"
        case "failed":
            return f"failed: {contestant['text'].strip().splitlines()[-1][:60]}"
        case _:
            return contestant["text"]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Ebb's time in a program as a multiple of another's in the same rounds."""

    program: str
    threads: int
    other: str
    ratio: Spread


def comparisons(results: Results) -> Iterator[Comparison]:
    """Ebb against every other that ran, and against its own other forms."""
    for program in results["programs"]:
        for contestant in program["contestants"]:
            threads = contestant["threads"]
            own = find(program, "ebb", threads)
            if own is None or contestant is own or contestant["status"] != "ok" or contestant["system"] == "reference":
                continue
            ratio = ratios(own, contestant)
            if ratio is not None and not contestant["program"].startswith("triad"):
                title = SYSTEMS[contestant["system"]].title
                if contestant["program"] != program["name"]:
                    title += f", {contestant['program']}"
                yield Comparison(program["name"], threads, title, ratio)


def bandwidth_share(results: Results, name: str, threads: int) -> Spread | None:
    """Ebb's bandwidth in a program as a part of the triad's in the same rounds."""
    program = program_named(results, name)
    if program is None:
        return None
    own, bound = find(program, "ebb", threads), find(program, "cpp", threads, f"triad-{name}")
    if own is None or bound is None or len(own["seconds"]) != len(bound["seconds"]):
        return None
    scale = program["work"]["bytes"] / program["triad_bytes"]
    pairs = zip(own["seconds"], bound["seconds"], strict=True)
    return spread([scale * other / mine for mine, other in pairs])


def versions(results: Results) -> dict[str, str]:
    found: dict[str, str] = {}
    for program in results["programs"]:
        for contestant in program["contestants"]:
            if contestant["version"]:
                found[SYSTEMS[contestant["system"]].title] = contestant["version"]
    found.pop(SYSTEMS["reference"].title, None)
    return found


def title_of(program: Results) -> str:
    return BY_NAME[program["name"]].title if program["name"] in BY_NAME else program["title"]
