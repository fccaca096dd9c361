"""``ebb.memory``: what fields, globals and indexes take on the host and on devices, and what has been moved."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ebb.records import record
from ebb.relations.field import all_fields
from ebb.relations.globals import all_globals
from ebb.relations.subset import all_subsets
from ebb.relations.table import bytes_text
from ebb.runtime.buffer import Array, Buffer
from ebb.runtime.copies import Copies, CopyState, constant_states, traffic


@record
class MemoryEntry:
    """The memory of one field, global or index.

    Attributes:
        name: ``vertices.pos``; an index has a word more, ``edges.tail offsets``.
        type: of each value.
        rows: how many values there are.
        host_bytes: what they take on the host, and as much on each device that has a copy, in whole lines of 64.
        host_valid: whether the host's copy is valid; if not, whoever looks at it waits for a device.
        devices: the devices' copies: ``device``, its name, ``nbytes`` and ``valid``.
    """

    name: str
    type: str
    rows: int
    host_bytes: int
    host_valid: bool
    devices: tuple[CopyState, ...]


@record
class MemoryReport:
    """What ``ebb.memory`` found. It prints as a table, with the size of a copy that is not valid in parentheses.

    Attributes:
        entries: one for each field, global and index, in the order in which they were made.
        uploads, uploaded_bytes: how many copies to devices there have been since the process began, and of how much.
        downloads, downloaded_bytes: the same for copies from devices.
    """

    entries: tuple[MemoryEntry, ...]
    uploads: int
    uploaded_bytes: int
    downloads: int
    downloaded_bytes: int

    @property
    def host_bytes(self) -> int:
        """The bytes on the host."""
        return sum(entry.host_bytes for entry in self.entries)

    @property
    def device_bytes(self) -> dict[str, int]:
        """The bytes on each device that has copies, valid or not, by its name."""
        totals: dict[str, int] = {}
        for entry in self.entries:
            for copy in entry.devices:
                totals[copy.device] = totals.get(copy.device, 0) + copy.nbytes
        return totals

    def __str__(self) -> str:
        totals = self.device_bytes
        sizes = [("the host", self.host_bytes), *totals.items()]
        up = _transfers(self.uploads, self.uploaded_bytes, "to devices")
        down = _transfers(self.downloads, self.downloaded_bytes, "from devices")
        cells = [("", "type", "rows", "host", *totals), *[_cells(entry, tuple(totals)) for entry in self.entries]]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        return "\n".join(
            [
                f"memory: {', '.join([f'{bytes_text(nbytes)} on {where}' for where, nbytes in sizes])}",
                f"moved: {up}, {down}",
                *[_line(row, widths) for row in cells],
            ]
        )

    def __repr__(self) -> str:
        return str(self)


def memory() -> MemoryReport:
    """What fields, globals and indexes take, on the host and on devices, which copies are valid, and what was moved.

    Fields that the compiler has made for itself are listed too. What nobody can reach any more is not. To report moves
    nothing.
    """
    entries = (*_of_fields(), *_of_globals(), *_of_orders(), *_of_subsets())
    return MemoryReport(entries, traffic.uploads, traffic.uploaded, traffic.downloads, traffic.downloaded)


def _of_fields() -> Iterator[MemoryEntry]:
    seen: set[Copies] = set()
    for field in all_fields.all():
        copies = field.buffer.copies
        # A stage is one memory by two names, and the field of a hidden index has no values.
        if copies not in seen and (copies.host.size or not field.relation.size):
            seen.add(copies)
            yield _of_buffer(field.path, repr(field.type), field.relation.size, field.buffer)
        grouping = field.grouping
        if grouping is not None:
            yield _of_index(f"{field.path} offsets", grouping.offsets)
            if grouping.rows is not None:
                yield _of_index(f"{field.path} rows", grouping.rows)


def _of_globals() -> Iterator[MemoryEntry]:
    for number, globl in enumerate(all_globals.all()):
        yield _of_buffer(f"global {number}", repr(globl.type), 1, globl.buffer)


def _of_orders() -> Iterator[MemoryEntry]:
    for relation in dict.fromkeys([field.relation for field in all_fields.all()]):
        for name, array in (("order", relation.storage.order), ("rank", relation.storage.rank)):
            if array is not None:
                yield _of_index(f"{relation.name} {name}", array)


def _of_subsets() -> Iterator[MemoryEntry]:
    for subset in all_subsets.all():
        for array in subset.kept_arrays():
            yield _of_index(f"{subset.relation.name}.{subset.name} rows", array)


def _of_buffer(name: str, type_: str, rows: int, buffer: Buffer) -> MemoryEntry:
    copies = buffer.copies
    return MemoryEntry(name, type_, rows, copies.host.size, copies.is_current, copies.states())


def _of_index(name: str, array: Array) -> MemoryEntry:
    return MemoryEntry(name, str(array.dtype), len(array), array.nbytes, True, constant_states(array))


# ---- The text ----


def _cells(entry: MemoryEntry, devices: Sequence[str]) -> tuple[str, ...]:
    """The line of ``entry``, with a column for each of ``devices``."""
    found = {copy.device: _size(copy.nbytes, copy.valid) for copy in entry.devices}
    held = [found.get(device, "") for device in devices]
    return (entry.name, entry.type, f"{entry.rows:,}", _size(entry.host_bytes, entry.host_valid), *held)


def _size(nbytes: int, valid: bool) -> str:
    return bytes_text(nbytes) if valid else f"({bytes_text(nbytes)})"


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    name, type_, *numbers = cells
    aligned = [f"{text:>{width}}" for text, width in zip(numbers, widths[2:], strict=True)]
    return "  ".join(["", f"{name:<{widths[0]}}", f"{type_:<{widths[1]}}", *aligned]).rstrip()


def _transfers(count: int, nbytes: int, where: str) -> str:
    return f"{bytes_text(nbytes)} {where} in {count:,} transfer{'' if count == 1 else 's'}"
