"""The layout of fields: what memory looks like, that nothing but strides tells, and when fields change theirs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import ebb
from ebb.compiler.elaborate.elaborate import elaborate
from ebb.compiler.pace import pace_of
from ebb.relations.family import family_of
from ebb.relations.field import Field
from ebb.relations.layout import LEAST_COMPONENTS, LEAST_ROWS, consider_layout
from ebb.relations.reach import Pace, Reach
from ebb.runtime.buffer import ALIGNMENT, Buffer, Layout, column_stride

ROWS, COLUMNS = Layout.ROWS, Layout.COLUMNS
SHAPES = [(), (1,), (3,), (2, 3), (3, 3)]
wide = ebb.vector(ebb.float32, LEAST_COMPONENTS)


def lay(layout: Layout, *fields: Field) -> None:
    for field in fields:
        family = family_of(field)
        family.layout = layout
        family.convert(field)


def in_columns(*fields: Field) -> None:
    lay(COLUMNS, *fields)


def reach(field: Field, *through: Field, changed: bool = False, affine: bool = False, queried: bool = False) -> Reach:
    keyed = bool(through) and not queried
    centered = not (keyed or affine or queried)
    return Reach(
        field, changed=changed, centered=centered, affine=affine, keyed=keyed, queried=queried, through=through
    )


# Memory


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("dtype", [np.bool_, np.float32, np.float64])
@pytest.mark.parametrize("rows", [0, 1, 15, 16, 17, 1000])
def test_a_column_is_contiguous_and_aligned(rows: int, dtype: type, shape: tuple[int, ...]) -> None:
    buffer = Buffer((rows, *shape), np.dtype(dtype), COLUMNS)
    stride = column_stride(rows, buffer.host.itemsize)
    assert buffer.host.shape == (rows, *shape)
    assert not buffer.host.any()
    for number, component in enumerate(np.ndindex(*shape)):
        column = buffer.host[(slice(None), *component)]
        assert rows < 2 or column.flags.c_contiguous
        assert column.ctypes.data == buffer.address + number * stride * buffer.host.itemsize
        assert column.ctypes.data % ALIGNMENT == 0
    assert stride >= rows


def test_columns_are_spread_over_the_sets_of_the_cache() -> None:
    for rows in (1, 1000, 1 << 12, 1 << 20):
        assert column_stride(rows, 4) * 4 // ALIGNMENT % 2 == 1


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize(("first", "then"), list(itertools.product(Layout, Layout)))
def test_conversion_and_permutation_keep_values(shape: tuple[int, ...], first: Layout, then: Layout) -> None:
    values = np.random.default_rng(0).random((37, *shape))
    buffer = Buffer(values.shape, values.dtype, first)
    buffer.host[...] = values
    converted = buffer.in_layout(then)
    assert converted.layout is then
    assert (converted is buffer) == (first is then)
    assert np.array_equal(converted.host, values)
    order = np.random.default_rng(1).permutation(37)
    permuted = converted.permuted(order)
    assert permuted.layout is then
    assert np.array_equal(permuted.host, values[order])


def test_keys_in_columns_are_mapped() -> None:
    buffer = Buffer((4, 2), np.dtype(np.int32), COLUMNS)
    buffer.host[...] = [[0, 1], [-1, 2], [2, -1], [1, 0]]
    mapped = buffer.mapped(np.array([2, 0, 1]))
    assert mapped.layout is COLUMNS
    assert mapped.host.tolist() == [[2, 0], [-1, 1], [1, -1], [0, 2]]


def test_conversion_takes_no_more_memory_than_the_values_and_little_padding() -> None:
    buffer = Buffer((100_000, 3, 3), np.dtype(np.float32), COLUMNS)
    assert buffer.host.base is not None
    assert column_stride(100_000, 4) * 9 * 4 <= 1.01 * buffer.host.nbytes
    assert column_stride(1, 8) * 8 == ALIGNMENT


# Fields


@pytest.fixture
def values() -> np.ndarray:
    return np.arange(24 * 9, dtype=np.float64).reshape(24, 3, 3)


@pytest.fixture
def rows() -> ebb.Relation:
    rows = ebb.Relation("rows", size=24)
    for name in ("a", "b"):
        in_columns(rows.new_field(name, ebb.mat3d))
    return rows


def test_loads_and_copies(rows: ebb.Relation, values: np.ndarray) -> None:
    rows.a.load(values)
    assert np.array_equal(rows.a, values)
    assert rows.a.to_numpy().flags.c_contiguous
    rows.b.load(lambda i: values[i])
    assert np.array_equal(rows.b, values)
    rows.b.fill(np.eye(3))
    assert np.array_equal(rows.b, np.broadcast_to(np.eye(3), (24, 3, 3)))
    rows.copy("a", "b")
    assert np.array_equal(rows.b, values)
    assert np.array_equal(rows.new_field("c", ebb.mat3f, init=rows.a), values)
    in_rows = rows.new_field("d", ebb.mat3d, init=rows.a)
    assert in_rows.buffer.layout is ROWS
    assert np.array_equal(in_rows, values)
    rows.a.load(in_rows)
    assert rows.a.buffer.layout is COLUMNS


def test_views_show_the_columns(values: np.ndarray) -> None:
    cells = ebb.Relation("cells", shape=(4, 6))
    field = cells.new_field("a", ebb.mat3d, init=values.reshape(4, 6, 3, 3))
    in_columns(field)
    view = field.view()
    assert view.shape == (4, 6, 3, 3)
    assert view.strides[1] == 8
    assert np.shares_memory(view, field.data)
    assert np.array_equal(view, values.reshape(4, 6, 3, 3))
    assert np.array_equal(np.from_dlpack(field), values.reshape(4, 6, 3, 3))
    with field.view(write=True) as array:
        array[1, 2] = 7
    assert (field.to_numpy()[1, 2] == 7).all()


def test_groupings_follow(values: np.ndarray) -> None:
    others, rows = ebb.Relation("others", size=5), ebb.Relation("rows", size=24)
    rows.new_field("to", others, init=np.arange(24) * 7 % 5)
    rows.new_field("pair", ebb.vector(others, 2), init=np.stack((np.arange(24) % 5, np.arange(24) * 3 % 5), axis=1))
    rows.new_field("a", ebb.mat3d, init=values)
    in_columns(rows.a, rows.pair)
    rows.group_by("to")
    assert rows.a.buffer.layout is rows.pair.buffer.layout is COLUMNS
    assert np.array_equal(rows.a, values)
    others.permute([4, 2, 0, 1, 3])
    assert rows.pair.to_numpy().tolist() == [[i % 5, i * 3 % 5] for i in range(24)]


def test_memory_is_reported_without_padding(rows: ebb.Relation) -> None:
    in_rows = ebb.Relation("rows", size=24)
    for name in ("a", "b"):
        in_rows.new_field(name, ebb.mat3d)
    assert repr(rows) == repr(in_rows)


def test_explain_says_the_layout(rows: ebb.Relation, capsys: pytest.CaptureFixture[str]) -> None:
    rows.new_field("v", ebb.vec3f)
    rows.new_field("s", ebb.float64)

    @ebb.kernel
    def sums(r: rows):
        r.s = ebb.trace(r.a) + ebb.dot(r.v, r.v)

    text = sums.explain(rows)
    assert "72 bytes a row, in columns" in text
    assert "12 bytes a row, in rows" in text
    assert text.count("8 bytes a row\n") == 1


# Kernels


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("layout", Layout)
def test_kernels_reach_every_component(backend: str, layout: Layout, values: np.ndarray) -> None:
    others, rows = ebb.Relation("others", size=5), ebb.Relation("rows", size=24)
    to = np.stack((np.arange(24) % 5, np.arange(24) * 3 % 5), axis=1)
    rows.new_field("to", ebb.vector(others, 2), init=to)
    rows.new_field("a", ebb.mat3d, init=values)
    rows.new_field("b", ebb.mat3d, init=1.0)
    rows.new_field("k", ebb.int32, init=np.arange(24) % 3)
    rows.new_field("x", ebb.float64)
    others.new_field("v", ebb.vec3d)
    lay(layout, rows.to, rows.a, rows.b, others.v)

    @ebb.kernel
    def program(r: rows):
        r.x = r.a[r.k, 2]
        r.b = ebb.transpose(r.a) + r.b
        r.b[r.k, 1] += 100
        for i in range(2):
            r.to[i].v += r.a[1]
        r.to[0].v[2] += r.k

    with ebb.backend(backend):
        program(rows)
    k = np.arange(24) % 3
    assert np.array_equal(rows.x, values[np.arange(24), k, 2])
    expected = values.transpose(0, 2, 1) + 1
    expected[np.arange(24), k, 1] += 100
    assert np.array_equal(rows.b, expected)
    sums = np.zeros((5, 3))
    for i in range(2):
        np.add.at(sums, to[:, i], values[:, 1])
    np.add.at(sums[:, 2], to[:, 0], k)
    assert np.array_equal(others.v, sums)
    assert rows.b.buffer.layout is layout


def test_each_layout_has_code_of_its_own() -> None:
    rows = ebb.Relation("rows", size=100)
    rows.new_field("a", ebb.vec2d, init=1.0)

    @ebb.kernel
    def double(r: rows):
        r.a *= 2

    text = double.inspect(rows, "lir")
    double(rows)
    in_columns(rows.a)
    assert double.inspect(rows, "lir") != text
    assert "columns of rows, 8 bytes an element" in double.inspect(rows, "lir")
    double(rows)
    lay(ROWS, rows.a)
    assert double.inspect(rows, "lir") == text
    double(rows)
    assert np.array_equal(rows.a, np.full((100, 2), 8.0))


# Decisions


def relation(size: int = LEAST_ROWS) -> ebb.Relation:
    rows = ebb.Relation("rows", size=size)
    for name in ("a", "b"):
        rows.new_field(name, wide)
    return rows


def launch(rows: ebb.Relation | ebb.Subset, *reaches: Reach, pace: Pace = Pace.VECTOR, runs: int = 8) -> list[Layout]:
    """The layout of the first field after each of the runs of one launch."""
    layouts: list[Layout] = []
    for run in range(runs):
        consider_layout(rows, reaches, lambda: pace, run)
        layouts.append(reaches[0].field.buffer.layout)
    return layouts


def test_a_wide_field_that_is_streamed_is_converted_once() -> None:
    rows = relation()
    assert launch(rows, reach(rows.a)) == [ROWS] * 5 + [COLUMNS] * 3
    cells = ebb.Relation("cells", shape=(LEAST_ROWS // 8, 8))
    cells.new_field("a", wide)
    inner = cells.new_subset("inner", np.s_[1:-1, 1:-1])
    assert launch(inner, reach(cells.a, affine=True))[-1] is COLUMNS


def test_what_stays_in_rows() -> None:
    assert launch(small := relation(LEAST_ROWS - 1), reach(small.a))[-1] is ROWS
    rows = relation()
    assert launch(rows, reach(rows.new_field("narrow", ebb.vec4d)))[-1] is ROWS
    assert launch(rows, reach(rows.new_field("keys", ebb.vector(rows, 8))))[-1] is ROWS
    listed = rows.new_subset("listed", np.arange(0, LEAST_ROWS, 3))
    assert launch(listed, reach(rows.a))[-1] is ROWS
    assert launch(rows, reach(rows.a), runs=5)[-1] is ROWS


def test_fields_that_are_gathered_stay_in_rows() -> None:
    rows = relation()
    rows.new_field("to", rows)
    launch(rows, reach(rows.a, rows.to))
    assert launch(rows, reach(rows.a))[-1] is ROWS


def test_what_runs_once_does_not_count() -> None:
    rows = relation()
    rows.new_field("to", rows)
    launch(rows, reach(rows.a, rows.to), runs=2)
    assert launch(rows, reach(rows.a))[-1] is COLUMNS


def test_a_launch_on_a_few_rows_counts_little() -> None:
    rows = relation()
    rows.new_field("to", rows)
    some = rows.new_subset("some", np.arange(LEAST_ROWS // 100))
    launch(some, reach(rows.a, rows.to))
    assert launch(rows, reach(rows.a))[-1] is COLUMNS


def test_a_query_finds_many_rows_for_each_row() -> None:
    rows, few = relation(), ebb.Relation("few", size=LEAST_ROWS // 100)
    rows.new_field("to", few)
    launch(few, reach(rows.a, rows.to), reach(rows.to, queried=True))
    assert launch(rows, reach(rows.a))[-1] is ROWS


def test_fields_go_back_to_rows_once_where_gathers_come_later() -> None:
    rows = relation()
    rows.new_field("to", rows)
    launch(rows, reach(rows.a))
    assert rows.a.buffer.layout is COLUMNS
    assert launch(rows, reach(rows.a, rows.to)) == [COLUMNS] * 5 + [ROWS] * 3
    for _ in range(100):
        launch(rows, reach(rows.a))
    assert rows.a.buffer.layout is ROWS


def test_launches_that_wait_for_memory_decide_nothing() -> None:
    rows = relation()
    assert launch(rows, reach(rows.a), pace=Pace.MEMORY)[-1] is ROWS
    launch(rows, reach(rows.a))
    assert launch(rows, reach(rows.a), pace=Pace.MEMORY)[-1] is COLUMNS


def test_launches_that_go_row_after_row_lose() -> None:
    rows = relation()
    launch(rows, reach(rows.a), pace=Pace.SCALAR)
    assert launch(rows, reach(rows.a))[-1] is ROWS


def test_the_pace_of_kernels() -> None:
    rows = ebb.Relation("rows", size=4)
    rows.new_field("to", rows)
    rows.new_field("a", ebb.mat3f)
    rows.new_field("b", ebb.mat3f)
    rows.new_field("x", ebb.float32)
    total = ebb.Global(ebb.float32, 0.0)
    n = 3

    @ebb.kernel
    def heavy(r: rows):
        r.b = ebb.inverse(r.a) @ r.a
        if r.x > 0:
            r.b += r.a
        total.value += ebb.det(r.a)

    @ebb.kernel
    def light(r: rows):
        r.b = r.a

    @ebb.kernel
    def loops(r: rows):
        for _ in range(n):
            r.b = r.b @ r.a

    @ebb.kernel
    def scatters(r: rows):
        r.to.b += ebb.inverse(r.a)

    @ebb.kernel
    def checks(r: rows):
        assert ebb.det(r.a) > 0
        r.b = ebb.inverse(r.a)

    def pace(kernel: ebb.Kernel) -> Pace:
        return pace_of(elaborate(kernel.source, rows, (), ()).kernel)

    assert pace(heavy) is Pace.VECTOR
    assert pace(light) is Pace.MEMORY
    assert {pace(loops), pace(scatters), pace(checks)} == {Pace.SCALAR}


def test_views_pin_the_layout() -> None:
    rows = relation()
    rows.b.view()
    assert launch(rows, reach(rows.a))[-1] is ROWS


def test_fields_that_are_swapped_share_a_layout() -> None:
    rows = relation()
    rows.swap("a", "b")
    assert launch(rows, reach(rows.a))[-1] is COLUMNS
    assert rows.b.buffer.layout is COLUMNS
    late = rows.new_field("late", wide, init=3.0)
    rows.swap("a", "late")
    assert (rows.a.to_numpy() == 3).all()
    consider_layout(rows, (reach(rows.a),), lambda: Pace.VECTOR, 8)
    assert {rows.a.buffer.layout, rows.b.buffer.layout, late.buffer.layout} == {COLUMNS}
    assert (rows.a.to_numpy() == 3).all()


def test_launches_convert_and_go_on() -> None:
    rows = ebb.Relation("rows", size=LEAST_ROWS)
    rows.new_field("F", ebb.mat3d, init=np.eye(3))
    rows.new_field("old", ebb.mat3d, init=2 * np.eye(3))
    rows.new_field("x", ebb.float64)
    turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])

    @ebb.kernel
    def step(r: rows):
        r.F = turn @ r.F
        r.x += ebb.det(ebb.inverse(r.F))

    layouts: list[Layout] = []
    for _ in range(9):
        step(rows)
        layouts.append(rows.F.buffer.layout)
        rows.swap("F", "old")
    assert layouts == [ROWS] * 5 + [COLUMNS] * 4
    assert np.array_equal(rows.old, np.broadcast_to(np.linalg.matrix_power(turn, 5), (LEAST_ROWS, 3, 3)))
    assert np.array_equal(rows.F, np.broadcast_to(2 * np.linalg.matrix_power(turn, 4), (LEAST_ROWS, 3, 3)))


def test_bits_do_not_depend_on_threads() -> None:
    values = np.random.default_rng(0).random((LEAST_ROWS, 3, 3))
    found: list[tuple[list[Layout], bytes]] = []
    for threads in (1, 2, 3, 7):
        rows = ebb.Relation("rows", size=LEAST_ROWS)
        rows.new_field("F", ebb.mat3d, init=values)
        rows.new_field("x", ebb.float64)
        total = ebb.Global(ebb.float64, 0.0)

        @ebb.kernel
        def step(r: rows):
            r.F = 0.5 * (r.F + ebb.inverse(r.F))
            total.value += ebb.det(r.F)  # noqa: B023

        layouts: list[Layout] = []
        with ebb.backend("cpu", threads=threads):
            for _ in range(7):
                step(rows)
                layouts.append(rows.F.buffer.layout)
        found.append((layouts, rows.F.to_numpy().tobytes() + np.float64(total.value).tobytes()))
    assert found[0][0][-1] is COLUMNS
    assert all(each == found[0] for each in found)
