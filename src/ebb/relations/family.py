"""Families of fields: those that swap their values with one another lie in one layout."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ebb.runtime.buffer import Layout

if TYPE_CHECKING:
    from ebb.relations.field import Field


class Family:
    """Fields that have exchanged their values, and what has been seen of the kernels that reach them.

    A swap exchanges memory with its layout. If the members of a family lay in different layouts, each swap would call
    for other code.

    Attributes:
        members: the fields, all of one relation and type.
        layout: in which the members are to lie.
        gaining: how many rows launches have gone over that would be quicker if the fields lay in columns.
        losing: how many rows they have reached that would take longer.
        conversions: how often the layout has been changed.
    """

    __slots__ = ("conversions", "gaining", "layout", "losing", "members")

    def __init__(self, first: Field) -> None:
        self.members = [first]
        self.layout: Layout = first.buffer.layout
        self.gaining = 0
        self.losing = 0
        self.conversions = 0

    def absorb(self, other: Family) -> None:
        """Takes over the members of ``other`` and what has been seen of them; the layout of columns prevails."""
        for member in other.members:
            member.family = self
        self.members += other.members
        self.gaining += other.gaining
        self.losing += other.losing
        self.conversions = max(self.conversions, other.conversions)
        if other.layout is Layout.COLUMNS:
            self.layout = Layout.COLUMNS

    def convert(self, *members: Field) -> None:
        """Brings ``members`` into the layout, one after the other, so that little more memory is held meanwhile."""
        for member in members:
            if member.buffer.layout is not self.layout:
                member.replace(member.buffer.in_layout(self.layout))


def family_of(field: Field) -> Family:
    """The family of ``field``; at first a field is alone in it."""
    if field.family is None:
        field.family = Family(field)
    return field.family


def join(left: Field, right: Field) -> None:
    """Makes ``left`` and ``right``, which are to be swapped, members of one family, and brings them into its layout."""
    family, other = family_of(left), family_of(right)
    if family is not other:
        family.absorb(other)
    if left.buffer.layout is not right.buffer.layout:
        family.convert(left, right)
