"""``ebb.where``, ``ebb.affine`` and ``ebb.row_at``: functions that exist in kernels only."""

from __future__ import annotations

from typing import Any, NoReturn

from ebb.records import record


@record(eq=False)
class Intrinsic:
    """A function on keys that the compiler knows. Outside of kernels it says so."""

    name: str
    signature: str
    doc: str

    def __call__(self, *arguments: Any, **named: Any) -> NoReturn:
        """Raises TypeError: there are no keys on the host."""
        raise TypeError(f"ebb.{self.name}{self.signature} works in kernels and members only: keys exist only there")

    def __repr__(self) -> str:
        return f"<ebb builtin {self.name}>"


where = Intrinsic(
    "where",
    "(field, key)",
    "The rows whose grouped key field is the key, to loop over or to project: ``ebb.where(edges.tail, v).head``.",
)
affine = Intrinsic(
    "affine",
    '(target, matrix, key, edge="check")',
    "The row of a grid at an affine map of the coordinates of another; ``edge='clamp'`` stays inside.",
)
row_at = Intrinsic(
    "row_at",
    '(target, coordinates, edge="check")',
    "The row of a grid at coordinates that are computed; ``edge='clamp'`` stays inside.",
)
