"""The disk cache of object code, and of what else is known of kernels: files named by a hash of all it depends on.

Whatever happens to the folder, a kernel runs and runs right: what cannot be read is compiled, and what cannot be kept
is compiled again by the next process.

- Any number of processes share a folder without locks. A file is written under another name and then renamed, so that
  none is ever seen half written.
- A file begins with a checksum over its key and the code, so that a damaged file, or one under a wrong name, is
  compiled again and replaced.
- The code will run with the rights of the user, so a file counts only if it belongs to the user or to root and nobody
  else may write to it.
- When the folder is over its limit, the files go that were not used for longest.
"""

from __future__ import annotations

import os
import re
import stat
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import suppress
from enum import Enum
from pathlib import Path

from ebb.runtime.digest import DIGEST_BYTES, checksum

_FOLDER_VARIABLE = "EBB_CACHE_DIR"
_LIMIT_VARIABLE = "EBB_CACHE_SIZE"
_MEBIBYTE = 1 << 20

DEFAULT_LIMIT = 512 * _MEBIBYTE
"""The most bytes that the folder takes, unless the environment says otherwise: some tens of thousands of kernels."""

_LARGEST_FILE = 64 * _MEBIBYTE
"""A kernel takes some kilobytes. What is larger than this is none of ours, and is not read into memory."""

_OURS = re.compile(r"[0-9a-f]{64}\.(?:[oifp]|[0-9a-f]{16}\.part)")
"""The names of our files. No other file is ever removed, should the folder hold any."""

_UNUSED_FOR = 3600.0
"""Seconds after which a use of a file is noted as its time of change; more often would cost a write for each hit."""

_STRAY_AFTER = 24 * 3600.0
"""Seconds after which a file that is still under its other name is what a killed process has left."""

_SWEEPING = "0"
"""What the key begins with after which the folder is looked through: one in sixteen does, and no count is needed."""

_SWEPT_TO = 0.75
"""The part of the limit that is left when files had to go, so that not every look finds too many again."""


def cache_directory() -> Path:
    """Where object code is kept: ``EBB_CACHE_DIR``, else ``ebb`` in the user's folder for caches."""
    chosen = os.environ.get(_FOLDER_VARIABLE)
    if chosen:
        return _absolute(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or "~/AppData/Local"
    elif sys.platform == "darwin":
        base = "~/Library/Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    found = os.path.expanduser(base)
    if found.startswith("~"):  # a user without a home, as containers have them
        return Path(os.environ.get("TMPDIR") or "/tmp") / f"ebb-{_user() or 0}"
    return _absolute(os.path.join(found, "ebb"))


def cache_limit() -> int:
    """The most bytes that the folder may take: ``EBB_CACHE_SIZE`` in MiB, else ``DEFAULT_LIMIT``. 0: keep nothing."""
    text = os.environ.get(_LIMIT_VARIABLE, "").strip()
    if not text:
        return DEFAULT_LIMIT
    if text.isdecimal():
        return int(text) * _MEBIBYTE
    problem = f"{_LIMIT_VARIABLE} is {text!r}, which is no whole number of MiB"
    _warn_once(_LIMIT_VARIABLE, f"{problem}; the limit is {DEFAULT_LIMIT // _MEBIBYTE} MiB")
    return DEFAULT_LIMIT


def cache_usage(directory: Path) -> tuple[int, int]:
    """How many kernels the folder keeps, and how many bytes our files take; none where it cannot be read."""
    files = [(path.endswith(".o"), status.st_size) for path, status in _files(directory)]
    return sum(whole for whole, _ in files), sum(size for _, size in files)


class Content(Enum):
    """What a file holds, by the end of its name."""

    CODE = ".o"
    INTERFACE = ".i"
    FACTS = ".f"
    PLAN = ".p"


class ObjectCache:
    """The object code in one folder. Without the folder everything works, and is compiled anew in each process.

    Attributes:
        directory: the folder, made when it is first needed.
        limit: the most bytes that its files may take; 0 neither reads nor keeps any.
    """

    __slots__ = ("_prefix", "directory", "limit")

    def __init__(self, directory: Path | None = None, limit: int | None = None) -> None:
        self.directory = cache_directory() if directory is None else directory
        self.limit = cache_limit() if limit is None else limit
        self._prefix = os.path.join(self.directory, "")

    def get(self, key: str, content: Content = Content.CODE) -> bytes | None:
        """The code, or other content, kept under ``key``, or None where there is none that is whole and ours."""
        if not self.limit:
            return None
        path = f"{self._prefix}{key}{content.value}"
        try:
            with open(path, "rb", buffering=0, opener=_open_to_read) as file:
                status = os.fstat(file.fileno())
                if not _is_trusted(status) or status.st_size > _LARGEST_FILE:
                    return None
                whole = file.read(status.st_size)
        except OSError:
            return None
        image = whole[DIGEST_BYTES:]
        if not image or whole[:DIGEST_BYTES] != checksum(key, image):
            return None
        if abs(time.time() - status.st_mtime) > _UNUSED_FOR:
            with suppress(OSError):
                os.utime(path)
        return image

    def put(self, key: str, image: bytes, content: Content = Content.CODE) -> None:
        """Keeps ``image`` under ``key``. Where that cannot be done, warns once a process."""
        if len(image) + DIGEST_BYTES > min(self.limit, _LARGEST_FILE):
            return
        part = f"{self._prefix}{key}.{os.urandom(8).hex()}.part"
        try:
            self.directory.mkdir(mode=0o700, parents=True, exist_ok=True)
            try:
                _write(part, checksum(key, image) + image)
                os.replace(part, f"{self._prefix}{key}{content.value}")
            except BaseException:
                with suppress(OSError):
                    os.unlink(part)
                raise
        except OSError as error:
            if self.get(key, content) is None:  # else another process was quicker, and holds the file
                self._warn(error)
            return
        if key.startswith(_SWEEPING):
            self._sweep()

    def _warn(self, error: OSError) -> None:
        problem = f"compiled kernels cannot be kept in {self.directory}: {error}"
        hint = f"set {_FOLDER_VARIABLE} to a folder that can be written, or every run compiles its kernels again"
        _warn_once(_FOLDER_VARIABLE, f"{problem}; {hint}")

    def _sweep(self) -> None:
        """Removes what killed processes have left and, over the limit, the files that were not used for longest.

        Other processes may do the same at the same time. Who reads a file that is removed reads on.
        """
        now, kept = time.time(), list[tuple[float, int, str]]()
        for path, status in _files(self.directory):
            if not path.endswith(".part"):
                kept.append((status.st_mtime, status.st_size, path))
            elif now - status.st_mtime > _STRAY_AFTER:
                _remove(path)
        total = sum(size for _, size, _ in kept)
        if total <= self.limit:
            return
        for _, size, path in sorted(kept):
            _remove(path)
            total -= size
            if total <= self.limit * _SWEPT_TO:
                return


def _files(directory: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Our files in ``directory`` that are still there when their turn comes."""
    with suppress(OSError), os.scandir(directory) as entries:
        for entry in entries:
            if _OURS.fullmatch(entry.name):
                with suppress(OSError):
                    status = entry.stat(follow_symlinks=False)
                    if stat.S_ISREG(status.st_mode):
                        yield entry.path, status


def _remove(path: str) -> None:
    with suppress(OSError):  # gone already, or open on Windows
        os.unlink(path)


def _open_to_read(path: str, flags: int) -> int:
    # Not to wait: what lies there may be a pipe.
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _open_to_write(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def _write(path: str, content: bytes) -> None:
    with open(path, "xb", buffering=0, opener=_open_to_write) as file:
        if not _is_trusted(os.fstat(file.fileno())):
            raise PermissionError("files there may be changed by other users")
        rest = memoryview(content)
        while rest:
            rest = rest[file.write(rest) :]


def _is_trusted(status: os.stat_result) -> bool:
    """Whether it is a plain file that only the user, or root, can have written."""
    if not stat.S_ISREG(status.st_mode):
        return False
    user = _user()
    return user is None or (status.st_uid in (user, 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH))


def _user() -> int | None:
    """The user that the process acts for; None where files are kept apart in other ways."""
    return os.geteuid() if sys.platform != "win32" else None


def _absolute(path: str) -> Path:
    """``path`` from where the process is now, as far as that is known: its folder may have been removed."""
    try:
        return Path(os.path.abspath(path))
    except OSError:
        return Path(path)


class _Warned:
    """What this process has warned of, by the variable that would help."""

    variables: frozenset[str] = frozenset()


def _warn_once(variable: str, message: str) -> None:
    if variable not in _Warned.variables:
        _Warned.variables |= {variable}
        warnings.warn(message, stacklevel=3)
