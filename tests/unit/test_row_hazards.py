"""Rows that LLVM's vectoriser, or strips of rows, once computed wrongly: random kernels found them."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.backends.llvm import row_plan
from ebb.relations.family import family_of
from ebb.runtime.buffer import Layout

ROWS = 70
SHIFT = np.array([[1, 2], [-1, 3]], dtype=np.int32)


@pytest.fixture(params=Layout)
def relations(request) -> tuple[ebb.Relation, ebb.Relation]:
    """Rows whose keys meet in a few targets; fields of several components lie as the parameter says."""
    rng = np.random.default_rng(3)
    cells, rows = ebb.Relation("cells", size=20), ebb.Relation("rows", size=ROWS)
    cells.new_field("s", ebb.float32, init=0)
    cells.new_field("p", ebb.vec3d, init=-0.0)
    cells.new_field("q", ebb.vec2d, init=rng.integers(-8, 9, (20, 2)) / 4)
    rows.new_field("cell", cells, init=rng.integers(0, 20, ROWS))
    rows.new_field("turns", ebb.int32, init=rng.integers(1, 40, ROWS))
    rows.new_field("m", ebb.mat2i, init=rng.integers(-8, 9, (ROWS, 2, 2)))
    rows.new_field("big", ebb.mat3d, init=rng.integers(-8, 9, (ROWS, 3, 3)) / 4)
    rows.new_field("long", ebb.vector(ebb.int32, 64), init=0)
    rows.new_field("at", ebb.vector(ebb.int32, 64), init=rng.integers(0, 3, (ROWS, 64)))
    for field in (rows.m, rows.big, rows.long, rows.at):
        family_of(field).layout = request.param
        family_of(field).convert(field)
    return cells, rows


@ebb.kernel
def sum_and_change(r):
    for _ in range(2):
        r.cell.s += ebb.float32(-1.25)
        for _ in range(3):
            r.m = (r.m + SHIFT).T


@ebb.kernel
def sum_while(r):
    n = 0
    while n < 2:
        n += 1
        r.cell.s += ebb.float32(-1.25)
        r.m = (r.m + SHIFT).T


@ebb.kernel
def count_in_row(r):
    for k in range(r.turns):
        r.long[r.at[k]] += 1
        r.at[k] = r.at[k] + r.long[k]


@ebb.kernel
def change_part(r):
    r.big[0, 1] = r.big[1, 0] + ebb.sqrt(abs(r.cell.q[0])) * 0 + r.cell.q[1]


@ebb.kernel
def take_from(r):
    r.cell.p[1] -= r.cell.q[0] * 0.5


@pytest.mark.parametrize(
    "kernel", [sum_and_change, sum_while, count_in_row, change_part, take_from], ids=lambda k: k.__name__
)
def test_rows_that_meet_give_what_they_give_one_by_one(relations, kernel, monkeypatch):
    monkeypatch.setattr(row_plan._Planner, "pays", lambda planner: True)
    _, rows = relations
    fields = [field for relation in relations for field in relation.fields.values()]
    before = [field.to_numpy() for field in fields]
    results = []
    for backend in ("reference", "cpu"):
        for field, value in zip(fields, before, strict=True):
            field.load(value)
        with ebb.backend(backend):
            kernel(rows)
        results.append([field.to_numpy() for field in fields])
    for field, expected, found in zip(fields, *results, strict=True):
        assert found.tobytes() == expected.tobytes(), field.path
