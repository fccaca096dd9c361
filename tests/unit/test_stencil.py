from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from ebb.compiler import kir
from ebb.compiler.phases.stencil import check_stencil, collect_stencil
from ebb.diagnostics.span import Source, Span
from ebb.errors import BoundsError
from ebb.relations.relation import Relation
from ebb.types.types import int64

SOURCE = Source("slope.py", "c(1, 0)")
HERE = Span(SOURCE, 1, 0, 1, 7)


def kernel(cells, *keys):
    row = kir.Local("c", 0, cells.key_type)
    body = tuple(
        kir.Assign(kir.Local("k", uid, int64), (), kir.RowId(key, int64, HERE), HERE) for uid, key in enumerate(keys, 1)
    )
    return kir.Kernel("slope", cells, row, (), body, HERE)


def own(cells):
    row = kir.Local("c", 0, cells.key_type)
    return kir.ReadLocal(row, row.type, HERE)


def affine(target, matrix, key, edge=kir.Edge.CHECK):
    entries = tuple(tuple(Fraction(entry) for entry in row) for row in matrix)
    return kir.Affine(entries, key, edge, target.key_type, HERE)


def move(cells, *offset, key=None, edge=kir.Edge.CHECK):
    matrix = [[int(i == j) for j in range(len(offset))] + [step] for i, step in enumerate(offset)]
    return affine(cells, matrix, key or own(cells), edge)


def check(cells, *keys, rows=None):
    built = kernel(cells, *keys)
    check_stencil(built, collect_stencil(built), rows if rows is not None else cells)


def failures(cells, *keys, rows=None):
    with pytest.raises(BoundsError) as caught:
        check(cells, *keys, rows=rows)
    return caught.value.diagnostics


def test_an_overrun_names_dimension_reach_row_and_subset():
    cells = Relation("cells", shape=(4, 5))
    (found,) = failures(cells, move(cells, 0, 2))
    assert (found.dimension, found.extent, found.reach, found.row) == (1, 5, (2, 6), (0, 3))
    assert found.move == "offset (0, 2)"
    assert found.subset == 'cells.new_subset("interior", np.s_[:, :-2])'
    assert "indices 2 to 6 of dimension 1, which has 0 to 4" in found.primary.text


def test_the_suggested_subset_does_for_all_accesses():
    cells = Relation("cells", shape=(4, 5, 6))
    keys = [move(cells, *offset) for offset in ((1, 0, 0), (-1, 0, 0), (0, 0, -2), (0, 0, 0))]
    found = failures(cells, *keys)
    assert [one.dimension for one in found] == [0, 0, 2]
    assert {one.subset for one in found} == {'cells.new_subset("interior", np.s_[1:-1, :, 2:])'}
    subset = eval(found[0].subset, {"cells": cells, "np": np})
    check(cells, *keys, rows=subset)


def test_a_taken_name_is_not_suggested():
    cells = Relation("cells", shape=(4,))
    cells.new_subset("interior", np.s_[1:-1])
    (found,) = failures(cells, move(cells, 1))
    assert found.subset == 'cells.new_subset("inside", np.s_[:-1])'
    check(cells, move(cells, 1), move(cells, -1), rows=cells.interior)


def test_periodic_dimensions_wrap_each_alone():
    cells = Relation("cells", shape=(4, 5), periodic=(True, False))
    check(cells, move(cells, 9, 0), move(cells, -9, 0))
    (found,) = failures(cells, move(cells, 9, -1))
    assert found.dimension == 1


def test_clamped_accesses_never_fail_and_are_followed():
    cells = Relation("cells", shape=(4,))
    clamped = move(cells, 3, edge=kir.Edge.CLAMP)
    check(cells, clamped, move(cells, -3, key=clamped))
    (found,) = failures(cells, move(cells, -4, key=clamped))
    assert found.reach == (-1, -1)


def test_chains_are_composed_exactly():
    cells = Relation("cells", shape=(4, 4), periodic=(False, True))
    corners = Relation("corners", shape=(5, 5))
    up = affine(corners, [[1, 0, 1], [0, 1, 1]], own(cells))
    check(cells, up, affine(cells, [[1, 0, -1], [0, 1, -1]], up))
    (found,) = failures(cells, up, affine(cells, [[1, 0, 0], [0, 1, 0]], up))
    assert (found.dimension, found.reach, found.move) == (0, (1, 4), "offset (1, 1)")


def test_a_chain_through_locals_is_followed():
    cells = Relation("cells", shape=(4,))
    local = kir.Local("k", 1, cells.key_type)
    read = kir.ReadLocal(local, local.type, HERE)
    body = (
        kir.Assign(local, (), move(cells, 1), HERE),
        kir.Assign(kir.Local("n", 2, int64), (), kir.RowId(move(cells, 1, key=read), int64, HERE), HERE),
    )
    built = kir.Kernel("slope", cells, kir.Local("c", 0, cells.key_type), (), body, HERE)
    assert [len(access.steps) for access in collect_stencil(built)] == [1, 2]
    cells.new_subset("left", np.s_[:3])
    with pytest.raises(BoundsError) as caught:
        check_stencil(built, collect_stencil(built), cells.left)
    (found,) = caught.value.diagnostics
    assert found.reach == (2, 4)


def test_keys_from_data_are_no_stencil():
    cells = Relation("cells", shape=(4,))
    link = cells.new_field("link", cells)
    key = kir.ReadField(link, own(cells), cells.key_type, HERE)
    assert collect_stencil(kernel(cells, move(cells, 1, key=key))) == ()


def test_fractions_are_floored():
    fine, coarse = Relation("fine", shape=(7,)), Relation("coarse", shape=(4,))
    half = Fraction(1, 2)
    check(fine, affine(coarse, [[half, 0]], own(fine)))
    check(fine, affine(coarse, [[half, half]], own(fine)))
    (found,) = failures(fine, affine(coarse, [[half, 1]], own(fine)))
    assert (found.reach, found.row, found.move) == ((1, 4), (6,), "map [[1/2, 1]]")
    (below,) = failures(fine, affine(coarse, [[half, -half]], own(fine)))
    assert below.reach == (-1, 2)


def test_subsets_of_rows_are_checked_row_by_row():
    cells = Relation("cells", shape=(3, 3))
    inner = cells.new_subset("inner", np.array([[1, 1], [0, 1]]))
    check(cells, move(cells, 1, 0), rows=inner)
    (found,) = failures(cells, move(cells, -1, 0), rows=inner)
    assert (found.row, found.reach) == ((0, 1), (-1, 0))


def test_maps_that_mix_dimensions():
    cells, line = Relation("cells", shape=(3, 4)), Relation("line", shape=(6,))
    check(cells, affine(line, [[1, 1, 0]], own(cells)))
    (found,) = failures(cells, affine(line, [[1, 1, 1]], own(cells)))
    assert (found.reach, found.row, found.subset) == ((1, 6), (2, 3), None)


def test_empty_sets_pass():
    cells = Relation("cells", shape=(3, 3))
    check(cells, move(cells, 9, 9), rows=cells.new_subset("none", np.s_[0:0, :]))
    check(cells, move(cells, 9, 9), rows=cells.new_subset("nothing", []))
    empty = Relation("empty", shape=(0, 3))
    check(empty, move(empty, 1, 0))


def test_an_empty_grid_has_no_rows_to_give():
    cells, empty = Relation("cells", shape=(3,)), Relation("empty", shape=(0,), periodic=(True,))
    (found,) = failures(cells, affine(empty, [[1, 0]], own(cells)))
    assert found.primary.text == "offset 0 asks for indices 0 to 2 of dimension 0, which is empty"


def test_no_box_will_do():
    cells = Relation("cells", shape=(3,))
    (found,) = failures(cells, move(cells, 3))
    assert found.subset is None
    assert any("no box" in note for note in found.notes)


def test_entries_beyond_64_bits_are_followed_exactly():
    cells = Relation("cells", shape=(5,))
    (found,) = failures(cells, affine(cells, [[2**63, 0]], own(cells)))
    assert found.reach == (0, 4 * 2**63)


def test_large_grids_are_checked_in_parts():
    cells = Relation("cells", shape=(1 << 12, 1 << 12))
    line = Relation("line", shape=(1 << 13,))
    check(cells, affine(line, [[1, 1, 0]], own(cells)))
    (found,) = failures(cells, affine(line, [[1, 1, 2]], own(cells)))
    assert found.row == (4095, 4095)
