from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from both_backends import assert_agree, checked, launch, run_both, run_cpu
from kir_forms import (
    BREAK,
    CONTINUE,
    HERE,
    OnRows,
    affine,
    assign,
    binary,
    call,
    cast,
    compare,
    component,
    const,
    coords,
    for_query,
    for_range,
    get,
    i32,
    local,
    loop,
    random,
    read,
    reduce,
    reduce_global,
    row_id,
    uniform,
    when,
    write,
)

import ebb.runtime.random as philox
from ebb.backends.cpu import cpu_backend
from ebb.compiler import kir, lir, lir_print, lir_verify
from ebb.compiler.lower import Launched, facts_of, lower
from ebb.compiler.phases.check import check_phases
from ebb.errors import BoundsError, KernelAssertionError, KernelTypeError, RelationError
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import bool_, float32, float64, int32, int64, key, matrix, vector

SIZES = [0, 1, 63, 64, 65, 1023, 1024, 1025, 5000]


def rows_with(size, **fields):
    relation = Relation("rows", size=size)
    for name, (type_, init) in fields.items():
        relation.new_field(name, type_, init=init)
    return relation, OnRows(relation)


def lowered(kernel, launched=Launched.ALL, unchecked=()):
    phases = check_phases(kernel)
    return lower(kernel, phases, unchecked, facts_of(kernel), launched, lir.Precision.CONTRACT)


# ---- Rows and sizes ----


@pytest.mark.parametrize("size", SIZES)
def test_each_row_once_whatever_the_size(size):
    relation, on = rows_with(size, n=(int64, None))
    run_cpu(on.kernel(reduce(relation.n, on.row, "+", row_id(on.row))), threads=2)
    assert np.array_equal(relation.n.to_numpy(), np.arange(size))


@pytest.mark.parametrize("shape", [(5000,), (40, 70), (3, 2000), (1, 1), (0, 4), (7, 9, 11), (5, 3, 1500), (2, 40, 40)])
def test_boxes_give_each_row_its_coordinates(shape):
    grid = Relation("cells", shape=shape)
    grid.new_field("at", vector(int32, len(shape)))
    grid.new_field("hits", int32)
    on = OnRows(grid)
    body = [write(grid.at, on.row, coords(on.row)), reduce(grid.hits, on.row, "+", i32(1))]
    run_cpu(on.kernel(*body), threads=3)
    assert np.array_equal(grid.at.to_numpy(), np.moveaxis(np.indices(shape), 0, -1))
    assert np.all(grid.hits.to_numpy() == 1)


@pytest.mark.parametrize(
    "rows",
    [np.s_[1:-1, 2:-2], [np.s_[:3, :], np.s_[2:5, 4:9]], np.s_[::2, ::3], [[0, 0], [7, 11]], np.s_[3:3, :]],
)
def test_subsets_of_a_grid(rows):
    grid = Relation("cells", shape=(8, 12))
    grid.new_field("at", vector(int32, 2), init=-1)
    on = OnRows(grid)
    subset = grid.new_subset("part", rows)
    expected, found = run_both(on.kernel(write(grid.at, on.row, coords(on.row))), rows=subset)
    assert np.array_equal(expected, found)
    assert (found[0][:, 0] >= 0).sum() == subset.size


def test_a_list_of_rows_of_a_permuted_relation():
    relation, on = rows_with(10, n=(int64, -1))
    subset = relation.new_subset("some", [1, 4, 9])
    relation.permute([3, 1, 4, 0, 5, 9, 2, 6, 8, 7])
    run_cpu(on.kernel(write(relation.n, on.row, row_id(on.row))), rows=subset)
    assert relation.n.to_numpy().tolist() == [-1, 1, -1, -1, 4, -1, -1, -1, -1, 9]


def test_a_subset_follows_a_permutation_between_launches():
    relation, on = rows_with(4, n=(int64, -1))
    subset = relation.new_subset("some", [0, 2])
    kernel = on.kernel(write(relation.n, on.row, row_id(on.row)))
    executable = cpu_backend(1).prepare(checked(kernel))
    launch(executable, kernel, subset)
    relation.permute([2, 3, 0, 1])
    relation.n.fill(-1)
    launch(executable, kernel, subset)
    assert relation.n.to_numpy().tolist() == [0, -1, 2, -1]


def test_a_swap_between_launches_is_seen():
    relation, on = rows_with(3, a=(float64, 1.0), b=(float64, 2.0))
    kernel = on.kernel(reduce(relation.a, on.row, "+", read(relation.b, on.row)))
    executable = cpu_backend(1).prepare(checked(kernel))
    launch(executable, kernel, relation)
    relation.swap("a", "b")
    launch(executable, kernel, relation)
    assert relation.a.to_numpy().tolist() == [5.0] * 3 and relation.b.to_numpy().tolist() == [3.0] * 3


# ---- Uniforms, locals, control flow ----


def test_uniforms_of_every_type():
    types = [(True, bool_), (-7, int32), (2**40, int64), (0.1, float32), (0.1, float64)]
    types += [
        ([1.5, 2.5], vector(float32, 2)),
        ([[1, 2], [3, 4]], matrix(int32, 2, 2)),
        ([True, False], vector(bool_, 2)),
    ]
    relation = Relation("rows", size=2)
    on = OnRows(relation)
    fields = [relation.new_field(f"f{k}", type_) for k, (_, type_) in enumerate(types)]
    kernel = on.kernel(*(write(f, on.row, uniform(k, f.type)) for k, f in enumerate(fields)), uniforms=tuple(types))
    values = tuple(np.asarray(value, dtype=type_.dtype)[()] for value, type_ in types)
    run_cpu(kernel, uniforms=values)
    for field, value in zip(fields, values, strict=True):
        assert np.array_equal(field.to_numpy()[1], value)


def test_loops_with_every_step():
    relation, on = rows_with(12, start=(int32, np.arange(12) - 6), total=(int64, None), last=(int32, -99))
    i = local("i", int32)
    steps = [1, 2, 5, -1, -3]
    body = []
    for step in steps:
        total = reduce(relation.total, on.row, "+", binary("*", cast(get(i), int64), const(step + 10, int64)))
        body.append(for_range(i, read(relation.start, on.row), i32(4 if step > 0 else -4), i32(step), total))
    body.append(for_range(i, i32(0), i32(5), i32(1), write(relation.last, on.row, get(i))))
    assert_agree(on.kernel(*body))


def test_a_loop_variable_keeps_its_last_value():
    relation, on = rows_with(3, n=(int32, None))
    i = local("i", int32)
    body = [for_range(i, i32(3), i32(8), i32(2)), write(relation.n, on.row, get(i))]
    body.insert(0, assign(i, i32(0)))
    assert_agree(on.kernel(*body))


def test_break_and_continue_in_nested_loops():
    relation, on = rows_with(20, n=(int32, np.arange(20)), total=(int32, None))
    i, j = local("i", int32), local("j", int32)
    inner = [
        when(compare("==", get(j), read(relation.n, on.row)), CONTINUE),
        when(compare(">", binary("+", get(i), get(j)), i32(14)), BREAK),
        reduce(relation.total, on.row, "+", get(j)),
    ]
    outer = [
        when(compare("==", binary("%", get(i), i32(3)), i32(1)), CONTINUE),
        for_range(j, i32(0), i32(10), i32(1), *inner),
        when(compare(">", get(i), read(relation.n, on.row)), BREAK),
    ]
    assert_agree(on.kernel(for_range(i, i32(0), i32(10), i32(1), *outer)))


def test_while_and_leave():
    relation, on = rows_with(30, n=(int32, np.arange(30) + 1), steps=(int32, None))
    n, steps, label = local("n", int32), local("steps", int32), kir.Label("collatz", 1)
    odd = compare("==", binary("%", get(n), i32(2)), i32(1))
    turn = [
        when(compare("==", get(n), i32(1)), kir.Leave(label, HERE)),
        when(
            odd,
            assign(n, binary("+", binary("*", get(n), i32(3)), i32(1))),
            orelse=(assign(n, binary("//", get(n), i32(2))),),
        ),
        assign(steps, binary("+", get(steps), i32(1))),
    ]
    body = [
        assign(n, read(relation.n, on.row)),
        assign(steps, i32(0)),
        kir.Block(label, (loop(const(True, bool_), *turn),), HERE),
        write(relation.steps, on.row, get(steps)),
    ]
    assert_agree(on.kernel(*body))


def test_only_the_chosen_arm_is_evaluated():
    relation, on = rows_with(4, i=(int32, [0, 1, 2, 9]), v=(vector(float64, 3), 5.0), x=(float64, None))
    at = read(relation.i, on.row)
    picked = component(read(relation.v, on.row), at)
    inside = compare("<", at, i32(3))
    chosen = kir.Choose(inside, picked, const(-1.0, float64), float64, HERE)
    both = kir.Logic("and", inside, compare(">", picked, const(0.0, float64)), bool_, HERE)
    kernel = on.kernel(
        write(relation.x, on.row, chosen), when(both, reduce(relation.x, on.row, "+", const(1.0, float64)))
    )
    assert_agree(kernel)
    assert relation.x.to_numpy().tolist() == [6.0, 6.0, 6.0, -1.0]


def test_parts_of_vectors_and_matrices():
    mat = matrix(float64, 3, 2)
    relation, on = rows_with(
        3, m=(mat, np.arange(18.0).reshape(3, 3, 2)), i=(int32, [0, 1, 2]), v=(vector(float64, 2), None)
    )
    m, x = local("m", mat), local("x", float64)
    i = read(relation.i, on.row)
    body = [
        assign(m, read(relation.m, on.row)),
        assign(m, component(get(m), i32(0)), i),
        assign(m, const(7.5, float64), i, i32(1)),
        assign(x, component(get(m), i, i32(0))),
        write(relation.v, on.row, component(get(m), i)),
        write(relation.m, on.row, get(m)),
        write(relation.m, on.row, get(x), i32(2), i32(1)),
        reduce(relation.m, on.row, "*", component(read(relation.m, on.row), i), i32(0)),
    ]
    assert_agree(on.kernel(*body))


# ---- Keys, queries, reductions ----


def edges_of(count, seed, vertices=50):
    rng = np.random.default_rng(seed)
    points = Relation("vertices", size=vertices)
    edges = Relation("edges", size=count)
    for name in ("head", "tail"):
        edges.new_field(name, key(points), init=rng.integers(0, vertices, size=count))
    edges.new_field("w", float64, init=rng.normal(size=count))
    points.new_field("x", float64, init=rng.normal(size=vertices))
    points.new_field("total", float64, init=0.0)
    points.new_field("degree", int32)
    return points, edges


@pytest.mark.parametrize("second", [False, True])
def test_query_loops(second):
    points, edges = edges_of(300, 1)
    if second:
        edges.group_by("head")
    edges.group_by("tail")
    on, e = OnRows(points), local("e", edges.key_type)
    weight = binary("*", read(edges.w, get(e)), read(points.x, read(edges.head, get(e))))
    body = [
        for_query(e, edges.tail, on.row, reduce(points.total, on.row, "+", weight)),
        write(points.degree, on.row, kir.QuerySize(edges.tail, on.row, int32, HERE)),
    ]
    assert (facts_of(on.kernel(*body)).indirect == frozenset({edges.tail})) is second
    assert_agree(on.kernel(*body), rtol=1e-13)
    assert points.degree.to_numpy().sum() == 300


@pytest.mark.parametrize("op", ["+", "*", "min", "max"])
def test_reductions_into_other_rows(op):
    points, edges = edges_of(500, 2)
    on = OnRows(edges)
    body = [
        reduce(points.total, read(edges.attribute(end), on.row), op, read(edges.w, on.row)) for end in ("head", "tail")
    ]
    assert_agree(on.kernel(*body), threads=3, rtol=1e-10 if op in "+*" else 0.0)  # on opencl in any order


def test_reductions_of_components_and_bits():
    points, edges = edges_of(500, 3)
    points.new_field("m", matrix(float64, 2, 2), init=0.0)
    points.new_field("bits", int64, init=0)
    on = OnRows(edges)
    tail = read(edges.tail, on.row)
    body = [
        reduce(points.m, tail, "+", read(edges.w, on.row), i32(1), i32(0)),
        reduce(points.bits, tail, "^", row_id(on.row)),
    ]
    assert_agree(on.kernel(*body), rtol=1e-10)


REDUCED = [
    ("+", float64, 5.0), ("*", float64, 1.0), ("min", float64, 9.0), ("max", float32, -9.0), ("+", int64, 3),
    ("*", int32, 3), ("min", int32, 2**31 - 1), ("max", int64, -(2**62)), ("&", int32, -1), ("|", int32, 0),
    ("^", int64, 1),
]  # fmt: skip


@pytest.mark.parametrize(("op", "scalar", "start"), REDUCED, ids=lambda x: str(x))
def test_globals_reduce_with_every_operator(op, scalar, start):
    rng = np.random.default_rng(5)
    data = rng.integers(-100, -1, size=3000) if scalar.kind.value == "i" else rng.normal(size=3000) / 30 - 1
    relation, on = rows_with(3000, x=(scalar, data.astype(scalar.dtype)))
    kernel = on.kernel(reduce_global(Global(scalar, start), op, read(relation.x, on.row)))
    assert_agree(kernel, rtol=1e-4 if scalar == float32 else 1e-10)


@pytest.mark.parametrize("op", ["min", "max"])
def test_nan_propagates_through_reductions(op):
    data = np.linspace(-1, 1, 2000)
    data[1234] = np.nan
    relation, on = rows_with(2000, x=(float64, data))
    total = Global(float64, 0.0)
    run_cpu(on.kernel(reduce_global(total, op, read(relation.x, on.row))), threads=2)
    assert np.isnan(total.value)


def test_several_globals_in_one_kernel():
    relation, on = rows_with(2500, v=(vector(float64, 3), np.arange(7500.0).reshape(2500, 3)), b=(bool_, True))
    v, n, every = Global(vector(float64, 3), [1.0, 2.0, 3.0]), Global(int64, 0), Global(bool_, True)
    body = [
        reduce_global(v, "+", read(relation.v, on.row)),
        reduce_global(v, "+", const(1.0, float64), i32(2)),
        reduce_global(n, "+", const(1, int64)),
        reduce_global(every, "&", read(relation.b, on.row)),
    ]
    assert_agree(on.kernel(*body), rtol=1e-13)
    assert n.value == 2500 and every.value is True


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_results_are_the_same_bits_for_any_number_of_threads(threads):
    rng = np.random.default_rng(8)
    points, edges = edges_of(20_000, 4, vertices=3000)
    edges.group_by("tail")
    relation, on = points, OnRows(points)
    relation.new_field("noise", float32, init=rng.normal(size=3000))
    total = Global(float32, 0.0)
    e = local("e", edges.key_type)
    body = [
        for_query(e, edges.tail, on.row, reduce(points.total, on.row, "+", read(edges.w, get(e)))),
        reduce_global(total, "+", read(relation.noise, on.row)),
    ]
    kernel = on.kernel(*body)

    def run(count):
        total.value = 0.0
        points.total.fill(0.0)
        run_cpu(kernel, threads=count)
        return total.data.tobytes(), points.total.data.tobytes()

    assert run(threads) == run(1)


# ---- Grids ----

OFFSETS = [
    [[1, 0, 1], [0, 1, 0]],
    [[1, 0, -1], [0, 1, 2]],
    [[1, 0, 0], [0, 1, -20]],
    [[0, 1, 0], [1, 0, 0]],
    [[2, 0, 0], [0, 2, 1]],
    [[Fraction(1, 2), 0, 0], [0, Fraction(1, 3), Fraction(-1, 2)]],
    [[1, 0, 0], [0, 1, 0]],
]


@pytest.mark.parametrize("matrix_", OFFSETS)
@pytest.mark.parametrize("periodic", [(True, True), (True, False), (False, False)])
@pytest.mark.parametrize("from_data", [False, True])
def test_clamped_and_wrapped_affine_maps(matrix_, periodic, from_data):
    grid = Relation("cells", shape=(9, 12), periodic=periodic)
    grid.new_field("x", int64, init=np.arange(108).reshape(9, 12))
    grid.new_field("y", int64)
    grid.new_field("k", grid.key_type, init=lambda i, j: ((i * 5) % 9, (j * 7) % 12))
    on = OnRows(grid)
    base = read(grid.k, on.row) if from_data else on.row
    assert_agree(on.kernel(write(grid.y, on.row, read(grid.x, affine(grid, matrix_, base, kir.Edge.CLAMP)))))


def test_stencils_chain_and_stay_within_the_launched_rows():
    grid = Relation("cells", shape=(20, 30), periodic=(False, True))
    grid.new_field("x", float64, init=np.random.default_rng(3).normal(size=(20, 30)))
    grid.new_field("y", float64)
    inner = grid.new_subset("inner", np.s_[2:-2, :])
    on = OnRows(grid)
    up, right = [[1, 0, 1], [0, 1, 0]], [[1, 0, 0], [0, 1, 1]]
    down_left = [[1, 0, -1], [0, 1, -1]]
    twice = affine(grid, up, affine(grid, up, on.row))
    total = binary("+", read(grid.x, twice), read(grid.x, affine(grid, down_left, affine(grid, right, on.row))))
    kernel = on.kernel(write(grid.y, on.row, total))
    stencil = list(checked(kernel).step.unchecked)
    program = lowered(kernel, Launched.BOXES, stencil)
    assert not program.sites
    assert_agree(kernel, rows=inner)


def test_maps_between_grids():
    cells, corners = Relation("cells", shape=(4, 5, 6)), Relation("corners", shape=(5, 6))
    cells.new_field("n", int64)
    corners.new_field("x", int64, init=np.arange(30).reshape(5, 6))
    on = OnRows(cells)
    node = affine(corners, [[1, 0, 0, 1], [0, 0, 1, 0]], on.row)
    assert_agree(on.kernel(write(cells.n, on.row, read(corners.x, node))))


@pytest.mark.parametrize("offset", [-7, -4, -3, -2, 2, 3, 4, 7])
def test_a_small_periodic_grid_wraps_more_than_once(offset):
    grid = Relation("cells", shape=(3, 20), periodic=True)
    grid.new_field("x", int64, init=np.arange(60).reshape(3, 20))
    grid.new_field("y", int64)
    on = OnRows(grid)
    assert_agree(on.kernel(write(grid.y, on.row, read(grid.x, affine(grid, [[1, 0, offset], [0, 1, offset]], on.row)))))


# ---- Failures ----


def test_an_assertion_names_the_first_row_on_any_number_of_threads():
    relation, on = rows_with(9000, n=(int32, np.arange(9000)))
    below = compare("<", binary("%", read(relation.n, on.row), i32(5000)), i32(4000))
    kernel = on.kernel(kir.Assert(below, "too big", HERE))
    for threads in (1, 2, 3, 7):
        with pytest.raises(KernelAssertionError, match=r"rows\[4000\]: too big"):
            run_cpu(kernel, threads=threads)


def test_a_failed_launch_leaves_globals_alone_and_the_next_one_works():
    relation, on = rows_with(5000, n=(int64, np.arange(5000)))
    total = Global(int64, 10)
    fine = compare("<", read(relation.n, on.row), const(4999, int64))
    kernel = on.kernel(reduce_global(total, "+", const(1, int64)), kir.Assert(fine, "", HERE))
    executable = cpu_backend(2).prepare(checked(kernel))
    with pytest.raises(KernelAssertionError):
        executable.bind(relation).run(())
    assert total.value == 10
    relation.n.fill(0)
    executable.bind(relation).run(())
    assert total.value == 5010


@pytest.mark.parametrize("at", [-1, 3, 2**31 - 1, -(2**31)])
def test_an_index_out_of_range_touches_no_memory(at):
    relation, on = rows_with(3, v=(vector(float64, 3), 1.0), i=(int32, [0, at, 1]), x=(float64, 0.0))
    i = read(relation.i, on.row)
    for body in (
        write(relation.x, on.row, component(read(relation.v, on.row), i)),
        write(relation.v, on.row, const(5.0, float64), i),
        reduce(relation.v, on.row, "+", const(5.0, float64), i),
    ):
        with pytest.raises(BoundsError, match=rf"index {at} .*rows\[1\]"):
            run_cpu(on.kernel(body))


def test_an_affine_access_from_data_is_checked():
    grid = Relation("cells", shape=(4, 5))
    grid.new_field("x", float64, init=0.0)
    particles = Relation("particles", size=3)
    particles.new_field("cell", grid.key_type, init=[[0, 0], [3, 4], [1, 1]])
    particles.new_field("y", float64)
    on = OnRows(particles)
    node = affine(grid, [[1, 0, 1], [0, 1, 0]], read(particles.cell, on.row))
    with pytest.raises(BoundsError, match=r"E403.*cells\[4, 4\].*particles\[1\]"):
        run_cpu(on.kernel(write(particles.y, on.row, read(grid.x, node))))


@pytest.mark.parametrize("edge", list(kir.Edge))
def test_no_row_of_an_empty_grid_is_touched(edge):
    grid = Relation("cells", shape=(0, 5))
    grid.new_field("x", float64)
    other = Relation("others", shape=(2, 2))
    other.new_field("y", float64)
    on = OnRows(other)
    node = affine(grid, [[1, 0, 0], [0, 1, 0]], on.row, edge)
    kernel = on.kernel(write(other.y, on.row, read(grid.x, node)))
    with pytest.raises(BoundsError):
        cpu_backend(1).prepare(checked(kernel)).bind(other).run(())


def test_unset_keys_are_errors_to_follow():
    points, edges = edges_of(4, 6)
    edges.new_field("next", key(points))
    edges.new_field("both", vector(key(points), 2))
    on = OnRows(edges)
    follow = on.kernel(write(edges.w, on.row, read(points.x, read(edges.next, on.row))))
    with pytest.raises(RelationError, match=r"E404.*edges\[0\].*'edges.next'"):
        run_cpu(follow)
    part = on.kernel(write(edges.w, on.row, read(points.x, component(read(edges.both, on.row), i32(1)))))
    with pytest.raises(RelationError, match=r"E404.*edges.both"):
        run_cpu(part)
    edges.next.load([0, 1, 2, 3])
    run_cpu(follow)
    assert np.array_equal(edges.w.to_numpy(), points.x.to_numpy()[:4])


def test_setting_the_last_key_needs_no_new_executable():
    points, edges = edges_of(3, 6)
    edges.new_field("next", key(points))
    on = OnRows(edges)
    kernel = on.kernel(write(edges.w, on.row, read(points.x, read(edges.next, on.row))))
    executable = cpu_backend(1).prepare(checked(kernel))
    with pytest.raises(RelationError):
        executable.bind(edges).run(())
    edges.next.load([2, 2, 2])
    executable.bind(edges).run(())
    assert np.all(edges.w.to_numpy() == points.x.to_numpy()[2])


def test_a_range_with_step_zero():
    relation, on = rows_with(3, s=(int32, [1, 0, 1]), n=(int32, None))
    i = local("i", int32)
    body = for_range(i, i32(0), i32(3), read(relation.s, on.row), reduce(relation.n, on.row, "+", get(i)))
    with pytest.raises(KernelTypeError, match=r"rows\[1\]"):
        run_cpu(on.kernel(body))


# ---- Random numbers, prints ----


@pytest.mark.parametrize("scalar", [float32, float64], ids=repr)
@pytest.mark.parametrize("permuted", [False, True])
def test_random_numbers_are_those_of_the_reference(scalar, permuted):
    relation, on = rows_with(40, a=(scalar, None), b=(scalar, None))
    if permuted:
        relation.permute(np.random.default_rng(1).permutation(40))
    x, y = local("x", scalar), local("y", scalar)
    body = [assign(x, random("rand", scalar)), assign(y, random("randn", scalar))]
    kernel = on.kernel(*body, write(relation.a, on.row, get(x)), write(relation.b, on.row, get(y)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(philox, "next_launch", lambda: philox.LaunchKey(12345678901, 3))
        assert_agree(kernel, rtol=1e-5 if scalar == float32 else 1e-12)


def test_prints_are_those_of_the_reference(capsys):
    _, edges = edges_of(3, 9)
    edges.new_field("v", vector(float32, 2), init=[[1, 2], [3, 4], [5, 6.5]])
    on = OnRows(edges)
    at = read(edges.tail, on.row)
    parts = (
        "e", (row_id(on.row), ""), " v=", (read(edges.v, on.row), ".2f"), " ", (at, ""), " ",
        (read(edges.w, on.row), ""), " ", (compare("<", row_id(on.row), const(1, int64)), ""), (i32(-5), "+d"),
    )  # fmt: skip
    run_both(on.kernel(kir.Print(parts, HERE)))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6 and lines[:3] == lines[3:]


def test_too_many_prints_are_counted(capsys):
    _, on = rows_with(70_000, n=(int32, None))
    run_cpu(on.kernel(kir.Print(("x",), HERE)))
    lines = capsys.readouterr().out.splitlines()
    assert lines.count("x") == 65_536 and "4464 more lines" in lines[-1]


# ---- The text of programs ----


def test_the_text_holds_no_data():
    def text(size):
        relation, on = rows_with(size, x=(float32, 1.0))
        return lir_print.text(lowered(on.kernel(reduce(relation.x, on.row, "*", const(2.0, float32)))))

    assert text(10) == text(1000)
    assert text(10) == (
        "program step over line, floats contract\n"
        "  slot s0: float32 write  # rows.x\n"
        "block %0:\n"
        "  rows %1, independent:\n"
        "    %2: float32 = s0[%1]\n"
        "    %3: float32 = %2 * 2.0:float32\n"
        "    s0[%1] = %3\n"
    )


def test_verification_finds_faults():
    relation, on = rows_with(3, x=(float32, 1.0))
    program = lowered(on.kernel(write(relation.x, on.row, const(2.0, float32))))
    lir_verify.verify(program)
    stray = lir.Store(program.slots[0], lir.Literal(0, int64), lir.Temp(99, float32))
    wrong = lir.Store(program.slots[0], lir.Literal(0, int64), lir.Literal(1, int64))
    for stmt in (stray, wrong, lir.Leave(lir.Label(1, "x")), lir.Fail(0, lir.Literal(0, int64), ())):
        broken = lir.Program(**{name: getattr(program, name) for name in lir.Program.__slots__} | {"finish": (stmt,)})
        with pytest.raises(lir_verify.MalformedLir):
            lir_verify.verify(broken)


def test_call_arguments_of_builtins_are_evaluated_once():
    relation, on = rows_with(3, x=(float64, 2.0))
    kernel = on.kernel(
        write(relation.x, on.row, call("clamp", read(relation.x, on.row), const(0.0, float64), const(1.0, float64)))
    )
    assert lir_print.text(lowered(kernel)).count("= s0[") == 1
