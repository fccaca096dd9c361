"""Things of a few closed types as trees that ``marshal`` takes, and back, in this process or another.

In a tree a tuple begins with the name of what makes the thing of the rest, and a list stands for a tuple.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from typing import Any, TypeAlias, cast

from ebb.types.types import SCALARS, ScalarType

Makers: TypeAlias = Mapping[str, Callable[..., Any]]

_SCALAR = "scalar"


class Unpackable(Exception):  # noqa: N818 - it is no error: what cannot be kept is made again
    """Something is of no type that is packed."""


class Packing:
    """Packs literals, scalar types, tuples, and things of certain types with all that is in them."""

    def __init__(self, records: Iterable[type[Any]], options: Iterable[type[Enum]]) -> None:
        """What packs ``records`` by their fields, and the ``options`` of enumerations by their values."""
        self._records = frozenset(records)
        self._makers: Makers = {
            **{kind.__name__: kind for kind in self._records},
            **{kind.__name__: {option.value: option for option in kind}.__getitem__ for kind in options},
            _SCALAR: {scalar.name: scalar for scalar in SCALARS}.__getitem__,
        }

    def pack(self, thing: Any, other: Callable[[Any], tuple[Any, ...]]) -> Any:
        """The tree of ``thing``; ``other`` gives that of whatever is of another type, with the name of its maker.

        Raises:
            Unpackable: something is of a type that neither packs.
        """
        kind = thing.__class__
        if kind in _LITERALS:
            return thing
        if kind is tuple:
            return [part if part.__class__ in _LITERALS else self.pack(part, other) for part in thing]
        if kind is ScalarType:
            return _SCALAR, thing.name
        if kind in self._records:
            parts = [getattr(thing, name) for name in kind.__match_args__]
            return kind.__name__, *[part if part.__class__ in _LITERALS else self.pack(part, other) for part in parts]
        if isinstance(thing, Enum):
            return kind.__name__, thing.value
        return other(thing)

    def unpack(self, tree: Any, others: Makers) -> Any:
        """The thing of a tree; ``others`` make what is of other types, by the names of their makers."""
        if not isinstance(tree, list | tuple):
            return tree
        parts = cast("Sequence[Any]", tree)
        if isinstance(tree, list):
            return tuple([self.unpack(part, others) if isinstance(part, _NESTED) else part for part in parts])
        make = self._makers.get(parts[0]) or others[parts[0]]
        return make(*[self.unpack(part, others) if isinstance(part, _NESTED) else part for part in parts[1:]])


_NESTED = (tuple, list)

_LITERALS = frozenset((bool, int, float, str, type(None)))
