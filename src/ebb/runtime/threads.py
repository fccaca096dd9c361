"""Threads: an OpenMP runtime that is already there, called from machine code; Python's threads where there is none."""

from __future__ import annotations

import atexit
import ctypes
import operator
import os
import sys
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

GRAIN = 25_000.0
"""Nanoseconds of work that are worth a thread. Two threads that are awake cost a launch some 2 us, asleep 10 to 60."""

GRAIN_OF_PYTHON = 1_000_000.0
"""The same for threads that Python starts anew for each launch."""

_PATIENCE = 30
"""How many seconds the end of the process waits for a launch, which may be a print that nobody takes."""

_WAITING = {"GOMP_SPINCOUNT": "4000"}
"""How libgomp's threads wait for work: some 0.2 ms awake, then asleep. So they are at hand in a loop of launches, also
where one has finished its share before the other, and lose little where other processes need the cores. Its own default
is 15 ms: with a core taken by another process, a launch of 0.3 ms took 8. Asleep at once, a launch of little work took
65 us; asleep after 15 us, steps of 1 to 20 ms took a sixth longer than now."""


@record
class OpenMP:
    """An OpenMP runtime that has been loaded: its path and the addresses of its entries."""

    path: str
    fork: int
    thread_number: int


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


@cache
def end_launches_at_exit() -> None:
    """When the process ends, lets the launch of a daemon thread come to its end, and no other begin.

    Python ends such a thread when it comes back from machine code. Where that is C++, as with drivers of devices, all
    of the process is aborted.
    """
    atexit.register(_end_launches)


def _end_launches() -> None:
    lock: Any = launching()
    lock.acquire(timeout=_PATIENCE)  # for good: who waits for it then stays there


def usable_threads(threads: int) -> int:
    """How many of ``threads`` a launch may use now: one in a process that was forked from one with threads."""
    if threads > 1 and not _process.orphaned:
        _process.forked_team = True
        return threads
    return 1


def worthwhile_threads(work: float) -> int:
    """How many threads a launch of ``work`` nanoseconds can pay for. It is for speed alone: no result depends on it."""
    if work < 2 * GRAIN:  # said without loading OpenMP
        return 1
    return max(1, int(work / (GRAIN if openmp() is not None else GRAIN_OF_PYTHON)))


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
    for path in _candidates():
        try:
            library = _load(path)
            entries = [_address(library, name) for name in ("GOMP_parallel", "omp_get_thread_num")]
        except (OSError, AttributeError):
            continue
        return OpenMP(path, *entries)
    return None


def _load(path: str) -> ctypes.CDLL:
    """Loads an OpenMP runtime, whose threads shall not spin for long: that takes the cores from those that work."""
    chosen = "OMP_WAIT_POLICY" in os.environ or "GOMP_SPINCOUNT" in os.environ
    if chosen:
        return ctypes.CDLL(path)
    if "gomp" not in path:
        os.environ["OMP_WAIT_POLICY"] = "passive"  # the others read it when they start their threads
        return ctypes.CDLL(path)
    os.environ.update(_WAITING)  # read while it is loaded, and not meant for the processes that this one starts
    try:
        return ctypes.CDLL(path)
    finally:
        for name in _WAITING:
            del os.environ[name]


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
    # Here, since they ask other processes, and are only needed where libgomp is not in its place.
    from ctypes.util import find_library

    found = find_library("gomp")
    if found:
        yield found
    yield from _installed("libiomp5*")
    for name in ("iomp5", "omp"):
        found = find_library(name)
        if found:
            yield found


def _installed(pattern: str) -> Iterator[str]:
    """Libraries that wheels (``intel-openmp``) put into the environment."""
    import sysconfig

    root = Path(sysconfig.get_path("data"))
    places = [root / "lib", root / "Library" / "bin", Path(sysconfig.get_path("platlib"))]
    for place in places:
        yield from sorted(str(path) for path in place.glob(pattern) if ".so" in path.name or path.suffix == ".dylib")
