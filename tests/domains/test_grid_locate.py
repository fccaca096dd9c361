"""Points in grids: which cell and which dual cell contains them, and interpolation between centres."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from grid_model import GRIDS

import ebb
from ebb.domains import Grid2D, Grid3D

SHAPES = {1: (5,), 2: (4, 7), 3: (3, 4, 2)}
PERIODIC = [(False,), (True,), *product((False, True), repeat=2), (True, True, True), (False, True, False)]
TYPES = {"float32": (ebb.float32, np.float32), "float64": (ebb.float64, np.float64)}


def samples(grid, dtype):
    """Points inside, on vertices and centres, outside, and at the ends of the domain."""
    rng, ndim = np.random.default_rng(3), len(grid.shape)
    low, size = np.array(grid.origin), np.array(grid.extent)
    halves = np.array(list(product(*(range(-3, 2 * n + 4) for n in grid.shape))))
    on = low + halves / 2 * np.array(grid.spacing)
    on = on[rng.permutation(len(on))[:200]]
    around = low + size * (rng.random((100, ndim)) * 5 - 2)
    ends = np.array([low, low + size, low - 100 * size, low + 1000 * size])
    near = np.concatenate([np.nextafter(on.astype(dtype), dtype(side)) for side in (-np.inf, np.inf)])
    return np.concatenate([on, around, ends, near]).astype(dtype)


def expected(grid, points, dual):
    """The formula, in the precision of the points."""
    dtype = points.dtype.type
    at = (points - np.array(grid.origin, dtype)) / np.array(grid.spacing, dtype) - dtype(0.5 if dual else 0)
    counts = np.array((grid.dual_cells if dual else grid.cells).shape)
    index = np.floor(at).astype(np.int64)
    return np.where(grid.periodic, index % counts, np.clip(index, 0, counts - 1))


@pytest.mark.parametrize("precision", TYPES)
@pytest.mark.parametrize("periodic", PERIODIC)
def test_points_in_cells_and_duals(backend, periodic, precision):
    ndim = len(periodic)
    scalar, dtype = TYPES[precision]
    grid = GRIDS[ndim](SHAPES[ndim], (-0.5, 0.1, 3.0)[:ndim], (2.5, 2.1, 0.75)[:ndim], periodic)
    points = samples(grid, dtype)
    rows = ebb.Relation("points", size=len(points))
    rows.new_field("pos", ebb.vector(scalar, ndim), init=points)
    for name, cells in (("cell", grid.cells), ("dual_cell", grid.dual_cells)):
        for by in ("kernel", "host"):
            rows.new_field(f"{name}_by_{by}", cells)

    @ebb.kernel
    def locate(p: rows):
        p.cell_by_kernel = grid.locate(p.pos)
        p.dual_cell_by_kernel = grid.dual_locate(p.pos)

    locate(rows)
    grid.cells.point_locate(rows.cell_by_host, rows.pos)
    grid.dual_cells.point_locate(rows.dual_cell_by_host, rows.pos)
    for by in ("kernel", "host"):
        np.testing.assert_array_equal(rows.attribute(f"cell_by_{by}").to_numpy(), expected(grid, points, False))
        np.testing.assert_array_equal(rows.attribute(f"dual_cell_by_{by}").to_numpy(), expected(grid, points, True))


def test_elements_lie_in_the_cells_that_they_should(backend):
    grid = Grid3D((4, 3, 5), origin=(-1, 0, 2), extent=(2, 1.5, 10), periodic=(False, True, False))

    @ebb.kernel
    def check_cells(c: grid.cells):
        assert grid.locate(c.center) == c

    @ebb.kernel
    def check_vertices(v: grid.vertices):
        assert grid.locate(v.pos) == v.cell(0, 0, 0), "a point where cells meet belongs to the upper one"

    @ebb.kernel
    def check_duals(d: grid.dual_cells):
        assert grid.dual_locate(d.center) == d
        assert grid.dual_locate(d.cell(0, 0, 0).center) == d

    check_cells(grid.cells)
    check_vertices(grid.vertices.new_subset("lower", np.s_[:-1, :, :-1]))
    check_duals(grid.dual_cells)


def test_far_away(backend):
    grid = Grid2D((4, 5), periodic=(True, False))
    rows = ebb.Relation("points", size=4)
    rows.new_field("pos", ebb.vec2d, init=[[-3, np.inf], [4e15 + 3, -np.inf], [-4e15 - 1, 1e300], [2, -1e300]])
    rows.new_field("cell", grid.cells)
    grid.cells.point_locate(rows.cell, rows.pos)
    np.testing.assert_array_equal(rows.cell.to_numpy(), [[1, 4], [3, 0], [3, 4], [2, 0]])


@pytest.mark.parametrize("bad", [(np.nan, 1.0), (1.0, np.nan), (np.inf, 1.0), (-np.inf, 1.0), (1e30, 1.0)])
@pytest.mark.parametrize("scalar", [ebb.float32, ebb.float64], ids=repr)
def test_what_is_no_place_is_an_error_that_names_the_row(backend, bad, scalar):
    grid = Grid2D((4, 5), periodic=(True, False))
    rows = ebb.Relation("points", size=9)
    rows.new_field("pos", ebb.vector(scalar, 2), init=[(1.0, 1.0)] * 6 + [bad] + [(1.0, 1.0)] * 2)
    rows.new_field("cell", grid.cells)

    @ebb.kernel(fastmath=True)
    def locate(p: rows):
        p.cell = grid.locate(p.pos)

    for launch in (lambda: locate(rows), lambda: grid.cells.point_locate(rows.cell, rows.pos)):
        with pytest.raises(ebb.KernelAssertionError, match=r"row points\[6\]: the position to locate is not a number"):
            launch()


def test_a_grid_of_one_cell_has_no_dual_cells(backend):
    grid = Grid2D((1, 3))
    rows = ebb.Relation("points", size=1)
    rows.new_field("pos", ebb.vec2f, init=0.5)
    rows.new_field("dual_cell", grid.dual_cells)
    with pytest.raises(ebb.BoundsError, match="E403"):
        grid.dual_cells.point_locate(rows.dual_cell, rows.pos)


def test_fields_that_cannot_be_located():
    grid, other = Grid2D((4, 5)), Grid2D((4, 5))
    rows, more = ebb.Relation("points", size=2), ebb.Relation("more", size=2)
    rows.new_field("pos", ebb.vec2f, init=0.5)
    rows.new_field("cell", grid.cells)
    rows.new_field("cells", ebb.vector(grid.cells, 2))
    rows.new_field("whole", ebb.vec2i)
    more.new_field("pos", ebb.vec2f)
    wrong = [
        ("cell", rows.pos),
        (rows.cell, "pos"),
        (rows.cell, more.pos),
        (rows.cell, rows.whole),
        (rows.pos, rows.pos),
    ]
    wrong += [(rows.cells, rows.pos), (rows.cell, rows.cell)]
    for key_field, pos_field in wrong:
        with pytest.raises(ebb.RelationError, match="E535"):
            grid.cells.point_locate(key_field, pos_field)
    for cells in (other.cells, grid.dual_cells):
        with pytest.raises(ebb.RelationError, match="E535"):
            cells.point_locate(rows.cell, rows.pos)
    assert rows.cell.maybe_unset


@pytest.mark.parametrize("scalar", [ebb.float32, ebb.float64], ids=repr)
def test_interpolation_between_centres_reproduces_linear_functions(backend, scalar):
    grid = Grid2D((8, 6), origin=(-1.0, 2.0), extent=(2.0, 3.0), precision=scalar)
    cells, (hx, hy) = grid.cells, grid.spacing
    cells.new_field("u", scalar)
    particles = ebb.Relation("particles", size=400)
    at = np.random.default_rng(5).random((400, 2)) * (2, 3) + (-1, 2)
    particles.new_field("pos", ebb.vector(scalar, 2), init=at)
    particles.new_field("dual_cell", grid.dual_cells)
    particles.new_field("u", scalar)

    @ebb.kernel
    def fill(c: cells):
        c.u = 3 * c.center.x - 2 * c.center.y + 1

    @ebb.kernel
    def interpolate(p: particles):
        d = p.dual_cell
        x1, y1 = (p.pos - d.cell(0, 0).center) / [hx, hy]
        x0, y0 = 1 - x1, 1 - y1
        p.u = x0 * y0 * d.cell(0, 0).u + x1 * y0 * d.cell(1, 0).u + x0 * y1 * d.cell(0, 1).u + x1 * y1 * d.cell(1, 1).u

    fill(cells)
    grid.dual_cells.point_locate(particles.dual_cell, particles.pos)
    interpolate(particles)
    pos = particles.pos.to_numpy()
    accuracy = 1e-5 if scalar == ebb.float32 else 1e-13
    np.testing.assert_allclose(particles.u.to_numpy(), 3 * pos[:, 0] - 2 * pos[:, 1] + 1, atol=accuracy)


def test_interpolation_across_the_seam(backend):
    grid = Grid2D((4, 5), periodic=(True, True))
    grid.cells.new_field("u", ebb.float64, init=np.random.default_rng(5).random((4, 5)))
    particles = ebb.Relation("particles", size=300)
    at = np.random.default_rng(6).random((300, 2)) * 20 - 10
    particles.new_field("pos", ebb.vec2d, init=at)
    particles.new_field("u", ebb.float64)

    @ebb.kernel
    def interpolate(p: particles):
        d = grid.dual_locate(p.pos)
        x1, y1 = (p.pos - 0.5) % 1.0
        low = (1 - x1) * d.cell(0, 0).u + x1 * d.cell(1, 0).u
        p.u = (1 - y1) * low + y1 * ((1 - x1) * d.cell(0, 1).u + x1 * d.cell(1, 1).u)

    interpolate(particles)
    u, (i, j) = grid.cells.u.to_numpy(), np.floor(at - 0.5).astype(int).T
    x, y = (at - 0.5 - np.floor(at - 0.5)).T

    def corner(a, b):
        return u[(i + a) % 4, (j + b) % 5]

    low, high = (1 - x) * corner(0, 0) + x * corner(1, 0), (1 - x) * corner(0, 1) + x * corner(1, 1)
    np.testing.assert_allclose(particles.u.to_numpy(), (1 - y) * low + y * high, atol=1e-13)


def test_particles_deposit_into_the_cells_that_hold_them(backend):
    grid = Grid2D((4, 5), extent=(1, 1))
    grid.cells.new_field("count", ebb.int32, init=0)
    particles = ebb.Relation("particles", size=1000)
    at = np.random.default_rng(5).random((1000, 2))
    particles.new_field("pos", ebb.vec2d, init=at)

    @ebb.kernel
    def deposit(p: particles):
        grid.locate(p.pos).count += 1

    deposit(particles)
    np.testing.assert_array_equal(grid.cells.count.to_numpy(), np.histogram2d(*at.T, (4, 5), [(0, 1), (0, 1)])[0])


def test_rows_located_in_a_captured_step(backend):
    grid = Grid2D((8, 8), periodic=True)
    particles = ebb.Relation("particles", size=3)
    particles.new_field("pos", ebb.vec2f, init=[[0, 0], [3.5, 7.5], [7, 2]])
    particles.new_field("cell", grid.cells)

    @ebb.kernel
    def move(p: particles):
        p.pos += [0.5, 0.25]

    with ebb.capture() as step:
        move(particles)
        grid.cells.point_locate(particles.cell, particles.pos)
    step.run(10)
    np.testing.assert_array_equal(particles.cell.to_numpy(), [[5, 2], [0, 2], [4, 4]])
