"""Families of fields: those that swap their values with one another lie in one layout."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebb.runtime.buffer import Layout

if TYPE_CHECKING:
    from ebb.relations.field import Field


class Family:
    """Fields that have exchanged their values, and what has been seen of how kernels reach them.

    A swap exchanges memory with its layout. If the members of a family lay in different layouts, each swap would call
    for other code.

    Attributes:
        members: the fields, all of one relation and type.
        layout: in which the members are to lie.
        streamed: how many rows launches have reached in the order in which they are stored.
        gathered: how many rows they have reached through keys.
        conversions: how often the layout has been changed.
    """

    __slots__ = ("conversions", "gathered", "layout", "members", "streamed")

    def __init__(self, first: Field) -> None:
        self.members = [first]
        self.layout: Layout = first.buffer.layout
        self.streamed = 0
        self.gathered = 0
        self.conversions = 0

    def absorb(self, other: Family) -> None:
        """Takes over the members of ``other`` and what has been seen of them; the layout of columns prevails."""
        for member in other.members:
            member.family = self
        self.members += other.members
        self.streamed += other.streamed
        self.gathered += other.gathered
        self.conversions = max(self.conversions, other.conversions)
        if other.layout is Layout.COLUMNS:
            self.layout = Layout.COLUMNS

    def convert(self, layout: Layout) -> None:
        """Brings each member into ``layout``, one after the other, so that little more memory is held meanwhile."""
        self.layout = layout
        for member in self.members:
            if member.buffer.layout is not layout:
                member.replace(member.buffer.in_layout(layout))


def family_of(field: Field) -> Family:
    """The family of ``field``; at first a field is alone in it."""
    if field.family is None:
        field.family = Family(field)
    return field.family


def join(left: Field, right: Field) -> None:
    """Makes ``left`` and ``right`` members of one family."""
    family, other = family_of(left), family_of(right)
    if family is not other:
        family.absorb(other)
