"""Which backend kernels run on: ``ebb.set_backend``, ``ebb.backend`` and ``EBB_BACKEND``."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from typing import Any

from ebb.backends.backend import Backend
from ebb.backends.cpu import cpu_backend
from ebb.errors import BackendError
from ebb.records import record
from ebb.runtime.device import use_device
from ebb.runtime.epoch import structure_changed
from ebb.runtime.errors import BadSwitch, UnknownBackend, UnknownBackendOption
from ebb.runtime.recording import refuse


def _reference_backend() -> Backend:
    from ebb.backends.reference import reference_backend  # here: few programs run on it

    return reference_backend()


def _opencl_backend(device: Any = None, deterministic: bool = False, reorder: bool = True) -> Backend:
    from ebb.backends.devices.select import opencl_backend  # here: not every machine has such a device

    return opencl_backend(device, deterministic, reorder)


def _cuda_backend(device: Any = 0, deterministic: bool = False, reorder: bool = True) -> Backend:
    from ebb.backends.devices.select import cuda_backend

    return cuda_backend(device, deterministic, reorder)


_SWITCHES = frozenset({"reorder", "atomics", "deterministic"})
"""The options that are True or False."""

#: How to make each backend, and the options that it takes.
BACKENDS: Mapping[str, tuple[Callable[..., Backend], tuple[str, ...]]] = {
    "cpu": (cpu_backend, ("threads", "reorder", "atomics")),
    "reference": (_reference_backend, ()),
    "opencl": (_opencl_backend, ("device", "deterministic", "reorder")),
    "cuda": (_cuda_backend, ("device", "deterministic", "reorder")),
}


@record(frozen=False)
class _Selection:
    """The one piece of state here: what ``set_backend`` chose last, None before the first use."""

    backend: Backend | None = None


_selection = _Selection()


def set_backend(name: str, **options: Any) -> None:
    """Makes all kernels run on the backend ``name`` from now on.

    Args:
        name: ``"cpu"``, ``"reference"``, ``"opencl"`` or ``"cuda"``.
        **options: all but reference take ``reorder=False``, so that launches leave the rows of relations where they
            are. For cpu ``threads=`` is the number of threads, ``EBB_NUM_THREADS`` or all cores by default; with
            ``atomics=True`` reductions into other rows are atomic updates: then the bits of sums depend on the threads.
            For opencl and cuda ``device=`` is one of the devices that ``ebb info`` lists, by its number, or for opencl
            by a part of its name; with ``deterministic=True`` sums in other rows have the same bits at each run.

    Raises:
        BackendError: there is no such backend, it does not take an option, or this machine lacks what it needs.
    """
    refuse("choosing a backend", "choose it before the with statement, or before the step runs")
    _select(_make_backend(name, options))


@contextmanager
def backend(name: str, **options: Any) -> Generator[None, None, None]:
    """Makes kernels run on the backend ``name`` within a ``with`` statement. Arguments as for ``set_backend``.

    Raises:
        BackendError: as ``set_backend``.
    """
    refuse("choosing a backend", "choose it before the with statement, or before the step runs")
    chosen, before = _make_backend(name, options), _selection.backend
    _select(chosen)
    try:
        yield
    finally:
        _select(before)


def current_backend() -> Backend:
    """The backend that launches run on: the last one set, else ``EBB_BACKEND``, else cpu.

    Raises:
        BackendError: ``EBB_BACKEND`` names no backend.
    """
    chosen = _selection.backend
    if chosen is None:
        chosen = _make_backend(os.environ.get("EBB_BACKEND") or "cpu", {})
        _select(chosen)
    return chosen


def _select(backend: Backend | None) -> None:
    """Makes ``backend`` the current one; None: what is current is decided when it is first needed."""
    _selection.backend = backend
    use_device(None if backend is None else backend.device)
    structure_changed()


def _make_backend(name: str, options: Mapping[str, Any]) -> Backend:
    if not isinstance(name, str) or name not in BACKENDS:  # pyright: ignore[reportUnnecessaryIsInstance]
        raise BackendError(UnknownBackend(str(name), tuple(BACKENDS)))
    make, accepted = BACKENDS[name]
    for option, value in options.items():
        if option not in accepted:
            raise BackendError(UnknownBackendOption(name, option, accepted))
        if option in _SWITCHES and not isinstance(value, bool):
            raise BackendError(BadSwitch(name, option, value))
    return make(**options)
