"""Particles: how they are made, and how they are coupled with grids."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import Grid1D, Grid2D, Grid3D, Particles

GRIDS = {1: Grid1D, 2: Grid2D, 3: Grid3D}
SHAPES = {1: (6,), 2: (5, 8), 3: (4, 3, 5)}


def grid_of(ndim, **options):
    return GRIDS[ndim](SHAPES[ndim], (-1.0, 2.0, 0.5)[:ndim], (3.0, 2.0, 1.25)[:ndim], **options)


def points_in(grid, count=200, seed=1):
    share = np.random.default_rng(seed).random((count, len(grid.shape)))
    return np.array(grid.origin) + share * np.array(grid.extent)


def index_of(grid, points, dual=False):
    """The cells or dual cells of points in the domain."""
    at = (points - np.array(grid.origin)) / np.array(grid.spacing) - (0.5 if dual else 0)
    counts = np.array((grid.dual_cells if dual else grid.cells).shape)
    return np.where(grid.periodic, np.floor(at).astype(int) % counts, np.clip(np.floor(at).astype(int), 0, counts - 1))


# ---- What they are made from ----


@pytest.mark.parametrize(("precision", "dtype"), [(ebb.float32, np.float32), (ebb.float64, np.float64)], ids=["f", "d"])
@pytest.mark.parametrize("ndim", [1, 2, 3])
def test_positions(ndim, precision, dtype):
    points = np.random.default_rng(0).random((7, ndim))
    particles = Particles(points, precision=precision)
    assert (particles.size, particles.dimension, particles.name) == (7, ndim, "particles")
    assert particles.pos.type == ebb.vector(precision, ndim)
    np.testing.assert_array_equal(particles.pos.to_numpy(), points.astype(dtype))
    assert isinstance(particles, ebb.Relation) and not particles.is_grid


def test_lists_and_integers_are_positions():
    np.testing.assert_array_equal(Particles([[0, 1], [2, 3]], name="dust").pos.to_numpy(), [[0, 1], [2, 3]])
    assert Particles(np.empty((0, 2))).size == 0


def test_fields_from_arrays():
    size = 6
    fields = {
        "mass": np.arange(6.0),
        "kind": np.arange(6, dtype=np.uint8),
        "tag": np.arange(6),
        "count": np.arange(6, dtype=np.uint64),
        "fixed": np.arange(6) % 2 == 0,
        "vel": np.arange(12.0).reshape(6, 2),
        "F": np.arange(24.0).reshape(6, 2, 2),
    }
    particles = Particles.from_arrays(np.zeros((size, 2)), precision=ebb.float64, **fields)
    types = [ebb.float64, ebb.uint32, ebb.int64, ebb.uint64, ebb.bool_, ebb.vec2d, ebb.mat2d]
    assert [particles.fields[name].type for name in fields] == types
    for name, values in fields.items():
        np.testing.assert_array_equal(particles.fields[name].to_numpy(), values)


def test_random_particles():
    particles = Particles.random(5000, (-1, 2), (3, 2.5), seed=4, precision=ebb.float64)
    points = particles.pos.to_numpy()
    assert (points >= (-1, 2)).all() and (points < (3, 2.5)).all()
    np.testing.assert_allclose(points.mean(axis=0), (1, 2.25), atol=0.06)
    again, other = (Particles.random(5000, (-1, 2), (3, 2.5), seed=seed, precision=ebb.float64) for seed in (4, 5))
    np.testing.assert_array_equal(again.pos.to_numpy(), points)
    assert not np.array_equal(other.pos.to_numpy(), points)


@pytest.mark.parametrize("ndim", [1, 2, 3])
def test_particles_in_cells(ndim):
    grid = grid_of(ndim, precision=ebb.float64)
    one, more = Particles.in_cells(grid), Particles.in_cells(grid, 3, precision=ebb.float32)
    assert one.pos.type == ebb.vector(ebb.float64, ndim) and more.pos.type == ebb.vector(ebb.float32, ndim)
    one.couple(grid, dual_cell=None)
    np.testing.assert_array_equal(one.cell.to_numpy(), np.argwhere(np.ones(grid.shape)))
    assert "dual_cell" not in one.fields
    more.couple(grid)
    counts = np.zeros(grid.shape, int)
    np.add.at(counts, tuple(more.cell.to_numpy().T), 1)
    assert (counts == 3**ndim).all()


# ---- Coupling ----


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("ndim", [1, 2, 3])
def test_keys_follow_the_particles(backend, ndim, periodic):
    grid = grid_of(ndim, periodic=periodic)
    particles = Particles(points_in(grid))
    particles.couple(grid)
    for points in (points_in(grid), points_in(grid, seed=2)):
        particles.pos.load(points)
        particles.locate()
        points = particles.pos.to_numpy()
        np.testing.assert_array_equal(particles.cell.to_numpy().reshape(200, ndim), index_of(grid, points))
        np.testing.assert_array_equal(particles.dual_cell.to_numpy().reshape(200, ndim), index_of(grid, points, True))


def test_two_grids_and_a_kernel_that_locates_its_own_row(backend):
    coarse, fine = Grid2D((4, 4), extent=1), Grid2D((64, 64), extent=1)
    particles = Particles.random(100, (0, 0), (1, 1))
    particles.couple(coarse, dual_cell=None)
    particles.couple(fine, cell="fine_cell", dual_cell="fine_dual")

    @ebb.kernel
    def jump(p: particles):
        p.pos = 1 - p.pos
        p.cell = coarse.locate(p.pos)
        p.fine_dual = fine.dual_locate(p.pos)

    jump(particles)
    points = particles.pos.to_numpy().astype(float)
    np.testing.assert_array_equal(particles.cell.to_numpy(), index_of(coarse, points))
    np.testing.assert_array_equal(particles.fine_dual.to_numpy(), index_of(fine, points, True))
    np.testing.assert_array_equal(particles.fine_cell.to_numpy(), index_of(fine, 1 - points))
    particles.locate()
    np.testing.assert_array_equal(particles.fine_cell.to_numpy(), index_of(fine, points))


def test_a_located_step_is_captured(backend):
    grid = Grid2D((8, 8), periodic=True)
    particles = Particles([[0, 0], [3.5, 7.5], [7, 2]])
    particles.couple(grid)

    @ebb.kernel
    def move(p: particles):
        moved = p.pos
        moved += [0.5, 0.25]
        p.pos = grid.wrap(moved)

    with ebb.capture() as step:
        move(particles)
        particles.locate()
    step.run(20)
    np.testing.assert_array_equal(particles.pos.to_numpy(), [[2, 5], [5.5, 4.5], [1, 7]])
    np.testing.assert_array_equal(particles.cell.to_numpy(), [[2, 5], [5, 4], [1, 7]])


@pytest.mark.parametrize("ndim", [1, 2, 3])
@pytest.mark.parametrize("periodic", [False, True])
def test_local_coordinates(backend, ndim, periodic):
    grid = grid_of(ndim, periodic=periodic, precision=ebb.float64)
    particles = Particles(np.concatenate([points_in(grid), [grid.origin]]), precision=ebb.float64)
    particles.couple(grid)
    for name in ("in_cell", "in_dual"):
        particles.new_field(name, ebb.vector(ebb.float64, ndim))

    @ebb.kernel
    def find(p: particles):
        p.in_cell = p.cell.local(p.pos)
        p.in_dual = p.dual_cell.local(p.pos)

    find(particles)
    at = (particles.pos.to_numpy() - np.array(grid.origin)) / np.array(grid.spacing)
    index = particles.dual_cell.to_numpy().reshape(-1, ndim)
    beyond = at - 0.5 - index
    expected = np.where(grid.periodic, beyond % np.array(grid.shape), beyond)
    np.testing.assert_allclose(particles.in_cell.to_numpy(), at - np.floor(at), atol=1e-12)
    np.testing.assert_allclose(particles.in_dual.to_numpy(), expected, atol=1e-12)
    if periodic:  # elsewhere points near the walls lie outside of all dual cells
        found = particles.in_dual.to_numpy()
        assert (found >= 0).all() and (found < 1).all()


def test_wrapped_positions(backend):
    grid = Grid2D((4, 5), origin=(-1, 2), extent=(2, 5), periodic=(True, False))
    at = np.array([[-1, 0], [1, 9], [0.5, 3], [-3.5, 3], [1000.25, 3], [-1000.25, 3]])
    particles = Particles(at, precision=ebb.float64)

    @ebb.kernel
    def wrap(p: particles):
        p.pos = grid.wrap(p.pos)

    wrap(particles)
    expected = [[-1, 0], [-1, 9], [0.5, 3], [0.5, 3], [0.25, 3], [-0.25, 3]]
    np.testing.assert_allclose(particles.pos.to_numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("fastmath", [False, True])
def test_a_lost_particle_is_named(backend, fastmath):
    grid = Grid2D((4, 5))
    particles = Particles.in_cells(grid)
    particles.couple(grid)
    before = particles.cell.to_numpy()
    at = particles.pos.to_numpy()
    at[7, 1] = np.nan
    particles.pos.load(at)

    @ebb.kernel(fastmath=fastmath)
    def locate(p: particles):
        p.cell = grid.locate(p.pos)

    for launch in (particles.locate, lambda: locate(particles)):
        with pytest.raises(ebb.KernelAssertionError, match=r"row particles\[7\]: the position to locate is not a numb"):
            launch()
    particles.pos.load(np.nan_to_num(at))
    particles.locate()
    after = particles.cell.to_numpy()
    assert after[7].tolist() == [1, 0]
    np.testing.assert_array_equal(np.delete(after, 7, axis=0), np.delete(before, 7, axis=0))


# ---- What is refused ----


@pytest.mark.parametrize(
    "positions",
    [3, [1.0, 2.0], np.zeros((4, 4)), np.zeros((4, 0)), np.zeros((2, 2, 2)), [[1, 2], [3]], [["a", "b"]], [[1j, 2]]],
    ids=str,
)
def test_what_are_no_positions(positions):
    with pytest.raises(ebb.RelationError, match="E540"):
        Particles(positions)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e39])
def test_positions_that_are_nowhere(bad):
    points = np.zeros((5, 3))
    points[3, 1] = bad
    with pytest.raises(ebb.RelationError, match=r"E541.*particle 3 lies nowhere"):
        Particles(points)
    if bad == 1e39:
        assert Particles(points, precision=ebb.float64).size == 5


def test_other_arguments_that_are_refused():
    points, grid = np.zeros((4, 2)), Grid2D((3, 3))
    for make in (
        lambda: Particles(points, precision=ebb.int32),
        lambda: Particles.random(-1, 0, 1),
        lambda: Particles.random(2.5, (0, 0), (1, 1)),
        lambda: Particles.random(3, (0, 0), (1, 1, 1)),
        lambda: Particles.random(3, (0, np.nan), (1, 1)),
        lambda: Particles.random(3, 0.0, 1.0),
        lambda: Particles.in_cells(grid, -1),
        lambda: Particles.from_arrays(points, mass=np.zeros(5)),
        lambda: Particles.from_arrays(points, mass=1.0),
        lambda: Particles.from_arrays(points, name_of=np.array(list("abcd"))),
        lambda: Particles.from_arrays(points, mass=np.zeros((4, 0))),
    ):
        with pytest.raises(ebb.RelationError, match="E540"):
            make()


def test_couplings_that_are_refused_add_nothing():
    particles = Particles(np.zeros((4, 2)))
    particles.new_field("vel", ebb.vec2f)
    grid = Grid2D((3, 3))
    for code, couple in (
        ("E542", lambda: particles.couple(Grid3D((3, 3, 3)))),
        ("E542", lambda: particles.couple(Grid2D((1, 3)))),
        ("E542", lambda: particles.couple(grid, cell="key", dual_cell="key")),
        ("E542", lambda: particles.couple(grid, cell=3)),
        ("E502", lambda: particles.couple(grid, dual_cell="vel")),
        ("E502", lambda: particles.couple(grid, dual_cell="locate")),
        ("E501", lambda: particles.couple(grid, dual_cell="dual cell")),
        ("E501", lambda: particles.couple(grid, dual_cell="for")),
    ):
        with pytest.raises(ebb.RelationError, match=code):
            couple()
        assert list(particles.fields) == ["pos", "vel"]
    particles.couple(Grid2D((1, 3)), dual_cell=None)
    particles.couple(grid, cell="other", dual_cell="between")
    assert list(particles.fields) == ["pos", "vel", "cell", "other", "between"]
