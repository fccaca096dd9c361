"""Grids: arrays and indices agree, affine maps, wrapping, clamping and bounds."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import grid, kernel_of, rejects


def test_a_one_dimensional_grid(backend):
    cells = grid((7,), (True,))

    @ebb.kernel
    def difference(c: cells):
        c.y = c(1).x - c(-1).x

    difference(cells)
    x = np.arange(7.0) ** 2
    np.testing.assert_array_equal(cells.y.to_numpy(), np.roll(x, -1) - np.roll(x, 1))


def test_a_two_dimensional_grid(backend):
    cells = grid((5, 7), (True, True))

    @ebb.kernel
    def difference(c: cells):
        c.y = c(1, 0).x - 10 * c(0, 2).x + c(-1, -3).x

    difference(cells)
    x = cells.x.to_numpy()
    np.testing.assert_array_equal(
        cells.y.to_numpy(), np.roll(x, -1, 0) - 10 * np.roll(x, -2, 1) + np.roll(x, (1, 3), (0, 1))
    )


def test_a_three_dimensional_grid(backend):
    cells = grid((3, 4, 5), (True, True, True))

    @ebb.kernel
    def difference(c: cells):
        c.y = c(1, 0, 0).x - 10 * c(0, 1, 0).x + 100 * c(0, 0, 1).x

    difference(cells)
    x = cells.x.to_numpy()
    np.testing.assert_array_equal(
        cells.y.to_numpy(), np.roll(x, -1, 0) - 10 * np.roll(x, -1, 1) + 100 * np.roll(x, -1, 2)
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_each_dimension_wraps_alone(backend, axis):
    periodic = tuple(d == axis for d in range(3))
    step = [int(wraps) for wraps in periodic]
    cells = grid((3, 4, 5), periodic)

    @ebb.kernel
    def along(c: cells):
        c.y = c(step[0], step[1], step[2]).x + c(-7 * step[0], -7 * step[1], -7 * step[2]).x

    along(cells)
    x = cells.x.to_numpy()
    np.testing.assert_array_equal(cells.y.to_numpy(), np.roll(x, -1, axis) + np.roll(x, 7, axis))
    for other in {0, 1, 2} - {axis}:
        move = [0, 0, 0]
        move[other] = 1

        @ebb.kernel
        def across(c: cells):
            c.y = c(move[0], move[1], move[2]).x

        rejects(ebb.BoundsError, "E410", lambda: across(cells))


def test_arrays_are_indexed_as_cells_are(backend):
    cells = ebb.Relation("cells", shape=(3, 4, 5))
    cells.new_field("x", ebb.int32, init=lambda i, j, k: 100 * i + 10 * j + k)
    cells.new_field("ok", ebb.bool_)

    @ebb.kernel
    def verify(c: cells):
        ijk = ebb.coords(c)
        c.ok = c.x == 100 * ijk[0] + 10 * ijk.y + ijk[2]

    verify(cells)
    assert cells.ok.to_numpy().all()
    assert cells.x.to_numpy()[2, 3, 4] == 234
    assert cells.x.to_numpy().ravel()[1] == 1


def test_an_overrun_is_an_error_before_anything_runs(backend):
    cells = grid((6, 8))

    @ebb.kernel
    def laplace(c: cells):
        c.y = c(1, 0).x + c(-1, 0).x + c(0, 1).x + c(0, -1).x - 4 * c.x

    error = rejects(ebb.BoundsError, "E410", lambda: laplace(cells))
    assert "c(1, 0)" in str(error) and "new_subset" in str(error)
    np.testing.assert_array_equal(cells.y.to_numpy(), np.full((6, 8), -1))
    cells.new_subset("interior", np.s_[1:-1, 1:-1])
    laplace(cells.interior)
    x = cells.x.to_numpy()
    expected = np.full((6, 8), -1.0)
    expected[1:-1, 1:-1] = x[2:, 1:-1] + x[:-2, 1:-1] + x[1:-1, 2:] + x[1:-1, :-2] - 4 * x[1:-1, 1:-1]
    np.testing.assert_array_equal(cells.y.to_numpy(), expected)


def test_the_stencil_is_checked_against_each_launched_subset(backend):
    cells = grid((6,))
    cells.new_subset("left", np.s_[:-1])
    cells.new_subset("right", np.s_[1:])
    cells.new_subset("scattered", [0, 2, 4])
    cells.new_subset("last", [5])

    @ebb.kernel
    def forward(c: cells):
        c.y = c(1).x

    forward(cells.left)
    forward(cells.scattered)
    rejects(ebb.BoundsError, "E410", lambda: forward(cells.right))
    rejects(ebb.BoundsError, "E410", lambda: forward(cells.last))
    np.testing.assert_array_equal(cells.y.to_numpy(), [1, 4, 9, 16, 25, -1])


def test_an_access_in_a_branch_counts(backend):
    cells = grid((6,))

    @ebb.kernel
    def guarded(c: cells):
        if ebb.coords(c)[0] < 5:
            c.y = c(1).x

    rejects(ebb.BoundsError, "E410", lambda: guarded(cells))


def test_moves_add_up(backend):
    cells = grid((6, 6))
    cells.new_subset("corner", np.s_[2:, :4])

    @ebb.kernel
    def knight(c: cells):
        a = c(-1, 0)
        c.y = a(-1, 1)(0, 1).x

    knight(cells.corner)
    np.testing.assert_array_equal(cells.y.to_numpy()[2:, :4], cells.x.to_numpy()[:4, 2:])
    rejects(ebb.BoundsError, "E410", lambda: knight(cells))


def test_clamp_repeats_the_edge(backend):
    cells = ebb.Relation("cells", shape=(4, 5))
    cells.new_field("x", ebb.float64, init=np.arange(20.0).reshape(4, 5))
    cells.new_field("y", ebb.float64)

    @ebb.kernel
    def shifted(c: cells):
        c.y = ebb.affine(cells, [[1, 0, 2], [0, 1, -1]], c, edge="clamp").x

    shifted(cells)
    i, j = np.indices((4, 5))
    np.testing.assert_array_equal(cells.y.to_numpy(), cells.x.to_numpy()[np.minimum(i + 2, 3), np.maximum(j - 1, 0)])


def test_clamp_beside_wrap(backend):
    cells = ebb.Relation("cells", shape=(4, 5), periodic=(False, True))
    cells.new_field("x", ebb.float64, init=np.arange(20.0).reshape(4, 5))
    cells.new_field("y", ebb.float64)

    @ebb.kernel
    def shifted(c: cells):
        c.y = ebb.affine(cells, [[1, 0, -2], [0, 1, 3]], c, edge="clamp").x

    shifted(cells)
    i, j = np.indices((4, 5))
    np.testing.assert_array_equal(cells.y.to_numpy(), cells.x.to_numpy()[np.maximum(i - 2, 0), (j + 3) % 5])


@pytest.mark.parametrize("shape", [(0,), (0, 5), (5, 0), (3, 0, 2)])
@pytest.mark.parametrize("wraps", [True, False])
def test_grids_without_cells(backend, shape, wraps):
    cells = grid(shape, (wraps,) * len(shape))
    offsets = ", ".join("1" for _ in shape)
    kernel_of(f"c.y = c({offsets}).x", "c: cells", cells=cells)(cells)
    assert cells.y.to_numpy().shape == shape
    particles = ebb.Relation("particles", size=1)
    particles.new_field("cell", cells)
    follow = kernel_of(f"y = p.cell({offsets}).x", "p: particles", particles=particles)
    rejects(ebb.RelationError, "E404", lambda: follow(particles))


def test_large_grids(backend):
    if backend == "reference":
        pytest.skip("large relations take the reference interpreter minutes")
    cells = grid((301, 333), (True, False))
    cells.new_subset("interior", np.s_[:, 1:-1])

    @ebb.kernel
    def laplace(c: cells):
        c.y = c(1, 0).x + c(-1, 0).x + c(0, 1).x + c(0, -1).x - 4 * c.x

    laplace(cells.interior)
    x = cells.x.to_numpy()
    expected = np.roll(x, 1, 0) + np.roll(x, -1, 0) + np.roll(x, 1, 1) + np.roll(x, -1, 1) - 4 * x
    np.testing.assert_array_equal(cells.y.to_numpy()[:, 1:-1], expected[:, 1:-1])
    np.testing.assert_array_equal(cells.y.to_numpy()[:, 0], -1)
