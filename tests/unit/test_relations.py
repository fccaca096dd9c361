"""Relations: what they are made of, their names, members and their table; swaps and copies."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from ebb.errors import RelationError
from ebb.relations.field import Field
from ebb.relations.member import Member
from ebb.relations.relation import Relation
from ebb.relations.subset import Box, RowSet
from ebb.types.aliases import vec3d, vec3f
from ebb.types.types import as_type, float32, float64, int32, key


def codes(caught: pytest.ExceptionInfo[RelationError]) -> tuple[str, ...]:
    return caught.value.codes


@pytest.fixture
def vertices() -> Relation:
    relation = Relation("vertices", size=4)
    relation.new_field("pos", vec3d, init=np.arange(12.0).reshape(4, 3))
    relation.new_field("mass", float32, init=1.0)
    return relation


def test_a_relation_of_rows(vertices: Relation) -> None:
    assert (vertices.name, vertices.size, len(vertices)) == ("vertices", 4, 4)
    assert (vertices.shape, vertices.periodic, vertices.ndim, vertices.is_grid) == ((4,), (False,), 1, False)
    assert vertices.boxes is None


def test_a_grid() -> None:
    cells = Relation("cells", shape=(3, 4, 5), periodic=(True, False, True))
    assert (cells.size, cells.shape, cells.periodic, cells.ndim, cells.is_grid) == (
        60, (3, 4, 5), (True, False, True), 3, True,
    )  # fmt: skip
    assert cells.boxes == (Box((0, 0, 0), (3, 4, 5)),)
    assert Relation("line", shape=7, periodic=True).periodic == (True,)
    assert Relation("plane", shape=np.array([2, 3])).shape == (2, 3)


@pytest.mark.parametrize("extent", [{"size": 0}, {"shape": (0,)}, {"shape": (3, 0)}])
def test_no_rows(extent: dict[str, object]) -> None:
    empty = Relation("empty", **extent)
    target = Relation("target", size=2)
    field = empty.new_field("q", vec3f, init=1.0)
    keys = empty.new_field("k", target, init=np.zeros(empty.shape, dtype=int))
    assert len(empty) == 0
    assert field.to_numpy().shape == (*empty.shape, 3)
    assert not keys.maybe_unset
    empty.group_by("k")
    assert keys.grouping is not None
    assert keys.grouping.offsets.tolist() == [0, 0, 0]
    empty.new_field("f", float64, init=lambda *index: 1 / 0)
    assert "0 rows" in repr(empty)


@pytest.mark.parametrize(
    "extent",
    [{}, {"size": 1, "shape": (1,)}, {"size": -1}, {"size": 1.5}, {"size": True}, {"size": "3"}, {"shape": ()},
     {"shape": (1, 2, 3, 4)}, {"shape": (2, -1)}, {"size": 3, "periodic": True}, {"shape": (2, 2), "periodic": (True,)},
     {"shape": (2,), "periodic": ("yes",)}],
)  # fmt: skip
def test_extents_that_are_none(extent: dict[str, object]) -> None:
    with pytest.raises(RelationError) as caught:
        Relation("r", **extent)
    assert codes(caught) == ("E505",)


@pytest.mark.parametrize("name", ["", "a b", "1st", "class", "__init", 3, None])
def test_bad_names(vertices: Relation, name: str) -> None:
    for attempt in (
        lambda: Relation(name, size=1),
        lambda: vertices.new_field(name, float32),
        lambda: vertices.new_subset(name, [0]),
    ):
        with pytest.raises(RelationError) as caught:
            attempt()
        assert codes(caught) == ("E501",)


def test_names_are_unique_among_all_attributes(vertices: Relation) -> None:
    vertices.new_subset("top", [0])
    vertices.member("edges")(lambda v: v)
    for name in ("pos", "top", "edges", "name", "storage", "new_field", "__len__"):
        for attempt in (
            lambda n=name: vertices.new_field(n, float32),
            lambda n=name: vertices.new_subset(n, [0]),
            lambda n=name: vertices.member(n)(lambda v: v),
        ):
            with pytest.raises(RelationError) as caught:
                attempt()
            assert codes(caught) == ("E502",)


@pytest.mark.parametrize("name", ["order", "rank", "positions", "rows", "_private", "type", "x"])
def test_names_that_users_keep(vertices: Relation, name: str) -> None:
    assert vertices.new_field(name, float32) is getattr(vertices, name)


def test_fields_are_live_and_read_only(vertices: Relation) -> None:
    fields = vertices.fields
    added = vertices.new_field("q", vec3f)
    assert list(fields) == ["pos", "mass", "q"]
    assert fields["q"] is added is vertices.q is vertices.attribute("q")
    assert vertices.attribute("nothing") is None
    with pytest.raises(TypeError):
        fields["q"] = added  # type: ignore[index]


def test_a_failed_init_adds_no_field(vertices: Relation) -> None:
    with pytest.raises(RelationError):
        vertices.new_field("q", vec3f, init=[1, 2])
    assert "q" not in vertices.fields
    vertices.new_field("q", vec3f, init=[1, 2, 3])


def test_missing_attributes(vertices: Relation) -> None:
    assert not hasattr(vertices, "velocity")
    with pytest.raises(AttributeError) as caught:
        vertices.mas
    assert isinstance(caught.value, RelationError)
    assert "write 'mass'" in str(caught.value)


def test_attributes_are_not_assigned(vertices: Relation) -> None:
    for name in ("mass", "velocity", "size"):
        with pytest.raises(RelationError) as caught:
            setattr(vertices, name, 1.0)
        assert codes(caught) == ("E516",)


class Stack(Relation):
    """A relation with a method and a slot of its own, as domains make them."""

    __slots__ = ("height",)

    def top(self) -> int:
        return self.size - 1


def test_a_derived_relation() -> None:
    stack = Stack("stack", size=3)
    with pytest.raises(AttributeError):
        _ = stack.height
    stack.height = 2.5
    field = stack.new_field("pos", vec3f)
    assert (stack.height, stack.top(), stack.pos) == (2.5, 2, field)
    for name in ("height", "top", "size"):
        with pytest.raises(RelationError):
            setattr(stack, name, 1)
        with pytest.raises(RelationError, match="E502"):
            stack.new_field(name, float32)


def test_a_relation_stands_for_its_key_type(vertices: Relation) -> None:
    assert as_type(vertices) == key(vertices) == vertices.key_type
    assert vertices.key_type != Relation("vertices", size=4).key_type
    assert vertices.key_dtype == np.int32
    assert Relation("large", size=2**31).key_dtype == np.int64


def test_relations_and_fields_compare_by_identity(vertices: Relation) -> None:
    assert vertices != Relation("vertices", size=4)
    assert len({vertices, vertices.pos, vertices.mass}) == 3
    assert vertices.pos == vertices.pos


def test_a_relation_is_a_row_set(vertices: Relation) -> None:
    assert isinstance(vertices, RowSet)
    assert vertices.relation is vertices
    assert vertices.row_positions() is None


def test_swap_exchanges_values_and_flags(vertices: Relation) -> None:
    a = vertices.new_field("a", vertices, init=[1, 2, 3, 0])
    b = vertices.new_field("b", vertices)
    memory = a.data
    vertices.swap("a", b)
    assert b.data is memory
    assert (a.maybe_unset, b.maybe_unset) == (True, False)
    assert b.to_numpy().tolist() == [1, 2, 3, 0]
    vertices.swap(a, a)
    assert a.maybe_unset


def test_copy(vertices: Relation) -> None:
    q = vertices.new_field("q", vec3d)
    vertices.copy("pos", q)
    assert np.array_equal(q, vertices.pos)
    vertices.pos.fill(0)
    assert q.to_numpy()[3, 2] == 11
    keys = vertices.new_field("k", vertices, init=0)
    unset = vertices.new_field("u", vertices)
    vertices.copy(unset, keys)
    assert keys.maybe_unset


def test_swap_and_copy_refuse(vertices: Relation) -> None:
    other = Relation("other", size=4)
    other.new_field("mass", float32)
    for action in (vertices.swap, vertices.copy):
        for fields, code in ((("pos", "mass"), "E510"), (("pos", "psition"), "E503"), ((other.mass, "mass"), "E504")):
            with pytest.raises(RelationError) as caught:
                action(*fields)
            assert codes(caught) == (code,)


def test_members(vertices: Relation) -> None:
    @vertices.member
    def weight(v):
        return 9.81 * v.mass

    @weight.setter
    def set_weight(v, value):
        v.mass = value / 9.81

    @weight.reducer("+")
    def add_weight(v, value):
        v.mass += value / 9.81

    assert isinstance(weight, Member)
    assert weight is set_weight is add_weight is vertices.weight
    assert (weight.name, weight.relation, weight.function.__name__) == ("weight", vertices, "weight")
    assert weight.setter_function is not None
    assert list(weight.reducers) == ["+"]


def test_the_call_of_a_key_is_a_member(vertices: Relation) -> None:
    called = vertices.member("__call__")(lambda v, i: v)
    assert vertices.attribute("__call__") is called
    with pytest.raises(RelationError) as caught:
        vertices.member("__call__")(lambda v, i: v)
    assert codes(caught) == ("E502",)


def test_members_refuse(vertices: Relation) -> None:
    named = vertices.member("named")(lambda v: v)
    for attempt, code in (
        (lambda: vertices.member("mass_of")(3), "E519"),
        (lambda: vertices.member(3), "E519"),
        (lambda: vertices.member(lambda v: v), "E501"),
        (lambda: named.reducer("-"), "E518"),
        (lambda: named.setter(3), "E519"),
        (lambda: named.reducer("+")(3), "E519"),
    ):
        with pytest.raises(RelationError) as caught:
            attempt()
        assert codes(caught) == (code,)


def test_repr_is_a_table(vertices: Relation) -> None:
    vertices.new_field("near", vertices)
    vertices.group_by("near")
    vertices.new_subset("top", [0, 2])
    vertices.member("edges")(lambda v: v)
    assert repr(vertices) == (
        "vertices: 4 rows, 128 B\n"
        "  pos   vector(float64, 3)  96 B\n"
        "  mass  float32             16 B\n"
        "  near  key(vertices)       16 B  grouped\n"
        "  subsets: top (2)\n"
        "  members: edges"
    )
    cells = Relation("cells", shape=(64, 64), periodic=(False, True))
    cells.new_field("T", float64)
    assert repr(cells) == "cells: 64 x 64 grid, 4,096 rows, periodic in j, 32.0 KiB\n  T  float64  32.0 KiB"


def test_a_relation_knows_its_referrers_weakly(vertices: Relation) -> None:
    edges = Relation("edges", size=2)
    edges.new_field("head", vertices, init=0)
    gone = weakref.ref(edges)
    assert len(vertices.storage.referrers) == 1
    del edges
    gc.collect()
    assert gone() is None
    assert len(vertices.storage.referrers) == 0


def test_a_type_is_needed(vertices: Relation) -> None:
    with pytest.raises(TypeError):
        vertices.new_field("n", int)
    assert isinstance(vertices.new_field("n", int32), Field)
