"""The command line: ``ebb info | explain | run | demo``. What a command needs is imported when it runs."""

from __future__ import annotations

import os
import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    name="ebb",
    help="Ebb, a language and runtime for physical simulation.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

BackendOption = Annotated[
    str | None, typer.Option("--backend", help="The backend to start with: cpu, opencl, cuda or reference.")
]
ThreadsOption = Annotated[int | None, typer.Option("--threads", min=1, help="Threads of the cpu backend.")]
PROGRAM_ARGUMENTS = {"allow_interspersed_args": False, "ignore_unknown_options": True}


def main() -> None:
    """Runs the command line."""
    app()


@app.command()
def info() -> None:
    """Print what this installation has: versions, processor, threads, cache, backends, extras."""
    from ebb.environment import describe_environment

    rows = describe_environment()
    width = max(len(name) for name, _ in rows)
    for name, value in rows:
        typer.echo(f"{name:<{width}}  {value}")


@app.command()
def explain(code: Annotated[str | None, typer.Argument(help="A code such as E301; none lists all.")] = None) -> None:
    """Print what an error code means, with a wrong program and the right one."""
    from ebb.diagnostics.explain import find_page, known_codes, nearest_codes, page_title

    if code is None:
        for known in known_codes():
            typer.echo(page_title(known))
        return
    page = find_page(code)
    if page is None:
        nearest = nearest_codes(code)
        meant = f"; did you mean {' or '.join(nearest)}?" if nearest else "; ebb explain lists all codes"
        typer.echo(f"no error has the code {code!r}{meant}", err=True)
        raise typer.Exit(1)
    _show_markdown(page)


@app.command(context_settings=PROGRAM_ARGUMENTS)
def run(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="A Python program.")],
    arguments: Annotated[list[str] | None, typer.Argument(help="What the program gets as its arguments.")] = None,
    backend: BackendOption = None,
    threads: ThreadsOption = None,
) -> None:
    """Run a program with a backend chosen here. Options come before the file, the program's own after it."""
    _select_backend(backend, threads)
    _run_program(file, arguments or [])


@app.command(context_settings=PROGRAM_ARGUMENTS, add_help_option=False)
def demo(
    arguments: Annotated[list[str] | None, typer.Argument(help="Options of the example; --help lists them.")] = None,
) -> None:
    """Let a body of springs fall, bounce and settle: the example spring_mass.py."""
    program = _find_example("spring_mass.py")
    if program is None:
        typer.echo("The examples are not with this installation; they are in the source distribution.", err=True)
        raise typer.Exit(1)
    _run_program(program, arguments or [])


def _show_markdown(text: str) -> None:
    if not sys.stdout.isatty():
        typer.echo(text.rstrip())
        return
    from rich.console import Console
    from rich.markdown import Markdown

    Console().print(Markdown(text))


def _find_example(name: str) -> Path | None:
    """The example of that name: in the wheel beside the package, in a checkout beside ``src``."""
    package = Path(__file__).resolve().parent
    places = (package / "examples" / name, package.parents[1] / "examples" / name)
    return next((place for place in places if place.is_file()), None)


def _select_backend(backend: str | None, threads: int | None) -> None:
    from ebb.backends.select import set_backend
    from ebb.errors import EbbError

    try:
        if threads is not None:
            set_backend(backend or "cpu", threads=threads)
        elif backend is not None:
            set_backend(backend)
    except EbbError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None


def _run_program(file: Path, arguments: list[str]) -> None:
    """Runs ``file`` as ``python file arguments`` would, without the frames of this command in its tracebacks."""
    import runpy

    sys.argv = [str(file), *arguments]
    sys.path.insert(0, str(file.resolve().parent))
    try:
        runpy.run_path(str(file), run_name="__main__")
    except Exception as error:
        tail = error.__traceback__
        while tail is not None and tail.tb_frame.f_code.co_filename != str(file):
            tail = tail.tb_next
        keep = error.__traceback__ if tail is None or os.environ.get("EBB_TRACEBACK") == "1" else tail
        traceback.print_exception(error.with_traceback(keep))
        raise typer.Exit(1) from None
