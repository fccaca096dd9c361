"""Small random relations for random kernels: rows that refer to each other and to a grid, and globals.

All floats are small multiples of 1/4, so that sums and products of a few are exact in any order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import ebb

from .functions import FUNCTIONS, add_members

NUMBERS = {
    "i": ebb.int32,
    "j": ebb.int32,
    "w": ebb.int64,
    "x": ebb.float64,
    "y": ebb.float64,
    "s": ebb.float32,
    "p": ebb.vec3d,
    "m": ebb.mat2i,
    "t": ebb.bool_,
}
"""The fields that every relation has."""

KEYS = {"nodes": {"next": "nodes", "cell": "cells"}, "links": {"a": "nodes", "b": "nodes"}, "cells": {"node": "nodes"}}
"""The key fields: relation, field, relation that it refers to."""

GLOBALS = {"GI": ebb.int32, "GX": ebb.float64, "GP": ebb.vec3d, "GT": ebb.bool_}


@dataclass
class World:
    """Relations and globals, what they held at first, and what a kernel's text may name."""

    relations: dict[str, ebb.Relation]
    globals: dict[str, ebb.Global]
    grouped: tuple[str, ...]
    saved: dict[Any, Any] = field(default_factory=dict)

    @property
    def names(self) -> dict[str, Any]:
        names = {"ebb": ebb, "half": 0.5, "three": 3, "turns": ((1, 0), (0, -1)), "shift": np.array([0.5, 0.0, -1.0])}
        return names | FUNCTIONS | self.relations | self.globals

    @property
    def fields(self) -> list[ebb.Field]:
        return [found for relation in self.relations.values() for found in relation.fields.values()]

    def save(self) -> None:
        self.saved = {place: place.to_numpy() for place in self.fields}
        self.saved |= {place: place.data.copy() for place in self.globals.values()}

    def restore(self) -> None:
        for place, value in self.saved.items():
            if isinstance(place, ebb.Global):
                place.value = value
            else:
                place.load(value)

    def state(self) -> dict[str, Any]:
        """All values now, by name."""
        state = {place.path: place.to_numpy() for place in self.fields}
        return state | {name: globl.data.copy() for name, globl in self.globals.items()}


def difference(left: dict[str, Any], right: dict[str, Any]) -> str | None:
    """The first place whose values differ in a bit (but for the sign of zero), and how; None where all agree."""
    for name, value in left.items():
        other = right[name]
        same = np.array_equal(value, other, equal_nan=value.dtype.kind == "f")
        if not same:
            return f"{name}: {value.tolist()} and {other.tolist()}"
    return None


def build_world(seed: int, size: int) -> World:
    """Relations of 0 to 8 rows with random fields, keys and groupings.

    Args:
        seed: decides all values.
        size: decides sizes and groupings; 0 gives the smallest.
    """
    random = np.random.default_rng(seed)
    size, count = divmod(size, 5)
    size, links = divmod(size, 9)
    size, rows = divmod(size, 3)
    size, columns = divmod(size, 3)
    relations = {
        "nodes": ebb.Relation("nodes", size=count + 1),
        "links": ebb.Relation("links", size=links),
        "cells": ebb.Relation("cells", shape=(rows + 1, columns + 1), periodic=(True, False)),
    }
    for name, relation in relations.items():
        for of, type_ in NUMBERS.items():
            relation.new_field(of, type_, init=_values(random, type_, relation.shape))
        for of, target in KEYS[name].items():
            relation.new_field(of, relations[target], init=_keys(random, relations[target], relation.shape))
    grouped = ((), ("a",), ("a",), ("a",), ("a", "b"))[size % 5]
    for key in grouped:
        relations["links"].group_by(key)
    add_members(relations)
    globals_ = {name: ebb.Global(type_, _values(random, type_, ())) for name, type_ in GLOBALS.items()}
    world = World(relations, globals_, grouped)
    world.save()
    return world


def _values(random: np.random.Generator, type_: Any, shape: tuple[int, ...]) -> Any:
    whole = random.integers(-8, 9, size=shape + type_.shape)
    if type_.dtype.kind == "b":
        return whole > 0
    return (whole / 4 if type_.dtype.kind == "f" else whole).astype(type_.dtype)


def _keys(random: np.random.Generator, target: ebb.Relation, shape: tuple[int, ...]) -> Any:
    if not target.is_grid:
        return random.integers(0, target.size, size=shape)
    return np.stack([random.integers(0, extent, size=shape) for extent in target.shape], axis=-1)
