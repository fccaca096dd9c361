"""What the programs take at the command line, and the refusal, before they run, of what would fail in the end."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Annotated

import typer

from outputs import why_unwritable

Backend = Annotated[str, typer.Option(help="cpu, opencl, cuda or reference")]
Threads = Annotated[int | None, typer.Option(help="for cpu; by default all cores", min=1)]

BY_MESHIO = (".vtu", ".vtk", ".pvd", ".ply", ".obj")


def positive(value: float | None) -> float | None:
    """Refuse a number that is not above 0, or infinite, or none: a callback of options."""
    if value is not None and not 0 < value < math.inf:
        raise typer.BadParameter(f"{value:g} is not a positive number")
    return value


def finite(value: float | None) -> float | None:
    """Refuse a number that is infinite or none: a callback of options."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value:g} is not a finite number")
    return value


def check_output(option: str, path: Path | None, *formats: str) -> None:
    """Check that a file can be written; its folder is made.

    Args:
        option: by which the file is named, ``--save``.
        path: of the file; None where none is wanted.
        formats: the endings, in small letters, of which it must have one; with ``""`` among them it may have none.

    Raises:
        BadParameter: its ending is another, or its format needs a package that is missing, or it cannot be written.
    """
    if path is None:
        return
    ending = path.suffix.lower()
    if ending not in formats:
        raise typer.BadParameter(f"{path} should end in {' or '.join(filter(None, formats))}", param_hint=option)
    if ending in BY_MESHIO and importlib.util.find_spec("meshio") is None:
        raise typer.BadParameter(f'{ending} files need meshio (pip install "ebblang[mesh]")', param_hint=option)
    reason = why_unwritable(path)
    if reason is not None:
        raise typer.BadParameter(f"{path} cannot be written: {reason}", param_hint=option)
