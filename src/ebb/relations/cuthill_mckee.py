"""The order of Cuthill and McKee: rows that are linked come to lie close together.

Breadth first from a row at the rim, the rows that one row reaches in the order of their degrees (E. Cuthill, J. McKee,
"Reducing the bandwidth of sparse symmetric matrices", 1969, doi:10.1145/800195.805928). To reverse that order, as is
usual, helps a factorisation and leaves all distances as they are, so it is not reversed here.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from ebb.records import record
from ebb.relations.sorting import stable_order
from ebb.relations.storage import Rows
from ebb.runtime.buffer import Array

if TYPE_CHECKING:
    import numpy.typing as npt

THIN = 32
"""With fewer rows than this to go on from, the search takes one by one: calls of NumPy would cost more than they."""

CROWDED = 1024
"""A row with more neighbours than this is never taken by itself."""

_MIX = (np.uint64(0x9E3779B97F4A7C15), np.uint64(0xC2B2AE3D27D4EB4F))


@record
class Graph:
    """Rows and the links between them, each link in the lists of both of its ends.

    Attributes:
        offsets: the neighbours of row ``r`` are ``neighbours[offsets[r] : offsets[r + 1]]``.
        neighbours: rows; one that is linked several times may stand several times.
        degrees: the length of each list.
    """

    offsets: Rows
    neighbours: Array
    degrees: Rows

    @property
    def size(self) -> int:
        """The number of rows."""
        return self.degrees.size

    def reached(self, rows: Rows) -> tuple[Array, Rows]:
        """The neighbours of ``rows``, list after list, and the place in ``rows`` of the row that each comes from."""
        counts = self.degrees[rows]
        parents = np.repeat(np.arange(rows.size), counts)
        starts = self.offsets[rows] - (np.cumsum(counts) - counts)
        return self.neighbours[starts[parents] + np.arange(parents.size)], parents


def graph_of(size: int, links: Iterable[tuple[Array, Array]]) -> Graph:
    """The graph of ``size`` rows in which ``a[i]`` is linked to ``b[i]``, for each pair of arrays ``(a, b)``.

    Left out are links to an unset key, -1, and of a row to itself.
    """
    pairs = [_proper(a, b) for a, b in links]
    ends = np.concatenate([a for a, _ in pairs]) if pairs else np.zeros(0, dtype=np.int64)
    others = np.concatenate([b for _, b in pairs]) if pairs else ends
    if _hash(ends, others) != _hash(others, ends):  # else each link has been given from both of its ends
        ends, others = np.concatenate((ends, others)), np.concatenate((others, ends))
    degrees = np.bincount(ends, minlength=size)
    offsets = np.concatenate((np.zeros(1, dtype=np.int64), np.cumsum(degrees)))
    return Graph(offsets, others[stable_order(ends)], degrees)


def cuthill_mckee(graph: Graph) -> Rows:
    """The row that comes to each position: component after component, then the rows without neighbours."""
    linked = np.flatnonzero(graph.degrees)
    alone = np.flatnonzero(graph.degrees == 0)
    if not linked.size:
        return alone
    # The last row that a search finds is as far from its first as any, and so at the rim: there the real one begins.
    far = _search(graph, linked[[graph.degrees[linked].argmin()]])
    if far.size == linked.size:
        return np.concatenate((_search(graph, far[-1:]), alone))
    components = _components(graph, linked)
    by_degree = linked[stable_order(-graph.degrees[linked] + graph.degrees.max())]
    far = _search(graph, _last_of_each(components, by_degree))
    found = _search(graph, _last_of_each(components, far))
    return np.concatenate((found[stable_order(components[found])], alone))


def _proper(a: Array, b: Array) -> tuple[Array, Array]:
    keep = (a >= 0) & (b >= 0) & (a != b)
    return (a, b) if keep.all() else (a[keep], b[keep])


def _hash(a: Array, b: Array) -> int:
    """A number that tells the links from ``a[i]`` to ``b[i]``, in any order, from others: surely enough for speed."""
    mixed = a.astype(np.uint64) * _MIX[0] + b.astype(np.uint64)
    mixed ^= mixed >> np.uint64(32)
    mixed *= _MIX[1]
    mixed ^= mixed >> np.uint64(29)
    return int(mixed.sum())


def _components(graph: Graph, linked: Rows) -> Rows:
    """For each row a row of its component, the same for all that are linked, however far."""
    roots = np.arange(graph.size)
    while True:
        nearest = np.minimum.reduceat(roots[graph.neighbours], graph.offsets[linked])
        joins = nearest < roots[linked]
        if not joins.any():
            return roots
        np.minimum.at(roots, roots[linked[joins]], nearest[joins])
        while not np.array_equal(roots, up := roots[roots]):
            roots = up


def _last_of_each(components: Rows, rows: Rows) -> Rows:
    """The last of ``rows`` in each component."""
    last = np.full(components.size, -1)
    last[components[rows]] = rows
    return last[last >= 0]


def _search(graph: Graph, level: Rows) -> Rows:
    """All rows that can be reached, breadth first from all rows of ``level`` at once."""
    found: list[Rows] = []
    seen = np.zeros(graph.size, dtype=np.bool_)
    seen[level] = True
    first = np.empty(graph.size, dtype=np.int64)
    while level.size:
        if level.size < THIN:
            walked, level = _walk(graph, level, seen)
            found.append(walked)
        found.append(level)
        reached, parents = graph.reached(level)
        fresh = np.flatnonzero(~seen[reached])
        rows = reached[fresh]
        first[rows[::-1]] = fresh[::-1]  # assigned last, and so left: the first parent that reaches the row
        fresh = fresh[first[rows] == fresh]
        rows = reached[fresh]
        seen[rows] = True
        level = rows[np.lexsort((graph.degrees[rows], parents[fresh]))]
    return np.concatenate(found)


def _walk(graph: Graph, level: Rows, seen: npt.NDArray[np.bool_]) -> tuple[Rows, Rows]:
    """The search row by row while it is thin: the rows that it has gone on from, and those still to go on from."""
    # As memory views, whose items are Python's own numbers: those of arrays would be made anew at each use.
    offsets, neighbours, degrees, is_seen = graph.offsets.data, graph.neighbours.data, graph.degrees.data, seen.data
    queue: list[int] = level.tolist()
    done, end = 0, len(queue)
    while done < end < done + THIN and degrees[queue[done]] <= CROWDED:
        start = offsets[queue[done]]
        for row in neighbours[start : start + degrees[queue[done]]]:
            if not is_seen[row]:
                is_seen[row] = True
                queue.append(row)
        if len(queue) > end + 1:
            queue[end:] = sorted(queue[end:], key=degrees.__getitem__)
        done, end = done + 1, len(queue)
    return np.array(queue[:done], dtype=np.int64), np.array(queue[done:], dtype=np.int64)
