"""LIR to what a target takes, through the disk cache; its stages as text; what it needs of a device."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import ebb.backends.llvm as emitter
from ebb.backends import target as targets
from ebb.backends.cache import ObjectCache
from ebb.backends.target import Target
from ebb.compiler import lir, lir_print, lir_verify, lir_walk
from ebb.compiler.pipeline import dump, log_time
from ebb.errors import BackendError
from ebb.runtime import cpu, device, replay
from ebb.runtime.device import Feature
from ebb.runtime.digest import key_of
from ebb.runtime.errors import VariablesTooLarge
from ebb.types.types import ScalarType, float64

MOST_PRIVATE_BYTES = 1 << 20
"""The most memory that a row's variables may take: threads have stacks of two megabytes and more."""


def object_code(
    program: lir.Program, target: Target, cache: ObjectCache, verify: Callable[[], None]
) -> bytes:  # fmt: skip
    """What ``target`` takes of ``program``, in its ``form``: ``kept_code`` without its key."""
    return kept_code(program, target, cache, verify)[1]


def kept_code(
    program: lir.Program, target: Target, cache: ObjectCache, verify: Callable[[], None]
) -> tuple[str, bytes]:  # fmt: skip
    """The key of ``program``, and what ``target`` takes of it: from ``cache``, or compiled and put there.

    Args:
        program: what to compile.
        target: for what.
        cache: where its code may be.
        verify: verifies what the program was lowered of; what is in the cache was verified.

    Raises:
        BackendError: the variables of one row do not fit on a thread's stack, or a library is not installed.
    """
    check_private_bytes(program.name, program.private_bytes)
    text = lir_print.text(program)
    dump(program.name, "lower", lambda: text)
    key = key_of(text, target.fingerprint, _emitter_version())
    image = cache.get(key)
    if image is None:
        verify()
        lir_verify.verify(program)
        start = time.perf_counter()
        module = _module(program, target)
        dump(program.name, "optimize", lambda: str(module))
        image = target.image(module)
        log_time(program.name, "compiling", start)
        cache.put(key, image)
    return key, image


def driver_code(target: Target, cache: ObjectCache, package: str | None) -> bytes:
    """The object code of the driver: from ``cache``, or compiled and put there.

    Args:
        target: what it is for.
        cache: where it may be.
        package: the state of the package's sources, None where that is not known, so that they are read.
    """
    key = key_of("driver", target.fingerprint, package or _emitter_version())
    image = cache.get(key)
    if image is None:
        from ebb.backends.llvm.driver import DRIVER_MODULE
        from ebb.backends.llvm.optimize import optimize

        image = bytes(target.machine.emit_object(optimize(DRIVER_MODULE, target)))
        cache.put(key, image)
    return image


def check_private_bytes(kernel: str, size: int) -> None:
    """Raises BackendError: the variables of ``kernel`` take ``size`` bytes, which no thread has."""
    if size > MOST_PRIVATE_BYTES:
        raise BackendError(VariablesTooLarge(kernel, size, MOST_PRIVATE_BYTES))


def stages_of(target: Target) -> tuple[str, ...]:
    """The stages beyond KIR that ``kernel.inspect`` can show of programs for ``target``."""
    return ("lir", "llvm", target.form.value)


def stage_text(program: lir.Program, target: Target, stage: str) -> str:
    """``program`` at one of ``stages_of(target)``."""
    match stage:
        case "lir":
            return lir_print.text(program)
        case "llvm":
            return llvm_text(program, target)
        case _:
            return assembly_text(program, target)


def llvm_text(program: lir.Program, target: Target) -> str:
    """``program`` as LLVM IR after LLVM's own passes."""
    return str(_module(program, target))


def assembly_text(program: lir.Program, target: Target) -> str:
    """``program`` in the target's assembly language."""
    return target.assembly(_module(program, target))


def needs(program: lir.Program) -> frozenset[Feature]:
    """What a device must have to run ``program``. Additions of floats are no need: there are other ways to do them."""
    found: set[Feature] = set()
    updated = {stmt.slot.type.bits for stmt in _statements(program) if isinstance(stmt, lir.AtomicUpdate)}
    if 64 in updated or program.prints:
        found.add(Feature.ATOMICS64)
    if float64 in _types(program):
        found.add(Feature.FLOAT64)
    return frozenset(found)


def _statements(program: lir.Program) -> Iterator[lir.Stmt]:
    return lir_walk.statements((*program.block, *program.finish))


def _types(program: lir.Program) -> set[ScalarType]:
    """The types of all that is computed."""
    found = {thing.type for things in (program.slots, program.arguments) for thing in things}
    for stmt in _statements(program):
        match stmt:
            case lir.Let(temp):
                found.add(temp.type)
            case lir.Declare(var):
                found.add(var.type)
            case _:
                pass
    return found


def _module(program: lir.Program, target: Target) -> Any:
    """What LLVM makes of ``program``."""
    # Here, since a process whose kernels are all in the cache never gets here.
    from ebb.backends.llvm.emit import emit
    from ebb.backends.llvm.optimize import optimize

    return optimize(emit(program, target.hooks), target)


@cache
def _emitter_version() -> str:
    """A hash of the sources that make machine code of LIR, so that code of another version is never taken for ours."""
    folder = next(iter(emitter.__path__))
    sources = sorted(os.path.join(folder, name) for name in os.listdir(folder) if name.endswith(".py"))
    sources += [str(module.__file__) for module in (lir, lir_walk, cpu, device, replay, targets)]
    return key_of(*map(_content, sources))


def _content(path: str) -> bytes:
    with open(path, "rb", buffering=0) as file:
        return file.read()
