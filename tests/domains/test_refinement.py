"""Red refinement: volumes, orientation, conformity, shapes, and what is kept."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import TetMesh

SHAPES = {
    "cube": lambda **options: TetMesh.box(1, 1, 1, **options),
    "flat box": lambda **options: TetMesh.box(2, 1, 3, size=(5, 0.1, 1), **options),
    "ball": lambda **options: TetMesh.ball(2, **options),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_each_tetrahedron_falls_into_eight_of_its_orientation(shape):
    coarse = SHAPES[shape]()
    fine = coarse.refine()
    assert fine.tetrahedra.size == 8 * coarse.tetrahedra.size
    assert fine.triangles.size == 4 * coarse.triangles.size
    assert fine.vertices.size == coarse.vertices.size + coarse.edges.size // 2
    volumes = fine.tetrahedra.volume.to_numpy().reshape(-1, 8)
    np.testing.assert_allclose(volumes, np.repeat(coarse.tetrahedra.volume.to_numpy()[:, None] / 8, 8, axis=1))
    # That at most two meet at a face and that volumes are positive is checked when a mesh is made; that it conforms:
    faces = (4 * fine.tetrahedra.size + fine.triangles.size) // 2
    assert fine.vertices.size - fine.edges.size // 2 + faces - fine.tetrahedra.size == 1


def test_vertices_keep_their_numbers_and_middles_follow():
    coarse = TetMesh.ball(2)
    fine = coarse.refine()
    n = coarse.vertices.size
    np.testing.assert_array_equal(fine.vertices.pos.to_numpy()[:n], coarse.vertices.pos.to_numpy())
    tail, head = coarse.edges.tail.to_numpy(), coarse.edges.head.to_numpy()
    ends = np.stack([tail, head])[:, tail < head]
    middles = coarse.vertices.pos.to_numpy()[ends].mean(axis=0)
    found = fine.vertices.pos.to_numpy()[n:]
    assert len(found) == len(middles)
    assert np.linalg.norm(found[:, None] - middles[None], axis=2).min(axis=0).max() < 1e-6


def test_the_shortest_diagonal_is_taken():
    """So that shapes do not get worse and worse: a long one would halve the angles at each step."""

    def shape(mesh):
        corners = mesh.vertices.pos.to_numpy().astype(float)[mesh.tetrahedra.v.to_numpy()]
        sides = corners[:, [1, 2, 3, 2, 3, 3]] - corners[:, [0, 0, 0, 1, 1, 2]]
        return (mesh.tetrahedra.volume.to_numpy() / np.linalg.norm(sides, axis=2).max(axis=1) ** 3).min()

    mesh = TetMesh.from_arrays(
        [(0, 0, 0), (1, 0.1, 0), (0.2, 1, 0), (0.1, 0.3, 0.7)], [(0, 1, 2, 3)], precision=ebb.float64
    )
    worst = [shape(mesh)]
    for _ in range(4):
        mesh = mesh.refine()
        worst.append(shape(mesh))
    assert worst[-1] > 0.9 * worst[1]


def test_options_and_regions_are_kept(tmp_path):
    path = tmp_path / "two.veg"
    path.write_text(
        "*VERTICES\n5 3 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 1\n"
        "*ELEMENTS\nTET\n2 4 0\n1 1 2 3 4\n2 5 3 2 4\n"
        "*MATERIAL soft\nENU, 1000, 1e5, 0.45\n*MATERIAL hard\nENU, 1000, 1e7, 0.3\n"
        "*SET one\n1\n*SET two\n2\n*REGION\none, soft\n*REGION\ntwo, hard\n"
    )
    fine = TetMesh.load(path, self_edges=True, precision=ebb.float64).refine()
    assert fine.vertices.pos.type == ebb.vec3d
    assert "diag" in fine.vertices.fields
    assert [material.name for material in fine.materials] == ["soft", "hard"]
    assert [region.rows.tolist() for region in fine.regions] == [list(range(8)), list(range(8, 16))]


def test_a_mesh_of_nothing():
    empty = TetMesh.from_arrays([], []).refine()
    assert (empty.vertices.size, empty.tetrahedra.size) == (0, 0)
