"""The storage order of relations, chosen by how kernels reach their rows.

A kernel that follows keys runs at the speed of the cache if rows that are reached one after the other lie close
together, and at that of memory if not. So the keys that kernels follow are looked at, and where the rows that they lead
to lie far apart, the rows of one relation are permuted: those of the target, in the order of Cuthill and McKee of the
links between them; or those that hold the keys, sorted by them; or the target's, as they are first reached. Whatever
refers to a permuted relation, and is in no order of its own, follows it.

What is decided depends on the keys alone, never on time measured or on threads, so that results are the same each time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ebb.errors import RelationError
from ebb.records import record
from ebb.relations.cuthill_mckee import Graph, cuthill_mckee, graph_of
from ebb.relations.errors import GridReordered
from ebb.relations.field import Field
from ebb.relations.locality import Placed, Spread, spread_of_keys, spread_of_links
from ebb.relations.reach import Reach
from ebb.relations.sorting import stable_order
from ebb.relations.storage import Rows, Watch, inverse
from ebb.runtime.buffer import Array
from ebb.runtime.epoch import structure_changed

if TYPE_CHECKING:
    from ebb.relations.relation import Relation
    from ebb.relations.subset import RowSet

CACHED = 256 * 1024
"""Bytes of rows that are close enough in any order."""

POOR = 4.0
"""Times the least memory: keys that touch less are well placed. In a mesh in its natural order it is 1 to 3."""

GAIN = 2.0
"""How many times less memory must be touched afterwards for a permutation to pay."""

FIRST_RUN = 2
"""The runs of a launch before its keys are looked at: a program that runs a kernel once or twice pays nothing."""

INSISTENT = 8
"""The patience up to which launches come here again and again. Keys that have changed more often are left alone."""


@record
class Candidate:
    """A permutation of a relation, and the spread of the keys before and after it."""

    relation: Relation
    order: Rows
    kind: str
    before: Spread
    after: Spread

    @property
    def pays(self) -> bool:
        """Whether the keys would reach much less memory."""
        return self.after.ratio * GAIN <= self.before.ratio

    @property
    def reason(self) -> str:
        """Why the rows are stored so, for ``kernel.explain``."""
        before, after = round(self.before.touched / 1000), round(self.after.touched / 1000)
        return f"{self.kind}, for locality: {self.after.keys:,} keys reach {after:,} kB, before {before:,} kB"


@record
class Route:
    """Keys of one relation that a kernel follows into another.

    Attributes:
        source: the relation that holds the keys.
        keys: its key fields.
        target: the relation that they refer to.
        width: the bytes that the kernel uses of a row of the target.
    """

    source: Relation
    keys: tuple[Field, ...]
    target: Relation
    width: int

    @property
    def columns(self) -> Array:
        """The keys, shape ``(rows of the source, keys of a row)``."""
        return _columns(self.keys)

    @property
    def placed(self) -> Placed:
        """The rows of the target, as the kernel uses them."""
        return Placed(self.target.size, self.width)


def consider_order(
    rows: RowSet, reaches: tuple[Reach, ...], run: int, changing: AbstractSet[Field] = frozenset()
) -> None:
    """May permute relations so that what a kernel reaches lies close together. The caller holds ``launching()``.

    Called before a launch takes any data or index: at each of the first runs of a launch, and whenever the structure
    has changed since its last run. Keys that stay as they are for some runs are looked at once.

    Args:
        rows: what the kernel runs on.
        reaches: how it reaches each field that it uses.
        run: how many times the launch has run before.
        changing: key fields that will be changed before it comes here again.
    """
    changed = {reach.field for reach in reaches if reach.changed} | changing
    for route in _worthwhile(rows, reaches):
        if changed.isdisjoint(route.keys):
            _look(route, run)


def may_reorder(rows: RowSet, reaches: tuple[Reach, ...]) -> bool:
    """Whether ``consider_order`` may ever permute anything for launches on ``rows``."""
    return any(True for _ in _worthwhile(rows, reaches))


def _worthwhile(rows: RowSet, reaches: tuple[Reach, ...]) -> Iterator[Route]:
    """The routes to so many rows that their order matters."""
    if 2 * rows.size >= rows.relation.size:
        for route in _routes(reaches):
            if route.target.size * route.width > CACHED and route.source.size:
                yield route


def reorder(relation: Relation) -> None:
    """Permutes ``relation`` for locality, whatever there is to gain; ``Relation.reorder`` says how.

    Raises:
        RelationError: it is a grid, or a writable view is open of a field that would have to move.
    """
    if relation.is_grid:
        raise RelationError(GridReordered(relation.name))
    root = _root(relation)
    order = None if root.is_grid else _order_of(root)
    if order is None:
        return
    for moving in (root, *_grouped_by(root)):
        for field in moving.fields.values():
            field.check_no_view()
    _permute(root, order, "for locality, as asked")
    # Groups follow now, rather than at the next launch: fields made in the meantime need not move then.
    for moved in _grouped_by(root):
        if moved.storage.primary is not None:
            moved.storage.primary.refresh()


# ---- When ----


def _routes(reaches: tuple[Reach, ...]) -> Iterator[Route]:
    """The keys that are followed, by where they stand and where they lead."""
    widths: dict[Relation, int] = {}
    found: dict[tuple[Relation, Relation], dict[Field, None]] = {}
    for reach in reaches:
        target = reach.field.relation
        keys = [key for key in reach.through if key.target is target]
        if keys:
            type_ = reach.field.type
            widths[target] = widths.get(target, 0) + type_.size * type_.dtype.itemsize
        for key in keys:
            found.setdefault((key.relation, target), {})[key] = None
    for (source, target), keys in found.items():
        yield Route(source, tuple(keys), target, widths[target])


def _look(route: Route, run: int) -> None:
    """Considers the route once its keys have stayed as they are, and again for a kernel that uses wider rows."""
    watches = [_watch(key) for key in route.keys]
    if all([watch.width >= route.width for watch in watches]):
        return
    if run < FIRST_RUN or not all([watch.calm >= watch.patience for watch in watches]):
        if all([watch.patience <= INSISTENT for watch in watches]):
            for key in route.keys:
                key.followed = True
            structure_changed()  # so that the next run of the launch, if none of its first, comes here too
        return
    for watch, key in zip(watches, route.keys, strict=True):
        watch.width = route.width
        key.followed = True  # keys that change are looked at again
    _improve(route)


def _watch(key: Field) -> Watch:
    """How long the keys have been as they are now, counted in looks."""
    watches = key.relation.storage.watches
    watch = watches.get(key)
    if watch is None:
        watch = watches[key] = Watch(key.version)
    elif watch.version != key.version:
        watch.restart(key.version)
    else:
        watch.calm += 1
    return watch


# ---- What ----


def _improve(route: Route) -> None:
    """Carries out the first of the candidates that makes the route good, else the best that pays, if any."""
    if not _refresh(route.source) or not _refresh(route.target):
        return
    before = spread_of_keys(route.placed, route.columns)
    if before.ratio < POOR:
        return
    best: Candidate | None = None
    for candidate in _candidates(route, before):
        if candidate.pays and (best is None or candidate.after.ratio < best.after.ratio):
            best = candidate
            if best.after.ratio < POOR:
                break
    if best is not None:
        _permute(best.relation, best.order, best.reason)


def _candidates(route: Route, before: Spread) -> Iterator[Candidate]:
    """The rows that hold the keys sorted by them; the target by its links; the target as it is reached."""
    source, target, columns = route.source, route.target, route.columns
    if _is_free(source) and source not in _chain(target):
        order = stable_order(_least(columns, target.size))
        kind = f"sorted by {', '.join([key.name for key in route.keys])}"
        yield Candidate(source, order, kind, before, spread_of_keys(route.placed, columns, order))
    *grouped, root = _chain(target)
    if _is_free(root):
        graph = _graph(root, [_keys_into(root, grouped[-1] if grouped else source)])
        if graph.neighbours.size:
            order, placed = cuthill_mckee(graph), Placed(root.size, route.width)
            if grouped:
                before = spread_of_links(placed, graph, np.arange(root.size))
            yield Candidate(root, order, "permuted", before, spread_of_links(placed, graph, order))
    if _is_free(target) and target not in _chain(source):
        order = _as_first_reached(columns, target.size)
        after = spread_of_keys(route.placed, columns, moved=inverse(order))
        yield Candidate(target, order, f"in the order of {source.name}", before, after)


def _order_of(relation: Relation) -> Rows | None:
    """An order for the rows of a relation that no grouping orders, or None where there is nothing to order them by."""
    sources = {source: _keys_into(relation, source) for source in _referring(relation)}
    # A relation of pairs, as edges are, mostly has all links of the larger cells besides, which would take more memory.
    pairs = [keys for keys in sources.values() if sum([key.type.size for key in keys]) == 2]
    graph = _graph(relation, pairs)
    if not graph.degrees.all():
        graph = _graph(relation, list(sources.values()))
    if graph.neighbours.size:
        return cuthill_mckee(graph)
    own = next((field.target for field in relation.fields.values() if field.target not in (None, relation)), None)
    if own is not None:
        return stable_order(_least(_columns(_keys_into(own, relation)), own.size))
    referring = next((keys for source, keys in sources.items() if source.size), None)
    return None if referring is None else _as_first_reached(_columns(referring), relation.size)


def _graph(relation: Relation, sources: Sequence[tuple[Field, ...]]) -> Graph:
    """The links between rows of ``relation``: a key in it links two rows, and so do two keys of one row elsewhere."""
    links: list[tuple[Array, Array]] = []
    for keys in sources:
        columns = list(_columns(keys).T) if keys else []
        if keys and keys[0].relation is relation:
            rows = np.arange(relation.size)
            links += [(rows, column) for column in columns]
        else:
            links += pairwise(columns)
    return graph_of(relation.size, links)


def _least(columns: Array, size: int) -> Array:
    """The least key of each row, ``size`` for a row whose keys are all unset."""
    if columns.shape[1] == 1:
        return columns[:, 0]
    return np.where(columns < 0, columns.dtype.type(size), columns).min(axis=1)


def _as_first_reached(columns: Array, size: int) -> Rows:
    """The rows that keys refer to, in the order in which they are met first; those that are not come last."""
    keys = columns.ravel()
    places = np.flatnonzero(keys >= 0)[::-1]
    first = np.full(size, keys.size)
    first[keys[places]] = places  # assigned last, and so left: the first place
    return stable_order(first)


def _columns(keys: Sequence[Field]) -> Array:
    """The keys of each row of their relation, those of one field after those of the other."""
    parts = [key.data.reshape(key.relation.size, key.type.size) for key in keys]
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)  # what there is one of may be large


# ---- What moves, and what with it ----


def _permute(relation: Relation, order: Rows, reason: str) -> None:
    """Permutes ``relation``, then sorts what refers to it and has no order of its own, and what refers to that."""
    relation.permute(order)
    relation.storage.reason = reason
    moved = [relation]
    for leader in moved:  # grows on the way
        followers = [source for source in _referring(leader) if source not in moved and _is_free(source)]
        for follower in followers:
            keys = _keys_into(leader, follower)
            follower.permute(stable_order(_least(_columns(keys), leader.size)))
            follower.storage.reason = f"sorted by {', '.join([key.name for key in keys])}, to follow {leader.name}"
        moved += followers
        moved += [source for source in _referring(leader) if source not in moved and _leads(source, leader, moved)]


def _leads(relation: Relation, leader: Relation, moved: Sequence[Relation]) -> bool:
    """Sorts a relation that is grouped by ``leader`` if there is one that must follow it; else that can wait."""
    primary = relation.storage.primary
    if primary is None or primary.target is not leader:
        return False
    behind = [source for each in (relation, *_grouped_by(relation)) for source in _referring(each)]
    if not any([source not in moved and _is_free(source) for source in behind]):
        return False
    primary.refresh()
    return True


def _is_free(relation: Relation) -> bool:
    """Whether the rows may be stored in any order, and nobody has seen in which they are."""
    storage = relation.storage
    if relation.is_grid or storage.primary is not None or not storage.may_reorder:
        return False
    return not any([moving.storage.pinned for moving in (relation, *_grouped_by(relation))])


def _refresh(relation: Relation) -> bool:
    """Brings the rows into the order of their groups; False if they are not and must not be moved now."""
    chain = _chain(relation)
    primaries = [each.storage.primary for each in chain]
    if not any([primary is not None and primary.stale for primary in primaries]):
        return True
    if primaries[0] is None or any([each.storage.pinned for each in chain]):
        return False
    primaries[0].refresh()
    return True


def _root(relation: Relation) -> Relation:
    """The relation that decides, through groupings, in which order the rows of ``relation`` are stored."""
    return _chain(relation)[-1]


def _chain(relation: Relation) -> list[Relation]:
    """``relation``, what it is grouped by, what that is grouped by, and so on: the last one orders them all."""
    chain = [relation]
    while (primary := chain[-1].storage.primary) is not None:
        chain.append(primary.target)
    return chain


def _grouped_by(relation: Relation) -> list[Relation]:
    """The relations that move with ``relation`` since their groups lie in its order."""
    found = [relation]
    for leader in found:  # grows on the way
        grouped = [(source, source.storage.primary) for source in _referring(leader)]
        found += [source for source, primary in grouped if primary is not None and primary.target is leader]
    return found[1:]


def _referring(relation: Relation) -> tuple[Relation, ...]:
    """The other relations that have keys into ``relation``, in the order of their oldest such field."""
    sources = dict.fromkeys([field.relation for field in list(relation.storage.referrers)])
    return tuple([source for source in sources if source is not relation and not source.is_grid])


def _keys_into(target: Relation, source: Relation) -> tuple[Field, ...]:
    return tuple([field for field in source.fields.values() if field.target is target])
