"""Odd but legal programs, and wrong ones at the corners: each was once a difference or a crash."""

from __future__ import annotations

import gc
import math
import weakref

import numpy as np
import pytest

import ebb
from ebb.backends.select import current_backend

from .harness import kernel_of, rejects, rows_with


@pytest.mark.parametrize("edge", ["check", "clamp"])
@pytest.mark.parametrize("periodic", [True, False])
def test_access_to_a_grid_without_cells(backend, periodic, edge):
    cells = ebb.Relation("cells", shape=(4,))
    cells.new_field("a", ebb.int32)
    hollow = ebb.Relation("hollow", shape=(3, 0), periodic=periodic)
    hollow.new_field("a", ebb.int32)
    text = f'r.a = ebb.affine(hollow, [[1, 0], [0, 2]], r, edge="{edge}").a'
    program = kernel_of(text, "r: cells", cells=cells, hollow=hollow)
    rejects(ebb.BoundsError, "E4", lambda: program(cells))


def test_affine_map_of_irrational_factors(backend):
    cells = ebb.Relation("cells", shape=(6000,))
    cells.new_field("a", ebb.int32)
    half = math.sqrt(0.5)
    program = kernel_of("r.a = ebb.affine(cells, [[half, 0]], r).a", "r: cells", cells=cells, half=half)
    assert "simple fractions" in str(rejects(ebb.KernelTypeError, "E228", lambda: program(cells)))


def test_affine_map_of_decimal_factors(backend):
    cells = ebb.Relation("cells", shape=(5000,))
    cells.new_field("a", ebb.int32, init=np.arange(5000))
    cells.new_field("b", ebb.int32)
    kernel_of("r.b = ebb.affine(cells, [[0.1, 0.3]], r).a", "r: cells", cells=cells)(cells)
    np.testing.assert_array_equal(cells.b.to_numpy(), (np.arange(5000) + 3) // 10)


def test_launch_on_no_rows_counts_for_random_numbers(backend):
    rows = rows_with(x=(ebb.float64, np.zeros(10)))
    rows.new_subset("none", [])
    program = kernel_of("r.x = ebb.rand()", rows=rows)
    ebb.seed(3)
    program(rows)
    program(rows)
    expected = rows.x.to_numpy()
    ebb.seed(3)
    program(rows.none)
    program(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), expected)


def test_list_of_integers_beyond_int64_as_parameter(backend):
    rows = rows_with(x=(ebb.uint64, [0]))
    kernel_of("r.x = q[0] - q[1]", "r: rows, q: ebb.vector(ebb.uint64, 2)", rows=rows)(rows, [2**64 - 1, 3])
    assert rows.x.to_numpy()[0] == 2**64 - 4


@pytest.mark.parametrize("annotation", ["", ": ebb.vec2d"])
def test_ragged_list_as_parameter(backend, annotation):
    rows = rows_with(x=(ebb.float64, [0.0]))
    program = kernel_of("r.x = q[0]", f"r: rows, q{annotation}", rows=rows)
    rejects(ebb.KernelTypeError, "E263", lambda: program(rows, [[1, 2], [3]]))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [1e300, -math.inf, 10**30])
def test_large_numbers_as_float_parameters(backend, value):
    rows = rows_with(x=(ebb.float64, [0.0]), y=(ebb.float32, [0.0]))
    program = kernel_of("r.x, r.y = a, b", "r: rows, a: ebb.float64, b: ebb.float32", rows=rows)
    program(rows, value, value)
    assert rows.x.to_numpy()[0] == value
    with np.errstate(over="ignore"):
        assert rows.y.to_numpy()[0] == np.float32(value)


@pytest.mark.parametrize("name", ["name", "size", "shape", "periodic", "is_grid", "fields", "storage"])
def test_facts_of_a_relation_cannot_be_set(name):
    grid = ebb.Relation("grid", shape=(3, 3))
    rejects(ebb.RelationError, "E516", lambda: setattr(grid, name, getattr(grid, name)))


def test_a_kernel_keeps_no_relation(backend):
    count = kernel_of("r.n += 1", "r")

    def launch():
        rows = rows_with(n=(ebb.int32, np.arange(100)))
        rows.new_subset("some", np.s_[::2])
        count(rows)
        count(rows.some)
        assert rows.n.to_numpy().tolist() == [n + 2 - n % 2 for n in range(100)]
        return weakref.ref(rows)

    kept = [launch() for _ in range(3)]
    gc.collect()
    assert [each() for each in kept] == [None] * 3


def test_a_relation_keeps_no_kernel(backend):
    rows = rows_with(n=(ebb.int32, np.arange(100)))

    def launch(amount):
        @ebb.kernel
        def add(r: rows):
            r.n += amount

        add(rows)
        return weakref.ref(add)

    kept = [launch(amount) for amount in (1, 2)]
    gc.collect()
    assert [each() for each in kept] == [None] * 2
    assert rows.n.to_numpy().tolist() == [n + 3 for n in range(100)]


def test_a_backend_that_is_chosen_again_is_the_same():
    def chosen(**options):
        with ebb.backend("cpu", **options):
            return current_backend()

    assert chosen(threads=2) is chosen(threads=2) is not chosen(threads=1)


def test_arguments_of_host_functions_that_are_no_names():
    rows = rows_with(a=(ebb.float64, [0.0]), b=(ebb.float64, [0.0]))
    rejects(ebb.RelationError, "E5", lambda: rows.swap(["a"], "b"))
    rejects(ebb.RelationError, "E5", lambda: rows.copy("a", {}))
    for name in (["cpu"], None, {}):
        rejects(ebb.BackendError, "E601", lambda name=name: ebb.set_backend(name))


def test_a_number_of_threads_from_numpy():
    with ebb.backend("cpu", threads=np.int64(2)):
        assert current_backend().processor.threads == 2


def test_fields_and_keys_are_no_parameters(backend):
    rows = rows_with(a=(ebb.float64, [0.0]), b=(ebb.float64, [2.0]))
    program = kernel_of("r.a = r[source]", "r: rows, source", rows=rows)
    assert "pass its name: 'b'" in str(rejects(ebb.KernelTypeError, "E263", lambda: program(rows, rows.b)))
    program(rows, "b")
    assert rows.a.to_numpy()[0] == 2.0
    number = kernel_of("r.a = ebb.float64(ebb.id(other))", "r: rows, other: rows", rows=rows)
    assert "reads them from fields" in str(rejects(ebb.KernelTypeError, "E263", lambda: number(rows, 0)))
