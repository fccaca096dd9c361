"""Loops over a list of rows as LLVM IR: up to eight rows that follow one another at once, one a lane.

The lists of subsets are often long runs. A strip takes what is left of a run, at most eight rows, as if all eight
followed: lanes behind the end of the run compute what nobody stores. So nothing is gathered. A block of the list with
short runs goes on row by row, as LLVM makes of it; since blocks are the same for any number of threads, so are results.
"""

from __future__ import annotations

from ebb.backends.llvm.lane_ops import MASK, NUMBERS_64, wide
from ebb.backends.llvm.lanes import Emitter, Flags
from ebb.backends.llvm.row_plan import RowPlan
from ebb.backends.llvm.row_strips import RowStrips
from ebb.backends.llvm.transpose import LANES
from ebb.compiler import lir

FEW = 3
"""Strips of fewer rows than this do not pay."""

PATIENCE = 16
"""So many rows may be missing from strips that pay before a block goes on row by row."""


def emit_runs(
    emitter: Emitter,
    loop: lir.RowLoop,
    runs: tuple[lir.RowLoop, RowPlan],
    flags: Flags,
    bounds: tuple[str, str],
    note: str,
) -> None:
    """Appends the loop over a list of rows; the function goes on behind it.

    Args:
        emitter: of the function.
        loop: the loop.
        runs: the loop over rows in place of the list, and how it runs in strips.
        flags: the fast-math flags of arithmetic and of sums.
        bounds: the first entry of the list, and the one behind the last.
        note: the metadata of the branch that closes the loop row by row.
    """
    _Runs(emitter, runs[0], runs[1], flags).emit_list(loop, *bounds, note)


class _Runs(RowStrips):
    def emit_list(self, loop: lir.RowLoop, low: str, high: str, note: str) -> None:
        """Appends the strips, and the loop row by row for short runs and failures."""
        w, row = self.w, self.loop.index[-1]
        strip, work, single, closed = (w.fresh(stem) for stem in ("run", "work", "single", "closed"))
        self.plain, self.start, self.guards = single, w.allocate("i64"), True
        self.open_sums()
        before, following, left = w.label, f"%{w.fresh('next')}", f"%{w.fresh('patience')}"
        w.do(f"store i64 {low}, ptr {self.start}")
        w.branch(strip)
        w.start(strip)
        turn = w.emit(f"phi i64 [ {low}, %{before} ], [ {following}, %{closed} ]")
        patience = w.emit(f"phi i64 [ {PATIENCE}, %{before} ], [ {left}, %{closed} ]")
        w.do(f"store i64 {turn}, ptr {self.start}")
        more = w.emit(f"icmp slt i64 {turn}, {high}")
        w.branch_if(w.emit(f"and i1 {more}, {w.emit(f'icmp sge i64 {patience}, 0')}"), work, single)
        w.start(work)
        first, count = self.open_run(loop, turn, high)
        w.remember()
        self.run_strip(row, first, closed)
        w.do(f"{following} = add nsw i64 {turn}, {count}")
        w.do(f"{left} = add nsw i64 {patience}, {w.emit(f'sub nsw i64 {count}, {FEW}')}")
        w.branch(strip)
        w.start(single)
        rest = w.emit(f"load i64, ptr {self.start}")
        self.e.count(loop.index[-1], rest, high, loop.body, note)
        self.close_sums()

    def open_run(self, loop: lir.RowLoop, turn: str, high: str) -> tuple[str, str]:
        """The first row of the strip, and how many rows follow one another from there.

        That there are eight is guessed from branches, so that the next strip need not wait for this one.
        """
        w, v = self.w, self.v
        probe, partial, ready = (w.fresh(stem) for stem in ("probe", "partial", "ready"))
        match loop.body[0]:
            case lir.Let(_, lir.Load(slot, _)):
                entry = self.e.element(slot, turn)
            case other:
                raise AssertionError(other)
        row = w.emit(f"load i64, ptr {entry}")
        left = w.emit(f"sub nsw i64 {high}, {turn}")
        w.branch_if(w.emit(f"icmp sge i64 {left}, {LANES}"), probe, partial)
        w.start(probe)
        last = w.emit(f"load i64, ptr {w.emit(f'getelementptr inbounds i64, ptr {entry}, i64 {LANES - 1}')}")
        # The list ascends.
        w.branch_if(w.emit(f"icmp eq i64 {w.emit(f'sub i64 {last}, {row}')}, {LANES - 1}"), ready, partial)
        w.start(partial)
        there = w.emit(f"icmp ult {wide('i64')} {NUMBERS_64}, {v.broadcast('i64', left)}")
        w.declare(f"{wide('i64')} @llvm.masked.load.v{LANES}i64.p0(ptr, i32, {MASK}, {wide('i64')})")
        listed = w.emit(
            f"call {wide('i64')} @llvm.masked.load.v{LANES}i64.p0(ptr {entry}, i32 8, {MASK} {there}, "
            f"{wide('i64')} splat (i64 -1))"
        )
        expected = w.emit(f"add {wide('i64')} {NUMBERS_64}, {v.broadcast('i64', row)}")
        differs = w.emit(f"icmp ne {wide('i64')} {listed}, {expected}")
        broken = w.emit(f"bitcast {MASK} {differs} to i{LANES}")
        w.declare(f"i{LANES} @llvm.cttz.i{LANES}(i{LANES}, i1)")
        narrow = w.emit(f"call i{LANES} @llvm.cttz.i{LANES}(i{LANES} {broken}, i1 false)")
        some = w.emit(f"zext i{LANES} {narrow} to i64")
        w.branch(ready)
        w.start(ready)
        count = w.emit(f"phi i64 [ {LANES}, %{probe} ], [ {some}, %{partial} ]")
        self.active = self.mask = w.emit(f"icmp ult {wide('i64')} {NUMBERS_64}, {v.broadcast('i64', count)}")
        self.memory.open("ult", count, self.active)
        return row, count
