"""Grids: the elements, where they lie, and every member that leads from one to another."""

from __future__ import annotations

import numpy as np
import pytest
from grid_model import CASES, GRIDS, elements, sides

import ebb
from ebb.domains import Grid1D, Grid2D, Grid3D

offset = (0, 0, 0)


@ebb.kernel
def follow(e, out: str, name: str):
    e[out] = ebb.coords(e[name])


@ebb.kernel
def follow_1d(e, out: str, name: str):
    e[out] = ebb.coords(e[name](offset[0]))


@ebb.kernel
def follow_2d(e, out: str, name: str):
    e[out] = ebb.coords(e[name](offset[0], offset[1]))


@ebb.kernel
def follow_3d(e, out: str, name: str):
    e[out] = ebb.coords(e[name](offset[0], offset[1], offset[2]))


MOVES = {1: follow_1d, 2: follow_2d, 3: follow_3d}


class Followed:
    """Launches kernels that follow one member of one relation, on the rows that have what it leads to."""

    def __init__(self, relation):
        self.relation = relation
        self.count = 0
        relation.new_field("out", ebb.vector(ebb.int32, relation.ndim))

    def check(self, kernel, name, indices, exist):
        """Checks the indices that a member gives, and where some do not exist, that the launch on all rows fails."""
        self.count += 1
        relation = self.relation
        if not exist.all() and relation.size:
            with pytest.raises(ebb.BoundsError, match="E410"):
                kernel(relation, "out", name)
        kernel(relation.new_subset(f"rows_{self.count}", exist), "out", name)
        np.testing.assert_array_equal(relation.out.to_numpy()[exist], indices[exist], f"{relation.name}.{name}")


def check_members(shape, periodic, moves=((0, 0, 0), (-1, 1, 0), (1, 0, -2))):
    """Follows every member of every relation of a grid, those that take offsets with each of ``moves``."""
    global offset
    grid = GRIDS[len(shape)](shape, periodic=periodic)
    kinds = elements(shape, periodic)
    for kind in kinds:
        followed = Followed(getattr(grid, kind.relation))
        at = 2 * kind.indices() + np.array(kind.first)
        for target in kinds:
            for name in target.names:
                for move in moves:
                    offset = move
                    moved = kind.indices() + np.array(move[: len(shape)])
                    found = target.at(2 * moved + np.array(target.first), shape, periodic)
                    followed.check(MOVES[len(shape)], name, *found)
        for axis in range(len(shape)):
            along = np.eye(len(shape), dtype=int)[axis]
            for name, step in ((f"{'xyz'[axis]}neg", -2), (f"{'xyz'[axis]}pos", 2)):
                followed.check(follow, name, *kind.at(at + step * along, shape, periodic))
            for name, step, other in sides(kind, axis, kinds):
                followed.check(follow, name, *other.at(at + step * along, shape, periodic))
        if any(name.endswith("edge") for name in kind.names):
            along = np.array(kind.first)
            vertices = next(each for each in kinds if each.dimension == 0)
            for name, step in (("tail", -1), ("head", 1)):
                followed.check(follow, name, *vertices.at(at + step * along, shape, periodic))


@pytest.mark.parametrize(("shape", "periodic"), [case for case in CASES if len(case[0]) < 3])
def test_every_member(shape, periodic):
    with ebb.backend("reference"):
        check_members(shape, periodic)


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "periodic"), [case for case in CASES if len(case[0]) == 3])
def test_every_member_in_three_dimensions(shape, periodic):
    with ebb.backend("reference"):
        check_members(shape, periodic, [(-1, 0, 1)])


def test_every_member_compiled():
    check_members((3,), (False,), [(1,)])


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "periodic"), [((3, 2), (True, False)), ((2, 1, 3), (False, True, False))])
def test_every_member_compiled_in_more_dimensions(shape, periodic):
    check_members(shape, periodic, [(1, 0, -1)])


@pytest.mark.parametrize(("shape", "periodic"), CASES)
def test_relations_and_counts(shape, periodic):
    grid = GRIDS[len(shape)](shape, periodic=periodic)
    kinds = elements(shape, periodic)
    for kind in kinds:
        relation = getattr(grid, kind.relation)
        assert (relation.name, relation.shape, relation.periodic) == (kind.relation, kind.counts, periodic)
        for name in kind.names:
            assert (
                getattr(grid, {"vertex": "vertices", "dual_vertex": "dual_vertices"}.get(name, f"{name}s")) is relation
            )
    assert grid.edges == tuple(getattr(grid, f"{axis}edges") for axis in "xyz"[: len(shape)])
    assert grid.faces == tuple(getattr(grid, f"{axis}faces") for axis in "xyz"[: len(shape)])
    euler = sum(
        (-1) ** kind.dimension * getattr(grid, kind.relation).size for kind in kinds if kind.dimension is not None
    )
    assert euler == int(not any(periodic))
    assert not any(getattr(grid, kind.relation).fields for kind in kinds)


@pytest.mark.parametrize(
    ("shape", "periodic"),
    [((1,), (True,)), ((5,), (False,)), ((4, 2), (True, False)), ((2, 1, 3), (False, True, False))],
)
@pytest.mark.parametrize("precision", [ebb.float32, ebb.float64], ids=["float32", "float64"])
def test_positions(backend, shape, periodic, precision):
    ndim = len(shape)
    origin, extent = (-1.0, 2.5, 0.1)[:ndim], (2.0, 0.7, 3.0)[:ndim]
    grid = GRIDS[ndim](shape, origin, extent, periodic, precision=precision)
    spacing = np.array(extent) / np.array(shape)
    np.testing.assert_allclose(grid.spacing, spacing)

    @ebb.kernel
    def read(e):
        e.center_out = e.center
        e.pos_out = e.pos

    for kind in elements(shape, periodic):
        relation = getattr(grid, kind.relation)
        for name in ("center_out", "pos_out"):
            relation.new_field(name, ebb.vector(precision, ndim))
        read(relation)
        expected = np.array(origin) + (kind.indices() + np.array(kind.first) / 2) * spacing
        accuracy = 1e-6 if precision == ebb.float32 else 1e-15
        for name in ("center_out", "pos_out"):
            np.testing.assert_allclose(getattr(relation, name).to_numpy(), expected, accuracy, 4 * accuracy)


@pytest.mark.parametrize("depth", [0, 1, 3, (2, 0)])
@pytest.mark.parametrize("periodic", [(False, False), (True, False), (False, True)])
def test_boundaries(backend, depth, periodic):
    shape = (5, 3)
    grid = Grid2D(shape, periodic=periodic, boundary_depth=depth)
    depths = np.where(periodic, 0, depth)
    assert grid.boundary_depth == tuple(depths)

    @ebb.kernel
    def mark(e):
        e.marks[0] += 1
        e.marks[1] = ebb.int32(e.in_boundary)
        e.marks[2] = ebb.int32(e.in_interior)

    @ebb.kernel
    def count(e):
        e.marks[3] += 1

    for kind in elements(shape, periodic):
        relation = getattr(grid, kind.relation)
        relation.new_field("marks", ebb.vec4i, init=0)
        at, last = kind.indices(), np.array(kind.counts) - 1
        outer = ((at < depths) | (last - at < depths)).any(axis=-1)
        mark(relation)
        count(relation.boundary)
        for _ in range(10):
            count(relation.interior)
        marks = relation.marks.to_numpy()
        np.testing.assert_array_equal(marks[..., 1], outer)
        np.testing.assert_array_equal(marks[..., 2], ~outer)
        np.testing.assert_array_equal(marks[..., 3], np.where(outer, 1, 10))


@pytest.mark.parametrize(("shape", "periodic"), CASES)
def test_walls(shape, periodic):
    grid = GRIDS[len(shape)](shape, periodic=periodic)

    @ebb.kernel
    def mark(e, which: ebb.int32):
        e.wall += which

    for kind in elements(shape, periodic):
        relation = getattr(grid, kind.relation)
        relation.new_field("wall", ebb.int32, init=0)
        with ebb.backend("reference"):
            mark(relation.walls, 1)
            mark(relation.inside, 10)
        at = 2 * kind.indices() + np.array(kind.first)
        ends = ((at == 0) | (at == 2 * np.array(shape))) & ~np.array(periodic)
        np.testing.assert_array_equal(relation.wall.to_numpy(), np.where(ends.any(axis=-1), 1, 10))


def test_ways_there_and_back(backend):
    grid = Grid3D((3, 2, 4), periodic=(True, False, True))
    grid.cells.new_field("same", ebb.bool_)

    @ebb.kernel
    def walk(c: grid.cells):
        by_vertex = c.vertex(1, 1, 1).cell(-1, -1, -1) == c
        by_faces = c.xneg_face.xpos_cell == c and c.ypos_face.yneg_cell == c
        by_edge = c.zneg_face.xpos_edge.head.xedge(0, -1, 0).zpos_face.yneg_cell == c(1, -1, 0)
        c.same = by_vertex and by_faces and by_edge

    walk(grid.cells.new_subset("upper", np.s_[:, 1:, :]))
    assert grid.cells.same.to_numpy()[:, 1:].all()


def test_clamped_stays_in_the_grid(backend):
    grid = Grid2D((4, 5), periodic=(False, True))
    grid.cells.new_field("x", ebb.float64, init=lambda i, j: 10 * i + j)
    grid.cells.new_field("y", ebb.float64)

    @ebb.kernel
    def read(c: grid.cells):
        c.y = c.clamped(2, -2).x + 100 * c.clamped(-1).x

    read(grid.cells)
    i, j = np.indices((4, 5))
    expected = 10 * np.minimum(i + 2, 3) + (j - 2) % 5 + 100 * (10 * np.maximum(i - 1, 0) + j)
    np.testing.assert_array_equal(grid.cells.y.to_numpy(), expected)


@pytest.mark.parametrize("periodic", [(False, False), (True, True), (True, False)])
def test_five_point_laplacian(backend, periodic):
    grid = Grid2D((6, 7), extent=(3.0, 2.0), periodic=periodic)
    cells, (hx, hy) = grid.cells, grid.spacing
    cells.new_field("u", ebb.float64, init=np.random.default_rng(1).random((6, 7)))
    cells.new_field("v", ebb.float64)

    @ebb.kernel
    def laplace(c: cells):
        c.v = (c.xneg.u - 2 * c.u + c.xpos.u) / hx**2 + (c(0, -1).u - 2 * c.u + c(0, 1).u) / hy**2

    laplace(cells.interior)
    u = cells.u.to_numpy()
    expected = sum((np.roll(u, 1, d) - 2 * u + np.roll(u, -1, d)) / h**2 for d, h in enumerate((hx, hy)))
    inside = tuple(slice(None) if wraps else slice(1, -1) for wraps in periodic)
    np.testing.assert_allclose(cells.v.to_numpy()[inside], expected[inside], 1e-12)


def test_seven_point_laplacian_as_the_divergence_of_fluxes(backend):
    grid = Grid3D((4, 5, 3), periodic=(True, False, True))
    cells = grid.cells
    cells.new_field("u", ebb.float64, init=np.random.default_rng(1).random((4, 5, 3)))
    cells.new_field("v", ebb.float64)

    @ebb.kernel
    def x_flux(f: grid.xfaces):
        f.flux = f.xpos_cell.u - f.xneg_cell.u

    @ebb.kernel
    def y_flux(f: grid.yfaces):
        f.flux = f.ypos_cell.u - f.yneg_cell.u

    @ebb.kernel
    def z_flux(f: grid.zfaces):
        f.flux = f.zpos_cell.u - f.zneg_cell.u

    @ebb.kernel
    def diverge(c: cells):
        c.v = c.xpos_face.flux - c.xneg_face.flux + c.ypos_face.flux - c.yneg_face.flux
        c.v += c.zpos_face.flux - c.zneg_face.flux

    for faces, kernel in zip(grid.faces, (x_flux, y_flux, z_flux), strict=True):
        faces.new_field("flux", ebb.float64, init=0.0)
        kernel(faces.inside)
    diverge(cells)
    u = cells.u.to_numpy()
    padded = np.pad(u, ((0, 0), (1, 1), (0, 0)), mode="edge")  # no flux through the walls
    expected = sum(np.roll(u, 1, d) + np.roll(u, -1, d) for d in (0, 2)) + padded[:, 2:] + padded[:, :-2] - 6 * u
    np.testing.assert_allclose(cells.v.to_numpy(), expected, atol=1e-12)


def test_curls_of_gradients_vanish(backend):
    grid = Grid3D((3, 2, 4))
    grid.vertices.new_field("u", ebb.int32, init=np.random.default_rng(1).integers(-9, 9, (4, 3, 5)))

    @ebb.kernel
    def gradient(e):
        e.du = e.head.u - e.tail.u

    for edges in grid.edges:
        edges.new_field("du", ebb.int32)
        gradient(edges)

    @ebb.kernel
    def curl(f: grid.zfaces):
        f.curl = f.yneg_edge.du + f.xpos_edge.du - f.ypos_edge.du - f.xneg_edge.du

    grid.zfaces.new_field("curl", ebb.int32, init=7)
    curl(grid.zfaces)
    assert not grid.zfaces.curl.to_numpy().any()


def test_neighbours_are_at_constant_offsets():
    grid = Grid3D((4, 4, 4))
    grid.cells.new_field("u", ebb.float32)
    grid.cells.new_field("v", ebb.float32)

    @ebb.kernel
    def laplace(c: grid.cells):
        c.v = c.xneg.u + c.xpos.u + c.yneg.u + c.ypos.u + c.zneg.u + c(0, 0, 1).u - 6 * c.u

    text = laplace.inspect(grid.cells.interior, "lir")
    assert "fail" not in text
    assert not any(f" {op} " in text for op in ("min", "max", "//", "%"))  # no bounds, wraps or coordinates


def test_names_in_use():
    grid = Grid2D((4, 4))
    for name in ("locate", "point_locate", "center", "xneg", "interior", "vertex"):
        with pytest.raises(ebb.RelationError, match="E502"):
            grid.cells.new_field(name, ebb.float32)
    with pytest.raises(ebb.RelationError):
        grid.cells.locate = None
    assert repr(Grid1D(3, -1, 2.5)) == "<Grid1D: 3 cells, 2.5 from (-1.0,)>"
    assert repr(Grid3D((2, 3, 4), periodic=(True, False, True))).endswith("from (0.0, 0.0, 0.0), periodic in x and z>")


WRONG = {
    "E530": [
        lambda: Grid2D((0, 4)),
        lambda: Grid2D((4, -1)),
        lambda: Grid2D(4),
        lambda: Grid2D((4, 4, 4)),
        lambda: Grid2D((4.0, 4)),
        lambda: Grid2D((True, 4)),
        lambda: Grid2D("44"),
        lambda: Grid2D(None),
        lambda: Grid2D(()),
        lambda: Grid1D(0),
        lambda: Grid3D(np.array([4, 4, 0])),
    ],
    "E531": [
        lambda: Grid2D((4, 4), origin=(0,)),
        lambda: Grid2D((4, 4), origin=(0, np.nan)),
        lambda: Grid2D((4, 4), origin="ab"),
        lambda: Grid2D((4, 4), origin=()),
        lambda: Grid2D((4, 4), origin=[[0], [0]]),
        lambda: Grid2D((4, 4), origin=(0, 10**400)),
        lambda: Grid2D((4, 4), extent=(1, 1, 1)),
        lambda: Grid2D((4, 4), extent=(1, np.inf)),
        lambda: Grid2D((4, 4), extent=(1, 1j)),
        lambda: Grid2D((4, 4), extent=True),
        lambda: Grid2D((4, 4), periodic=(True,)),
        lambda: Grid2D((4, 4), periodic=(1, 0)),
        lambda: Grid2D((4, 4), periodic=None),
        lambda: Grid2D((4, 4), boundary_depth=-1),
        lambda: Grid2D((4, 4), boundary_depth=1.0),
        lambda: Grid2D((4, 4), boundary_depth=(1, 1, 1)),
        lambda: Grid2D((4, 4), boundary_depth=True),
        lambda: Grid2D((4, 4), precision=ebb.int32),
        lambda: Grid2D((4, 4), precision="float32"),
    ],
    "E532": [
        lambda: Grid2D((4, 4), extent=0),
        lambda: Grid2D((4, 4), extent=(-1, 1)),
        lambda: Grid2D((4, 4), origin=(1e39, 0)),
        lambda: Grid2D((4, 4), origin=1e8, extent=1),
    ],
    "E533": [
        lambda: Grid2D((4, 4), boundary_depth=5),
        lambda: Grid2D((4, 4), periodic=(True, False), boundary_depth=(1, 5)),
    ],
}


@pytest.mark.parametrize(("code", "make"), [(code, make) for code, makers in WRONG.items() for make in makers])
def test_wrong_arguments(code, make):
    with pytest.raises(ebb.RelationError, match=code):
        make()


def test_arguments_of_many_kinds():
    grid = Grid2D(
        np.array([4, 2]), np.float32(1), [np.int64(8), 3], np.array([True, False]), (9, 2), precision=ebb.float64
    )
    assert (grid.shape, grid.origin, grid.extent) == ((4, 2), (1.0, 1.0), (8.0, 3.0))
    assert (grid.spacing, grid.periodic, grid.boundary_depth) == ((2.0, 1.5), (True, False), (0, 2))
    assert Grid1D(4).shape == Grid1D([4]).shape == (4,)
    assert all(type(n) is int for n in grid.shape)
