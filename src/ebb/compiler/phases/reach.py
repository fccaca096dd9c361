"""How a kernel reaches each field that it uses: directly, at an offset, or through the keys of other fields."""

from __future__ import annotations

from ebb.compiler import kir
from ebb.compiler.kir_walk import operands, statements, subexpressions
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
        for operand in operands(stmt):
            for expr in subexpressions(operand):
                match expr:
                    case kir.ReadField(used, key):
                        _use(found.setdefault(used, _Found()), key, centered, routes)
                    case kir.QuerySize(index):
                        found.setdefault(index, _Found()).queried = True
                    case _:
                        pass
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
    routes: dict[int, dict[Field, None]] = {}
    while True:
        before = sum(map(len, routes.values()))
        for stmt in statements(kernel.body):
            match stmt:
                case kir.Assign(local, _, value):
                    routes.setdefault(local.uid, {}).update(_through(value, routes))
                case kir.ForQuery(local, index, key):
                    routes.setdefault(local.uid, {}).update({index: None, **_through(key, routes)})
                case _:
                    pass
        if sum(map(len, routes.values())) == before:
            return routes


def _through(value: kir.Expr, routes: dict[int, dict[Field, None]]) -> dict[Field, None]:
    """The key fields that ``value`` may have come through. Numbers come through none: only keys lead to rows."""
    found: dict[Field, None] = {}
    for part in subexpressions(value):
        if isinstance(part, kir.ReadLocal):
            through = routes.get(part.local.uid)
            if through:
                found.update(through)
        elif isinstance(part, kir.ReadField) and part.field.target is not None:
            found[part.field] = None
    return found
