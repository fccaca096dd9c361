"""What the reader sees: tables in the terminal, and the page of the documentation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.figures import (
    Results,
    Row,
    Spread,
    bandwidth_share,
    bytes_a_second,
    comparisons,
    find,
    flops_a_second,
    program_named,
    ratios,
    rows_of,
    spread,
    title_of,
    versions,
)
from benchmarks.machine import BUSY
from benchmarks.systems.registry import SYSTEMS

HEADERS = ("program", "system", "threads", "median", "quartiles", "x C++", "of the bound", "")
COLUMNS = ("ebb", "cpp", "numba", "taichi", "quadrants", "warp")
SLOWER = 1.02  # a ratio below is no difference on a machine as noisy as most are


def in_unit(seconds: float, unit: tuple[float, str]) -> str:
    return f"{seconds / unit[0]:.3g}"


def unit_of(seconds: float) -> tuple[float, str]:
    return next((unit for unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us")) if seconds >= unit[0]), (1e-9, "ns"))


def duration(seconds: float) -> str:
    scale, name = unit_of(seconds)
    digits = max(0, 2 - len(str(int(seconds / scale))) + 1)
    return f"{seconds / scale:.{digits}f} {name}"


def cells(row: Row) -> tuple[str, ...]:
    """The columns from the system on."""
    if row.seconds is None:
        return (row.title, str(row.threads), "-", "", "", "", row.text)
    unit = unit_of(row.seconds.median)
    quartiles = f"{in_unit(row.seconds.low, unit)} to {in_unit(row.seconds.high, unit)}"
    return (
        row.title,
        str(row.threads),
        duration(row.seconds.median),
        quartiles,
        f"{row.ratio.median:.2f}" if row.ratio else "",
        f"{row.share:.0%}" if row.share is not None else "",
        row.text,
    )


# --- the terminal ---------------------------------------------------------------------------------------------------


def show(results: Results, console: Console) -> None:
    """The tables of a run."""
    table = Table(*HEADERS, box=None, header_style="bold", pad_edge=False)
    for program in results["programs"]:
        name = program["name"]
        for row in rows_of(results, program):
            style = "bold" if row.system == "ebb" and not row.is_guest else "red" if row.seconds is None else ""
            table.add_row(name, *cells(row), style=style)
            name = ""
        table.add_section()
    console.print(table)
    if results.get("startup"):
        console.print(startup_table(results))
    for line in (*peak_lines(results), *verdict_lines(results)):
        console.print(line, markup=False)


def startup_table(results: Results) -> Table:
    table = Table(*STARTUP_HEADERS, box=None, header_style="bold", pad_edge=False)
    for row in startup_rows(results):
        table.add_row(*row)
    return table


STARTUP_HEADERS = (
    "starting",
    "import",
    "set up, cold",
    "first launch, cold",
    "set up, cached",
    "first launch, cached",
    "second launch",
)


def startup_rows(results: Results) -> Iterator[tuple[str, ...]]:
    for row in results["startup"]:
        title = SYSTEMS[row["system"]].title
        if "text" in row:
            yield (title, "not installed: " + row["text"] if row["status"] == "missing" else "failed", *[""] * 5)
            continue

        def median(kind: str, name: str, row: Results = row) -> str:
            return duration(spread([one[name] for one in row[kind]]).median)

        imported = median("cached", "import")
        if row["system"] == "ebb":
            imported += f" (and {median('cached', 'llvmlite')} for llvmlite)"
        yield (
            title,
            imported,
            median("cold", "prepare"),
            median("cold", "launch"),
            median("cached", "prepare"),
            median("cached", "launch"),
            median("cached", "second launch"),
        )


def peak_lines(results: Results) -> Iterator[str]:
    """What the machine gave at best in this run."""
    for threads in threads_of(results):
        parts = []
        flops = flops_a_second(results, threads)
        if flops:
            parts.append(f"{flops / 1e9:.0f} GFlop/s of multiply-adds")
        streaming = program_named(results, "streaming")
        bandwidth = bytes_a_second(streaming, threads) if streaming else None
        if bandwidth:
            parts.append(f"{bandwidth / 1e9:.1f} GB/s in the triad of `streaming`")
        if parts:
            yield f"The machine with {plural(threads)}: {', '.join(parts)}."


def verdict_lines(results: Results) -> Iterator[str]:
    """The figures that a reader looks for first."""
    for threads in threads_of(results):
        share = bandwidth_share(results, "streaming", threads)
        if share:
            of = f"{share.median:.0%} of the triad's bandwidth{quartiles(share)}"
            yield f"Ebb streams at {of} with {plural(threads)}."
    for one in comparisons(results):
        if one.other.startswith("Ebb,"):
            yield f"Ebb's {one.program} takes {times(one.ratio)} its {one.other[5:]} with {plural(one.threads)}."
    yield from interpreter_lines(results)


def interpreter_lines(results: Results) -> Iterator[str]:
    program = program_named(results, "interpreter")
    if program:
        slow, fast = find(program, "reference", 1), find(program, "ebb", 1)
        ratio = ratios(slow, fast) if slow and fast else None
        if ratio:
            yield f"The reference interpreter takes {ratio.median:,.0f} times as long as the backend cpu with 1 thread."


def losing_lines(results: Results) -> Iterator[str]:
    """Where another is faster than Ebb, the worst first."""
    slower = [one for one in comparisons(results) if one.ratio.median > SLOWER and not one.other.startswith("Ebb,")]
    for one in sorted(slower, key=lambda one: -one.ratio.median):
        yield f"`{one.program}`, {plural(one.threads)}: Ebb takes {times(one.ratio)} what {one.other} takes."


def times(ratio: Spread) -> str:
    return f"{ratio.median:.2f} times{quartiles(ratio, '.2f')}"


def quartiles(values: Spread, form: str = ".0%") -> str:
    return f" (quartiles {values.low:{form}} and {values.high:{form}})"


def plural(threads: int) -> str:
    return f"{threads} thread" if threads == 1 else f"{threads} threads"


def threads_of(results: Results) -> list[int]:
    return sorted({one["threads"] for program in results["programs"] for one in program["contestants"]})


# --- the documentation ----------------------------------------------------------------------------------------------


def write_docs(results: Results, kept: str, path: Path) -> None:
    """The page, whole; nobody edits it by hand. ``kept`` is the name of the file that has the results."""
    path.write_text("\n".join(page(results, kept)) + "\n", encoding="utf-8")


def page(results: Results, kept: str) -> Iterator[str]:
    machine = results["machine"]
    yield from (
        "# Benchmarks",
        "",
        "<!-- Written by `make bench-docs`: change benchmarks/report.py, not this page. -->",
        "",
        f"One run of `make bench`, {results['date'][:10]}, commit {machine['commit']}, on {machine['processor']}, "
        f"{machine['cores']} cores, {machine['cache']} last-level cache, {machine['system']}, "
        f"Python {machine['python']}; the load was {machine['load']} at the start. "
        f"The numbers behind it: [{kept}](../benchmarks/results/{kept}).",
        "",
    )
    if float(machine["load"]) > BUSY:
        yield from ("**Others kept the machine busy during this run: the figures are preliminary.**", "")
    yield "Time of a step, the fastest in bold; the table below has spreads and ratios."
    yield ""
    yield from markdown(("program", "threads", *(SYSTEMS[name].title for name in COLUMNS)), summary_rows(results))
    yield from section("Where Ebb is slower", bullets(losing_lines(results), "Nowhere in this run, by more than 2 %."))
    yield from section("Ebb against itself and the machine", bullets([*verdict_lines(results), *peak_lines(results)]))
    if results.get("startup"):
        yield from section("Starting", (STARTUP_TEXT, "", *markdown(STARTUP_HEADERS, startup_rows(results))))
    yield from section("How it is measured", (METHOD.format(**method_facts(results)), "", *program_bullets(results)))
    yield from section("Every row", (ROWS_TEXT, "", *markdown(HEADERS, all_rows(results))))


STARTUP_TEXT = """\
Fresh processes, one after the other. *Import* is beyond Python, NumPy and, for Ebb, llvmlite. *Set up* makes the arrays
and defines the kernel `y = a*x + y` (1000 rows); for C++ it is g++ and the loading of the library. *Cold* is with an
empty cache, *cached* is another process after it."""

ROWS_TEXT = """\
*x C++* is the median of the ratios to C++ with as many threads, round by round: above 1 is slower. *Of the bound* is
the time that the machine needs at least, divided by the median: what the program must move at the rate of a triad over
as large a working set, or its operations at the rate of multiply-adds in registers. Each array counts once for each
pass over it, twice where it is written without being read, since its cache lines are read first; so for the triad.
Where another program stands after a name, Ebb ran that one in the same rounds, to compare with."""

METHOD = """\
All systems get the same input, in float32, and must compute what NumPy computes in float64, within a tolerance, before
anything is timed. Each has a process of its own for each program and number of threads. They wait while others run:
the driver asks them in turn for steps of about {batch:.0f} ms in all, in {rounds} rounds, each beginning with another
system, so that all see the same machine. Compiling and the first steps are not counted. Medians and quartiles are of
the rounds.

- C++ is `{cpp}`, loops over a CSR index, by hand; one thread without OpenMP, several with it; scatters
  use OpenMP's atomics.
- Numba {numba}: `njit(fastmath=True)`, `parallel=True` where there are several threads. It has no atomics on the CPU,
  so the loops that scatter stay on one thread.
- Taichi {taichi} and Quadrants {quadrants}: kernels over dense fields of numbers and vectors with the default options;
  `+=` is atomic where it must be.
- Warp {warp}: kernels over `wp.vec3` arrays, without the code for adjoints. On the CPU it uses one thread.
- Ebb {ebb}: the programs of `benchmarks/systems/ebb.py`, without any option but the number of threads.

`make bench` repeats it on your machine in some minutes; it needs g++ for C++, and makes an environment of its own for
the peers. What is not installed is left out. `python -m benchmarks.run --help` lists the options. The programs:
"""


def method_facts(results: Results) -> dict[str, object]:
    found = versions(results)
    facts: dict[str, object] = {name: found.get(SYSTEMS[name].title, "(not installed)") for name in COLUMNS}
    return {**facts, "batch": results["batch"] * 1e3, "rounds": results["rounds"]}


def program_bullets(results: Results) -> Iterator[str]:
    for program in results["programs"]:
        size = f"; arrays of {program['working_set'] / 1e6:.3g} MB" if program["work"] else ""
        yield f"- `{program['name']}`: {title_of(program)}{size}."


def summary_rows(results: Results) -> Iterator[tuple[str, ...]]:
    for program in results["programs"]:
        if program["name"] == "fma":
            continue
        for threads in threads_of({"programs": [program]}):
            found = {name: find(program, name, threads) for name in COLUMNS}
            medians = {name: spread(one["seconds"]).median for name, one in found.items() if one}
            best = min(medians.values(), default=0.0)
            texts = (duration(medians[name]) if name in medians else "-" for name in COLUMNS)
            marked = (
                f"**{text}**" if medians.get(name) == best else text for name, text in zip(COLUMNS, texts, strict=True)
            )
            yield (f"`{program['name']}`", str(threads), *marked)


def all_rows(results: Results) -> Iterator[tuple[str, ...]]:
    for program in results["programs"]:
        for row in rows_of(results, program):
            yield (f"`{program['name']}`", *cells(row))


def section(title: str, lines: Iterable[str]) -> Iterator[str]:
    yield from ("", f"## {title}", "", *lines)


def bullets(lines: Iterable[str], none: str = "") -> Iterator[str]:
    found = [f"- {line}" for line in lines]
    yield from found or [none]


def markdown(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield line_of(headers)
    yield line_of(["---"] * len(headers))
    yield from map(line_of, rows)


def line_of(texts: Sequence[str]) -> str:
    return f"| {' | '.join(texts)} |"
