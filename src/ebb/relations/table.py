"""The ``repr`` of a relation: a small table of its fields, their types and their memory."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod

from ebb.relations.field import Field
from ebb.relations.member import Member
from ebb.relations.subset import Subset

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")


def table(
    name: str,
    shape: tuple[int, ...],
    periodic: tuple[bool, ...] | None,
    attributes: Mapping[str, Field | Member | Subset],
) -> str:
    """The table of a relation; ``periodic`` is None where it is no grid."""
    fields = [found for found in attributes.values() if isinstance(found, Field)]
    lines = [f"{name}: {_extent(shape, periodic)}, {bytes_text(sum(field.buffer.nbytes for field in fields))}"]
    rows = [(f.name, repr(f.type), bytes_text(f.buffer.nbytes), "grouped" if f.grouping else "") for f in fields]
    widths = [max((len(row[column]) for row in rows), default=0) for column in range(3)]
    for field, type_, size, note in rows:
        text = f"  {field:<{widths[0]}}  {type_:<{widths[1]}}  {size:>{widths[2]}}  {note}"
        lines.append(text.rstrip())
    subsets = [f"{s.name} ({s.size:,})" for s in attributes.values() if isinstance(s, Subset)]
    members = [m.name for m in attributes.values() if isinstance(m, Member)]
    lines += [f"  {kind}: {', '.join(names)}" for kind, names in (("subsets", subsets), ("members", members)) if names]
    return "\n".join(lines)


def bytes_text(nbytes: int) -> str:
    """A number of bytes in the unit that keeps it short: ``12.0 KiB``."""
    value, unit = float(nbytes), 0
    while value >= 1024 and unit < len(_UNITS) - 1:
        value, unit = value / 1024, unit + 1
    return f"{value:.0f} B" if unit == 0 else f"{value:.1f} {_UNITS[unit]}"


def _extent(shape: tuple[int, ...], periodic: tuple[bool, ...] | None) -> str:
    rows = f"{prod(shape):,} row{'' if prod(shape) == 1 else 's'}"
    if periodic is None:
        return rows
    axes = [axis for axis, wraps in zip("ijk", periodic, strict=False) if wraps]
    return f"{' x '.join(map(str, shape))} grid, {rows}{', periodic in ' + ' '.join(axes) if axes else ''}"
