"""How a kernel reaches each field that it uses: directly, at an offset, or through the keys of other fields."""

from __future__ import annotations

from ebb.compiler import kir
from ebb.compiler.kir_walk import expressions_in, statements, subexpressions
from ebb.compiler.phases.centered import Centered, find_centered
from ebb.records import field, record
from ebb.relations.field import Field
from ebb.relations.reach import Reach


@record(frozen=False)
class _Found:
    """What has been found of one field so far."""

    changed: bool = False
    centered: bool = False
    affine: bool = False
    keyed: bool = False
    queried: bool = False
    through: dict[Field, None] = field(default_factory=dict[Field, None])


def collect_reaches(kernel: kir.Kernel) -> tuple[Reach, ...]:
    """How ``kernel`` reaches each field that it uses, in the order of their first use."""
    centered = find_centered(kernel)
    routes = _routes(kernel)
    found: dict[Field, _Found] = {}
    for stmt in statements(kernel.body):
        for expr in expressions_in(stmt):
            if isinstance(expr, kir.ReadField):
                _use(found.setdefault(expr.field, _Found()), expr.key, centered, routes)
            elif isinstance(expr, kir.QuerySize):
                found.setdefault(expr.index, _Found()).queried = True
        match stmt:
            case kir.WriteField(used, key) | kir.ReduceField(used, key):
                place = found.setdefault(used, _Found())
                place.changed = True
                _use(place, key, centered, routes)
            case kir.ForQuery(index=index):
                found.setdefault(index, _Found()).queried = True
            case _:
                pass
    return tuple(
        Reach(used, at.changed, at.centered, at.affine, at.keyed, at.queried, tuple(at.through))
        for used, at in found.items()
    )


def _use(found: _Found, key: kir.Expr, centered: Centered, routes: dict[int, dict[Field, None]]) -> None:
    """Notes one use of a field through ``key``."""
    if centered.is_centered(key):
        found.centered = True
        return
    through = _through(key, routes)
    found.affine = found.affine or any(isinstance(part, kir.Affine | kir.RowAt) for part in subexpressions(key))
    found.keyed = found.keyed or bool(through)
    found.through.update(through)


def _routes(kernel: kir.Kernel) -> dict[int, dict[Field, None]]:
    """The key fields that the value of each local may have come through, by ``uid``, whatever the branches."""
    bound: list[tuple[int, list[Field | int]]] = []
    for stmt in statements(kernel.body):
        match stmt:
            case kir.Assign(local, _, value):
                bound.append((local.uid, _looked_at(value)))
            case kir.ForQuery(local, index, key):
                bound.append((local.uid, [index, *_looked_at(key)]))
            case _:
                pass
    routes: dict[int, dict[Field, None]] = {uid: {} for uid, _ in bound}
    while True:
        before = sum(map(len, routes.values()))
        for uid, parts in bound:
            routes[uid].update(_followed(parts, routes))
        if sum(map(len, routes.values())) == before:
            return routes


def _through(value: kir.Expr, routes: dict[int, dict[Field, None]]) -> dict[Field, None]:
    """The key fields that ``value`` may have come through. Numbers come through none: only keys lead to rows."""
    return _followed(_looked_at(value), routes)


def _looked_at(value: kir.Expr) -> list[Field | int]:
    """The key fields that ``value`` reads, and the locals, by ``uid``."""
    found: list[Field | int] = []
    for part in subexpressions(value):
        if isinstance(part, kir.ReadLocal):
            found.append(part.local.uid)
        elif isinstance(part, kir.ReadField) and part.field.holds_keys:
            found.append(part.field)
    return found


def _followed(parts: list[Field | int], routes: dict[int, dict[Field, None]]) -> dict[Field, None]:
    """The key fields among ``parts`` and those that its locals may have come through."""
    found: dict[Field, None] = {}
    for part in parts:
        if isinstance(part, int):
            found.update(routes.get(part, {}))
        else:
            found[part] = None
    return found
