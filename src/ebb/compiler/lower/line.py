"""The lines of a grid along which rows run: where coordinates wrap, and which memory rows reach in its order."""

from __future__ import annotations

from ebb.compiler import kir, lir
from ebb.records import field, record
from ebb.relations.field import Field


@record(frozen=False, eq=False)
class Line:
    """What is known of the rows of a line of a grid while a body is lowered.

    Attributes:
        extent: the length of the line.
        inside: whether the body is for rows that are not near the ends of the line.
        ends: how many rows at the beginning and at the end are near: those for which some coordinate wraps or is held.
        offsets: the difference between a coordinate and that of the row along the line, by the number of the
            temporary. Where the coordinate has been wrapped or held, that is the difference for rows inside.
        moves: the offsets of rows of the grid from the own row, by the number of the temporary that is their position.
        farthest: of each field the row that is read last of all of its place in the order, with its offsets.
    """

    extent: int
    inside: bool = False
    ends: tuple[int, int] = (0, 0)
    offsets: dict[int, int] = field(default_factory=dict[int, int])
    moves: dict[int, tuple[int, ...]] = field(default_factory=dict[int, tuple[int, ...]])
    farthest: dict[Field, tuple[tuple[int, ...], lir.Value]] = field(
        default_factory=dict[Field, "tuple[tuple[int, ...], lir.Value]"]
    )

    def begin(self, index: tuple[lir.Temp, ...], row: lir.Value) -> None:
        """Begins a body, whose row is at the position ``row``."""
        self.offsets = {index[-1].number: 0}
        self.moves = {row.number: (0,) * len(index)} if isinstance(row, lir.Temp) else {}
        self.farthest = {}

    def note_row(self, entries: tuple[kir.Entry, ...], at: tuple[lir.Value, ...], result: lir.Value) -> None:
        """Notes that ``result`` is what the affine map ``entries`` makes of the coordinates ``at``."""
        used = [coordinate for entry, coordinate in zip(entries, at, strict=False) if entry]
        plain = sum(entry == 1 for entry in entries[:-1]) == len(used) == 1 and entries[-1].denominator == 1
        if plain and (offset := self.offset(used[0])) is not None and isinstance(result, lir.Temp):
            self.offsets[result.number] = offset + int(entries[-1])

    def offset(self, coordinate: lir.Value) -> int | None:
        """The difference between ``coordinate`` and that of the row along the line, if it is one."""
        return self.offsets.get(coordinate.number) if isinstance(coordinate, lir.Temp) else None

    def note_end(self, offset: int, extent: int) -> None:
        """Notes that the coordinate ``offset`` further wraps or is held where it leaves a dimension of ``extent``."""
        before, after = self.ends
        self.ends = max(before, -offset), max(after, self.extent + offset - extent)

    def note_move(self, base: lir.Value, offsets: tuple[int, ...] | None, result: lir.Value) -> None:
        """Notes that the row at ``result`` is that at ``base`` moved by ``offsets``."""
        before = self.moves.get(base.number) if isinstance(base, lir.Temp) else None
        if before is not None and offsets is not None and isinstance(result, lir.Temp):
            self.moves[result.number] = tuple(a + b for a, b in zip(before, offsets, strict=True))

    def note_read(self, source: Field, position: lir.Value) -> None:
        """Notes that the row at ``position`` is read."""
        moved = self.moves.get(position.number) if isinstance(position, lir.Temp) else None
        if moved is not None and (source not in self.farthest or moved > self.farthest[source][0]):
            self.farthest[source] = moved, position
