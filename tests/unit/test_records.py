"""Records are what dataclasses are, as far as they go."""

from __future__ import annotations

import copy
import inspect
import pickle
from dataclasses import dataclass
from typing import ClassVar

import pytest

from ebb.records import field, record, replace


@record
class Point:
    """A point."""

    kind: ClassVar[str] = "point"
    x: int
    y: int = 2

    @property
    def total(self):
        return self.x + self.y


@record
class Named(Point):
    name: str = field(default="", repr=False)


@record(frozen=False)
class Bag:
    items: list[int] = field(default_factory=list[int])
    size: int = 0


@record(eq=False)
class Thing:
    name: str


@record
class Nothing:
    pass


@dataclass(frozen=True, slots=True)
class PointOfPython:
    x: int
    y: int = 2


@pytest.mark.parametrize(
    ("arguments", "named"), [((1,), {}), ((1, 5), {}), ((1,), {"y": 5}), ((), {"x": 1}), ((), {"y": 3, "x": 1})]
)
def test_they_are_made_like_dataclasses(arguments, named):
    made, expected = Point(*arguments, **named), PointOfPython(*arguments, **named)
    assert (made.x, made.y) == (expected.x, expected.y)
    assert repr(made) == repr(expected).replace("PointOfPython", "Point")
    assert made.total == made.x + made.y and made.kind == "point"


@pytest.mark.parametrize(("arguments", "named"), [((), {}), ((1, 2, 3), {}), ((1,), {"x": 1}), ((1,), {"z": 1})])
def test_wrong_arguments_are_refused_in_the_same_words(arguments, named):
    with pytest.raises(TypeError) as error:
        Point(*arguments, **named)
    with pytest.raises(TypeError) as expected:
        PointOfPython(*arguments, **named)
    assert str(error.value) == str(expected.value).replace("PointOfPython", "Point")


def test_their_signature_names_the_fields():
    assert str(inspect.signature(Named)) == "(x, y=2, name='')"
    assert Named.__match_args__ == ("x", "y", "name")
    assert Point.__doc__ == "A point." and Point.__module__ == __name__


def test_they_are_equal_by_class_and_value():
    assert Point(1) == Point(1, 2) != Point(2, 1)
    assert Named(1, 2) != Point(1, 2) and Point(1, 2) != PointOfPython(1, 2)
    assert len({Point(1), Point(1), Point(2), Named(1), Nothing(), Nothing()}) == 4
    assert Bag([1]) == Bag([1]) != Bag([2])
    with pytest.raises(TypeError):
        hash(Bag())


def test_those_without_equality_are_equal_to_themselves_alone():
    thing = Thing("a")
    assert thing == thing != Thing("a")
    assert len({thing, thing, Thing("a")}) == 2


def test_the_frozen_ones_do_not_change():
    point = Point(1)
    for change in (lambda: setattr(point, "x", 2), lambda: setattr(point, "z", 2), lambda: delattr(point, "x")):
        with pytest.raises(AttributeError):
            change()
    assert point == Point(1) and not hasattr(point, "__dict__")


def test_the_others_do():
    bag = Bag()
    bag.size = 3
    bag.items.append(4)
    assert bag == Bag([4], 3) and Bag() == Bag([], 0)
    with pytest.raises(AttributeError):
        bag.other = 1  # they have slots


def test_a_field_may_be_hidden_and_a_method_one_s_own():
    @record
    class Loud:
        x: int

        def __repr__(self):
            return "LOUD"

    assert repr(Named(1, 2, "a")) == "Named(x=1, y=2)"
    assert repr(Loud(1)) == "LOUD"


def test_they_match():
    match Named(1, 2, "a"):
        case Point(x, y):
            assert (x, y) == (1, 2)


def test_copies():
    named = Named(1, 2, "a")
    assert replace(named, y=5) == Named(1, 5, "a") and named.y == 2
    with pytest.raises(TypeError):
        replace(named, z=1)
    for copied in (copy.copy(named), copy.deepcopy(named), pickle.loads(pickle.dumps(named))):
        assert copied == named and type(copied) is Named
    assert copy.deepcopy(bag := Bag([1])).items is not bag.items


def test_defaults_come_last():
    with pytest.raises(TypeError, match="follows one with a default"):

        @record
        class Wrong(Point):
            z: int


@pytest.mark.parametrize("count", [0, 1, 9, 10, 11, 30])
def test_any_number_of_fields(count):
    names = [f"f{index}" for index in range(count)]
    made = record(type("Many", (), {"__annotations__": dict.fromkeys(names, "int"), "__module__": __name__}))
    assert [getattr(made(*range(count)), name) for name in names] == list(range(count))


def test_factories_stand_anywhere_among_many_fields():
    @record
    class Many:
        a: int
        b: int
        c: list[int] = field(default_factory=lambda: [3])
        d: int = 4
        e: list[int] = field(default_factory=lambda: [5])
        f: int = 6

    assert Many(1, 2) == Many(1, 2, [3], 4, [5], 6)
    assert Many(1, 2, e=[]) == Many(1, 2, [3], 4, [], 6)
