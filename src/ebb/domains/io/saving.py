"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from ebb.domains.io.errors import UnreadableFile
from ebb.errors import MeshFormatError


@contextmanager
def replacing(path: str | PathLike[str]) -> Generator[Path, None, None]:
    """Gives a path to write to, of the same name in a folder of its own, and moves what is there to ``path`` later.

    What was at ``path`` stays as it was until then, and for good if an error leaves the block. The files of a format
    that has several move together.

    Raises:
        MeshFormatError: a file cannot be written (E701).
    """
    target = Path(path)
    try:
        with TemporaryDirectory(prefix=".ebb-", dir=target.parent) as folder:
            yield Path(folder, target.name)
            for written in Path(folder).iterdir():
                os.replace(written, target.with_name(written.name))
    except OSError as error:
        raise MeshFormatError(UnreadableFile(str(path), error.strerror or type(error).__name__)) from None
    except ValueError as error:  # a path that no file can have
        raise MeshFormatError(UnreadableFile(str(path), str(error))) from None


def write_text(path: str | PathLike[str], lines: list[str]) -> None:
    """Write the lines.

    Raises:
        MeshFormatError: the file cannot be written (E701).
    """
    with replacing(path) as file:
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
