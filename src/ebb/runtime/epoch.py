"""The structure epoch: whether anything that a prepared launch relies on may have changed since it was prepared.

Most of what a launch needs stays the same from one launch to the next: which code fits the data, where indexes lie,
that no view is open. What can change that calls ``structure_changed``: keys that the host loads or swaps, or that
kernels write where something depends on them (``Field.rewritten``), the order or the layout in which rows are stored, a
grouping, an open view, the choice of the backend. Values of other fields are no structure.
"""

from __future__ import annotations


class _Structure:
    """The present epoch, a token: two epochs are the same only if they are the same object."""

    __slots__ = ("epoch",)

    def __init__(self) -> None:
        self.epoch = object()


structure = _Structure()
"""``structure.epoch is kept`` says that nothing has changed since ``kept`` was read."""


def structure_changed() -> None:
    """Begins a new epoch: every prepared launch looks at the data again before it runs next."""
    # A new token instead of a count: one store, so that no thread can undo the change of another.
    structure.epoch = object()
