"""The disk cache of object code: files named by a hash of everything that the code depends on.

Any number of processes may share a folder. A file is written under another name and then renamed, so that none is ever
seen half written, and it begins with a checksum, so that a damaged one is compiled again.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import warnings
from pathlib import Path

from ebb.records import field, record

_ENVIRONMENT = "EBB_CACHE_DIR"
_CHECKSUM_BYTES = hashlib.sha256().digest_size


def cache_directory() -> Path:
    """Where object code is kept: ``EBB_CACHE_DIR``, else ``ebb`` in the user's folder for caches."""
    chosen = os.environ.get(_ENVIRONMENT)
    if chosen:
        return Path(chosen)
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or "~/AppData/Local"
    elif sys.platform == "darwin":
        base = "~/Library/Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "ebb"


def key_of(*parts: str) -> str:
    """The name under which code that depends on ``parts`` is kept."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(f"{len(part)}:".encode())
        digest.update(part.encode())
    return digest.hexdigest()


@record(frozen=False)
class ObjectCache:
    """The object code in one folder. Without the folder everything works, and is compiled anew in each process.

    Attributes:
        directory: the folder, made when it is first needed.
    """

    directory: Path = field(default_factory=cache_directory)
    _warned: bool = False

    def get(self, key: str) -> bytes | None:
        """The code kept under ``key``, or None where there is none that is whole."""
        try:
            content = self._path(key).read_bytes()
        except OSError:
            return None
        checksum, image = content[:_CHECKSUM_BYTES], content[_CHECKSUM_BYTES:]
        return image if image and hashlib.sha256(image).digest() == checksum else None

    def put(self, key: str, image: bytes) -> None:
        """Keeps ``image`` under ``key``. Warns once where the folder cannot be written."""
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self.directory, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(hashlib.sha256(image).digest() + image)
                os.replace(name, self._path(key))
            except BaseException:
                Path(name).unlink(missing_ok=True)
                raise
        except OSError as error:
            self._warn(error)

    def _path(self, key: str) -> Path:
        return self.directory / f"{key}.o"

    def _warn(self, error: OSError) -> None:
        if not self._warned:
            self._warned = True
            warnings.warn(
                f"compiled kernels cannot be kept in {self.directory}: {error}; set {_ENVIRONMENT} to a folder that can"
                " be written, or every run compiles its kernels again",
                stacklevel=2,
            )
