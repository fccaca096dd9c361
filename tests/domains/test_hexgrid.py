"""Hexahedra on a grid: the same members as those with keys, the same answers, the same files."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import Grid3D, HexGrid, HexMesh

SHAPE = (3, 2, 4)
OPTIONS = {"size": (3, 4, 2), "symmetry": ("xneg", "zpos"), "precision": ebb.float64}


@ebb.kernel
def look(e):
    for i in (0, 1, 2, 3, 4, 5, 6, 7):
        e.middle += e.corner(i).pos / 8
        e.corner(i).weight += e.mass
    for side in (0, 1, 2, 3, 4, 5):
        e.kinds += e.boundary(side) * 4**side
        e.around += e.beyond(side).mass * (side + 1)
    e.around += 10 * e.xneg.mass + 20 * e.xpos.mass + 30 * e.yneg.mass
    e.around += 40 * e.ypos.mass + 50 * e.zneg.mass + 60 * e.zpos.mass


@ebb.kernel
def mark(v, amount: ebb.int32):
    v.sides += amount


def observe(mesh):
    """All that the members give, in arrays."""
    elements, vertices = mesh.elements, mesh.vertices
    elements.new_field("mass", ebb.float64, init=(np.arange(24.0) ** 2 % 7).reshape(elements.shape))
    elements.new_field("middle", ebb.vec3d, init=0.0)
    elements.new_field("kinds", ebb.int32, init=0)
    elements.new_field("around", ebb.float64, init=0.0)
    vertices.new_field("weight", ebb.float64, init=0.0)
    vertices.new_field("sides", ebb.int32, init=0)
    look(elements)
    for number, side in enumerate(("xneg", "xpos", "yneg", "ypos", "zneg", "zpos")):
        mark(getattr(vertices, side), 1 << number)
    fields = [*elements.fields.values(), *vertices.fields.values()]
    return {f.path: f.to_numpy().reshape(f.relation.size, -1) for f in fields if f.target is None}


def test_a_grid_has_what_a_mesh_has(backend):
    grid, mesh = observe(HexGrid.box(*SHAPE, **OPTIONS)), observe(HexMesh.box(*SHAPE, **OPTIONS))
    for path, values in grid.items():
        same = "elements.kinds" if path == "elements.sides" else path
        np.testing.assert_allclose(values, mesh[same], rtol=1e-14, err_msg=path)


def test_the_elements_of_a_vertex(backend):
    grid, mesh = HexGrid.box(*SHAPE, **OPTIONS), HexMesh.box(*SHAPE, **OPTIONS)
    for each in (grid, mesh):
        each.elements.new_field("mass", ebb.float64, init=(np.arange(24.0) ** 2 % 7).reshape(each.elements.shape))
        each.elements.new_field("low", ebb.vec3d, init=0.0)
        each.vertices.new_field("mass", ebb.float64, init=0.0)

    @ebb.kernel
    def gather_on_grid(v: grid.vertices):
        for i in (0, 1, 2, 3, 4, 5, 6, 7):
            if v.has_element(i):
                v.mass += v.element(i).mass

    @ebb.kernel
    def gather_on_mesh(v: mesh.vertices):
        for e in v.elements:
            v.mass += e.mass

    @ebb.kernel
    def find_low(e):
        e.low = e.v[0].pos + e.v[6].pos

    gather_on_grid(grid.vertices)
    gather_on_mesh(mesh.vertices)
    find_low(grid.elements)
    find_low(mesh.elements)
    assert grid.vertices.mass.to_numpy().ravel() == pytest.approx(mesh.vertices.mass.to_numpy())
    assert (grid.elements.low.to_numpy().reshape(-1, 3) == mesh.elements.low.to_numpy()).all()


def test_grids_and_bent_boxes():
    made = HexGrid.from_grid(Grid3D((2, 3, 4), origin=(1, 2, 3), extent=(2, 6, 8)))
    assert repr(made) == "<HexGrid: 2 x 3 x 4 elements>"
    assert made.vertices.pos.to_numpy()[-1, -1, -1].tolist() == [3, 8, 11]
    points = made.vertices.pos.to_numpy()
    points[1, 1, 1] += 5
    with pytest.raises(ebb.MeshFormatError, match="folded"):
        HexGrid.from_grid(points)
    with pytest.raises(ebb.MeshFormatError, match=r"points should be numbers of the shape \(nx \+ 1"):
        HexGrid.from_grid(points[:1])
    with pytest.raises(ValueError, match="symmetry should name sides"):
        HexGrid.box(1, 1, 1, symmetry=["top"])
    with pytest.raises(ebb.MeshFormatError, match="precision should be"):
        HexGrid.box(1, 1, 1, precision=ebb.int32)


def test_files(tmp_path):
    pytest.importorskip("meshio")
    meshes = HexGrid.box(*SHAPE, **OPTIONS), HexMesh.box(*SHAPE, **OPTIONS)
    for name, mesh in zip(("grid", "mesh"), meshes, strict=True):
        mesh.elements.new_field("e", ebb.vec2d, init=np.arange(48.0).reshape(*mesh.elements.shape, 2))
        mesh.vertices.new_field("far", ebb.bool_, init=np.arange(60).reshape(mesh.vertices.shape) > 30)
        mesh.save(tmp_path / f"{name}.vtu", fields=[mesh.elements.e, "far"])
    assert (tmp_path / "grid.vtu").read_bytes() == (tmp_path / "mesh.vtu").read_bytes()
    again = HexMesh.load(tmp_path / "grid.vtu")
    assert np.array_equal(again.elements.v.to_numpy(), meshes[1].elements.v.to_numpy())
