"""Subsets: the rows that each way of selecting gives, each once, wherever they are stored."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ebb.errors import RelationError
from ebb.relations.relation import Relation
from ebb.relations.subset import Box, RowSet, Subset


def rows_of(subset: Subset) -> list[int]:
    return subset.identities().tolist()


def mask_rows(shape: tuple[int, ...], *selections: object) -> list[int]:
    mask = np.zeros(shape, dtype=bool)
    for selection in selections:
        mask[selection] = True
    return np.flatnonzero(mask).tolist()


@pytest.fixture
def cells() -> Relation:
    return Relation("cells", shape=(5, 6))


@pytest.mark.parametrize(
    "selection",
    [np.s_[1:-1, 1:-1], np.s_[:], np.s_[2], np.s_[2:3], np.s_[:, 0], np.s_[-1, :], np.s_[..., 2], np.s_[1:100, -3:],
     np.s_[4:2, :], np.s_[::2, 1::3], np.s_[::-1, ::-2], np.s_[1:, ...], np.s_[...]],
    ids=repr,
)  # fmt: skip
def test_slices_mean_what_they_mean_in_numpy(cells: Relation, selection: object) -> None:
    if not isinstance(selection, slice | tuple):
        selection = (selection, ...) if selection is not ... else (...,)
    subset = cells.new_subset("some", selection)
    expected = mask_rows(cells.shape, selection)
    assert rows_of(subset) == expected
    assert subset.row_positions().tolist() == expected
    assert len(subset) == subset.size == len(expected)
    assert subset.row_positions().dtype == np.int64


def test_a_subset_is_an_attribute_and_a_row_set(cells: Relation) -> None:
    subset = cells.new_subset("interior", np.s_[1:-1, 1:-1])
    assert cells.interior is subset is cells.attribute("interior")
    assert isinstance(subset, RowSet)
    assert subset.boxes == (Box((1, 1), (4, 5)),)
    assert repr(subset) == "<subset cells.interior: 12 of 30 rows>"


def test_steps_are_no_boxes(cells: Relation) -> None:
    assert cells.new_subset("red", np.s_[::2, ::2]).boxes is None


@pytest.mark.parametrize("shape", [(7,), (5, 6), (3, 4, 5)])
@given(data=st.data())
def test_boxes_that_overlap_count_once(shape: tuple[int, ...], data: st.DataObject) -> None:
    def one_slice(extent: int) -> st.SearchStrategy[slice]:
        ends = st.integers(-extent - 1, extent + 1)
        return st.builds(slice, ends, ends)

    boxes = data.draw(st.lists(st.tuples(*map(one_slice, shape)), min_size=1, max_size=6))
    subset = Relation("cells", shape=shape).new_subset("some", boxes)
    assert rows_of(subset) == mask_rows(shape, *boxes)
    assert subset.boxes is not None
    assert subset.size == len(rows_of(subset)), "the boxes are disjoint"


def test_many_boxes_become_rows() -> None:
    cells = Relation("cells", shape=(200, 3))
    boxes = [np.s_[i : i + 1, :] for i in range(0, 200, 2)]
    subset = cells.new_subset("stripes", boxes)
    assert subset.boxes is None
    assert rows_of(subset) == mask_rows(cells.shape, np.s_[::2])


def test_masks_and_rows(cells: Relation) -> None:
    mask = np.random.default_rng(0).random(cells.shape) < 0.3
    assert rows_of(cells.new_subset("mask", mask)) == np.flatnonzero(mask).tolist()
    assert rows_of(cells.new_subset("numbers", [7, 3, 7, 29])) == [3, 7, 29]
    assert rows_of(cells.new_subset("tuples", [(1, 1), (0, 3), (1, 1), (4, 5)])) == [3, 7, 29]
    assert rows_of(cells.new_subset("argwhere", np.argwhere(mask))) == np.flatnonzero(mask).tolist()


@pytest.mark.parametrize("nothing", [[], np.zeros((0, 2), dtype=int), np.s_[0:0, :], np.zeros((5, 6), dtype=bool)])
def test_empty_subsets(cells: Relation, nothing: object) -> None:
    subset = cells.new_subset("nothing", nothing)
    assert (subset.size, rows_of(subset), subset.row_positions().tolist()) == (0, [], [])


def test_a_relation_that_is_no_grid() -> None:
    rows = Relation("rows", size=6)
    assert rows_of(rows.new_subset("slices", np.s_[1:-1:2])) == [1, 3]
    assert rows_of(rows.new_subset("parts", [np.s_[:2], np.s_[1:3]])) == [0, 1, 2]
    assert rows_of(rows.new_subset("mask", np.arange(6) > 3)) == [4, 5]
    assert rows_of(rows.new_subset("numbers", (5, 0))) == [0, 5]
    assert rows.slices.boxes is None


def test_positions_follow_the_storage() -> None:
    rows = Relation("rows", size=6)
    subset = rows.new_subset("some", [0, 2, 5])
    assert subset.row_positions().tolist() == [0, 2, 5]
    rows.permute([5, 4, 3, 0, 2, 1])
    assert subset.row_positions().tolist() == [0, 3, 4]
    assert rows.storage.order[subset.row_positions()].tolist() == [5, 0, 2]
    rows.permute([5, 4, 3, 2, 1, 0])
    assert sorted(rows.storage.order[subset.row_positions()].tolist()) == [0, 2, 5]
    assert rows_of(rows.new_subset("later", [1])) == [1]
    assert rows.storage.order[rows.later.row_positions()].tolist() == [1]


def test_a_subset_of_no_rows() -> None:
    none = Relation("none", size=0)
    assert none.new_subset("all", np.s_[:]).size == 0
    assert none.new_subset("mask", np.zeros(0, dtype=bool)).size == 0


@pytest.mark.parametrize(
    ("selection", "code"),
    [([30], "E515"), ([3, -1], "E515"), ([(0, 0), (5, 0)], "E515"), ([(0, -1)], "E515"), (np.s_[5, :], "E515"),
     (np.s_[-6, :], "E515"), (np.s_[:, :, :], "E514"), (np.s_[..., ...], "E514"), (np.s_[::0, :], "E514"),
     (np.s_["a":, :], "E514"), (np.zeros(30, dtype=bool), "E514"), ([0.5], "E514"), ("abc", "E514"), (7, "E514"),
     ([(0, 0, 0)], "E514"), ([[0, 1], [2]], "E514"), (None, "E514")],
    ids=repr,
)  # fmt: skip
def test_what_is_no_subset(cells: Relation, selection: object, code: str) -> None:
    with pytest.raises(RelationError) as caught:
        cells.new_subset("some", selection)
    assert caught.value.codes == (code,)
    assert cells.attribute("some") is None
