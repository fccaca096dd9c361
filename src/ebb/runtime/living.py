"""Lists of what is still there, in the order in which it was made, that keep nothing alive."""

from __future__ import annotations

from typing import Generic, TypeVar
from weakref import WeakKeyDictionary

_Item = TypeVar("_Item")


class Living(Generic[_Item]):
    """Objects that are each equal to themselves only."""

    def __init__(self) -> None:
        self._items: WeakKeyDictionary[_Item, None] = WeakKeyDictionary()

    def add(self, item: _Item) -> None:
        """Lists ``item`` from now on, as long as somebody else holds it."""
        self._items[item] = None

    def all(self) -> list[_Item]:
        """Those that are still there."""
        found = [reference() for reference in self._items.keyrefs()]  # taken at once: other threads may add some
        return [item for item in found if item is not None]
