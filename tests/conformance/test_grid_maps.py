"""Affine maps between grids, scatter through offsets, and keys into grids."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import define, grid, names_row, rejects

# ---- Between grids ----


def test_cells_to_vertices(backend):
    vertices = grid((5, 6), name="vertices")
    cells = grid((4, 5))

    @cells.member
    def vertex(c, i, j):
        return ebb.affine(vertices, [[1, 0, i], [0, 1, j]], c)

    @ebb.kernel
    def average(c: cells):
        c.y = 0.25 * (c.vertex(0, 0).x + c.vertex(1, 0).x + c.vertex(0, 1).x + c.vertex(1, 1).x)

    average(cells)
    x = vertices.x.to_numpy()
    np.testing.assert_array_equal(cells.y.to_numpy(), (x[:-1, :-1] + x[1:, :-1] + x[:-1, 1:] + x[1:, 1:]) / 4)


def test_scatter_from_cells_to_vertices(backend):
    vertices = ebb.Relation("vertices", shape=(5, 6))
    vertices.new_field("n", ebb.int32, init=0)
    cells = ebb.Relation("cells", shape=(4, 5))

    @ebb.kernel
    def splat(c: cells):
        for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
            ebb.affine(vertices, [[1, 0, i], [0, 1, j]], c).n += 1

    splat(cells)
    valence = np.outer([1, 2, 2, 2, 1], [1, 2, 2, 2, 2, 1])
    np.testing.assert_array_equal(vertices.n.to_numpy(), valence)


def test_three_dimensions_to_two(backend):
    volume = ebb.Relation("volume", shape=(3, 4, 5))
    image = ebb.Relation("image", shape=(3, 5))
    volume.new_field("density", ebb.float64, init=np.arange(60.0).reshape(3, 4, 5))
    image.new_field("x", ebb.float64, init=0.0)

    @ebb.kernel
    def project(c: volume):
        ebb.affine(image, [[1, 0, 0, 0], [0, 0, 1, 0]], c).x += c.density

    project(volume)
    np.testing.assert_array_equal(image.x.to_numpy(), volume.density.to_numpy().sum(axis=1))


def test_two_dimensions_to_one_and_to_a_constant(backend):
    cells = grid((4, 5))
    line = grid((4,), name="line")

    @ebb.kernel
    def spread(c: cells):
        c.y = ebb.affine(line, [[1, 0, 0]], c).x + 100 * ebb.affine(line, [[0, 0, 3]], c).x

    spread(cells)
    x = line.x.to_numpy()
    np.testing.assert_array_equal(cells.y.to_numpy(), np.repeat(x[:, None] + 100 * x[3], 5, axis=1))


def test_axes_exchanged_and_mirrored(backend):
    cells = grid((4, 5))
    turned = grid((5, 4), name="turned")

    @ebb.kernel
    def turn(t: turned):
        t.y = ebb.affine(cells, [[0, 1, 0], [-1, 0, 4]], t).x

    turn(turned)
    np.testing.assert_array_equal(turned.y.to_numpy(), cells.x.to_numpy().T[::-1])


def test_coarse_to_fine(backend):
    coarse, fine = grid((3, 4), name="coarse"), grid((6, 8), name="fine")

    @ebb.kernel
    def restrict(c: coarse):
        c.y = ebb.affine(fine, [[2, 0, 0], [0, 2, 0]], c).x + 10 * ebb.affine(fine, [[2, 0, 1], [0, 2, 1]], c).x

    restrict(coarse)
    x = fine.x.to_numpy()
    np.testing.assert_array_equal(coarse.y.to_numpy(), x[::2, ::2] + 10 * x[1::2, 1::2])


def test_fine_to_coarse_by_fractions(backend):
    coarse, fine = grid((3, 4), name="coarse"), grid((6, 8), name="fine")

    @ebb.kernel
    def prolong(f: fine):
        f.y = ebb.affine(coarse, [[0.5, 0, 0], [0, 0.5, 0]], f).x

    prolong(fine)
    np.testing.assert_array_equal(fine.y.to_numpy(), coarse.x.to_numpy().repeat(2, 0).repeat(2, 1))


def test_fractions_floor_also_below_zero(backend):
    coarse, fine = grid((4,), (True,), name="coarse"), grid((9,), name="fine")

    @ebb.kernel
    def prolong(f: fine):
        f.y = ebb.affine(coarse, [[1 / 3, -1.5]], f).x

    prolong(fine)
    index = np.floor((np.arange(9) * 2 - 9) / 6).astype(int)
    np.testing.assert_array_equal(fine.y.to_numpy(), coarse.x.to_numpy()[index % 4])


def test_mixed_int_and_float_entries(backend):
    coarse, fine = grid((3, 8), name="coarse"), grid((6, 8), name="fine")

    @ebb.kernel
    def prolong(f: fine):
        f.y = ebb.affine(coarse, [[0.5, 0, 0.0], [0, 1.0, 0]], f).x

    prolong(fine)
    np.testing.assert_array_equal(fine.y.to_numpy(), coarse.x.to_numpy().repeat(2, 0))


def test_a_matrix_captured_from_python(backend):
    coarse, fine = grid((3, 4), name="coarse"), grid((6, 8), name="fine")
    ratio = 2
    shift = np.array([1, 0])

    @ebb.kernel
    def restrict(c: coarse):
        c.y = ebb.affine(fine, [[ratio, 0, shift[0]], [0, ratio, shift[1]]], c).x

    restrict(coarse)
    np.testing.assert_array_equal(coarse.y.to_numpy(), fine.x.to_numpy()[1::2, ::2])


@pytest.mark.parametrize("make", [list, tuple, np.array], ids=["list", "tuple", "array"])
def test_a_whole_matrix_captured_from_python(backend, make):
    coarse, fine = grid((3, 4), name="coarse"), grid((6, 8), name="fine")
    M = make([[2, 0, 1], [0, 2, 0]])

    @ebb.kernel
    def restrict(c: coarse):
        c.y = ebb.affine(fine, M, c).x

    restrict(coarse)
    np.testing.assert_array_equal(coarse.y.to_numpy(), fine.x.to_numpy()[1::2, ::2])
    M = make([[2, 0, 0], [0, 2, 1]])
    restrict(coarse)
    np.testing.assert_array_equal(coarse.y.to_numpy(), fine.x.to_numpy()[::2, 1::2])
    if make is not tuple:
        M[0][2] = 1
        restrict(coarse)
        np.testing.assert_array_equal(coarse.y.to_numpy(), fine.x.to_numpy()[1::2, 1::2])


# ---- Scatter and keys ----


def test_scatter_through_offsets_to_the_same_relation(backend):
    cells = grid((5, 6), (True, False))
    cells.y.fill(0.0)
    cells.new_subset("inner", np.s_[:, 1:-1])

    @ebb.kernel
    def spread(c: cells):
        c(1, 0).y += c.x
        c(0, 1).y += 2 * c.x
        c(0, -1).y -= c.x

    spread(cells.inner)
    x = cells.x.to_numpy().copy()
    x[:, [0, -1]] = 0
    expected = np.roll(x, 1, 0) + 2 * np.roll(x, 1, 1) - np.roll(x, -1, 1)
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)


def test_key_fields_into_a_grid(backend):
    cells = grid((4, 5), (True, True))
    particles = ebb.Relation("particles", size=6)
    at = np.array([[0, 0], [3, 4], [1, 2], [1, 2], [2, 0], [3, 1]])
    particles.new_field("cell", cells, init=at)
    particles.new_field("x", ebb.float64, init=1.0)
    particles.new_field("ij", ebb.vec2i)

    @ebb.kernel
    def gather(p: particles):
        p.x = p.cell.x + 1000 * p.cell(1, 0).x + ebb.id(p.cell)
        p.ij = ebb.coords(p.cell(0, 1))

    gather(particles)
    x, (i, j) = cells.x.to_numpy(), at.T
    np.testing.assert_array_equal(particles.x.to_numpy(), x[i, j] + 1000 * x[(i + 1) % 4, j] + 5 * i + j)
    np.testing.assert_array_equal(particles.ij.to_numpy(), np.stack([i, (j + 1) % 5], axis=1))


def test_scatter_from_particles_into_a_grid(backend):
    cells = grid((4, 5), (True, True))
    cells.y.fill(0.0)
    particles = ebb.Relation("particles", size=65)
    at = np.random.default_rng(2).integers(0, (4, 5), (65, 2))
    particles.new_field("cell", cells, init=at)

    @ebb.kernel
    def deposit(p: particles):
        p.cell.y += 3
        p.cell(0, 1).y += 1

    deposit(particles)
    expected = np.zeros((4, 5))
    np.add.at(expected, (at[:, 0], at[:, 1]), 3)
    np.add.at(expected, (at[:, 0], (at[:, 1] + 1) % 5), 1)
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)


def test_group_by_a_key_into_a_grid(backend):
    cells = grid((4, 5))
    particles = ebb.Relation("particles", size=65)
    at = np.random.default_rng(2).integers(0, (4, 5), (65, 2))
    particles.new_field("cell", cells, init=at)
    particles.new_field("mass", ebb.float64, init=np.arange(65.0))
    particles.group_by("cell")

    @ebb.kernel
    def weigh(c: cells):
        c.y = 0
        for p in ebb.where(particles.cell, c):
            c.y += p.mass

    weigh(cells)
    expected = np.zeros((4, 5))
    np.add.at(expected, (at[:, 0], at[:, 1]), np.arange(65.0))
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)


def test_a_grid_cell_stores_a_neighbour_as_a_key(backend):
    cells = grid((4, 5), (True, True))
    cells.new_field("next", cells)

    @ebb.kernel
    def link(c: cells):
        c.next = c(1, 2)

    @ebb.kernel
    def follow(c: cells):
        c.y = c.next.next.x

    link(cells)
    follow(cells)
    np.testing.assert_array_equal(cells.y.to_numpy(), np.roll(cells.x.to_numpy(), (-2, -4), (0, 1)))
    np.testing.assert_array_equal(cells.next.to_numpy()[3, 4], [0, 1])


def test_an_access_from_data_out_of_bounds_names_the_row(backend):
    cells = grid((4, 5))
    particles = ebb.Relation("particles", size=5)
    particles.new_field("cell", cells, init=[[0, 0], [1, 1], [3, 2], [2, 2], [0, 4]])
    particles.new_field("x", ebb.float64, init=7.0)

    @ebb.kernel
    def gather(p: particles):
        p.x = p.cell(1, 0).x

    error = rejects(ebb.BoundsError, "E403", lambda: gather(particles))
    assert "gather" in str(error) and names_row(error, 2)


def test_a_reduction_from_data_out_of_bounds_does_not_happen(backend):
    cells = grid((4, 5))
    particles = ebb.Relation("particles", size=2)
    particles.new_field("cell", cells, init=[[0, 0], [3, 4]])

    @ebb.kernel
    def deposit(p: particles):
        p.cell(0, 1).y += 1

    rejects(ebb.BoundsError, "E403", lambda: deposit(particles))
    y = cells.y.to_numpy()
    assert set(np.unique(y[0])) <= {-1, 0} and (y[1:] == -1).all()


def test_an_access_from_data_can_be_clamped(backend):
    cells = grid((4, 5))
    particles = ebb.Relation("particles", size=2)
    particles.new_field("cell", cells, init=[[0, 0], [3, 4]])
    particles.new_field("x", ebb.float64)

    @ebb.kernel
    def gather(p: particles):
        p.x = ebb.affine(cells, [[1, 0, 2], [0, 1, -1]], p.cell, edge="clamp").x

    gather(particles)
    np.testing.assert_array_equal(particles.x.to_numpy(), cells.x.to_numpy()[[2, 3], [0, 3]])


WRONG = {
    "offsets that are not known at compile time": "c.y = ebb.affine(cells, [[1, 0, c.n], [0, 1, 0]], c).x",
    "a loop variable of range as an offset": "for i in range(2):\n        c.y += c(i * c.n, 0).x",
    "a matrix of the wrong shape": "c.y = ebb.affine(cells, [[1, 0], [0, 1]], c).x",
    "too few rows": "c.y = ebb.affine(cells, [[1, 0, 0]], c).x",
    "a base that is no key": "c.y = ebb.affine(cells, [[1, 0, 0], [0, 1, 0]], 5).x",
    "a base that is no grid's key": "c.y = ebb.affine(cells, [[1, 0, 0], [0, 1, 0]], c.other).x",
    "a target that is no grid": "c.y = ebb.affine(rows, [[1, 0, 0]], c).z",
    "an unknown edge": "c.y = ebb.affine(cells, [[1, 0, 0], [0, 1, 0]], c, edge='wrap').x",
    "too many offsets": "c.y = c(1, 0, 0).x",
    "coords of a row of no grid": "c.y = ebb.coords(c.other)[0]",
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_affine_maps(case):
    cells, rows = grid((4, 5), (True, True)), ebb.Relation("rows", size=3)
    cells.new_field("n", ebb.int32, init=1)
    cells.new_field("other", rows, init=0)
    rows.new_field("z", ebb.float64)
    kernel = define(f"@ebb.kernel\ndef program(c: cells):\n    {WRONG[case]}\n", cells=cells, rows=rows)["program"]
    rejects(ebb.KernelTypeError, "E2", lambda: kernel(cells))
