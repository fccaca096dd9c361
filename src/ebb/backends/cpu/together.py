"""Which launches of a captured step run together: one block of rows through all of them, then the next block.

So what a launch leaves for the next one is still in the cache, and threads are woken once for all of them. That is the
same as one launch after the other as long as rows have nothing to do with one another: a field that one of the launches
changes is used by all of them through their own row alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ebb.backends.cpu.binding import Binding
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.relations.subset import RowSet
from ebb.runtime.buffer import Array


@record(eq=False)
class RunBinding:
    """A `RunKernel` that runs rows on the processor: what is bound is a `Binding`."""

    binding: Binding
    uniforms: tuple[Any, ...]


@record(frozen=False)
class _Use:
    """How the launches use a field."""

    changed: bool
    centered: bool


class Together:
    """Launches that run together, in their order.

    Attributes:
        launches: these, by the rows that they run on. The rows of any two are the same, or have none in common.
    """

    def __init__(self, first: RunBinding) -> None:
        """The launch ``first`` alone, whatever it does."""
        self._open = first.binding.is_apart
        self._uses: dict[Field, _Use] = {}
        self._covered: dict[Relation, Array] = {}
        self.launches: dict[RowSet, list[RunBinding]] = {first.binding.rows: [first]}
        self._note(first)

    def take(self, launch: RunBinding) -> bool:
        """Adds ``launch`` behind the others, if it can run together with them."""
        binding = launch.binding
        if not (self._open and binding.is_apart and self._is_fit(binding) and self._has_room(binding)):
            return False
        self.launches.setdefault(binding.rows, []).append(launch)
        self._note(launch)
        return True

    def __len__(self) -> int:
        return sum(map(len, self.launches.values()))

    def _note(self, launch: RunBinding) -> None:
        for field, phase in launch.binding.phases.fields.items():
            use = self._uses.setdefault(field, _Use(changed=False, centered=True))
            use.changed = use.changed or phase.changed
            use.centered = use.centered and phase.centered_only

    def _is_fit(self, binding: Binding) -> bool:
        """Whether rows would still have nothing to do with one another."""
        for field, phase in binding.phases.fields.items():
            use = self._uses.get(field)
            changed = phase.changed or (use is not None and use.changed)
            centered = phase.centered_only and (use is None or use.centered)
            if changed and not centered:
                return False
        return True

    def _has_room(self, binding: Binding) -> bool:
        """Whether the launch goes through the same blocks as others, or through rows that no other has."""
        same = self.launches.get(binding.rows)
        if same is not None:
            return binding.has_blocks_of(same[0].binding)
        relation = binding.rows.relation
        others = [rows for rows in self.launches if rows.relation is relation]
        if others and relation not in self._covered:
            self._covered[relation] = np.zeros(relation.shape, dtype=np.bool_)
            _cover(self._covered[relation], others[0])
        return not others or _cover(self._covered[relation], binding.rows)


def grouped(launches: Sequence[RunBinding]) -> Iterator[Together]:
    """``launches``, which follow one another, as few groups that run together."""
    group: Together | None = None
    for launch in launches:
        if group is None or not group.take(launch):
            if group is not None:
                yield group
            group = Together(launch)
    if group is not None:
        yield group


def _cover(covered: Array, rows: RowSet) -> bool:
    """Marks ``rows``, unless some of them are marked: then nothing is changed."""
    if rows.boxes is not None:
        places = [tuple(slice(*ends) for ends in zip(box.start, box.stop, strict=True)) for box in rows.boxes]
    else:
        covered, positions = covered.reshape(-1), rows.row_positions()
        places = [slice(None) if positions is None else positions]
    if any(covered[place].any() for place in places):
        return False
    for place in places:
        covered[place] = True
    return True
