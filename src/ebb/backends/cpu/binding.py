"""A compiled kernel bound to a set of rows: what a repeated launch runs.

All that does not change between launches is put into the argument block once, the addresses of indexes again whenever
the structure has changed. A launch writes the addresses of fields, which swaps replace, and the uniforms, and calls the
machine code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ebb.backends.cpu.tiles import tile_boxes
from ebb.backends.kernel_code import Draft
from ebb.backends.llvm.layout import layout_of
from ebb.backends.printing import PrintBuffer
from ebb.backends.sources import constant_value, index_array, random_word
from ebb.compiler import lir
from ebb.compiler.interface import Interface
from ebb.compiler.lower import error_at
from ebb.compiler.scatter.waves import Waves
from ebb.errors import EbbError
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.subset import RowSet
from ebb.runtime import random
from ebb.runtime.buffer import Array, aligned_zeros, host_code_uses
from ebb.runtime.cpu import (
    BLOCK_CODE,
    BOXES,
    FINISH_CODE,
    ITEMS,
    ROWS,
    SHARES,
    STARTS,
    THREADS,
    WAVES,
    ArgumentBlock,
    CpuCode,
    CpuDevice,
    Driver,
)
from ebb.runtime.threads import worthwhile_threads
from ebb.types.types import Kind, ScalarType

_VIEWS = {
    (Kind.BOOL, 8): "?",
    (Kind.SIGNED, 32): "i",
    (Kind.SIGNED, 64): "q",
    (Kind.UNSIGNED, 32): "I",
    (Kind.UNSIGNED, 64): "Q",
    (Kind.FLOAT, 32): "f",
    (Kind.FLOAT, 64): "d",
}
"""The view of the argument block that takes a scalar."""

_MANY_ROWS = 1 << 20
"""Launches of so many rows are worth all threads, whatever a row costs."""


class Binding:
    """A program, its code, and the argument block for launches on one set of rows.

    Attributes:
        rows: what a launch runs on.
        phases: how the kernel uses fields and globals.
        random_words: the words of the argument block that make launches draw other numbers, for kernels that draw.
    """

    def __init__(
        self, draft: Draft, interface: Interface, code: CpuCode, driver: Driver, device: CpuDevice, rows: RowSet
    ) -> None:  # fmt: skip
        self._draft = draft
        self._outline = draft.step.outline
        self._interface = interface
        self._code = code  # held: it would be unloaded
        self._driver = driver
        self._device = device
        self._layout = layout_of(interface)
        self._block = ArgumentBlock(self._layout.words, device.threads)
        self._block.words[[BLOCK_CODE, FINISH_CODE, SHARES]] = code.blocks, code.finish, device.shares.ctypes.data
        self.rows = rows
        self.phases = draft.step.phases
        self._rows = rows.size
        self._tiles: Array | None = None
        self._blocks = self._place_rows(rows)
        self._waves: Waves | None = None
        self._shares = 0
        self._alone = False
        self._fields: list[Field] = []
        self._field_words: list[int] = []
        self._addresses: list[int] = []
        self._globals: list[Global] = []
        self._written: list[Field | Global] = []
        self._sources: list[tuple[int, Callable[[], Array]]] = []
        self._arrays: list[Array] = []
        self._numbers: list[tuple[memoryview[Any], int, int]] = []
        self._components: list[tuple[memoryview[Any], int, int, int]] = []
        self.random_words: dict[lir.RandomWord, int] = {}
        self._prints: PrintBuffer | None = None
        self._kept: list[Array] = []
        for slot in interface.slots:
            self._bind_slot(slot, rows)
        for argument in interface.arguments:
            self._bind_argument(argument)

    def settle(self, waves: Waves | None) -> None:
        """Puts the addresses of indexes in place, which lie elsewhere after a change of the structure, and ``waves``.

        Values that a device has changed are fetched from there.

        Args:
            waves: which blocks may run at once; None for all.

        Raises:
            BackendError: a device does not give what it has.
        """
        used = [each.buffer for each in (*self._fields, *self._globals)]
        host_code_uses(used, [each.buffer for each in self._written])
        if self._shares == 0 or waves is not self._waves:
            self._place_waves(waves)
        arrays: list[Array] = []
        for word, source in self._sources:
            array = source()
            self._block.words[word] = array.ctypes.data
            arrays.append(array)
        self._arrays = arrays  # held while their addresses are in use

    def run(self, uniforms: Sequence[Any]) -> None:
        """Launches the code once. The caller holds ``launching()``: there is one argument block.

        Raises:
            EbbError: an assertion or a check of the kernel failed for some row.
        """
        # Held, so that no memory goes while the code runs, should another thread swap or group meanwhile; and no
        # longer, so that a kernel that never runs again holds none that its fields have left.
        held = [field.buffer for field in self._fields]
        addresses = [buffer.address for buffer in held]
        if addresses != self._addresses:
            self._place_fields(addresses)
        self._place_uniforms(uniforms)
        if self.random_words:
            self.place_key(self._block.words, random.next_launch())
        try:
            if self._alone:
                failed = self._driver.launch(self._block.address)
            else:
                failed = self._device.launch(self._driver, self._block, self._shares)
            failure = self.take_failure() if failed else None
        except BaseException:  # an interrupt: the failure of this launch is none of the next
            self.forget_failures()
            raise
        if self._prints is not None:
            self._prints.flush()
        if failure is not None:
            raise failure

    # ---- For captured steps ----

    @property
    def field_words(self) -> list[tuple[int, Field]]:
        """The words of the argument block that are addresses of fields, and whose."""
        return list(zip(self._field_words, self._fields, strict=True))

    def copy_block(self, uniforms: Sequence[Any]) -> tuple[Array, object]:
        """The words of the argument block with these values of the uniforms, and what to hold while they are in use."""
        self._place_uniforms(uniforms)
        words = aligned_zeros(self._block.words.shape, self._block.words.dtype)
        words[:] = self._block.words
        return words, (self._waves, self._starts, self._arrays)

    @property
    def is_apart(self) -> bool:
        """Whether a launch is nothing but its blocks, in any order: none can fail, and nothing is added up of them."""
        adds = any(isinstance(each, Global) for each in self._written) or self._kept
        ordered = self._waves is not None or self._interface.can_fail or self._prints is not None
        return not (adds or ordered or self.random_words)

    @property
    def blocks(self) -> int:
        """How many blocks a launch goes through."""
        return self._blocks

    def has_blocks_of(self, other: Binding) -> bool:
        """Whether a launch goes through the blocks of another on the same rows."""
        mine, others = self._tiles, other._tiles
        return mine is others or (mine is not None and others is not None and np.array_equal(mine, others))

    def threads(self) -> int:
        """How many threads a launch gets now."""
        return 1 if self._alone else self._device.threads_for(self._shares)

    def place_key(self, words: Array, key: random.LaunchKey) -> None:
        """Puts what makes the random numbers of a launch its own into the words of an argument block."""
        for name, word in self.random_words.items():
            words[word] = random_word(name, key)

    def take_failure(self) -> EbbError:
        """The error of the row that failed first in the launch that has just failed; the records are cleared."""
        site, position, payload = self._block.take_failure()
        return error_at(self._draft.lower().sites[site], self._draft.step.kernel, position, payload)

    def forget_failures(self) -> None:
        """Clears the records of rows that have failed."""
        self._block.failures.fill(0)

    def _place_uniforms(self, uniforms: Sequence[Any]) -> None:
        for view, place, uniform in self._numbers:
            view[place] = uniforms[uniform]
        for view, place, uniform, component in self._components:
            view[place] = uniforms[uniform].flat[component]

    def _place_fields(self, addresses: list[int]) -> None:
        words = self._block.numbers
        self._addresses = []  # should an interrupt come before all are there
        for word, address in zip(self._field_words, addresses, strict=True):
            words[word] = address
        self._addresses = addresses

    # ---- What is bound once ----

    def _place_rows(self, rows: RowSet) -> int:
        """Puts the rows into the argument block and returns the number of blocks."""
        words = self._block.words
        if self._interface.space is lir.Space.BOX:
            # Rows that may fail run in their order.
            ahead = 0 if self._interface.can_fail else self._interface.ahead_bytes
            self._tiles = tile_boxes(rows.boxes or (), ahead)
            words[BOXES] = self._tiles.ctypes.data
            return len(self._tiles)
        words[ROWS] = rows.size
        return -(-rows.size // lir.BLOCK_ROWS)

    def _place_waves(self, waves: Waves | None) -> None:
        """Puts into the argument block which blocks may run at once."""
        words = self._block.words
        self._waves = waves  # held while its addresses are in use
        self._starts = np.array([0, self._blocks], dtype=np.int64) if waves is None else waves.starts
        self._shares = self._worthwhile(self._blocks if waves is None else waves.widest)
        self._alone = self._shares == 1 or self._device.threads == 1
        if not self._alone:
            self._block.join_threads()
        words[ITEMS] = 0 if waves is None else waves.items.ctypes.data
        words[STARTS] = self._starts.ctypes.data
        words[WAVES] = len(self._starts) - 1
        words[THREADS] = 1

    def _worthwhile(self, most: int) -> int:
        """How many of ``most`` threads the work of a wave pays for: all of them, where that is sure or not known."""
        if min(most, self._device.threads) == 1 or self._rows >= _MANY_ROWS:
            return most
        cost = self._draft.step.cost()
        waves = len(self._starts) - 1
        return most if cost.uncounted else min(most, worthwhile_threads(self._rows * cost.nanoseconds / waves))

    def _bind_slot(self, slot: lir.Slot, rows: RowSet) -> None:
        word = self._layout.slots + slot.number
        match slot.binding:
            case lir.FieldData(field):
                self._fields.append(field)
                self._field_words.append(word)
                self._note_access(field, slot)
            case lir.GlobalData(globl):
                self._globals.append(globl)
                self._note_access(globl, slot)
                self._sources.append((word, lambda: globl.data))
            case lir.Partials(_, sum_):
                self._keep(word, (self._blocks * sum_.size,), slot.type)
            case lir.PrintRecords():
                self._prints = PrintBuffer(self._draft.step.kernel, self._draft.lower())
                self._block.words[word] = self._prints.address
            case index:
                self._sources.append((word, lambda: index_array(index, rows)))

    def _note_access(self, place: Field | Global, slot: lir.Slot) -> None:
        if slot.access is lir.Access.WRITE:
            self._written.append(place)

    def _keep(self, word: int, shape: tuple[int, ...], scalar: ScalarType) -> None:
        array = aligned_zeros(shape, scalar.dtype)
        self._kept.append(array)
        self._block.words[word] = array.ctypes.data

    def _bind_argument(self, argument: lir.Argument) -> None:
        word = self._layout.arguments + argument.number
        match argument.binding:
            case lir.RandomWord():
                self.random_words[argument.binding] = word
            case lir.UniformComponent(uniform, component):
                view = self._block.views[_VIEWS[argument.type.kind, argument.type.bits]]
                place = word * (8 // view.itemsize)
                if self._outline.uniforms[uniform].type.shape:
                    self._components.append((view, place, uniform, component))
                else:
                    self._numbers.append((view, place, uniform))
            case constant:
                self._block.words[word] = constant_value(constant, self._blocks)
