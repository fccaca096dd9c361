"""Code that is found without lowering: by the text of the kernel, with what a launch must know of its program.

To lower a kernel, and to print the program that keys the cache, takes longer than to link its code. So what becomes of
a kernel is kept once more, under the text of the kernel (``kir_key``): the interface of the program, and the key of its
code. The text of the program stays the key of the code, which grids of all extents share.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import cache

from ebb.backends.cache import Content, ObjectCache
from ebb.backends.compile import kept_code
from ebb.backends.kernel_code import Draft
from ebb.backends.target import Target
from ebb.compiler.interface import Interface, interface_of, packed, unpacked
from ebb.compiler.pipeline import dumps
from ebb.runtime.digest import key_of

_PACKAGE = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
"""Without links, which may lead to another version by the time when a kernel is launched."""

_LOADED_NS = time.time_ns()

_SETTLED_NS = 2 * 10**9
"""How long before this process began a file must have changed for the last time: clocks of file systems are coarse."""


def known_code(
    draft: Draft, target: Target, kept: ObjectCache, verify: Callable[[], None]
) -> tuple[Interface, bytes]:  # fmt: skip
    """What a launch must know of the program of ``draft``, and its object code: kept, or compiled and kept.

    Args:
        draft: the program, which is lowered where it is not known.
        target: what to compile it for.
        kept: where its code may be.
        verify: verifies what it is lowered of; what is kept was verified.

    Raises:
        BackendError: as ``kept_code``.
    """
    sources = None if dumps(draft.name) or not kept.limit else package_state()
    if sources is None:
        program = draft.lower()
        return interface_of(program), kept_code(program, target, kept, verify)[1]
    kernel = draft.key()
    key = key_of(kernel.text, draft.choices, target.fingerprint, sources)
    content = kept.get(key, Content.INTERFACE)
    if content is not None:
        interface, code = unpacked(content, kernel)
        image = kept.get(code)
        if image is not None:
            return interface, image
    program = draft.lower()
    interface = interface_of(program)
    code, image = kept_code(program, target, kept, verify)
    kept.put(key, packed(interface, code, kernel), Content.INTERFACE)
    return interface, image


@cache
def package_state() -> str | None:
    """What tells this state of the package's sources from any other; None where they have changed just now.

    Nothing is read, since it would take longer than what it saves: a file that changes, or another in its place, has
    another time of change, which unlike that of modification nobody can set. Files that have changed since about the
    time when this process loaded them may differ from what runs here.
    """
    if sys.platform == "win32":  # which has no such time
        return None
    found = [sys.version]
    try:
        for entry in _files(_PACKAGE):
            status = entry.stat()
            if status.st_ctime_ns > _LOADED_NS - _SETTLED_NS:
                return None
            found.append(f"{entry.path} {status.st_ino} {status.st_size} {status.st_mtime_ns} {status.st_ctime_ns}")
    except OSError:  # the package lies in an archive
        return None
    return key_of("\n".join(sorted(found)))


def _files(folder: str) -> Iterator[os.DirEntry[str]]:
    """The source files of ``folder`` and of the folders in it."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".py"):
                yield entry
            elif entry.is_dir() and entry.name != "__pycache__":
                yield from _files(entry.path)
