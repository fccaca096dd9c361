"""Programs for groups of threads, written in LIR, and their launches on an OpenCL device."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pytest

import ebb
from ebb.backends import target
from ebb.backends.compile import _module
from ebb.backends.llvm.group import parameters
from ebb.compiler import lir, lir_print, lir_verify
from ebb.compiler.lower.builder import Builder, Values
from ebb.relations.relation import Relation
from ebb.runtime.device import FAILURE_BYTES, FAILURE_COUNT, FAILURE_START, FAILURE_WORDS
from ebb.runtime.opencl import opencl_device
from ebb.types.types import int64


@cache
def device():
    """The OpenCL device of this machine; tests that ask for it are skipped where there is none."""
    try:
        return opencl_device()
    except ebb.BackendError as error:
        if "pyopencl" in str(error):
            pytest.skip(str(error))
        raise


class Written:
    """A program in the writing.

    Attributes:
        b: what builds its bodies.
        slots: its memory, of ``types``, of which the last is written and the others are not, but where ``writes`` says.
    """

    def __init__(self, *types, writes=None):
        relation = Relation("rows", size=1)
        self.b = Builder()
        self.block_number = self.b.temp(int64)
        writes = [len(types) - 1] if writes is None else writes
        self.slots = [
            lir.Slot(
                number,
                type_,
                lir.Access.WRITE if number in writes else lir.Access.READ,
                lir.FieldData(relation.new_field(f"f{number}", type_)),
            )
            for number, type_ in enumerate(types)
        ]

    def program(
        self,
        row: Callable[[Values], None],
        group_size: int = 64,
        dimensions: int = 1,
        space: lir.Space = lir.Space.LINE,
        coverage: lir.Coverage = lir.Coverage.ONE,
        before: Callable[[], None] = lambda: None,
        after: Callable[[], None] = lambda: None,
        sites: int = 0,
        prints: int = 0,
        print_words: int = 0,
    ) -> lir.Program:
        """The program that runs ``row`` for each row, between ``before`` and ``after``."""
        b = self.b
        index = tuple(b.temp(int64) for _ in range(dimensions))
        with b.body() as block:
            before()
            with b.body() as body:
                row(index)
            b.add(lir.RowLoop(index, lir.Rows.INDEPENDENT, tuple(body)))
            after()
        program = lir.Program(
            name="test",
            space=space,
            dimensions=dimensions,
            group_size=group_size,
            coverage=coverage,
            precision=lir.Precision.CONTRACT,
            slots=tuple(self.slots),
            arguments=(),
            block_number=self.block_number,
            block=tuple(block),
            finish=(),
            private_bytes=b.private_bytes,
            sites=(None,) * sites,
            prints=(None,) * prints,
            print_words=print_words,
        )
        lir_verify.verify(program)
        return program

    def store(self, slot: int, at: lir.Value, value: lir.Value) -> None:
        self.b.add(lir.Store(self.slots[slot], at, value))

    def load(self, slot: int, at: lir.Value) -> lir.Value:
        return self.b.load(self.slots[slot], at)


_entries: dict[tuple[str, frozenset], tuple] = {}


def _loaded(program, lacks):
    key = (lir_print.text(program), lacks)
    if key not in _entries:
        _entries[key] = device().load("test", image_of(program, lacks), program.entries)
    return _entries[key]


def image_of(program: lir.Program, lacks=frozenset()) -> bytes:
    chosen = target.spirv(lacks)
    return chosen.image(_module(program, chosen))


def run(
    program: lir.Program,
    arrays: Sequence[np.ndarray],
    box: Sequence[tuple[int, int]],
    groups: int | None = None,
    lacks=frozenset(),
    first_row: int = 0,
) -> tuple[np.ndarray, int]:
    """Launches ``program`` over ``box``; ``arrays`` are what stands behind its slots, and what the launch makes of it.

    Returns the words that tell of failures, and their number.
    """
    d = device()
    (entry,) = _loaded(program, lacks)
    none = np.zeros(FAILURE_BYTES, dtype=np.uint8)
    none[:4] = 255
    failures = d.allocate(FAILURE_BYTES)
    d.upload(failures, none)
    memories = []
    for array in arrays:
        memory = d.allocate(array.nbytes + 64)
        d.upload(memory, array.reshape(-1).view(np.uint8))
        memories.append(memory)
    words = [np.int64(0), np.int64(first_row), *(np.int64(bound) for bounds in box for bound in bounds)]
    assert len(parameters(program)) == 1 + len(words) + len(arrays)
    if groups is None:
        groups = -(-math.prod(high - low for low, high in box) // program.group_size)
    d.launch(entry, groups, program.group_size, [failures, *words, *memories])
    for memory, array in zip(memories, arrays, strict=True):
        d.download(memory, array.reshape(-1).view(np.uint8))
    d.download(failures, none)
    records = none[FAILURE_START:].view(np.int64).reshape(-1, FAILURE_WORDS)
    return records, int(none[:16].view(np.uint32)[FAILURE_COUNT])
