"""Files that the programs write: whether they can be, asked before a long run, and arrays, whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np


def why_unwritable(path: Path) -> str | None:
    """Why no file can be written at ``path``, or None. Its folder is made, and a file is tried in it."""
    if path.is_dir():
        return "it is a folder"
    if path.exists() and not os.access(path, os.W_OK):
        return "it may not be changed"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path.parent):
            return None
    except OSError as error:
        return f"nothing can be written into {str(path.parent)!r}: {error.strerror}"


def save_arrays(path: Path, **arrays: Any) -> None:
    """Write an archive of NumPy's. What was at ``path`` stays until all of the new file is there."""
    with TemporaryDirectory(prefix=".ebb-", dir=path.parent) as folder:
        part = Path(folder, path.name)
        with part.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **arrays)
        os.replace(part, path)
