"""Combines what each thread of a group has, by a tree: the first half of the threads take in what the others have, then
the first quarter, and so on.

All that is combined goes through one array of the group for each scalar type, one component after the other.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import TypeAlias

from ebb.compiler import lir
from ebb.compiler.lower.builder import Builder, index
from ebb.types.types import ScalarType, int64

Component: TypeAlias = tuple[lir.Var, int]
"""A component of a variable."""


class Tree:
    """What ``threads`` threads do together in the open body, which all of them run. One alone combines nothing."""

    def __init__(self, build: Builder, threads: int) -> None:
        self._build = build
        self._threads = threads
        self._thread = build.let(lir.ThreadNumber(), int64) if threads > 1 else index(0)
        self._arrays: dict[ScalarType, lir.Var] = {}

    def turns(self, count: lir.Value) -> lir.Value:
        """How many of ``count`` items the thread takes."""
        b = self._build
        return b.binary("//", b.add_index(b.binary("-", count, self._thread), self._threads - 1), index(self._threads))

    def item(self, turn: lir.Value) -> lir.Value:
        """The number of the item that the thread takes in ``turn``."""
        return self._build.add_index(self._thread, self._build.scale_index(turn, self._threads))

    @contextmanager
    def combined(self, op: str, each: Component) -> Generator[Component, None, None]:
        """Gives where ``each`` of all threads under ``op`` is; what is built meanwhile is for the first thread only."""
        if self._threads == 1:
            yield each
            return
        b, array = self._build, self._array(each[0].type)
        b.store_var(array, self._thread, b.load_var(*each))
        b.add(lir.Barrier())
        left = self._threads
        while left > 1:
            half = (left + 1) // 2
            self._take(op, array, half, left)
            b.add(lir.Barrier())
            left = half
        first = b.compare("==", self._thread, index(0))
        with b.body() as body:
            yield array, 0
        b.add(lir.If(first, tuple(body), ()))

    def _take(self, op: str, array: lir.Var, half: int, left: int) -> None:
        """Each of the first threads takes what the one ``half`` further has, where there is such a one."""
        b = self._build
        has_other = b.compare("<", self._thread, index(left - half))
        with b.body() as body:
            other = b.load_var(array, b.add_index(self._thread, half))
            b.store_var(array, self._thread, b.binary(op, b.load_var(array, self._thread), other))
        b.add(lir.If(has_other, tuple(body), ()))

    def _array(self, scalar: ScalarType) -> lir.Var:
        if scalar not in self._arrays:
            self._arrays[scalar] = self._build.declare("shared", scalar, self._threads, lir.Memory.GROUP)
        return self._arrays[scalar]
