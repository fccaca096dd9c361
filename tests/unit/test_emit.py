from __future__ import annotations

import re

import numpy as np
import pytest
from both_backends import checked, launch, run_both
from kir_forms import OnRows, binary, call, const, for_query, get, local, random, read, reduce_global, uniform, write

from ebb.backends.cpu import cpu_backend
from ebb.backends.cpu.tiles import tile_boxes
from ebb.backends.llvm import ops
from ebb.backends.llvm.hooks import CPU
from ebb.compiler.lir import BLOCK_ROWS
from ebb.errors import BackendError
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.relations.subset import Box
from ebb.runtime.symbols import external_symbols
from ebb.types.types import bool_, float32, float64, int32, key, uint64, vector


@pytest.fixture
def axpy():
    relation = Relation("rows", size=100)
    relation.new_field("x", float32, init=1.0)
    relation.new_field("y", float32, init=2.0)
    on = OnRows(relation)
    product = binary("*", uniform(0, float32), read(relation.x, on.row))
    body = write(relation.y, on.row, binary("+", product, read(relation.y, on.row)))
    return on.kernel(body, uniforms=((3.0, float32),))


def inspect(kernel, stage):
    return cpu_backend(1).prepare(checked(kernel)).inspect(stage)


def test_straight_line_kernels_are_vectorised_without_runtime_checks(axpy):
    text = inspect(axpy, "llvm")
    assert re.search(r"fmul contract <\d+ x float>", text)
    assert "vector.memcheck" not in text and "llvm.loop.isvectorized" in text


def test_reductions_into_globals_are_vectorised():
    relation = Relation("rows", size=100)
    relation.new_field("x", float32, init=1.0)
    on = OnRows(relation)
    for op in ("+", "max"):
        kernel = on.kernel(reduce_global(Global(float32, 0.0), op, read(relation.x, on.row)))
        assert re.search(r"<\d+ x float>", inspect(kernel, "llvm"))


def test_offsets_on_a_grid_are_vectorised():
    from kir_forms import affine

    grid = Relation("cells", shape=(20, 30))
    grid.new_field("x", float64, init=1.0)
    grid.new_field("y", float64)
    on = OnRows(grid)
    near = [affine(grid, [[1, 0, di], [0, 1, dj]], on.row) for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    total = read(grid.x, near[0])
    for node in near[1:]:
        total = binary("+", total, read(grid.x, node))
    text = inspect(on.kernel(write(grid.y, on.row, total)), "llvm")
    assert re.search(r"fadd contract <\d+ x double>", text) and "gather" not in text


def test_every_stage_is_shown(axpy):
    assert inspect(axpy, "lir").startswith("program step over line")
    assert "define" in inspect(axpy, "llvm") and "ebb_blocks" in inspect(axpy, "asm")
    assert inspect(axpy, "ptx") is None


def test_literals_are_exact():
    assert ops.literal(0.1, float64) == "0x3FB999999999999A"
    assert ops.literal(0.1, float32) == "0x3FB99999A0000000"
    assert ops.literal(1e300, float32) == "0x7FF0000000000000"
    assert ops.literal(-1, uint64) == "-1" and ops.literal(2**63, uint64) == str(-(2**63))
    assert ops.literal(np.bool_(True), bool_) == "true"


def test_every_function_of_the_c_library_is_there():
    templates = [name for name in CPU.math.values() if not name.startswith("llvm.")]
    names = {name.format(suffix=suffix) for name in templates for suffix in ("", "f")}
    assert names <= set(external_symbols("".join(f"{name}\0" for name in names).encode()))
    assert set(external_symbols(b"\0asin\0cosine\0")) == {"asin", "sin"}


def test_a_kernel_that_draws_and_queries_compiles_to_calls_that_link():
    points = Relation("points", size=5)
    edges = Relation("edges", size=7)
    edges.new_field("end", key(points), init=[0, 1, 2, 3, 4, 4, 4])
    edges.group_by("end")
    points.new_field("x", float64)
    on, e, x = OnRows(points), local("e", edges.key_type), local("x", float64)
    from kir_forms import assign

    body = [
        assign(x, random("randn", float64)),
        for_query(e, edges.end, on.row, assign(x, call("cbrt", call("hypot", get(x), const(1.0, float64))))),
        write(points.x, on.row, get(x)),
    ]
    kernel = on.kernel(*body)
    launch(cpu_backend(1).prepare(checked(kernel)), kernel, points)
    assert np.isfinite(points.x.to_numpy()).all()


@pytest.mark.parametrize(
    "boxes",
    [
        [Box((0,), (5000,))],
        [Box((1, 2), (40, 70))],
        [Box((0, 0), (3, 4000)), Box((5, 1), (9, 3))],
        [Box((0, 0, 0), (9, 20, 30)), Box((1, 1, 1), (1, 5, 5))],
        [Box((0, 0, 0), (2, 2, 1024))],
    ],
)
def test_tiles_cover_boxes_in_the_order_of_rows(boxes):
    tiles = tile_boxes(boxes)
    rows = [row for tile in tiles for row in np.ndindex(*(stop - start for start, stop in tile))]
    assert len(rows) == sum(box.size for box in boxes)
    sizes = [int(np.prod(tile[:, 1] - tile[:, 0])) for tile in tiles]
    assert 0 < max(sizes) <= BLOCK_ROWS and min(sizes) > 0
    listed = [tuple(np.add(tile[:, 0], at)) for tile in tiles for at in np.ndindex(*(tile[:, 1] - tile[:, 0]))]
    expected = [
        tuple(np.add(box.start, at))
        for box in boxes
        if box.size
        for at in np.ndindex(*(np.subtract(box.stop, box.start)))
    ]
    assert listed == expected


def test_keys_of_grids_are_kept_as_int32():
    grid = Relation("cells", shape=(4, 4))
    grid.new_field("next", grid.key_type, init=lambda i, j: (j, i))
    grid.new_field("n", int32, init=np.arange(16).reshape(4, 4))
    grid.new_field("m", int32)
    on = OnRows(grid)
    kernel = on.kernel(write(grid.m, on.row, read(grid.n, read(grid.next, on.row))))
    assert "int32 read  # cells.next" in inspect(kernel, "lir")
    expected, found = run_both(kernel)
    assert np.array_equal(expected, found)


def test_variables_that_no_stack_holds_are_an_error():
    from kir_forms import assign, component, i32

    wide = vector(float64, 1000)
    relation = Relation("rows", size=2)
    relation.new_field("v", wide)
    relation.new_field("x", float64)
    relation.new_field("i", int32)
    on = OnRows(relation)
    body = []
    for number in range(140):
        v = local(f"v{number}", wide)
        body += [
            assign(v, read(relation.v, on.row)),
            write(relation.x, on.row, component(get(v), read(relation.i, on.row))),
        ]
    kernel = on.kernel(*body, write(relation.i, on.row, i32(0)))
    with pytest.raises(BackendError, match="E605"):
        cpu_backend(1).prepare(checked(kernel)).bind(relation).run(())
