"""A compiled kernel bound to a set of rows: what a repeated launch runs.

All that does not change between launches is put into the argument block once, the addresses of indexes again whenever
the structure has changed. A launch writes the addresses of fields, which swaps replace, and the uniforms, and calls the
machine code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ebb.backends.llvm.layout import layout_of
from ebb.backends.printing import PrintBuffer
from ebb.backends.tiles import tile_boxes
from ebb.compiler import kir, lir
from ebb.compiler.lower import error_at
from ebb.relations.field import Field
from ebb.relations.grouping import Grouping
from ebb.relations.subset import RowSet
from ebb.runtime import random
from ebb.runtime.buffer import Array, aligned_zeros, column_stride
from ebb.runtime.cpu import BLOCKS, BOXES, ITEMS, ROWS, STARTS, WAVES, ArgumentBlock, CpuCode, CpuDevice
from ebb.types.types import Kind, ScalarType

_VIEWS = {
    (Kind.BOOL, 8): "B",
    (Kind.SIGNED, 32): "i",
    (Kind.SIGNED, 64): "q",
    (Kind.UNSIGNED, 32): "I",
    (Kind.UNSIGNED, 64): "Q",
    (Kind.FLOAT, 32): "f",
    (Kind.FLOAT, 64): "d",
}
"""The view of the argument block that takes a scalar."""


class Binding:
    """A program, its code, and the argument block for launches on one set of rows."""

    def __init__(
        self, kernel: kir.Kernel, program: lir.Program, code: CpuCode, device: CpuDevice, rows: RowSet
    ) -> None:
        self._kernel = kernel
        self._program = program
        self._code = code
        self._device = device
        self._layout = layout_of(program)
        self._block = ArgumentBlock(self._layout.words, device.threads)
        self._blocks = self._place_rows(rows)
        self._shares = self._place_waves()
        self._fields: list[tuple[int, Field]] = []
        self._sources: list[tuple[int, Callable[[], Array | None]]] = []
        self._arrays: list[Array] = []
        self._uniforms: list[tuple[Callable[[int, Any], None], int, int, int]] = []
        self._random_words: dict[lir.RandomWord, int] = {}
        self._prints: PrintBuffer | None = None
        self._kept: list[Array] = []
        for slot in program.slots:
            self._bind_slot(slot, rows)
        for argument in program.arguments:
            self._bind_argument(argument)

    def settle(self) -> None:
        """Puts the addresses of indexes in place, which lie elsewhere after a change of the structure."""
        arrays: list[Array] = []
        for word, source in self._sources:
            array = source()
            assert array is not None
            self._block.words[word] = array.ctypes.data
            arrays.append(array)
        self._arrays = arrays  # held while their addresses are in use

    def run(self, uniforms: tuple[Any, ...]) -> None:
        """Launches the code once. The caller holds ``launching()``: there is one argument block.

        Raises:
            EbbError: an assertion or a check of the kernel failed for some row.
        """
        words = self._block.numbers
        # Held, so that no memory goes while the code runs, should another thread swap or group meanwhile.
        held = [field.buffer for _, field in self._fields]
        for (word, _), buffer in zip(self._fields, held, strict=True):
            words[word] = buffer.address
        for store, place, uniform, component in self._uniforms:
            value = uniforms[uniform]
            store(place, value.item() if component < 0 else value.flat[component].item())
        if self._random_words:
            self._draw_key()
        try:
            failed = self._device.launch(self._code, self._block, self._shares)
            failure = self._block.take_failure() if failed else None
        except BaseException:  # an interrupt: the failure of this launch is none of the next
            self._block.failures.fill(0)
            raise
        if self._prints is not None:
            self._prints.flush()
        if failure is not None:
            site, position, payload = failure
            raise error_at(self._program.sites[site], self._kernel, position, payload)

    # ---- What is bound once ----

    def _place_rows(self, rows: RowSet) -> int:
        """Puts the rows into the argument block and returns the number of blocks."""
        words = self._block.words
        if self._program.space is lir.Space.BOX:
            self._tiles = tile_boxes(rows.boxes or ())
            words[BOXES] = self._tiles.ctypes.data
            blocks = len(self._tiles)
        else:
            words[ROWS] = rows.size
            blocks = -(-rows.size // lir.BLOCK_ROWS)
        words[BLOCKS] = blocks
        return blocks

    def _place_waves(self) -> int:
        """Puts into the argument block which blocks may run at once; returns the most items of a wave."""
        words = self._block.words
        parallel = self._program.schedule is lir.Schedule.PARALLEL
        self._items = np.array([0, self._blocks], dtype=np.int64)
        self._starts = np.array([0, self._blocks if parallel else 1], dtype=np.int64)
        words[ITEMS] = 0 if parallel else self._items.ctypes.data
        words[STARTS] = self._starts.ctypes.data
        words[WAVES] = 1
        return self._blocks if parallel else 1

    def _bind_slot(self, slot: lir.Slot, rows: RowSet) -> None:
        word = self._layout.slots + slot.number
        match slot.binding:
            case lir.FieldData(field):
                self._fields.append((word, field))
            case lir.GroupOffsets(index):
                self._sources.append((word, lambda: _grouping(index).offsets))
            case lir.GroupRows(index):
                self._sources.append((word, lambda: _grouping(index).rows))
            case lir.RowOrder(relation):
                self._sources.append((word, lambda: relation.storage.order))
            case lir.LaunchPositions():
                self._sources.append((word, rows.row_positions))
            case lir.GlobalData(globl):
                self._sources.append((word, lambda: globl.data))
            case lir.Partials(reduction):
                self._keep(word, (self._blocks * self._components(reduction),), slot.type)
            case lir.PrintRecords():
                self._prints = PrintBuffer(self._kernel, self._program)
                self._block.words[word] = self._prints.address

    def _components(self, reduction: int) -> int:
        """The components of the reduction of that number: its sums are stored one block after the other."""
        sums = [stmt.var for stmt in self._program.block if isinstance(stmt, lir.Declare)]
        return sums[reduction].size

    def _keep(self, word: int, shape: tuple[int, ...], scalar: ScalarType) -> None:
        array = aligned_zeros(shape, scalar.dtype)
        self._kept.append(array)
        self._block.words[word] = array.ctypes.data

    def _bind_argument(self, argument: lir.Argument) -> None:
        word = self._layout.arguments + argument.number
        match argument.binding:
            case lir.Extent(relation, dimension):
                self._block.words[word] = relation.shape[dimension]
            case lir.ColumnStride(relation, itemsize):
                self._block.words[word] = column_stride(relation.size, itemsize)
            case lir.BlockCount():
                self._block.words[word] = self._blocks
            case lir.RandomWord():
                self._random_words[argument.binding] = word
            case lir.UniformComponent(uniform, component):
                view = self._block.views[_VIEWS[argument.type.kind, argument.type.bits]]
                shaped = self._kernel.uniforms[uniform].type.shape != ()
                place = word * (8 // view.itemsize)
                self._uniforms.append((view.__setitem__, place, uniform, component if shaped else -1))

    def _draw_key(self) -> None:
        key = random.next_launch()
        values = {
            lir.RandomWord.SEED_LOW: key.seed & 0xFFFFFFFF,
            lir.RandomWord.SEED_HIGH: key.seed >> 32,
            lir.RandomWord.LAUNCH: key.launch,
        }
        for name, word in self._random_words.items():
            self._block.words[word] = values[name]


def _grouping(index: Field) -> Grouping:
    assert index.grouping is not None
    return index.grouping
