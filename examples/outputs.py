"""Files that the programs write: whether they can be, asked before a long run, and writing them whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np


def why_unwritable(path: Path) -> str | None:
    """Why no file can be written at ``path``, or None. Its folder is made, and a file is tried in it."""
    try:
        if path.is_dir():
            return "it is a folder"
        if path.exists() and not os.access(path, os.W_OK):
            return "it may not be changed"
    except OSError as error:  # its name is too long, say
        return error.strerror or str(error)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path.parent):
            return None
    except OSError as error:
        return f"nothing can be written into {str(path.parent)!r}: {error.strerror}"


@contextmanager
def replacing(path: Path) -> Generator[Path, None, None]:
    """Gives a place to write a file to, which goes to ``path`` once it is whole. Until then the old one stays there.

    If an error leaves the block, the old one stays for good.
    """
    with TemporaryDirectory(prefix=".ebb-", dir=path.parent) as folder:
        part = Path(folder, path.name)
        yield part
        os.replace(part, path)


def save_text(path: Path, text: str) -> None:
    """Write a text, in UTF-8."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def save_arrays(path: Path, **arrays: Any) -> None:
    """Write an archive of NumPy's."""
    with replacing(path) as part, part.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)
