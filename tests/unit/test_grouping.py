"""Grouping and the storage order: the index is right, keys stay right, and no dump can tell."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from ebb.errors import RelationError
from ebb.relations.field import Field
from ebb.relations.relation import Relation
from ebb.runtime.buffer import Buffer
from ebb.runtime.epoch import structure
from ebb.types.types import float64, int64, matrix, vector

TAILS = [2, 0, 1, 0, 3, 2]
HEADS = [0, 1, 2, 3, 0, 1]


def groups(field: Field) -> list[list[int]]:
    """For each row of the target, by identity, the identities of the rows whose key it is, in stored order."""
    grouping = field.grouping
    assert grouping is not None
    grouping.refresh()
    target = grouping.target
    positions = np.arange(field.relation.size) if grouping.rows is None else grouping.rows
    ids = field.relation.storage.identities_of(positions)
    by_position = [ids[grouping.offsets[t] : grouping.offsets[t + 1]].tolist() for t in range(target.size)]
    return [by_position[p] for p in target.storage.positions_of(np.arange(target.size)).tolist()]


def expected(keys: list[int], size: int) -> list[list[int]]:
    return [[row for row, key in enumerate(keys) if key == target] for target in range(size)]


@pytest.fixture
def mesh() -> tuple[Relation, Relation]:
    vertices, edges = Relation("vertices", size=4), Relation("edges", size=6)
    edges.new_field("tail", vertices, init=TAILS)
    edges.new_field("head", vertices, init=HEADS)
    edges.new_field("length", float64, init=lambda i: 10.0 * i)
    return vertices, edges


def test_the_first_grouping_sorts_the_storage(mesh: tuple[Relation, Relation]) -> None:
    _, edges = mesh
    edges.group_by("tail")
    grouping = edges.tail.grouping
    assert grouping.rows is None
    assert grouping.offsets.tolist() == [0, 2, 3, 5, 6]
    assert grouping.offsets.dtype == edges.key_dtype == np.int32
    assert edges.tail.data.tolist() == [0, 0, 1, 2, 2, 3]
    assert edges.storage.order.tolist() == [1, 3, 2, 0, 5, 4]
    assert edges.storage.rank[edges.storage.order].tolist() == list(range(6))
    assert edges.length.data.tolist() == [10, 30, 20, 0, 50, 40]
    assert edges.length.data.ctypes.data % 64 == 0


def test_no_dump_or_load_can_tell(mesh: tuple[Relation, Relation]) -> None:
    _, edges = mesh
    edges.group_by("tail")
    assert edges.length.to_numpy().tolist() == [0, 10, 20, 30, 40, 50]
    assert edges.head.to_numpy().tolist() == HEADS
    edges.length.load([5, 4, 3, 2, 1, 0])
    assert edges.length.to_numpy().tolist() == [5, 4, 3, 2, 1, 0]
    edges.length.load(lambda i: i)
    assert edges.length.to_numpy().tolist() == list(range(6))
    added = edges.new_field("number", int64, init=np.arange(6))
    assert added.to_numpy().tolist() == list(range(6))
    with pytest.raises(RelationError, match="row 4"):
        edges.head.load([0, 0, 0, 0, 4, 0])


def test_a_second_grouping_goes_through_rows(mesh: tuple[Relation, Relation]) -> None:
    _, edges = mesh
    edges.group_by("tail")
    edges.group_by(edges.head)
    assert groups(edges.tail) == expected(TAILS, 4)
    assert groups(edges.head) == expected(HEADS, 4)
    assert edges.head.grouping.rows.dtype == np.int32
    assert edges.tail.grouping.rows is None
    kept = edges.tail.grouping
    edges.group_by("tail")
    assert edges.tail.grouping is kept


@pytest.mark.parametrize("change", ["load", "write", "swap", "copy", "fill"])
def test_the_index_follows_its_keys(mesh: tuple[Relation, Relation], change: str) -> None:
    _, edges = mesh
    edges.group_by("tail")
    edges.group_by("head")
    new = [3, 3, 0, 1, 1, 0]
    spare = edges.new_field("spare", edges.tail.type, init=new)
    match change:
        case "load":
            edges.tail.load(new)
        case "write":
            edges.tail.data[...] = spare.data
            edges.tail.changed()
        case "swap":
            edges.swap("tail", "spare")
        case "copy":
            edges.copy("spare", "tail")
        case _:
            new = [2] * 6
            edges.tail.fill(2)
    assert edges.tail.grouping.stale
    assert groups(edges.head) == expected(HEADS, 4)
    assert groups(edges.tail) == expected(new, 4)
    assert edges.tail.grouping.rows is None
    assert not edges.tail.grouping.stale
    assert groups(edges.head) == expected(HEADS, 4)
    assert edges.length.to_numpy().tolist() == [0, 10, 20, 30, 40, 50]


def test_unset_keys_are_in_no_group(mesh: tuple[Relation, Relation]) -> None:
    vertices, edges = mesh
    edges.new_field("opposite", vertices)
    edges.group_by("opposite")
    assert groups(edges.opposite) == [[], [], [], []]
    assert edges.opposite.grouping.offsets.tolist() == [6, 6, 6, 6, 6]
    edges.opposite.load(np.ma.masked_less([-1, 3, -1, 0, 3, -1], 0))
    assert groups(edges.opposite) == [[3], [], [], [1, 4]]
    assert edges.opposite.to_numpy().tolist() == [-1, 3, -1, 0, 3, -1]


def test_keys_that_point_into_a_sorted_relation_stay_right(mesh: tuple[Relation, Relation]) -> None:
    vertices, edges = mesh
    first = vertices.new_field("first", edges, init=[1, 2, 0, 4])
    ring = vertices.new_field("ring", vector(edges, 2), init=[[0, 1], [2, 3], [4, 5], [5, 0]])
    square = vertices.new_field("square", matrix(edges, 2, 2), init=[[0, 1], [4, 5]])
    unset = vertices.new_field("unset", edges)
    twin = edges.new_field("twin", edges, init=[3, 4, 5, 0, 1, 2])
    edges.group_by("tail")
    assert first.to_numpy().tolist() == [1, 2, 0, 4]
    assert edges.length.data[first.data].tolist() == [10, 20, 0, 40]
    assert ring.to_numpy().tolist() == [[0, 1], [2, 3], [4, 5], [5, 0]]
    assert edges.length.data[ring.data].tolist() == [[0, 10], [20, 30], [40, 50], [50, 0]]
    assert square.to_numpy()[0].tolist() == [[0, 1], [4, 5]]
    assert unset.data.tolist() == [-1] * 4
    assert twin.to_numpy().tolist() == [3, 4, 5, 0, 1, 2]
    later = vertices.new_field("later", edges, init=[5, 4, 3, 2])
    assert edges.length.data[later.data].tolist() == [50, 40, 30, 20]
    assert later.to_numpy().tolist() == [5, 4, 3, 2]


def test_permuting_the_target_makes_the_index_stale(mesh: tuple[Relation, Relation]) -> None:
    vertices, edges = mesh
    edges.group_by("tail")
    edges.group_by("head")
    vertices.permute([3, 1, 0, 2])
    assert edges.tail.to_numpy().tolist() == TAILS
    assert groups(edges.tail) == expected(TAILS, 4)
    assert edges.tail.grouping.rows is None
    assert groups(edges.head) == expected(HEADS, 4)
    vertices.permute(np.array([1, 0, 3, 2]))
    assert groups(edges.head) == expected(HEADS, 4)
    assert groups(edges.tail) == expected(TAILS, 4)


def test_a_chain_of_sorted_relations_settles_in_any_order() -> None:
    cells, vertices, edges = (Relation(name, size=n) for name, n in (("cells", 3), ("vertices", 4), ("edges", 6)))
    edges.new_field("tail", vertices, init=TAILS)
    edges.new_field("head", vertices, init=HEADS)
    vertices.new_field("cell", cells, init=[2, 0, 1, 0])
    cells.new_field("group", cells, init=[1, 0, 1])
    edges.group_by("tail")
    edges.group_by("head")
    vertices.group_by("cell")
    cells.group_by("group")
    cells.permute([2, 0, 1])
    used = [edges.head.grouping, edges.tail.grouping, vertices.cell.grouping, cells.group.grouping]
    for grouping in used:
        grouping.refresh()
    assert not any(grouping.stale for grouping in used)
    assert [edges.tail.grouping.rows, vertices.cell.grouping.rows] == [None, None]
    assert groups(edges.tail) == expected(TAILS, 4)
    assert groups(edges.head) == expected(HEADS, 4)
    assert groups(vertices.cell) == expected([2, 0, 1, 0], 3)
    assert groups(cells.group) == expected([1, 0, 1], 3)


def test_refreshing_one_index_leaves_another_valid() -> None:
    pixels, vertices, cells = Relation("pixels", shape=(6,)), Relation("vertices", size=4), Relation("cells", size=3)
    pixels.new_field("vertex", vertices, init=TAILS)
    vertices.new_field("cell", cells, init=[2, 0, 1, 0])
    pixels.group_by("vertex")
    vertices.group_by("cell")
    vertices.permute([3, 2, 1, 0])
    pixels.vertex.grouping.refresh()
    vertices.cell.grouping.refresh()
    assert not pixels.vertex.grouping.stale
    assert groups(pixels.vertex) == expected(TAILS, 4)


def test_a_relation_grouped_by_its_own_rows_is_not_sorted() -> None:
    trees = Relation("trees", size=5)
    trees.new_field("parent", trees, init=[1, 2, 0, 0, 3])
    trees.group_by("parent")
    assert groups(trees.parent) == expected([1, 2, 0, 0, 3], 5)
    assert trees.storage.order is None
    assert trees.parent.grouping.rows is not None


def test_two_relations_that_group_each_other_settle() -> None:
    a, b = Relation("a", size=3), Relation("b", size=3)
    a.new_field("to_b", b, init=[2, 0, 1])
    b.new_field("to_a", a, init=[1, 2, 1])
    a.group_by("to_b")
    b.group_by("to_a")
    for _ in range(2):
        assert groups(a.to_b) == expected([2, 0, 1], 3)
        assert groups(b.to_a) == expected([1, 2, 1], 3)
        b.permute([1, 2, 0])
        b.to_a.load([1, 2, 1])


def test_grids_are_never_permuted() -> None:
    cells, blocks = Relation("cells", shape=(2, 3)), Relation("blocks", shape=(2,))
    cells.new_field("block", blocks, init=lambda i, j: (j % 2,))
    cells.group_by("block")
    assert cells.storage.order is None
    assert cells.block.grouping.rows.tolist() == [0, 2, 3, 5, 1, 4]
    with pytest.raises(ValueError, match="grid"):
        cells.permute(np.arange(6))


def test_a_grid_can_be_the_target() -> None:
    cells, particles = Relation("cells", shape=(2, 2)), Relation("particles", size=5)
    particles.new_field("cell", cells, init=[[1, 1], [0, 0], [1, 0], [0, 0], [1, 1]])
    particles.group_by("cell")
    assert groups(particles.cell) == [[1, 3], [], [2], [0, 4]]
    assert particles.cell.to_numpy().tolist() == [[1, 1], [0, 0], [1, 0], [0, 0], [1, 1]]


def test_sorted_keys_move_nothing(mesh: tuple[Relation, Relation]) -> None:
    vertices, _ = mesh
    edges = Relation("sorted", size=5)
    edges.new_field("tail", vertices, init=[0, 0, 1, 3, 3])
    edges.group_by("tail")
    assert edges.storage.order is None
    assert groups(edges.tail) == [[0, 1], [2], [], [3, 4]]


def test_permute_takes_permutations(mesh: tuple[Relation, Relation]) -> None:
    vertices, _ = mesh
    for order in ([0, 1, 2], [0, 1, 2, 2], [0, 1, 2, 4], [0, 1, 2, -1]):
        with pytest.raises(ValueError, match="permutation"):
            vertices.permute(order)
    assert vertices.storage.order is None


@pytest.mark.parametrize("step", ["permuted", "mapped"])
@pytest.mark.parametrize("works", range(3))
def test_a_permutation_that_fails_leaves_all_as_it_was(monkeypatch, step: str, works: int) -> None:
    vertices, edges = Relation("vertices", size=3), Relation("edges", size=4)
    fields = [
        vertices.new_field("mass", float64, init=[1, 2, 3]),
        vertices.new_field("left", vertices, init=[2, 0, 1]),
        vertices.new_field("right", vertices, init=[1, 2, 0]),
        edges.new_field("tail", vertices, init=[0, 1, 1, 2]),
    ]
    before = [field.data.tolist() for field in fields]
    usual, count = getattr(Buffer, step), itertools.count()

    def without_memory(self, table):
        if next(count) == works:
            raise MemoryError
        return usual(self, table)

    monkeypatch.setattr(Buffer, step, without_memory)
    with pytest.raises(MemoryError):
        vertices.permute([2, 0, 1])
    assert [field.data.tolist() for field in fields] == before
    assert (vertices.storage.order, vertices.storage.version) == (None, 0)


@pytest.mark.parametrize("works", range(4))
def test_a_permutation_that_is_interrupted_late_is_carried_out(monkeypatch, works: int) -> None:
    vertices, edges = Relation("vertices", size=3), Relation("edges", size=4)
    fields = [
        vertices.new_field("mass", float64, init=[1, 2, 3]),
        vertices.new_field("left", vertices, init=[2, 0, 1]),
        vertices.new_field("right", vertices, init=[1, 2, 0]),
        edges.new_field("tail", vertices, init=[0, 1, 1, 2]),
    ]
    before = [field.to_numpy().tolist() for field in fields]
    usual, count = Field.replace, itertools.count()

    def interrupted(self, buffer):
        if next(count) == works:
            raise KeyboardInterrupt
        usual(self, buffer)

    monkeypatch.setattr(Field, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        vertices.permute([2, 0, 1])
    assert [field.to_numpy().tolist() for field in fields] == before
    assert (vertices.storage.order.tolist(), vertices.storage.version) == ([2, 0, 1], 1)


@pytest.mark.parametrize("of_a_field", [False, True])
def test_keys_that_an_interrupted_load_has_written_are_noticed(
    monkeypatch, mesh: tuple[Relation, Relation], of_a_field: bool
) -> None:
    _, edges = mesh
    edges.group_by("tail")
    assert groups(edges.tail) == expected(TAILS, 4)
    epoch, usual = structure.epoch, Field.changed

    def interrupted(self):
        if self.to_numpy().tolist() == HEADS:
            raise KeyboardInterrupt
        usual(self)

    monkeypatch.setattr(Field, "changed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        edges.tail.load(edges.head if of_a_field else HEADS)
    assert structure.epoch is not epoch
    assert groups(edges.tail) == expected(HEADS, 4)


def test_a_grouping_that_is_interrupted_is_none(monkeypatch, mesh: tuple[Relation, Relation]) -> None:
    _, edges = mesh

    def interrupted(self, table):
        raise KeyboardInterrupt

    monkeypatch.setattr(Buffer, "permuted", interrupted)
    with pytest.raises(KeyboardInterrupt):
        edges.group_by("tail")
    monkeypatch.undo()
    assert edges.tail.grouping is None and edges.storage.primary is None
    edges.group_by("tail")
    assert groups(edges.tail) == expected(TAILS, 4)


@pytest.mark.parametrize("field", ["length", "ends"])
def test_only_single_keys_group(mesh: tuple[Relation, Relation], field: str) -> None:
    vertices, edges = mesh
    edges.new_field("ends", vector(vertices, 2))
    with pytest.raises(RelationError) as caught:
        edges.group_by(field)
    assert caught.value.codes == ("E511",)
    assert "tail, head" in str(caught.value)


def test_an_open_view_stops_the_sort_and_leaves_all_as_it_was(mesh: tuple[Relation, Relation]) -> None:
    _, edges = mesh
    with edges.length.view(write=True), pytest.raises(RelationError) as caught:
        edges.group_by("tail")
    assert caught.value.codes == ("E512",)
    assert (edges.tail.grouping, edges.storage.primary, edges.storage.order) == (None, None, None)
    edges.group_by("tail")
    assert groups(edges.tail) == expected(TAILS, 4)
