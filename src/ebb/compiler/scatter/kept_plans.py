"""Plans kept between processes: rows that are launched again on the same mesh run in the colours found for it before.

To weigh the ways in which a launch may reduce takes its kernel, and to colour takes as long as some launches. What
comes of it depends on the text of the kernel, on the facts of its code, on how many rows relations have, on which rows
are launched in which blocks, and on the keys that the kernel reads; a plan is kept under a digest of all of these. Kept
are plans that run the kernel as it is written, in waves. A kernel that queries groups, or whose keys have some by which
it could gather, is planned in each process.
"""

from __future__ import annotations

import marshal
from typing import Any, Protocol

import numpy as np

from ebb.compiler.outline import Outline
from ebb.compiler.scatter.waves import Waves
from ebb.records import record
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.relations.subset import RowSet
from ebb.runtime.buffer import Array
from ebb.runtime.digest import key_of


class PlanStore(Protocol):
    """Where plans are kept."""

    def get(self, name: str) -> bytes | None:
        """What is kept under ``name``, or None."""
        ...

    def put(self, name: str, content: bytes) -> None:
        """Keeps ``content`` under ``name``, if that can be done."""
        ...


@record(eq=False)
class KeptPlan:
    """A plan that runs the kernel as it is written; the attributes are those of ``Plan`` and of its only run."""

    waves: Waves
    how: str
    order: str | None
    read: tuple[Field, ...]

    def packed(self, outline: Outline) -> bytes:
        """The plan in bytes, which have the numbers of the fields in the kernel's key."""
        numbers = {id(each): number for number, each in enumerate(outline.key.named)}
        waves = self.waves
        stretches = (waves.items.astype(np.int64).tobytes(), waves.starts.astype(np.int64).tobytes(), waves.chunk)
        return marshal.dumps((*stretches, self.how, self.order, [numbers[id(field)] for field in self.read]))


def unpacked(content: bytes, outline: Outline) -> KeptPlan:
    """What ``KeptPlan.packed`` made of a plan of a kernel of the same key."""
    items, starts, chunk, how, order, read = marshal.loads(content)
    numbers = np.frombuffer(items, dtype=np.int64).reshape(-1, 2)
    waves = Waves(numbers, np.frombuffer(starts, dtype=np.int64), chunk)
    fields: Any = [outline.key.named[number] for number in read]
    return KeptPlan(waves, how, order, tuple(fields))


def plan_name(outline: Outline, rows: RowSet, starts: Array) -> str | None:
    """The name of the plan of a kernel on ``rows``, whose blocks start at ``starts``; None where none is kept."""
    fields = [each for each in outline.key.named if isinstance(each, Field)]
    if outline.groups or any([field.grouping is not None for field in fields]):
        return None
    relations = dict.fromkeys([rows.relation, *_relations(outline)])
    sizes = [(relation.size, relation.shape) for relation in relations]
    own = rows.row_positions() if rows.boxes is None else None
    listed = [] if own is None else [own]
    keys = [field.data for field in fields if field.holds_keys]
    forms = [(array.dtype.str, array.shape, array.strides) for array in (starts, *listed, *keys)]
    facts = repr((outline.sources.state(), sizes, rows.boxes, own is None, forms))
    return key_of("plan", outline.key.text, facts, *map(_content, (starts, *listed, *keys)))


def _relations(outline: Outline) -> list[Relation]:
    """All relations that the kernel is about."""
    found: list[Relation] = []
    for each in outline.key.named:
        match each:
            case Relation():
                found.append(each)
            case Field():
                found += [each.relation] if each.target is None else [each.relation, each.target]
            case _:
                pass
    return found


def _content(array: Array) -> memoryview:
    """The values of ``array`` in the order in which they lie in memory: in any other they would take long to copy."""
    in_order = np.moveaxis(array, 0, -1) if array.strides[0] < array.strides[-1] else array
    return np.ascontiguousarray(in_order).reshape(-1).view(np.uint8).data
