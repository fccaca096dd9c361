"""Surfaces filled so that their triangles are the boundary."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.domains import TetMesh, TriMesh

pytest.importorskip("tetgen")


def test_the_surface_is_the_boundary():
    surface = TriMesh.icosphere(2)
    mesh = TetMesh.from_surface(surface, method="conforming", resolution=8, self_edges=True, precision=ebb.float64)
    points, triangles = surface.vertices.pos.to_numpy().astype(float), surface.triangles.v.to_numpy()
    a, b, c = (points[triangles[:, i]] for i in range(3))
    assert mesh.tetrahedra.volume.to_numpy().sum() == pytest.approx(np.einsum("ij,ij", np.cross(a, b), c) / 6)
    # Each point of the surface is a vertex of the boundary, and each vertex of the boundary lies on the surface.
    boundary = mesh.vertices.pos.to_numpy()[np.unique(mesh.triangles.v.to_numpy())]
    nearest = np.linalg.norm(points[:, None] - boundary[None], axis=2).min(axis=1)
    assert nearest.max() < 1e-12
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(np.einsum("nfi,fi->nf", boundary[:, None] - a, normal)).min(axis=1).max() < 1e-6


def test_the_resolution_says_how_large_tetrahedra_are():
    for resolution in (2, 6):
        mesh = TetMesh.from_surface(TriMesh.box(1, 1, 1), method="conforming", resolution=resolution)
        assert mesh.tetrahedra.volume.to_numpy().max() <= 1.3 * 2**0.5 / 12 / resolution**3
        assert mesh.tetrahedra.volume.to_numpy().sum() == pytest.approx(1)


def test_wrong_arguments():
    with pytest.raises(ValueError, match="'lattice' or 'conforming'"):
        TetMesh.from_surface(TriMesh.box(1, 1, 1), method="delaunay")
    with pytest.raises(ValueError, match="resolution"):
        TetMesh.from_surface(TriMesh.box(1, 1, 1), method="conforming", resolution=0)
    with pytest.raises(ebb.MeshFormatError, match="E711"):
        TetMesh.from_surface(TriMesh.grid(2, 2), method="conforming")
