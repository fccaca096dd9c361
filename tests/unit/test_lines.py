"""Lines of grids on the processor: the split of their ends, stores past the cache, bands of planes."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.backends import kernel_code
from ebb.backends.cpu.tiles import tile_boxes
from ebb.relations.subset import Box
from ebb.runtime import threads

SHAPES = [
    (1,),
    (2,),
    (17,),
    (1030,),
    (1, 1),
    (3, 1),
    (1, 3),
    (5, 31),
    (3, 600),
    (1, 1, 1),
    (2, 1, 2),
    (3, 7, 40),
    (2, 3, 256),
]


@pytest.fixture(params=["kept", "streamed"])
def stores(request, monkeypatch):
    if request.param == "streamed":
        monkeypatch.setattr(kernel_code, "_MOST_CACHED", 0)
    monkeypatch.setattr(threads, "GRAIN", 1.0)
    with ebb.backend("cpu", threads=2):
        yield request.param


def streams(kernel, rows):
    return "streams " in kernel.inspect(rows, "lir")


def neighbors(cells, unit, edge):
    """Members ``c.left`` and ``c.right`` along the last dimension, and ``c.below`` along the first."""
    first = [[*row, 1 if d == 0 else 0] for d, row in enumerate(unit)]
    left, right = ([[*row, s if d == len(unit) - 1 else 0] for d, row in enumerate(unit)] for s in (-1, 2))
    named = {"left": left, "right": right, "below": first}
    for name, matrix in named.items():
        wrapped, held = _maps(cells, matrix)
        cells.member(name)(wrapped if edge == "wrap" else held)


def _maps(cells, matrix):
    def wrapped(c):
        return ebb.affine(cells, matrix, c)

    def held(c):
        return ebb.affine(cells, matrix, c, edge="clamp")

    return wrapped, held


@pytest.mark.parametrize("edge", ["wrap", "clamp"])
@pytest.mark.parametrize("shape", SHAPES)
def test_rows_near_the_ends_and_between(stores, shape, edge):
    cells = ebb.Relation("cells", shape=shape, periodic=(edge == "wrap",) * len(shape))
    x = np.random.default_rng(1).integers(-99, 99, shape).astype(np.float32)
    cells.new_field("x", ebb.float32, init=x)
    cells.new_field("y", ebb.float32, init=-1.0)
    neighbors(cells, np.eye(len(shape), dtype=int).tolist(), edge)

    @ebb.kernel
    def add(c: cells):
        c.y = 2.0 * c.x + c.left.x - 3.0 * c.right.x + 5.0 * c.below.x

    add(cells)
    index = np.indices(shape)

    def at(axis, step):
        place = list(index)
        n = shape[axis]
        place[axis] = (place[axis] + step) % n if edge == "wrap" else np.clip(place[axis] + step, 0, n - 1)
        return x[tuple(place)]

    last = len(shape) - 1
    np.testing.assert_array_equal(cells.y.to_numpy(), 2 * x + at(last, -1) - 3 * at(last, 2) + 5 * at(0, 1))
    assert streams(add, cells) == (stores == "streamed")


def test_only_launched_rows_are_stored(stores):
    cells = ebb.Relation("cells", shape=(6, 9, 70))
    x = np.random.default_rng(2).integers(-99, 99, cells.shape).astype(np.int32)
    cells.new_field("x", ebb.int32, init=x)
    cells.new_field("y", ebb.int32, init=-x)
    cells.new_field("v", ebb.vec3d, init=1.5)
    boxes = [np.s_[1:-1, 1:-1, 1:-1], np.s_[:1, 2:5, 31:33], np.s_[5:, :2, :17]]
    rows = cells.new_subset("some", boxes)

    @ebb.kernel
    def write(c: cells):
        c.y = 3 * c.x
        c.v = [ebb.float64(c.x), 2.0, -ebb.float64(c.x)]

    write(rows)
    mask = np.zeros(cells.shape, dtype=bool)
    for box in boxes:
        mask[box] = True
    np.testing.assert_array_equal(cells.y.to_numpy(), np.where(mask, 3 * x, -x))
    expected = np.where(mask[..., None], np.stack([x, np.full_like(x, 2), -x], axis=-1), 1.5)
    np.testing.assert_array_equal(cells.v.to_numpy(), expected)
    assert streams(write, rows) == (stores == "streamed")


@pytest.mark.parametrize("size", [1, 15, 63, 64, 65, 1025, 5000])
def test_rows_that_are_no_grid(stores, size):
    rows = ebb.Relation("rows", size=size)
    x = np.random.default_rng(3).integers(-99, 99, (size, 3)).astype(np.float64)
    rows.new_field("x", ebb.vec3d, init=x)
    rows.new_field("y", ebb.float64)
    rows.new_field("kept", ebb.float64, init=1.0)
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def measure(r: rows):
        r.y = ebb.dot(r.x, r.x)
        r.kept += r.x[0]
        total.value += r.x[1]

    measure(rows)
    np.testing.assert_array_equal(rows.y.to_numpy(), (x * x).sum(axis=1))
    np.testing.assert_array_equal(rows.kept.to_numpy(), 1 + x[:, 0])
    assert total.value == x[:, 1].sum()
    assert streams(measure, rows) == (stores == "streamed")


@pytest.mark.parametrize("edge", ["wrap", "clamp"])
@pytest.mark.parametrize("type_", [ebb.float32, ebb.float64])
def test_what_neighbors_have_in_common(stores, type_, edge):
    """Sums that rows along a line share, taken from registers of other rows."""
    shape = (4, 6, 300)
    cells = ebb.Relation("cells", shape=shape, periodic=(edge == "wrap",) * 3)
    x = np.random.default_rng(5).integers(-99, 99, shape).astype(type_.dtype)
    cells.new_field("x", type_, init=x)
    for name in "yz":
        cells.new_field(name, type_, init=-1.0)

    if edge == "wrap":

        @cells.member("__call__")
        def moved(c, i, j, k):
            return ebb.affine(cells, [[1, 0, 0, i], [0, 1, 0, j], [0, 0, 1, k]], c)

    else:

        @cells.member("__call__")
        def held(c, i, j, k):
            return ebb.affine(cells, [[1, 0, 0, i], [0, 1, 0, j], [0, 0, 1, k]], c, edge="clamp")

    @cells.member("sides")
    def sides(c, k):
        return c(-1, 0, k).x + 2.0 * c(1, 0, k).x - c(0, 1, k).x

    @ebb.kernel
    def share(c: cells):
        c.y = c.sides(-1) - 3.0 * c.sides(1) + c.sides(0) + 5.0 * c.x
        c.z = abs(c(0, -1, 1).x) - c.sides(2) + c(0, 0, -2).x - c(0, 0, -40).x

    share(cells)
    padded = np.pad(x, 40, mode="wrap" if edge == "wrap" else "edge")

    def at(i, j, k):
        return padded[tuple(slice(40 + step, 40 + step + n) for step, n in zip((i, j, k), shape, strict=True))]

    def sides_at(k):
        return at(-1, 0, k) + 2 * at(1, 0, k) - at(0, 1, k)

    np.testing.assert_array_equal(cells.y.to_numpy(), sides_at(-1) - 3 * sides_at(1) + sides_at(0) + 5 * x)
    expected = np.abs(at(0, -1, 1)) - sides_at(2) + at(0, 0, -2) - at(0, 0, -40)
    np.testing.assert_array_equal(cells.z.to_numpy(), expected)
    assert streams(share, cells) == (stores == "streamed")


BOXES = [
    ((5, 9, 64), np.s_[1:-1, 1:-1, 1:-1]),
    ((5, 9, 64), np.s_[1:-1, 1:-1, 16:48]),
    ((3, 11, 67), np.s_[1:-1, 1:-1, 1:-1]),
    ((3, 12, 35), np.s_[1:2, 2:-1, 3:-1]),
    ((3, 40, 9), np.s_[1:-1, 1:-1, 1:-1]),
    ((3, 40, 5), np.s_[1:-1, 1:-1, 2:3]),
    ((3, 6, 100), np.s_[1:-1, 1:-1, 60:70]),
    ((3, 4, 1500), np.s_[1:-1, 1:-1, 1:-1]),
]


@pytest.mark.parametrize("type_", [ebb.float32, ebb.float64])
@pytest.mark.parametrize(("shape", "box"), BOXES)
def test_lines_that_follow_one_another(stores, type_, shape, box):
    """Rows of a box, whose lines have rows between them that are left alone: with sums that cross the ends of lines."""
    cells = ebb.Relation("cells", shape=shape)
    x = np.random.default_rng(7).integers(-99, 99, shape).astype(type_.dtype)
    cells.new_field("x", type_, init=x)
    for name in "yz":
        cells.new_field(name, type_, init=-1.0)
    rows = cells.new_subset("inner", box)

    @cells.member("__call__")
    def moved(c, i, j, k):
        return ebb.affine(cells, [[1, 0, 0, i], [0, 1, 0, j], [0, 0, 1, k]], c)

    @cells.member("sides")
    def sides(c, k):
        return c(-1, 0, k).x + 2.0 * c(1, 0, k).x - c(0, 1, k).x

    @ebb.kernel
    def share(c: cells):
        c.y = c.sides(-1) - 3.0 * c.sides(1) + 2.0 * c.sides(0) + 5.0 * c.x
        c.z = c(0, -1, 1).x - c(0, -1, -1).x

    share(rows)
    padded = np.pad(x, 1)

    def at(i, j, k):
        return padded[tuple(slice(1 + step, 1 + step + n) for step, n in zip((i, j, k), shape, strict=True))]

    def sides_at(k):
        return at(-1, 0, k) + 2 * at(1, 0, k) - at(0, 1, k)

    mask = np.zeros(shape, dtype=bool)
    mask[box] = True
    y = sides_at(-1) - 3 * sides_at(1) + 2 * sides_at(0) + 5 * x
    np.testing.assert_array_equal(cells.y.to_numpy(), np.where(mask, y, -1))
    np.testing.assert_array_equal(cells.z.to_numpy(), np.where(mask, at(0, -1, 1) - at(0, -1, -1), -1))
    assert streams(share, rows) == (stores == "streamed")


def test_coordinates_that_are_looked_at_join_no_lines(stores):
    cells = ebb.Relation("cells", shape=(3, 20, 33))
    cells.new_field("x", ebb.float32, init=2.0)
    cells.new_field("y", ebb.float32)
    rows = cells.new_subset("inner", np.s_[1:-1, 1:-1, 1:-1])

    @ebb.kernel
    def place(c: cells):
        c.y = c.x + ebb.float32(ebb.coords(c)[1])

    place(rows)
    expected = np.zeros(cells.shape)
    expected[1:-1, 1:-1, 1:-1] = 2.0 + np.arange(1, 19)[:, None]
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)


def test_vectors_along_lines(stores):
    cells = ebb.Relation("cells", shape=(5, 70), periodic=(True, True))
    x = np.random.default_rng(6).integers(-99, 99, (5, 70, 3)).astype(np.float32)
    cells.new_field("x", ebb.vec3f, init=x)
    cells.new_field("y", ebb.vec3f)

    @cells.member("__call__")
    def moved(c, i, j):
        return ebb.affine(cells, [[1, 0, i], [0, 1, j]], c)

    @ebb.kernel
    def add(c: cells):
        c.y = c(0, 1).x - 2.0 * c(0, -1).x + 3.0 * c(1, 0).x

    add(cells)
    expected = np.roll(x, -1, 1) - 2 * np.roll(x, 1, 1) + 3 * np.roll(x, -1, 0)
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)
    assert streams(add, cells) == (stores == "streamed")


def test_no_register_goes_to_the_stack_for_a_part_of_a_line(monkeypatch):
    monkeypatch.setattr(kernel_code, "_MOST_CACHED", 0)
    cells = ebb.Relation("cells", shape=(4, 6, 300), periodic=(True, True, True))
    cells.new_field("x", ebb.float32)
    cells.new_field("y", ebb.float32)
    neighbors(cells, np.eye(3, dtype=int).tolist(), "wrap")

    @ebb.kernel
    def add(c: cells):
        c.y = c.left.x + c.right.x + c.below.x

    assert streams(add, cells)
    assert "ebb.stream" not in add.inspect(cells, "asm")


def test_what_is_looked_at_is_kept(stores):
    rows = ebb.Relation("rows", size=100)
    for name in "xyz":
        rows.new_field(name, ebb.float32, init=1.0)

    @ebb.kernel
    def change(r: rows):
        r.x = r.y + 1.0
        r.z = r.x * 2.0
        if r.y > 0.0:
            r.x = 0.0

    change(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), np.zeros(100))
    np.testing.assert_array_equal(rows.z.to_numpy(), np.full(100, 4))


def test_the_number_of_threads_changes_no_bit(monkeypatch):
    monkeypatch.setattr(kernel_code, "_MOST_CACHED", 0)
    cells = ebb.Relation("cells", shape=(9, 40, 130), periodic=(True, True, True))
    cells.new_field("x", ebb.float32, init=np.random.default_rng(4).random(cells.shape, dtype=np.float32))
    cells.new_field("y", ebb.float32)
    total = ebb.Global(ebb.float32, 0.0)
    neighbors(cells, np.eye(3, dtype=int).tolist(), "wrap")

    @ebb.kernel
    def relax(c: cells):
        c.y = 0.4 * c.x + 0.1 * (c.left.x + c.right.x) + ebb.sin(c.below.x)
        total.value += c.x

    found = []
    for count in (1, 2, 3):
        with ebb.backend("cpu", threads=count):
            total.value = 0.0
            relax(cells)
            found.append((cells.y.to_numpy().tobytes(), total.value))
    assert found[0] == found[1] == found[2]


class TestBands:
    def test_blocks_cover_each_row_once(self):
        boxes = [Box((0, 0, 0), (5, 300, 100)), Box((5, 3, 2), (9, 4, 50)), Box((9, 0, 0), (9, 5, 5))]
        for row_bytes in (0, 4, 1000, 1 << 20):
            covered = np.zeros((9, 300, 100), dtype=int)
            for block in tile_boxes(boxes, row_bytes):
                covered[tuple(slice(*bounds) for bounds in block)] += 1
            expected = np.zeros_like(covered)
            for box in boxes:
                expected[box.slices] += 1
            np.testing.assert_array_equal(covered, expected)

    def test_a_band_goes_through_all_planes(self):
        tiles = tile_boxes([Box((0, 0, 0), (4, 256, 256))], 4)
        half = tiles[: len(tiles) // 2]
        assert half[:, 1, 1].max() == 128 and half[:, 0, 1].max() == 4
        assert np.array_equal(tile_boxes([Box((0, 0, 0), (4, 256, 256))])[:, 0, 0], np.repeat(np.arange(4), 64))

    def test_fewer_dimensions_have_none(self):
        box = Box((0, 0), (64, 4096))
        assert np.array_equal(tile_boxes([box], 4), tile_boxes([box]))


@pytest.mark.parametrize("size", [1, 40, 1000])
def test_rows_of_several_numbers(stores, size):
    """Their components lie together, so rows do not go on by one element."""
    rows = ebb.Relation("rows", size=size)
    rows.new_field("weight", ebb.float64, init=lambda i: float(i))
    rows.new_field("a", ebb.mat3d)

    @ebb.kernel
    def scale(r: rows, factor: ebb.float64):
        r.a = factor * r.weight * ebb.identity(3)

    scale(rows, 2.0)
    np.testing.assert_array_equal(rows.a.to_numpy(), 2.0 * np.arange(size)[:, None, None] * np.eye(3))
