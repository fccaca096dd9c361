"""Fields: what can be loaded, what is refused, and what comes out again."""

from __future__ import annotations

import numpy as np
import pytest

from ebb.errors import RelationError
from ebb.relations.field import Field
from ebb.relations.globals import constant
from ebb.relations.relation import Relation
from ebb.runtime.buffer import ALIGNMENT
from ebb.types.aliases import mat3d, vec2i, vec3f
from ebb.types.types import SCALARS, bool_, float32, float64, int32, int64, matrix, uint32, uint64, vector

N = 5


@pytest.fixture
def rows() -> Relation:
    return Relation("rows", size=N)


@pytest.fixture
def cells() -> Relation:
    return Relation("cells", shape=(3, 4))


def refused(code: str, field: Field, value: object, *texts: str) -> None:
    before = field.data.copy()
    version = field.version
    with pytest.raises(RelationError) as caught:
        field.load(value)
    assert caught.value.codes == (code,)
    for text in texts:
        assert text in str(caught.value)
    np.testing.assert_array_equal(field.data, before, "a failed load changes nothing")
    assert field.version == version


# What a field holds


@pytest.mark.parametrize("scalar", SCALARS, ids=repr)
@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
def test_every_type_by_every_way(rows: Relation, scalar, shape: tuple[int, ...]) -> None:
    type_ = scalar if not shape else vector(scalar, *shape) if len(shape) == 1 else matrix(scalar, *shape)
    values = (np.arange(N * int(np.prod(shape))).reshape(N, *shape) % 2).astype(scalar.dtype)
    one = values[1]
    field = rows.new_field("f", type_)
    assert not field.to_numpy().any(), "numbers are 0 at first"
    field.load(values)
    assert np.array_equal(field, values)
    assert field.to_numpy().dtype == scalar.dtype
    field.load(one)
    assert np.array_equal(field, np.broadcast_to(one, (N, *shape)))
    field.load(lambda i: values[i])
    assert np.array_equal(field, values)
    field.fill(scalar(1))
    assert (field.to_numpy() == 1).all()
    field.load(values.tolist())
    assert np.array_equal(rows.new_field("copied", type_, init=field), values)


def test_memory_is_aligned_and_contiguous(rows: Relation) -> None:
    for name, type_ in (("a", float32), ("b", mat3d), ("c", bool_), ("d", rows)):
        data = rows.new_field(name, type_).data
        assert data.ctypes.data % ALIGNMENT == 0
        assert data.flags.c_contiguous
        assert data.shape == (N, *getattr(type_, "shape", ())[: data.ndim - 1])


def test_grid_arrays_are_indexed_as_the_cells(cells: Relation) -> None:
    field = cells.new_field("T", float64, init=lambda i, j: 10 * i + j)
    expected = 10.0 * np.arange(3)[:, None] + np.arange(4)
    assert np.array_equal(field, expected)
    assert field.data.tolist() == expected.ravel().tolist()
    field.load(expected.T.copy().T)
    assert np.array_equal(field, expected)
    assert field.view().shape == (3, 4)


def test_an_array_is_copied_in_and_out(rows: Relation) -> None:
    values = np.zeros(N)
    field = rows.new_field("f", float64, init=values)
    values[:] = 1
    field.to_numpy()[:] = 2
    np.asarray(field)[:] = 3
    assert not field.data.any()


# The shape decides


def test_the_shape_decides_where_rows_and_components_are_as_many() -> None:
    three = Relation("three", size=3)
    field = three.new_field("v", vec3f, init=[1, 2, 3])
    assert field.to_numpy().tolist() == [[1, 2, 3]] * 3, "one value for every row, not a number a row"
    assert three.new_field("w", float32, init=[1, 2, 3]).to_numpy().tolist() == [1, 2, 3]


@pytest.mark.parametrize("shape", [(2,), (N,), (N, 1), (N, 2), (1, 3), (N + 1, 3), (N, 3, 1)])
def test_shapes_that_do_not_fit(rows: Relation, shape: tuple[int, ...]) -> None:
    refused("E506", rows.new_field("v", vec3f), np.zeros(shape), str(shape), "(3,)", "(5, 3)")


def test_flat_arrays_do_not_fit_a_grid(cells: Relation) -> None:
    refused("E506", cells.new_field("T", float64), np.zeros(12), "(3, 4)")


def test_ragged_values(rows: Relation) -> None:
    field = rows.new_field("v", vec3f)
    refused("E506", field, [[1, 2, 3], [1, 2]], "no regular shape")
    refused("E506", field, lambda i: [0.0] * (3 if i != 3 else 2), "(2,) in row 3")


def test_a_function_may_give_a_number_for_every_component(rows: Relation) -> None:
    field = rows.new_field("v", vec3f, init=lambda i: i if i % 2 else [i, 0, 0])
    assert field.to_numpy()[:2].tolist() == [[0, 0, 0], [1, 1, 1]]


def test_an_error_of_the_function_changes_nothing(rows: Relation) -> None:
    field = rows.new_field("f", float64, init=1.0)
    with pytest.raises(ZeroDivisionError):
        field.load(lambda i: 1 / (2 - i))
    assert (field.data == 1).all()


def test_fill_takes_constants_only(rows: Relation) -> None:
    field = rows.new_field("f", float64)
    field.fill(constant(2.5, float32))
    assert (field.data == 2.5).all()
    with pytest.raises(RelationError) as caught:
        field.fill(np.zeros(N))
    assert caught.value.codes == ("E506",)


# Kinds and ranges


@pytest.mark.parametrize("value", [[0.0, 1.0, 2.5, 3.0, 4.5], [0, 1, np.nan, 3, 4], [0, 1, np.inf, 3, 4]])
def test_floats_into_integers(rows: Relation, value: list[float]) -> None:
    refused("E507", rows.new_field("n", int32), value, "row 2", str(value[2]))


def test_whole_floats_into_integers(rows: Relation) -> None:
    refused("E507", rows.new_field("n", int32), 2.0, "cannot take floats")


@pytest.mark.parametrize("type_", [int32, float64], ids=repr)
def test_bools_are_no_numbers(rows: Relation, type_) -> None:
    refused("E507", rows.new_field("n", type_), True, "astype")
    refused("E507", rows.new_field("b", bool_), 1, "x != 0")


@pytest.mark.parametrize("value", ["text", 1j, None, object(), b"bytes", np.datetime64("2020-01-01")])
def test_what_is_no_number(rows: Relation, value: object) -> None:
    field = rows.new_field("f", float64)
    refused("E507", field, np.array(value))


@pytest.mark.parametrize(
    ("type_", "value"),
    [(int32, 2**31), (int32, -(2**31) - 1), (int32, 10**30),
     (uint32, -1), (uint64, -1), (int64, 2**63), (uint64, 2**64)],
)  # fmt: skip
def test_integers_out_of_range(rows: Relation, type_, value: int) -> None:
    field = rows.new_field("n", type_)
    refused("E508", field, value, str(value))
    refused("E508", field, [1, 1, value, 1, value] if abs(value) < 2**62 else [value] * N, str(value), "row")


@pytest.mark.parametrize("type_", [int32, int64, uint32, uint64], ids=repr)
def test_the_ends_of_the_range(rows: Relation, type_) -> None:
    limits = np.iinfo(type_.dtype)
    field = rows.new_field("n", type_, init=int(limits.max))
    assert int(field.data[0]) == limits.max
    field.fill(int(limits.min))
    assert int(field.data[0]) == limits.min


def test_floats_may_lose_precision_but_stay_finite(rows: Relation) -> None:
    field = rows.new_field("f", float32, init=np.full(N, 0.1))
    assert field.data[0] == np.float32(0.1)
    field.load([np.nan, np.inf, -np.inf, 0.0, 1e-60])
    assert np.isnan(field.data[0])
    refused("E508", field, [0, 0, 0, 1e39, 0], "row 3", "1e+39")
    field.load(np.arange(N, dtype=np.int64))
    assert field.data.tolist() == [0, 1, 2, 3, 4]
    assert rows.new_field("g", float32, init=2**70).data[0] == 2.0**70


# Other fields


def test_another_field_is_converted(rows: Relation) -> None:
    source = rows.new_field("a", float64, init=lambda i: 0.1 * i)
    assert np.array_equal(rows.new_field("b", float32, init=source), source.to_numpy().astype(np.float32))
    refused("E507", rows.new_field("n", int32), source, "0.1 in row 1")


def test_another_field_that_does_not_fit(rows: Relation) -> None:
    other = Relation("other", size=N)
    scalars, keys = rows.new_field("s", float64), rows.new_field("k", other, init=0)
    refused("E510", rows.new_field("v", vec3f), scalars)
    refused("E510", rows.new_field("n", int32), keys)
    refused("E510", rows.new_field("k2", rows), keys)
    refused("E504", scalars, other.new_field("s", float64))


# Keys


def test_keys_are_row_numbers(rows: Relation) -> None:
    target = Relation("target", size=3)
    keys = rows.new_field("k", target)
    assert keys.maybe_unset
    assert keys.to_numpy().tolist() == [-1] * N
    keys.load([2, 0, 1, 2, 0])
    assert not keys.maybe_unset
    assert keys.data.dtype == np.int32
    assert keys.to_numpy().tolist() == [2, 0, 1, 2, 0]
    keys.fill(1)
    assert keys.to_numpy().tolist() == [1] * N


@pytest.mark.parametrize("bad", [-1, 3, 2**31, -(2**40), 2**70])
def test_keys_out_of_range(rows: Relation, bad: int) -> None:
    target = Relation("target", size=3)
    keys = rows.new_field("k", target, init=0)
    refused("E509", keys, [0, 1, bad, 2, bad], "row 2", str(bad), "'target'")
    refused("E509", keys, bad)
    pairs = rows.new_field("p", vector(target, 2), init=0)
    refused("E509", pairs, [[0, 0], [0, 0], [0, 0], [0, bad], [bad, 0]], "row 3")


def test_keys_are_integers(rows: Relation) -> None:
    keys = rows.new_field("k", rows, init=0)
    refused("E507", keys, 1.0)
    refused("E507", keys, [True] * N)


def test_a_relation_of_no_rows_has_no_keys(rows: Relation) -> None:
    keys = rows.new_field("k", Relation("none", size=0))
    refused("E509", keys, 0, "0 rows")
    assert keys.maybe_unset


def test_keys_of_a_grid_are_index_tuples(rows: Relation, cells: Relation) -> None:
    where = [[0, 0], [2, 3], [1, 2], [0, 1], [2, 0]]
    keys = rows.new_field("cell", cells)
    assert keys.to_numpy().tolist() == [[-1, -1]] * N
    keys.load(where)
    assert keys.data.tolist() == [0, 11, 6, 1, 8]
    assert keys.to_numpy().tolist() == where
    keys.fill((1, 2))
    assert keys.to_numpy().tolist() == [[1, 2]] * N
    refused("E509", keys, [[0, 0], [2, 3], [3, 2], [0, -1], [2, 0]], "row 2", "(3, 2)")
    refused("E506", keys, [0, 11, 6, 1, 8])
    corners = rows.new_field("corners", vector(cells, 2), init=[[0, 0], [2, 3]])
    assert corners.to_numpy().shape == (N, 2, 2)
    assert corners.data[0].tolist() == [0, 11]


def test_keys_of_a_grid_in_a_grid(cells: Relation) -> None:
    right = cells.new_field("right", cells, init=lambda i, j: (i, min(j + 1, 3)))
    assert right.to_numpy().shape == (3, 4, 2)
    assert right.to_numpy()[2, 3].tolist() == [2, 3]
    dumped = right.to_numpy()
    right.load(dumped)
    assert np.array_equal(right, dumped)
    line = Relation("line", shape=(4,))
    assert line.new_field("k", line, init=[[3], [2], [1], [0]]).to_numpy().tolist() == [[3], [2], [1], [0]]


def test_a_written_key_field_is_looked_at_again(rows: Relation) -> None:
    keys = rows.new_field("k", rows, init=0)
    assert not keys.maybe_unset
    keys.data[2] = -1
    keys.changed()
    assert keys.maybe_unset
    keys.data[2] = 0
    keys.changed()
    assert not keys.maybe_unset


def test_masked_keys_are_unset(rows: Relation, cells: Relation) -> None:
    keys = rows.new_field("k", rows, init=np.ma.masked_less([3, -1, 0, -1, 4], 0))
    assert keys.maybe_unset
    assert keys.to_numpy().tolist() == [3, -1, 0, -1, 4]
    refused("E509", keys, np.ma.masked_equal([0, 1, 9, 2, 3], 1), "row 2")
    refused("E506", keys, np.ma.masked_equal([0, 1], 1))
    in_grid = rows.new_field("c", cells, init=np.ma.masked_less([[0, 0], [-1, -1], [2, 3], [-1, 1], [1, 1]], 0))
    assert in_grid.to_numpy().tolist() == [[0, 0], [-1, -1], [2, 3], [-1, -1], [1, 1]]
    refused("E506", in_grid, np.ma.masked_equal(0, 0))
    nowhere = rows.new_field("n", Relation("none", size=0), init=np.ma.masked_less([-1] * N, 0))
    assert nowhere.maybe_unset
    refused("E507", rows.new_field("f", float64), np.ma.masked_equal(np.zeros(N), 0.0))


# Views


def test_a_view_is_the_memory_and_read_only(rows: Relation) -> None:
    field = rows.new_field("f", vec3f)
    view = field.view()
    assert np.shares_memory(view, field.data)
    with pytest.raises(ValueError, match="read-only"):
        view[0] = 1
    field.fill(2)
    assert (view == 2).all()
    field.data[0] = 3  # the runtime's own array stays writable


def test_a_writable_view(rows: Relation) -> None:
    field = rows.new_field("f", float64)
    before = field.version
    with field.view(write=True) as array:
        array[:] = 7
        with pytest.raises(RelationError) as caught:
            field.check_no_view()
        assert caught.value.codes == ("E512",)
        for attempt in (lambda: field.load(0), lambda: field.fill(0), lambda: rows.swap("f", "f")):
            with pytest.raises(RelationError):
                attempt()
    field.check_no_view()
    assert field.version > before
    assert (field.data == 7).all()
    with pytest.raises(ValueError, match="read-only"):
        array[0] = 1


def test_a_writable_view_closes_on_an_error(rows: Relation) -> None:
    field = rows.new_field("f", float64)
    with pytest.raises(KeyError), field.view(write=True):
        raise KeyError
    field.check_no_view()


def test_keys_have_no_writable_view(rows: Relation) -> None:
    keys = rows.new_field("k", rows, init=0)
    with pytest.raises(RelationError) as caught:
        keys.view(write=True)
    assert caught.value.codes == ("E513",)
    assert not keys.view().flags.writeable


def test_numpy_takes_a_field(rows: Relation) -> None:
    field = rows.new_field("v", vec2i, init=[1, 2])
    assert np.asarray(field).dtype == np.int32
    assert np.asarray(field, dtype=float).tolist() == [[1.0, 2.0]] * N
    with pytest.raises(ValueError, match="view"):
        np.asarray(field, copy=False)


def test_dlpack_shares_the_memory(rows: Relation) -> None:
    field = rows.new_field("f", float64, init=1.0)
    shared = np.from_dlpack(field)
    assert np.shares_memory(shared, field.data)
    assert field.__dlpack_device__() == (1, 0)
    with pytest.raises(BufferError):
        rows.new_field("k", rows).__dlpack__()


def test_repr(rows: Relation) -> None:
    assert repr(rows.new_field("v", vec3f)) == "<field rows.v: vector(float32, 3), 5 rows>"
