"""Fields: fill, load, dump, swap and copy of every type, and what they refuse without changing anything."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import rejects

TYPES = [
    ebb.bool_,
    ebb.int32,
    ebb.int64,
    ebb.uint32,
    ebb.uint64,
    ebb.float32,
    ebb.float64,
    ebb.vec3f,
    ebb.vec2i,
    ebb.vec4b,
    ebb.mat2x3d,
    ebb.mat3f,
    ebb.vector(ebb.float64, 9),
]


def sample(field_type, shape):
    values = np.arange(int(np.prod(shape)) * field_type.size).reshape((*shape, *field_type.shape))
    return (values % 2 if field_type.dtype == bool else values).astype(field_type.dtype)


def relations():
    return [
        ebb.Relation("none", size=0),
        ebb.Relation("one", size=1),
        ebb.Relation("many", size=65),
        ebb.Relation("line", shape=(7,)),
        ebb.Relation("plane", shape=(3, 4)),
        ebb.Relation("box", shape=(2, 3, 4)),
    ]


@pytest.mark.parametrize("field_type", TYPES, ids=repr)
def test_load_and_dump_by_array(field_type):
    for relation in relations():
        values = sample(field_type, relation.shape)
        field = relation.new_field("f", field_type, init=values)
        assert field.to_numpy().shape == relation.shape + field_type.shape
        assert field.to_numpy().dtype == field_type.dtype
        np.testing.assert_array_equal(field.to_numpy(), values)
        np.testing.assert_array_equal(np.asarray(field), values)
        field.load(values[::-1])
        np.testing.assert_array_equal(field.to_numpy(), values[::-1])


@pytest.mark.parametrize("field_type", TYPES, ids=repr)
def test_fill_by_constant(field_type):
    for relation in relations():
        field = relation.new_field("f", field_type)
        np.testing.assert_array_equal(field.to_numpy(), 0)
        field.fill(True if field_type.dtype == bool else 1)
        np.testing.assert_array_equal(field.to_numpy(), np.ones(relation.shape + field_type.shape))
        constant = sample(field_type, ())
        field.load(constant)
        np.testing.assert_array_equal(field.to_numpy(), np.broadcast_to(constant, relation.shape + field_type.shape))


@pytest.mark.parametrize("field_type", TYPES, ids=repr)
def test_load_from_another_field_swap_and_copy(field_type):
    for relation in relations():
        values = sample(field_type, relation.shape)
        a = relation.new_field("a", field_type, init=values)
        b = relation.new_field("b", field_type, init=a)
        np.testing.assert_array_equal(b.to_numpy(), values)
        b.fill(field_type.dtype.type(0))
        relation.swap("a", "b")
        np.testing.assert_array_equal(relation.b.to_numpy(), values)
        assert not relation.a.to_numpy().any()
        relation.copy("b", "a")
        np.testing.assert_array_equal(relation.a.to_numpy(), values)
        relation.copy(relation.a, relation.b)
        relation.swap(relation.a, relation.b)
        np.testing.assert_array_equal(relation.a.to_numpy(), values)


def test_load_by_function_of_the_row():
    rows = ebb.Relation("rows", size=5)
    np.testing.assert_array_equal(rows.new_field("x", ebb.float64, init=lambda i: i * i).to_numpy(), np.arange(5) ** 2)
    np.testing.assert_array_equal(
        rows.new_field("v", ebb.vec3f, init=lambda i: [i, 2 * i, 3]).to_numpy(), [[i, 2 * i, 3] for i in range(5)]
    )


def test_load_by_function_of_the_indices_of_a_grid():
    plane = ebb.Relation("plane", shape=(3, 4))
    field = plane.new_field("x", ebb.int32, init=lambda i, j: 10 * i + j)
    np.testing.assert_array_equal(field.to_numpy(), 10 * np.arange(3)[:, None] + np.arange(4))
    box = ebb.Relation("box", shape=(2, 3, 4))
    field = box.new_field("x", ebb.vec3i, init=lambda i, j, k: [i, j, k])
    np.testing.assert_array_equal(field.to_numpy(), np.moveaxis(np.indices((2, 3, 4)), 0, -1))


def test_the_shape_decides_between_a_constant_and_an_array():
    rows = ebb.Relation("rows", size=3)
    scalar = rows.new_field("s", ebb.float64, init=[1, 2, 3])
    vector = rows.new_field("v", ebb.vec3d, init=[1, 2, 3])
    np.testing.assert_array_equal(scalar.to_numpy(), [1, 2, 3])
    np.testing.assert_array_equal(vector.to_numpy(), [[1, 2, 3]] * 3)
    vector.load(np.arange(9).reshape(3, 3))
    np.testing.assert_array_equal(vector.to_numpy(), np.arange(9).reshape(3, 3))


def test_a_field_of_a_narrower_type_initialises_a_wider_one():
    rows = ebb.Relation("rows", size=3)
    narrow = rows.new_field("f", ebb.vec2f, init=0.1)
    wide = rows.new_field("d", ebb.vec2d, init=narrow)
    np.testing.assert_array_equal(wide.to_numpy(), np.full((3, 2), np.float32(0.1)))


def test_float64_arrays_and_python_floats_round_to_float32():
    rows = ebb.Relation("rows", size=3)
    third = np.full((3, 2), 1 / 3)
    by_array = rows.new_field("a", ebb.vec2f, init=third)
    by_list = rows.new_field("b", ebb.vec2f, init=third.tolist())
    by_constant = rows.new_field("c", ebb.vec2f, init=1 / 3)
    for field in (by_array, by_list, by_constant):
        np.testing.assert_array_equal(field.to_numpy(), third.astype(np.float32))


def test_to_numpy_is_a_copy():
    rows = ebb.Relation("rows", size=3)
    field = rows.new_field("x", ebb.float64, init=1.0)
    field.to_numpy()[:] = 99
    np.testing.assert_array_equal(field.to_numpy(), [1, 1, 1])


def test_loading_copies():
    rows = ebb.Relation("rows", size=3)
    values = np.ones(3)
    field = rows.new_field("x", ebb.float64, init=values)
    values[:] = 99
    np.testing.assert_array_equal(field.to_numpy(), [1, 1, 1])


def test_properties_of_relations_and_fields():
    plane = ebb.Relation("plane", shape=(3, 4), periodic=(True, False))
    field = plane.new_field("pos", ebb.vec2d)
    assert (plane.name, plane.size, len(plane), plane.shape) == ("plane", 12, 12, (3, 4))
    assert plane.periodic == (True, False)
    assert list(plane.fields) == ["pos"]
    assert plane.fields["pos"] is plane.pos is field
    assert (field.name, field.type, field.relation) == ("pos", ebb.vec2d, plane)
    assert ebb.Relation("rows", size=3).shape == (3,)
    assert "pos" in repr(plane) and "plane" in repr(plane)


def test_the_fields_of_a_relation_are_read_only():
    rows = ebb.Relation("rows", size=3)
    rows.new_field("x", ebb.float64)
    with pytest.raises(TypeError):
        rows.fields["y"] = None
    with pytest.raises((AttributeError, ebb.RelationError)):
        rows.size = 5
    with pytest.raises((AttributeError, ebb.RelationError)):
        rows.x = np.zeros(3)
    assert rows.size == 3


def test_swap_is_seen_by_kernels(backend):
    rows = ebb.Relation("rows", size=4)
    rows.new_field("x", ebb.float64, init=[1, 2, 3, 4])
    rows.new_field("x_new", ebb.float64, init=0.0)

    @ebb.kernel
    def double(r: rows):
        r.x_new = 2 * r.x

    for _ in range(5):
        double(rows)
        rows.swap("x", "x_new")
    np.testing.assert_array_equal(rows.x.to_numpy(), 32 * np.arange(1, 5))


def test_kernels_on_relations_without_rows(backend):
    nothing = ebb.Relation("nothing", size=0)
    vertices = ebb.Relation("vertices", size=3)
    nothing.new_field("x", ebb.float64)
    nothing.new_field("v", vertices)
    vertices.new_field("n", ebb.int32, init=0)
    total = ebb.Global(ebb.float64, 5.0)

    @ebb.kernel
    def program(r: nothing):
        r.x += 1
        r.v.n += 1
        total.value += r.x

    program(nothing)
    assert nothing.x.to_numpy().shape == (0,)
    assert total.value == 5
    nothing.group_by("v")

    @ebb.kernel
    def query(v: vertices):
        for _r in ebb.where(nothing.v, v):
            v.n += 1

    query(vertices)
    np.testing.assert_array_equal(vertices.n.to_numpy(), [0, 0, 0])


# ---- Keys ----


def test_keys_are_loaded_and_dumped_as_row_numbers():
    cells = ebb.Relation("cells", size=10)
    rows = ebb.Relation("rows", size=3)
    key = rows.new_field("k", cells, init=[9, 0, 5])
    np.testing.assert_array_equal(key.to_numpy(), [9, 0, 5])
    key.load(lambda i: 2 * i)
    np.testing.assert_array_equal(key.to_numpy(), [0, 2, 4])
    key.fill(7)
    np.testing.assert_array_equal(key.to_numpy(), [7, 7, 7])
    pair = rows.new_field("p", ebb.vector(cells, 2), init=[[1, 2], [3, 4], [5, 6]])
    np.testing.assert_array_equal(pair.to_numpy(), [[1, 2], [3, 4], [5, 6]])


def test_keys_of_a_grid_are_index_tuples():
    cells = ebb.Relation("cells", shape=(4, 5))
    rows = ebb.Relation("rows", size=2)
    key = rows.new_field("k", cells, init=[[3, 4], [0, 1]])
    np.testing.assert_array_equal(key.to_numpy(), [[3, 4], [0, 1]])
    pair = rows.new_field("p", ebb.vector(cells, 2), init=[[[0, 0], [1, 1]], [[2, 3], [3, 4]]])
    assert pair.to_numpy().shape == (2, 2, 2)
    np.testing.assert_array_equal(pair.to_numpy(), [[[0, 0], [1, 1]], [[2, 3], [3, 4]]])


def test_keys_of_a_line_have_one_more_axis():
    line = ebb.Relation("line", shape=(4,))
    rows = ebb.Relation("rows", size=2)
    key = rows.new_field("k", line, init=[[3], [0]])
    np.testing.assert_array_equal(key.to_numpy(), [[3], [0]])


def test_keys_dump_what_they_load():
    vertices = ebb.Relation("vertices", size=4)
    edges = ebb.Relation("edges", size=3)
    edges.new_field("a", vertices, init=[3, 1, 0])
    edges.new_field("b", vertices, init=edges.a)
    np.testing.assert_array_equal(edges.b.to_numpy(), [3, 1, 0])
    edges.b.load(edges.a.to_numpy())
    np.testing.assert_array_equal(edges.b.to_numpy(), [3, 1, 0])


# ---- What is refused, and changes nothing ----


def bad_loads():
    return {
        "too few rows": (ebb.float64, np.zeros(4)),
        "too many rows": (ebb.float64, np.zeros(6)),
        "a vector for a scalar": (ebb.float64, np.zeros((5, 3))),
        "vectors of another length": (ebb.vec3d, np.zeros((5, 2))),
        "a constant of another length": (ebb.vec3d, [1.0, 2.0]),
        "floats into integers": (ebb.int32, np.full(5, 1.5)),
        "a float that no integer holds": (ebb.int64, np.array([1e300] * 5)),
        "an integer that does not fit": (ebb.int32, np.array([0, 1, 2**31, 3, 4])),
        "a negative unsigned": (ebb.uint32, np.array([0, 1, -1, 3, 4])),
        "text": (ebb.float64, np.array(["a", "b", "c", "d", "e"])),
        "complex numbers": (ebb.float64, np.zeros(5, complex)),
        "None": (ebb.float64, [None] * 5),
        "objects": (ebb.float64, [object()] * 5),
        "a float constant into integers": (ebb.int32, 1.5),
        "numbers into bools": (ebb.bool_, np.array([0.5] * 5)),
        "a ragged list": (ebb.vec2d, [[1, 2], [3], [4, 5], [6, 7], [8, 9]]),
        "a function of the wrong shape": (ebb.vec3d, lambda i: [i, i]),
    }


@pytest.mark.parametrize("case", bad_loads())
def test_what_cannot_be_loaded_changes_nothing(case):
    field_type, value = bad_loads()[case]
    rows = ebb.Relation("rows", size=5)
    field = rows.new_field("x", field_type, init=1 if field_type != ebb.bool_ else True)
    before = field.to_numpy()
    rejects(ebb.RelationError, "E5", lambda: field.load(value))
    np.testing.assert_array_equal(field.to_numpy(), before)
    rejects(ebb.RelationError, "E5", lambda: rows.new_field("y", field_type, init=value))
    assert "y" not in rows.fields
    rows.new_field("y", field_type)


def test_a_function_that_raises_half_way_changes_nothing():
    rows = ebb.Relation("rows", size=5)
    field = rows.new_field("x", ebb.float64, init=1.0)

    def fails(i):
        return 1 / (3 - i)

    with pytest.raises((ZeroDivisionError, ebb.RelationError)):
        field.load(fails)
    np.testing.assert_array_equal(field.to_numpy(), np.ones(5))


@pytest.mark.parametrize("bad", [[0, 1, 7, 3, 99], [0, 1, -1, 3, 4], [0, 1, 5, 3, 4]])
def test_keys_out_of_range_name_the_first_bad_row(bad):
    vertices = ebb.Relation("vertices", size=5)
    rows = ebb.Relation("rows", size=5)
    key = rows.new_field("k", vertices, init=0)
    error = rejects(ebb.RelationError, "E509", lambda: key.load(bad))
    assert "2" in str(error) and str(bad[2]) in str(error)
    np.testing.assert_array_equal(key.to_numpy(), np.zeros(5))


def test_keys_of_a_grid_out_of_range():
    cells = ebb.Relation("cells", shape=(3, 4))
    rows = ebb.Relation("rows", size=2)
    key = rows.new_field("k", cells, init=[[0, 0], [0, 0]])
    rejects(ebb.RelationError, "E509", lambda: key.load([[2, 3], [2, 4]]))
    rejects(ebb.RelationError, "E5", lambda: key.load([5, 6]))
    np.testing.assert_array_equal(key.to_numpy(), [[0, 0], [0, 0]])


def test_float_keys_are_refused():
    rows = ebb.Relation("rows", size=2)
    rejects(ebb.RelationError, "E5", lambda: rows.new_field("k", rows, init=[0.0, 1.0]))


@pytest.mark.parametrize(
    "name", ["", "two words", "1st", "for", "class", "pos.x", "__init__", "size", "fields", "x", 5]
)
def test_bad_and_taken_names(name):
    rows = ebb.Relation("rows", size=2)
    rows.new_field("x", ebb.float64)
    rejects(ebb.RelationError, "E50", lambda: rows.new_field(name, ebb.float64))
    assert list(rows.fields) == ["x"]


def test_unknown_names_suggest_the_nearest():
    rows = ebb.Relation("rows", size=2)
    rows.new_field("velocity", ebb.float64)
    rows.new_field("other", ebb.float32)
    error = rejects(ebb.RelationError, "E503", lambda: rows.swap("velocty", "velocity"))
    assert "'velocity'" in str(error)
    rejects(ebb.RelationError, "E503", lambda: rows.copy("velocity", "nothing"))
    with pytest.raises(AttributeError, match="velocity"):
        rows.velocty


def test_swap_and_copy_of_different_types_or_relations():
    rows, others = ebb.Relation("rows", size=2), ebb.Relation("others", size=2)
    rows.new_field("a", ebb.float64, init=1.0)
    rows.new_field("b", ebb.float32, init=2.0)
    others.new_field("a", ebb.float64, init=3.0)
    rejects(ebb.RelationError, "E5", lambda: rows.swap("a", "b"))
    rejects(ebb.RelationError, "E5", lambda: rows.copy("a", "b"))
    rejects(ebb.RelationError, "E5", lambda: rows.swap(rows.a, others.a))
    rejects(ebb.RelationError, "E5", lambda: rows.new_field("c", ebb.float64, init=others.a))
    np.testing.assert_array_equal(rows.a.to_numpy(), [1, 1])


@pytest.mark.parametrize(
    "make",
    [
        lambda: ebb.Relation("rows", size=-1),
        lambda: ebb.Relation("rows", size=2.5),
        lambda: ebb.Relation("rows"),
        lambda: ebb.Relation("rows", size=3, shape=(3,)),
        lambda: ebb.Relation("two words", size=3),
        lambda: ebb.Relation("rows", shape=()),
        lambda: ebb.Relation("rows", shape=(1, 2, 3, 4)),
        lambda: ebb.Relation("rows", shape=(2, -2)),
        lambda: ebb.Relation("rows", shape=(2, 2), periodic=(True,)),
        lambda: ebb.Relation("rows", size=4, periodic=(True,)),
    ],
)
def test_relations_that_cannot_be(make):
    rejects(ebb.RelationError, "E5", make)


def test_a_field_of_no_type():
    rows = ebb.Relation("rows", size=2)
    with pytest.raises((TypeError, ebb.RelationError)):
        rows.new_field("x", "float32")
    with pytest.raises((TypeError, ebb.RelationError)):
        rows.new_field("x", float)
    assert not rows.fields


# ---- Views ----


def test_a_view_shares_memory(backend):
    rows = ebb.Relation("rows", size=4)
    rows.new_field("x", ebb.float64, init=1.0)
    view = rows.x.view()
    kernel_doubles(rows)
    now = rows.x.view()  # by which memory of the host becomes what a device has
    assert np.shares_memory(now, view)
    np.testing.assert_array_equal(view, [2, 2, 2, 2])
    with pytest.raises(ValueError):
        view[0] = 5


def test_a_writable_view(backend):
    rows = ebb.Relation("rows", size=4)
    rows.new_field("x", ebb.float64, init=1.0)
    with rows.x.view(write=True) as x:
        x[:] = [1, 2, 3, 4]
    kernel_doubles(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [2, 4, 6, 8])


def kernel_doubles(rows):
    @ebb.kernel
    def double(r: rows):
        r.x *= 2

    double(rows)


def test_a_launch_while_a_writable_view_is_open(backend):
    rows = ebb.Relation("rows", size=4)
    rows.new_field("x", ebb.float64, init=1.0)
    rows.new_field("y", ebb.float64, init=1.0)
    with rows.y.view(write=True):
        kernel_doubles(rows)  # touches x only
    with rows.x.view(write=True) as x:
        rejects(ebb.RelationError, "E512", lambda: kernel_doubles(rows))
        x[0] = 7
    kernel_doubles(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [14, 4, 4, 4])


def test_dlpack(backend):
    rows = ebb.Relation("rows", size=4)
    rows.new_field("x", ebb.vec2f, init=3.0)
    np.testing.assert_array_equal(np.from_dlpack(rows.x), np.full((4, 2), 3))
