"""Where the lanes of a strip of rows are: integers that differ from lane to lane, and addresses made of them."""

from __future__ import annotations

from typing import TypeAlias

from ebb.backends.llvm import ops
from ebb.backends.llvm.lane_ops import LaneWriter
from ebb.backends.llvm.lanes import Emitter
from ebb.backends.llvm.row_values import Place
from ebb.compiler import lir
from ebb.records import record
from ebb.types.types import int64


@record
class Integers:
    """Integers that are loaded."""

    slot: lir.Slot
    place: Place


@record
class Computed:
    """Integers in a vector."""

    name: str
    element: str


@record
class Guarded:
    """The integers of ``place``, but 0 in lanes that are not in ``mask``."""

    place: Place
    mask: str


Root: TypeAlias = Integers | Computed | Guarded


class RowPlaces:
    """The places of one loop in strips, by the numbers of what they come from."""

    def __init__(self, emitter: Emitter, lanes: LaneWriter) -> None:
        self.e, self.w, self.v = emitter, emitter.w, lanes
        self.roots: list[Root] = []
        self.narrow: dict[tuple[int, int], str] = {}

    def root(self, root: Root) -> int:
        """The number of a root."""
        if root not in self.roots:
            self.roots.append(root)
        return self.roots.index(root)

    def arithmetic(self, instruction: str, left: str, right: str) -> str:
        """An operation on two scalars: by one name, in whatever order they are; places are known by these."""
        if instruction != "sub":
            left, right = sorted((left, right), key=lambda name: (not name.startswith("%"), name))
        if instruction == "mul" and "0" in (left, right):
            return "0"
        if right == ("1" if instruction == "mul" else "0"):
            return left
        return self.w.emit(f"{instruction} i64 {left}, {right}")

    def scalar(self, place: Place) -> str:
        """A place that is the same in all lanes."""
        return self.arithmetic("add", place.base, str(place.offset)) if place.base != "0" else str(place.offset)

    def lane(self, place: Place, k: int) -> tuple[str, int]:
        """Where lane ``k`` is: an integer, and a constant to be added to it."""
        if place.root is None:
            return place.base, place.scale * k + place.offset
        scaled = self.arithmetic("mul", self.root_lane(place.root, k), str(place.scale))
        return self.arithmetic("add", scaled, place.base), place.offset

    def root_lane(self, number: int, k: int) -> str:
        """Lane ``k`` of a root, as an int64."""
        if (number, k) not in self.narrow:
            match self.roots[number]:
                case Integers(slot, place):
                    name = self.w.emit(f"load {ops.memory_type(slot.type)}, ptr {self.address(slot, place, k)}")
                    name = ops.convert(self.w, slot.type, int64, name)
                case Computed(vector, element):
                    name = self.v.extract(element, vector, k)
                case Guarded(place, mask):
                    index, constant = self.lane(place, k)
                    index = self.arithmetic("add", index, str(constant))
                    name = self.w.emit(f"select i1 {self.v.extract('i1', mask, k)}, i64 {index}, i64 0")
            self.narrow[number, k] = name
        return self.narrow[number, k]

    def address(self, slot: lir.Slot, place: Place, k: int) -> str:
        """The address of an element in lane ``k``."""
        index, constant = self.lane(place, k)
        return self.behind(slot, self.e.element(slot, index), constant)

    def behind(self, slot: lir.Slot, address: str, constant: int) -> str:
        """The address so many elements behind another."""
        if not constant:
            return address
        return self.w.emit(f"getelementptr inbounds {ops.memory_type(slot.type)}, ptr {address}, i64 {constant}")

    def guarded(self, place: Place, mask: str) -> Place:
        """``place`` in the lanes of ``mask``, and the first row in others."""
        if place.root is None and not place.scale:
            some = self.v.any(mask)
            return Place(None, 0, self.w.emit(f"select i1 {some}, i64 {self.scalar(place)}, i64 0"), 0)
        if place.root is None or place.base != "0":
            return Place(self.root(Guarded(place, mask)), 1, "0", 0)
        own = Place(place.root, 1, "0", 0)
        return Place(self.root(Guarded(own, mask)), place.scale, "0", place.offset)
