"""Rows in which nothing rare happens are computed several at once; what does happen is what would happen anyway."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.backends.llvm.rare import PART, plan_rare
from ebb.compiler import lir
from ebb.compiler.lir_walk import statements

SIZE = 3 * PART + 37


def points(size=SIZE):
    """Rows with a number, and places in a periodic line of as many cells."""
    line = ebb.Relation("line", shape=(size,), periodic=True)
    line.new_field("value", ebb.float32, init=np.arange(size))
    rows = ebb.Relation("rows", size=size)
    rows.new_field("x", ebb.float32, init=np.arange(size))
    rows.new_field("y", ebb.float32)
    return line, rows


def row_loop(kernel, rows, *arguments):
    """The loop over rows of a kernel's program."""
    launch = kernel._find_launch(rows, arguments)
    executable = launch.specialisation.executable(ebb.backends.select.current_backend())
    program = executable._code(executable.step).program(rows)
    return next(stmt for stmt in statements(program.block) if isinstance(stmt, lir.RowLoop))


@pytest.fixture(autouse=True, params=[1, 3])
def threads(request):
    with ebb.backend("cpu", threads=request.param):
        yield


def test_rows_with_checks_are_vectors() -> None:
    line, rows = points()

    @ebb.kernel
    def take(r: rows):
        assert r.x >= 0, "below"
        r.y = ebb.row_at(line, [ebb.int64(ebb.floor(r.x)) - 5]).value

    take(rows)
    assert rows.y.to_numpy().tolist() == np.roll(np.arange(SIZE), 5).tolist()
    assert plan_rare(row_loop(take, rows)) is not None
    vectors = [line for line in take.inspect(rows, "llvm").splitlines() if " x float>" in line]
    assert vectors


@pytest.mark.parametrize("bad", [0, 5, PART - 1, PART, 2 * PART + 100, SIZE - 1])
def test_the_first_row_that_fails_is_told(bad) -> None:
    _, rows = points()
    x = np.arange(SIZE, dtype=np.float32)
    x[[bad, SIZE - 1]] = np.nan
    rows.x.load(x)

    @ebb.kernel
    def double(r: rows):
        assert r.x >= 0, "not a number"
        r.x = 2 * r.x
        r.y = r.x + 1

    with pytest.raises(ebb.KernelAssertionError, match=rf"rows\[{bad}\]"):
        double(rows)
    found = rows.x.to_numpy()
    # Each row has been run once or not at all, and none before the one that fails has been left out.
    before = np.arange(SIZE)
    same = np.isnan(found) | (found == before) | (found == 2 * before)
    assert same.all() and np.isnan(found[bad]) and (found[:bad] == 2 * before[:bad]).all()


def test_places_many_periods_away() -> None:
    line, rows = points(2 * PART)
    shift = np.zeros(2 * PART, dtype=np.int64)
    shift[::7], shift[3], shift[11] = -(2**40), 2**62, -(2**62)
    rows.new_field("shift", ebb.int64, init=shift)

    @ebb.kernel
    def take(r: rows):
        r.y = ebb.row_at(line, [ebb.id(r) + r.shift]).value

    take(rows)
    expected = [(i + int(s)) % (2 * PART) for i, s in enumerate(shift)]
    assert rows.y.to_numpy().astype(int).tolist() == expected
    assert plan_rare(row_loop(take, rows)) is not None


@pytest.mark.parametrize("low", [-3, -2, -1, 0, 1, 2])
@pytest.mark.parametrize("size", [1, 2, 7])
def test_each_place_wraps(size, low) -> None:
    line, _ = points(size)
    rows = ebb.Relation("rows", size=4 * size)
    rows.new_field("y", ebb.float32)

    @ebb.kernel
    def take(r: rows):
        r.y = ebb.row_at(line, [ebb.id(r) + low * size]).value

    take(rows)
    assert rows.y.to_numpy().tolist() == (np.arange(4 * size) % size).tolist()


@pytest.mark.parametrize("bad", [0, 7, PART - 1, PART, 2 * PART + 100, SIZE - 1])
def test_a_condition_on_what_the_row_has_written_is_looked_at_when_rows_have_run(bad) -> None:
    _, rows = points()

    @ebb.kernel
    def grow(r: rows, limit: ebb.int32):
        r.x = r.x + 1
        assert r.x != limit, "too large"
        r.y = r.x

    plan = plan_rare(row_loop(grow, rows, SIZE + 1))
    assert plan is not None and not plan.ahead and [size for _, size in plan.kept] == [1, 1]
    grow(rows, SIZE + 1)
    before = np.arange(1, SIZE + 1)
    assert rows.x.to_numpy().tolist() == rows.y.to_numpy().tolist() == before.tolist()
    with pytest.raises(ebb.KernelAssertionError, match=rf"rows\[{bad}\]"):
        grow(rows, bad + 2)
    x, y = rows.x.to_numpy(), rows.y.to_numpy()
    assert (x[: bad + 1] == before[: bad + 1] + 1).all() and (y[:bad] == x[:bad]).all() and y[bad] == before[bad]
    assert ((x == before) | (x == before + 1)).all() and ((y == before) | (y == before + 1)).all()


def test_rows_that_locate_where_they_have_moved_are_vectors() -> None:
    line, rows = points()
    rows.new_field("at", ebb.vec2f, init=np.arange(2 * SIZE).reshape(SIZE, 2) % SIZE)
    rows.new_field("cell", line, init=np.zeros(SIZE, int)[:, None])

    @ebb.kernel
    def move(r: rows, by: ebb.float32):
        r.at = ebb.vec2f(r.at[0] + by, r.at[1] - by + r.cell.value)
        r.cell = ebb.row_at(line, [ebb.int64(ebb.floor(r.at[0]))])

    plan = plan_rare(row_loop(move, rows, 0.5))
    assert plan is not None and not plan.ahead and sorted(size for _, size in plan.kept) == [1, 2]
    at, cell = rows.at.to_numpy(), np.zeros(SIZE)
    for by in (0.5, 3.0, 5.0 * SIZE, -2.0, 7e4):  # some beyond a period
        move(rows, by)
        at = np.stack([at[:, 0] + np.float32(by), at[:, 1] - np.float32(by) + cell.astype(np.float32)], axis=-1)
        cell = np.floor(at[:, 0]) % SIZE
        np.testing.assert_array_equal(rows.cell.to_numpy().reshape(-1), cell)
        np.testing.assert_allclose(rows.at.to_numpy(), at, rtol=1e-6)
        at = rows.at.to_numpy()


def test_rows_that_do_nothing_but_check_are_tried() -> None:
    _, rows = points()

    @ebb.kernel
    def check(r: rows, limit: ebb.int32):
        twice = r.x
        if r.x > 5:
            twice = 2 * r.x
        assert twice < limit, "too large"

    plan = plan_rare(row_loop(check, rows, 2 * SIZE))
    assert plan is not None and not plan.ahead and not plan.kept
    check(rows, 2 * SIZE)
    with pytest.raises(ebb.KernelAssertionError, match=rf"rows\[{PART + 5}\]"):
        check(rows, 2 * (PART + 5))


@pytest.mark.parametrize("at", [-(10**9), 10**9])
def test_where_a_wrong_component_would_be_touched_nothing_is_tried(at) -> None:
    _, rows = points()
    rows.new_field("v", ebb.vec3f, init=np.arange(3 * SIZE).reshape(SIZE, 3))
    rows.new_field("at", ebb.int32, init=np.where(np.arange(SIZE) == PART, at, np.arange(SIZE) % 3))

    @ebb.kernel
    def put(r: rows):
        r.x = r.x + 1
        assert r.x > 0, "below"
        v = r.v
        v[r.at] = 0.0
        r.v = v

    @ebb.kernel
    def take(r: rows):
        r.x = r.x + 1
        assert r.x > 0, "below"
        v = r.v
        r.y = ebb.int32(v[r.at])

    for kernel in (put, take):
        assert plan_rare(row_loop(kernel, rows)) is None
        with pytest.raises(ebb.EbbError, match=rf"rows\[{PART}\]"):
            kernel(rows)


def test_sums_are_not_tried() -> None:
    """A row that is run again must not have added anything yet."""
    _, rows = points()
    total = ebb.Global(ebb.int64, 0)

    @ebb.kernel
    def count(r: rows, limit: ebb.int32):
        r.x = r.x + 1
        total.value += 1
        assert r.x != limit, "too large"

    assert plan_rare(row_loop(count, rows, -1)) is None
    count(rows, -1)
    assert total.value == SIZE


def test_a_condition_on_other_rows_is_not_looked_at_ahead() -> None:
    line, rows = points()
    rows.new_field("at", line, init=np.arange(SIZE)[::-1, None])

    @ebb.kernel
    def take(r: rows):
        assert r.at.value >= 0, "below"
        r.y = r.at.value

    assert plan_rare(row_loop(take, rows)) is None
    take(rows)
    assert rows.y.to_numpy().tolist() == np.arange(SIZE)[::-1].tolist()


def test_rows_with_loops_are_left_alone() -> None:
    _, rows = points()

    @ebb.kernel
    def add(r: rows, n: ebb.int32):
        assert r.x >= 0, "below"
        for i in range(n):
            r.y += r.x * i

    launch = add._find_launch(rows, (3,))
    del launch
    add(rows, 3)
    assert rows.y.to_numpy().tolist() == (3 * np.arange(SIZE)).tolist()


def test_bits_do_not_depend_on_threads() -> None:
    found = []
    for count in (1, 2, 5):
        with ebb.backend("cpu", threads=count):
            _, rows = points()
            rows.x.load(np.random.default_rng(0).random(SIZE).astype(np.float32))

            @ebb.kernel
            def mix(r: rows):
                assert r.x < 2, "too large"
                r.y = 3 * r.x + r.x * r.x * 0.1

            mix(rows)
            found.append(rows.y.to_numpy().tobytes())
    assert found[0] == found[1] == found[2]
