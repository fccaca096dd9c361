"""A compiled kernel bound to a set of rows on a device: what a repeated launch runs.

The arguments of the kernels are a list that is made once. A launch copies it, puts in the memory of the fields, which
swaps exchange, and the uniforms, and queues one launch of the device for each box of rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ebb.backends.devices.failures import FailureRecords, PrintMemory
from ebb.backends.llvm.group import FAILURES, FIRST_BLOCK, parameters
from ebb.backends.sources import Index, constant_value, index_array, random_word
from ebb.compiler import lir
from ebb.compiler.lower import error_at
from ebb.compiler.phases.residency import overwritten
from ebb.compiler.scatter.step import Step
from ebb.errors import EbbError
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.globals import Global
from ebb.relations.subset import Box, RowSet
from ebb.runtime import random
from ebb.runtime.copies import constant_on
from ebb.runtime.device import Device, Entry, KernelArgument


@record
class _Part:
    """Rows that one launch of the device runs on.

    Attributes:
        groups: how many work-groups that takes.
        words: the arguments that say which: from ``FIRST_BLOCK`` on, up to the slots.
    """

    groups: int
    words: tuple[np.int64, ...]


class _Scalar:
    """An argument: takes any number of its kind, and gives it in the type of the parameter."""

    __slots__ = ("_taken", "_written", "place")

    def __init__(self, place: int, dtype: np.dtype[Any]) -> None:
        cell = np.zeros(1, dtype=dtype)
        self.place = place
        self._written: Any = memoryview(cell)  # pyright: ignore[reportArgumentType] - NumPy's stubs have no __buffer__
        self._taken = cell.view(np.uint8) if dtype == np.bool_ else cell

    def put(self, arguments: list[Any], value: Any) -> None:
        """Puts ``value`` in its place. Floats beyond the range of the type are infinite."""
        self._written[0] = value
        arguments[self.place] = self._taken[0]


class DeviceBinding:
    """A program, its kernels, and their arguments for launches on one set of rows."""

    def __init__(
        self,
        step: Step,
        program: lir.Program,
        entries: tuple[Entry, ...],
        device: Device,
        failures: FailureRecords,
        rows: RowSet,
    ) -> None:
        self._kernel = step.kernel
        self._program = program
        self._rows = rows
        self._device = device
        self._failures = failures
        self._entry = entries[0]
        self._finish = entries[1] if len(entries) > 1 else None
        assert program.group_size is not None
        self._group_size = program.group_size
        self._places = {name: place for place, (name, _) in enumerate(parameters(program))}
        self._arguments: list[Any] = [None] * len(self._places)
        self._arguments[self._places[FAILURES]] = failures.memory
        self._parts = _parts(program, rows)
        self._groups = sum(part.groups for part in self._parts)
        first = self._places[FIRST_BLOCK]
        self._bounds = slice(first, first + len(self._parts[0].words))
        every_row = rows.size == rows.relation.size and not program.sites
        self._unread = overwritten(step.kernel, step.phases) if every_row else frozenset[Field]()
        self._uses: list[tuple[int, Field | Global, bool]] = []
        self._changes: list[Field | Global] = []
        self._rewrites: list[Field] = []
        self._indexes: list[tuple[int, Index]] = []
        self._numbers: list[tuple[_Scalar, int]] = []
        self._components: list[tuple[_Scalar, int, int]] = []
        self._random: list[tuple[_Scalar, lir.RandomWord]] = []
        self._prints: PrintMemory | None = None
        for slot in program.slots:
            self._bind_slot(slot)
        for argument in program.arguments:
            self._bind_argument(argument)

    def settle(self) -> None:
        """Puts the indexes in place, which are others after a change of the structure.

        Raises:
            BackendError: the device has no room for them.
        """
        for place, index in self._indexes:
            self._arguments[place] = constant_on(self._device, index_array(index, self._rows))

    def run(self, uniforms: Sequence[Any]) -> None:
        """Queues the kernel once, and waits for it if it can fail or prints. The caller holds ``launching()``.

        Raises:
            BackendError: the device has no room for the fields; then nothing has run.
            EbbError: an assertion or a check of the kernel failed for some row.
        """
        device = self._device
        arguments = self._arguments.copy()
        for place, used, unread in self._uses:
            arguments[place] = used.buffer.on(device, unread)
        for scalar, uniform in self._numbers:
            scalar.put(arguments, uniforms[uniform])
        for scalar, uniform, component in self._components:
            scalar.put(arguments, uniforms[uniform].flat[component])
        if self._random:
            key = random.next_launch()
            for scalar, word in self._random:
                scalar.put(arguments, random_word(word, key))
        # What the device has is up to date, so that this is true whether the launch comes about or is interrupted;
        # what it does not have, since all of it will be written, is only valid once that has been queued.
        for changed in self._changes:
            changed.buffer.changed_on(device)
        failure = self._launch(arguments)
        for rewritten in self._rewrites:
            rewritten.buffer.changed_on(device)
        if failure is not None or self._prints is not None:
            self._report(failure)

    def _launch(self, arguments: list[KernelArgument]) -> tuple[EbbError, int] | None:
        """Queues the kernels; if they can fail, waits, and gives the error and the position of the row."""
        launch, size, sites = self._device.launch, self._group_size, self._program.sites
        if sites:
            self._failures.prepare()
        if self._prints is not None:
            self._prints.prepare()
        for part in self._parts:
            arguments[self._bounds] = part.words
            launch(self._entry, part.groups, size, arguments)
        failure = self._failures.take() if sites else None
        if failure is not None:
            site, position, payload = failure
            return error_at(sites[site], self._kernel, position, payload), position
        if self._finish is not None:
            launch(self._finish, 1, size, arguments)
        return None

    def _report(self, failure: tuple[EbbError, int] | None) -> None:
        if self._prints is not None:
            self._prints.flush(None if failure is None else failure[1])
        if failure is not None:
            raise failure[0]

    # ---- What is bound once ----

    def _bind_slot(self, slot: lir.Slot) -> None:
        place = self._places[f"slot{slot.number}"]
        match slot.binding:
            case lir.FieldData(field):
                unread = field in self._unread
                self._uses.append((place, field, unread))
                if unread:
                    self._rewrites.append(field)
                elif slot.access is lir.Access.WRITE:
                    self._changes.append(field)
            case lir.GlobalData(globl):
                self._uses.append((place, globl, False))
                if slot.access is lir.Access.WRITE:
                    self._changes.append(globl)
            case lir.Partials(_, sum_):
                nbytes = self._groups * sum_.size * slot.type.dtype.itemsize
                self._arguments[place] = self._device.allocate(nbytes)
            case lir.PrintRecords():
                self._prints = PrintMemory(self._kernel, self._program, self._device)
                self._arguments[place] = self._prints.memory
            case index:
                self._indexes.append((place, index))

    def _bind_argument(self, argument: lir.Argument) -> None:
        scalar = _Scalar(self._places[f"argument{argument.number}"], argument.type.dtype)
        match argument.binding:
            case lir.RandomWord():
                self._random.append((scalar, argument.binding))
            case lir.UniformComponent(uniform, component):
                if self._kernel.uniforms[uniform].type.shape:
                    self._components.append((scalar, uniform, component))
                else:
                    self._numbers.append((scalar, uniform))
            case constant:
                scalar.put(self._arguments, constant_value(constant, self._groups))


def _parts(program: lir.Program, rows: RowSet) -> list[_Part]:
    """The launches that it takes to run ``program`` on ``rows``: one for each box."""
    if program.space is lir.Space.LINE:
        boxes = (Box((0,), (rows.size,)),)
    else:
        boxes = tuple(box for box in rows.boxes or () if box.size)
    parts: list[_Part] = []
    first_block = first_row = 0
    for box in boxes:
        bounds = [bound for pair in zip(box.start, box.stop, strict=True) for bound in pair]
        parts.append(_Part(_groups(program, box.size), tuple(map(np.int64, (first_block, first_row, *bounds)))))
        first_block += parts[-1].groups
        first_row += box.size
    return parts


def _groups(program: lir.Program, size: int) -> int:
    """How many work-groups run ``size`` rows."""
    assert program.group_size is not None
    if program.in_order:
        return 1
    groups = -(-size // program.group_size)
    return groups if program.coverage is lir.Coverage.ONE else min(groups, lir.MOST_GROUPS)
