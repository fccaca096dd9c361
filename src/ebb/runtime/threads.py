"""Threads: an OpenMP runtime that is already there, called from machine code; Python's threads where there is none."""

from __future__ import annotations

import ctypes
import ctypes.util
import operator
import os
import sys
import sysconfig
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any

from ebb.errors import BackendError
from ebb.records import field, record
from ebb.runtime.errors import BadThreadCount

MOST_THREADS = 1024
"""More than this is taken for a mistake."""

_ENVIRONMENT = "EBB_NUM_THREADS"


@record
class OpenMP:
    """An OpenMP runtime that has been loaded: its path and the addresses of its entries."""

    path: str
    fork: int
    thread_number: int
    thread_count: int


@record(frozen=False)
class _Process:
    """What a process must know of its threads: they do not survive a fork, and what they held stays held."""

    forked_team: bool = False
    orphaned: bool = False
    launching: AbstractContextManager[Any] = field(default_factory=threading.RLock)


_process = _Process()


def _after_fork() -> None:
    # The pool of the parent is not there in the child, and OpenMP would wait for it for ever.
    _process.orphaned = _process.orphaned or _process.forked_team
    _process.launching = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def launching() -> AbstractContextManager[Any]:
    """What a launch holds from when it looks at the data until it is done: Python's threads launch one by one.

    A thread that holds it may launch again, as what stands in for ``sys.stdout`` or a debugger may do.
    """
    return _process.launching


def usable_threads(threads: int) -> int:
    """How many of ``threads`` a launch may use now: one in a process that was forked from one with threads."""
    if threads > 1 and not _process.orphaned:
        _process.forked_team = True
        return threads
    return 1


def thread_count(requested: Any = None) -> int:
    """The number of threads: as requested, else ``EBB_NUM_THREADS``, else the cores that the process may use.

    Raises:
        BackendError: it is no whole number from 1 to ``MOST_THREADS``.
    """
    if requested is not None:
        return _checked("threads", requested)
    text = os.environ.get(_ENVIRONMENT, "").strip()
    if text:
        return _checked(_ENVIRONMENT, int(text) if text.isdecimal() else text)
    if hasattr(os, "sched_getaffinity"):
        return min(len(os.sched_getaffinity(0)), MOST_THREADS)
    return min(os.cpu_count() or 1, MOST_THREADS)


def _checked(source: str, value: Any) -> int:
    try:
        count = operator.index(value)
    except TypeError:
        count = 0
    if isinstance(value, bool) or not 1 <= count <= MOST_THREADS:
        raise BackendError(BadThreadCount(source, value, MOST_THREADS))
    return count


@cache
def openmp() -> OpenMP | None:
    """The OpenMP runtime of this process, loaded on first use: libgomp, else Intel's or LLVM's."""
    # Read when the library is loaded. Threads that spin while they wait take the cores from those that work: on a busy
    # machine of two cores a launch of 0.5 ms took 10 to 30 ms.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    for path in _candidates():
        try:
            library = ctypes.CDLL(path)
            entries = [
                _address(library, name) for name in ("GOMP_parallel", "omp_get_thread_num", "omp_get_num_threads")
            ]
        except (OSError, AttributeError):
            continue
        return OpenMP(path, *entries)
    return None


def describe_threads() -> str:
    """How launches run on several threads here, in words, for ``ebb info``."""
    runtime = openmp()
    if runtime is not None:
        return f"OpenMP ({runtime.path})"
    return "Python threads, which start slowly: no OpenMP runtime was found (pip install ebblang[openmp])"


def _address(library: ctypes.CDLL, name: str) -> int:
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    if address is None:
        raise AttributeError(name)
    return address


def _candidates() -> Iterator[str]:
    if sys.platform.startswith("linux"):
        yield "libgomp.so.1"
    found = ctypes.util.find_library("gomp")
    if found:
        yield found
    yield from _installed("libiomp5*")
    for name in ("iomp5", "omp"):
        found = ctypes.util.find_library(name)
        if found:
            yield found


def _installed(pattern: str) -> Iterator[str]:
    """Libraries that wheels (``intel-openmp``) put into the environment."""
    root = Path(sysconfig.get_path("data"))
    places = [root / "lib", root / "Library" / "bin", Path(sysconfig.get_path("platlib"))]
    for place in places:
        yield from sorted(str(path) for path in place.glob(pattern) if ".so" in path.name or path.suffix == ".dylib")
