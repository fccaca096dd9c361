from __future__ import annotations

from importlib import resources

import pytest
from kir_forms import HERE, OnRows, affine, const, for_range, i32, local

from ebb.compiler import failures, kir
from ebb.errors import BoundsError, KernelAssertionError, KernelTypeError, RelationError
from ebb.relations.relation import Relation
from ebb.types.types import bool_, float32, int32, vector

vertices = Relation("vertices", size=5)
vertices.new_field("next", vertices)
cells = Relation("cells", shape=(2, 3), periodic=(True, False))
on = OnRows(vertices)
kernel = on.kernel()
beyond = affine(cells, [[1, 0, 9], [0, 1, 9]], OnRows(cells, "c").row)

FAILURES = {
    "E401": (failures.assertion_failed(kernel, 3, kir.Assert(const(False, bool_), "why", HERE)), KernelAssertionError),
    "E402": (failures.component_out_of_range(kernel, 3, HERE, 7, 0, vector(float32, 3)), BoundsError),
    "E403": (failures.affine_outside(kernel, 3, beyond, (9, 11)), BoundsError),
    "E404": (failures.unset_key(kernel, 3, HERE, vertices.next, 4), RelationError),
    "E405": (failures.zero_step(kernel, 3, for_range(local("i", int32), i32(0), i32(1), i32(0))), KernelTypeError),
}  # fmt: skip


@pytest.mark.parametrize("code", FAILURES)
def test_a_failure_names_kernel_row_and_line(code):
    error, kind = FAILURES[code]
    text = str(error)
    assert isinstance(error, kind) and error.codes == (code,)
    for fact in ("'step'", "vertices[3]", "line 2", "x = v.a", f"ebb explain {code}"):
        assert fact in text


@pytest.mark.parametrize("code", FAILURES)
def test_every_failure_has_a_page(code):
    page = resources.files("ebb.diagnostics").joinpath("pages", f"{code}.md").read_text(encoding="utf-8")
    assert page.startswith(f"# {code}: ") and page.count("```python") >= 2


def test_the_offending_values_are_shown():
    assert "7 is not in range(3)" in str(FAILURES["E402"][0])
    assert "11 is not in range(3), dimension 1" in str(FAILURES["E403"][0])
    assert "'vertices.next' of vertices[4]" in str(FAILURES["E404"][0])


def test_rows_are_named_by_identity():
    moved = Relation("moved", size=3)
    moved.new_field("key", vertices, init=[2, 1, 0])
    moved.group_by("key")
    moved.key.grouping.refresh()
    assert failures.row_name(moved, 0) == "moved[2]"
    assert failures.row_name(cells, 5) == "cells[1, 2]"
    assert failures.row_name(vertices, -1) == "vertices[unset]"
