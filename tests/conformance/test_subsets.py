"""Subsets: by slices, boxes, masks and indices; a kernel touches exactly their rows, once each."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import rejects, sizes_for


def touched(relation, subset):
    """How often a launch on ``subset`` visits each row."""
    if "n" not in relation.fields:
        relation.new_field("n", ebb.int32)
    relation.n.fill(0)

    @ebb.kernel
    def touch(r: relation):
        r.n += 1

    touch(subset)
    return relation.n.to_numpy()


SLICES = {
    "interior": np.s_[1:-1, 1:-1],
    "left": np.s_[:, 0],
    "corner": np.s_[-1, -1:],
    "rows": np.s_[2:4],
    "all": np.s_[:, :],
    "ellipsis": np.s_[..., 1:3],
    "stride": np.s_[::2, 1::3],
    "backwards": np.s_[::-1, 3:0:-1],
    "beyond": np.s_[3:100, :],
    "nothing": np.s_[3:3, :],
}


@pytest.mark.parametrize("name", SLICES)
def test_subsets_by_slices(backend, name):
    cells = ebb.Relation("cells", shape=(5, 6))
    subset = cells.new_subset("s", SLICES[name])
    expected = np.zeros((5, 6))
    expected[SLICES[name]] = 1
    np.testing.assert_array_equal(touched(cells, subset), expected)
    assert cells.s is subset
    assert subset.size == len(subset) == expected.sum()
    assert subset.relation is cells


def test_a_subset_of_one_and_three_dimensions(backend):
    line, box = ebb.Relation("line", shape=(9,)), ebb.Relation("box", shape=(3, 4, 5))
    np.testing.assert_array_equal(touched(line, line.new_subset("s", np.s_[2:-2])), [0, 0, 1, 1, 1, 1, 1, 0, 0])
    expected = np.zeros((3, 4, 5))
    expected[1:, 1:-1, 2] = 1
    np.testing.assert_array_equal(touched(box, box.new_subset("s", np.s_[1:, 1:-1, 2])), expected)


def test_overlapping_boxes_visit_each_row_once(backend):
    cells = ebb.Relation("cells", shape=(6, 7))
    boxes = [np.s_[0:1, :], np.s_[-1:, :], np.s_[:, 0:1], np.s_[:, -1:], np.s_[0:3, 0:3]]
    expected = np.zeros((6, 7))
    for box in boxes:
        expected[box] = 1
    np.testing.assert_array_equal(touched(cells, cells.new_subset("boundary", boxes)), expected)
    assert cells.boundary.size == expected.sum()


def test_a_subset_by_mask(backend):
    cells = ebb.Relation("cells", shape=(5, 6))
    mask = np.add.outer(np.arange(5), np.arange(6)) % 2 == 0
    np.testing.assert_array_equal(touched(cells, cells.new_subset("red", mask)), mask)
    np.testing.assert_array_equal(touched(cells, cells.new_subset("black", ~mask)), ~mask)


def test_a_subset_by_indices_of_any_relation(backend):
    for size in sizes_for(backend):
        rows = ebb.Relation("rows", size=size)
        mask = np.arange(size) % 3 == 1
        np.testing.assert_array_equal(touched(rows, rows.new_subset("a", np.flatnonzero(mask))), mask)
        np.testing.assert_array_equal(touched(rows, rows.new_subset("b", mask)), mask)
        np.testing.assert_array_equal(
            touched(rows, rows.new_subset("c", np.s_[: size // 2])), np.arange(size) < size // 2
        )


def test_repeated_and_unsorted_indices_visit_once(backend):
    rows = ebb.Relation("rows", size=6)
    np.testing.assert_array_equal(touched(rows, rows.new_subset("s", [4, 1, 4, 1, 0])), [1, 1, 0, 0, 1, 0])


def test_an_empty_subset(backend):
    rows = ebb.Relation("rows", size=6)
    assert not touched(rows, rows.new_subset("a", [])).any()
    assert not touched(rows, rows.new_subset("b", np.zeros(6, bool))).any()


def test_a_subset_follows_its_rows_when_the_relation_is_grouped(backend):
    others, rows = ebb.Relation("others", size=5), ebb.Relation("rows", size=65)
    rows.new_field("k", others, init=np.random.default_rng(0).integers(0, 5, 65))
    before = rows.new_subset("before", np.arange(0, 65, 7))
    expected = np.arange(65) % 7 == 0
    np.testing.assert_array_equal(touched(rows, before), expected)
    rows.group_by("k")
    np.testing.assert_array_equal(touched(rows, before), expected)
    np.testing.assert_array_equal(touched(rows, rows.new_subset("after", ~expected)), ~expected)


def test_reductions_from_a_subset(backend):
    cells = ebb.Relation("cells", shape=(40, 50))
    cells.new_field("x", ebb.int64, init=np.arange(2000).reshape(40, 50))
    cells.new_subset("inner", np.s_[3:-3, 5:-5])
    total = ebb.Global(ebb.int64, 0)

    @ebb.kernel
    def add(c: cells):
        total.value += c.x

    add(cells.inner)
    assert total.value == np.arange(2000).reshape(40, 50)[3:-3, 5:-5].sum()


def test_coords_and_id_in_a_subset(backend):
    cells = ebb.Relation("cells", shape=(4, 5))
    cells.new_field("ij", ebb.vec2i, init=-1)
    cells.new_subset("s", [np.s_[1:3, 1:3], np.s_[2:4, 3:5]])

    @ebb.kernel
    def place(c: cells):
        c.ij = ebb.coords(c)

    place(cells.s)
    mask = np.zeros((4, 5), bool)
    mask[1:3, 1:3] = mask[2:4, 3:5] = True
    expected = np.where(mask[..., None], np.moveaxis(np.indices((4, 5)), 0, -1), -1)
    np.testing.assert_array_equal(cells.ij.to_numpy(), expected)


def test_one_kernel_on_the_relation_and_on_subsets(backend):
    rows = ebb.Relation("rows", size=10)
    rows.new_field("x", ebb.int32, init=0)
    rows.new_subset("low", np.s_[:5])
    rows.new_subset("high", np.s_[5:])

    @ebb.kernel
    def add(r: rows, amount: ebb.int32):
        r.x += amount

    add(rows, 1)
    add(rows.low, 10)
    add(rows.high, 100)
    add(rows.low, 1000)
    np.testing.assert_array_equal(rows.x.to_numpy(), [1011] * 5 + [101] * 5)


def test_a_subset_of_another_relation_is_an_error():
    rows, others = ebb.Relation("rows", size=3), ebb.Relation("others", size=3)
    rows.new_field("x", ebb.int32)
    others.new_field("x", ebb.int32)
    others.new_subset("some", [0, 1])

    @ebb.kernel
    def add(r: rows):
        r.x += 1

    rejects(ebb.KernelTypeError, "E261", lambda: add(others.some))
    assert not others.x.to_numpy().any()


@pytest.mark.parametrize(
    "selection",
    [
        [6],
        [-1],
        np.array([0.5]),
        "abc",
        np.zeros(5, bool),
        np.zeros((2, 3), bool),
        [[0, 1], [2, 3]],
        5.5,
        np.s_[1:2, 1:2],
    ],
)
def test_selections_that_are_none(selection):
    rows = ebb.Relation("rows", size=6)
    rejects(ebb.RelationError, "E5", lambda: rows.new_subset("s", selection))
    with pytest.raises(AttributeError):
        rows.s


def test_the_name_of_a_subset_is_unique():
    rows = ebb.Relation("rows", size=6)
    rows.new_field("x", ebb.int32)
    rejects(ebb.RelationError, "E502", lambda: rows.new_subset("x", [0]))
    rows.new_subset("s", [0])
    rejects(ebb.RelationError, "E502", lambda: rows.new_subset("s", [1]))


@pytest.mark.parametrize(("failing", "first"), [([(5, 1), (1, 6), (1, 1)], (5, 1)), ([(1, 1), (2, 7), (1, 6)], (1, 6))])
def test_the_row_that_fails_is_the_first_of_the_first_box(failing, first):
    cells = ebb.Relation("cells", shape=(8, 8))
    cells.new_subset("parts", [np.s_[4:8, 0:2], np.s_[0:3, 5:8], np.s_[0:2, 0:3]])
    bad = np.zeros((8, 8), dtype=bool)
    for place in failing:
        bad[place] = True
    cells.new_field("bad", ebb.bool_, init=bad)

    @ebb.kernel
    def look(c: cells):
        assert not c.bad, "it is bad"

    with pytest.raises(ebb.KernelAssertionError, match=rf"cells\[{first[0]}, {first[1]}\]"):
        look(cells.parts)
