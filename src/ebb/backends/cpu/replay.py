"""A captured step on the backend ``cpu``: a table of operations that machine code goes through, without Python.

Each launch of the step has an argument block of its own, a copy of its binding's with the values of its uniforms. Where
the memory of fields lies is kept in a table meanwhile; when the machine code is done, or has failed, the fields are
given what the table says.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from time import perf_counter

import numpy as np

from ebb.backends.backend import Operation, RunKernel, SetGlobal, SwapFields
from ebb.backends.cpu.binding import Binding
from ebb.backends.cpu.together import RunBinding, Together, grouped
from ebb.backends.kernel_code import Bindings, NoRows
from ebb.compiler import lir
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.runtime import random
from ebb.runtime.buffer import Array, host_code_uses
from ebb.runtime.cpu import THREADS, Driver
from ebb.runtime.replay import (
    BUFFERS,
    COUNT,
    DRAWN,
    FAILED,
    LAUNCHES,
    NONE,
    OPERATION_WORDS,
    OPERATIONS,
    RUNS,
    STATE_WORDS,
    TABLE,
    TEAM,
    TOGETHER_WORDS,
    TURNS,
    Kind,
)
from ebb.runtime.threads import openmp

SLICE_SECONDS = 0.05
"""About how long the machine code runs at a time: in between Python takes notice of an interrupt."""


class Replay:
    """A step that is ready to run, until the structure changes."""

    def __init__(self, driver: Driver, operations: Sequence[Operation]) -> None:
        """Makes the table of ``operations``.

        Args:
            driver: the machine code.
            operations: what the step consists of; fields that are swapped have the same layout.

        Raises:
            BackendError: a device does not give what it has.
        """
        self._driver = driver
        self._numbers: dict[Field, int] = {}
        self._rows: list[list[int]] = []
        self._launches: dict[int, tuple[Binding, Array]] = {}
        self._swapped: dict[Field, int] = {}
        self._set: list[Global] = []
        self._kept: list[object] = []
        self._slice = 1
        self._waiting: list[RunBinding] = []
        self._teams: list[tuple[int, list[Binding]]] = []
        for operation in operations:
            self._add(operation)
        self._add_waiting()
        exchanged = [each.buffer for each in (*self._swapped, *self._set)]
        host_code_uses(exchanged, exchanged)  # by other names, launches may write what is swapped
        self._table = np.array(self._rows, dtype=np.int64).reshape(-1, OPERATION_WORDS)
        self._buffers = np.zeros(max(len(self._numbers), 1), dtype=np.int64)
        self._state = np.zeros(STATE_WORDS, dtype=np.int64)
        self._state[OPERATIONS] = self._table.ctypes.data
        self._state[COUNT] = len(self._table)
        self._state[BUFFERS] = self._buffers.ctypes.data
        self._address: int = self._state.ctypes.data

    def run(self, count: int) -> None:
        """Runs the step ``count`` times. The caller holds ``launching()``.

        Raises:
            EbbError: an assertion or a check of a kernel failed for some row; what comes after it has not run.
        """
        while count and len(self._table):
            turns = min(self._slice, count)
            start = perf_counter()
            self._run_turns(turns)
            seconds = perf_counter() - start
            count -= turns
            if seconds < SLICE_SECONDS / 4 and turns == self._slice:
                self._slice *= 2
            elif seconds > SLICE_SECONDS:
                self._slice = max(1, self._slice // 2)

    def _run_turns(self, turns: int) -> None:
        """Calls the machine code once. Before and after it fields own their memory, as who interrupts it expects."""
        held = [field.buffer for field in self._numbers]
        self._buffers[: len(held)] = [buffer.address for buffer in held]
        by_address = {held[number].address: held[number] for number in self._swapped.values()}
        self._begin(turns)
        failure = None
        try:
            if self._driver.replay(self._address):
                failure = self._launches[int(self._state[FAILED])][0].take_failure()
        except BaseException:  # an interrupt: a failure that nobody has seen is none of the next launch
            for binding, _ in self._launches.values():
                binding.forget_failures()
            raise
        finally:
            for field, number in self._swapped.items():
                field.buffer = by_address[int(self._buffers[number])]
            random.go_on_from(int(self._state[DRAWN]))
        if failure is not None:
            raise failure

    def _begin(self, turns: int) -> None:
        """Puts in place what may have changed since the last call without a change of the structure."""
        key = random.present_key()
        self._state[DRAWN] = key.launch
        self._state[RUNS] = turns
        for binding, words in self._launches.values():
            words[THREADS] = binding.threads()
            if binding.random_words:
                binding.place_key(words, key)
        for place, bindings in self._teams:
            self._table[place, TEAM] = max([binding.threads() for binding in bindings])

    # ---- The table. ----

    def _add(self, operation: Operation) -> None:
        match operation:
            case RunKernel(Binding() as binding, uniforms):
                self._waiting.append(RunBinding(binding, uniforms))
            case RunKernel(Bindings(bindings=bindings), uniforms):
                for bound in bindings:
                    self._add(RunKernel(bound, uniforms))
            case RunKernel(NoRows(draws=draws)):
                if draws:
                    self._add_waiting()
                    self._add_row(Kind.DRAW)
            case RunKernel():
                raise TypeError(f"{operation.bound!r} is not bound to this backend")
            case SwapFields(left, right):
                self._add_waiting()
                self._swapped.update({field: self._number(field) for field in (left, right)})
                self._add_row(Kind.SWAP, self._number(left), self._number(right))
            case SetGlobal(globl, value):
                self._add_waiting()
                source = np.ascontiguousarray(value)
                self._kept.append(source)
                self._set.append(globl)
                self._add_row(Kind.COPY, globl.data.ctypes.data, source.ctypes.data, source.nbytes)

    def _add_waiting(self) -> None:
        """Adds the launches since the last operation of another kind."""
        for group in grouped(self._waiting):
            if len(group) > 1:
                self._add_together(group)
            else:
                for launch in chain(*group.launches.values()):
                    self._add_launch(launch, Kind.LAUNCH)
        self._waiting = []

    def _add_together(self, group: Together) -> None:
        """Adds launches that run together: those that put addresses in place, then what runs."""
        launches, turns = list[int](), list[tuple[int, int, int]]()
        for each in group.launches.values():
            first, blocks = len(launches), each[0].binding.blocks
            for launch in each:
                words = self._add_launch(launch, Kind.PLACE)
                launches.append(words.ctypes.data)
            turns += [(first, len(launches), block) for block in range(blocks)]
        turns.sort(key=lambda turn: turn[0] - turn[1])  # the longest first: so threads end at about the same time
        tables = np.array(turns, dtype=np.int64), np.array(launches, dtype=np.int64)
        what = np.zeros(TOGETHER_WORDS, dtype=np.int64)
        what[[TURNS, TABLE, LAUNCHES]] = len(turns), tables[0].ctypes.data, tables[1].ctypes.data
        self._kept += [tables, what]
        bindings = [launch.binding for launch in chain(*group.launches.values())]
        self._teams.append((len(self._rows), bindings))
        runtime = openmp() if max([binding.threads() for binding in bindings]) > 1 else None
        self._add_row(Kind.TOGETHER, what.ctypes.data, 0 if runtime is None else runtime.fork, 1)

    def _add_launch(self, launch: RunBinding, kind: Kind) -> Array:
        """Adds a launch, which runs or only puts addresses in place, and gives its argument block."""
        binding = launch.binding
        words, held = binding.copy_block(launch.uniforms)
        pairs = [(word, self._number(field)) for word, field in binding.field_words]
        places = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        self._kept += [places, held]
        self._launches[len(self._rows)] = binding, words
        number = binding.random_words.get(lir.RandomWord.LAUNCH, NONE)
        self._add_row(kind, words.ctypes.data, places.ctypes.data, len(places), number)
        return words

    def _add_row(self, kind: Kind, *words: int) -> None:
        self._rows.append([kind, *words, *[0] * (OPERATION_WORDS - 1 - len(words))])

    def _number(self, field: Field) -> int:
        """The number of ``field`` in the table of buffers."""
        return self._numbers.setdefault(field, len(self._numbers))
