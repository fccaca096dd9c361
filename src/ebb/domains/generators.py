"""Points and cells of simple shapes, as arrays. The domains offer them as ``TriMesh.icosphere`` and so on."""

from __future__ import annotations

import operator
from itertools import permutations
from typing import Any

import numpy as np

from ebb.domains.io.data import Floats, Integers
from ebb.domains.topology import undirected_edges

# The six tetrahedra of a cube, as corners numbered x + 2 y + 4 z: each walks from corner 0 to corner 7 along the axes
# in one order, and has a positive volume. All cubes of a lattice split alike conform (Kuhn 1960; Freudenthal 1942).
KUHN = np.array(
    [
        (0, a, a + b, 7) if (a, b) in ((1, 2), (2, 4), (4, 1)) else (0, a + b, a, 7)
        for a, b, _ in permutations((1, 2, 4))
    ]
)


def icosahedron() -> tuple[Floats, Integers]:
    """The 12 points, at distance 1 from the origin, and the 20 triangles, outward."""
    phi = (1 + 5**0.5) / 2
    points = [(-1, phi, 0), (1, phi, 0), (-1, -phi, 0), (1, -phi, 0)]
    points = [row for p in points for row in (p, (p[2], p[0], p[1]), (p[1], p[2], p[0]))]
    array = np.array(points) / np.hypot(1, phi)
    # The triangles are the triples of points at the distance of an edge.
    near = np.isclose(np.linalg.norm(array[:, None] - array[None], axis=2), 2 / np.hypot(1, phi))
    triples = [
        (i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] and near[j, k] and near[k, i]
    ]
    triangles = np.array(triples, dtype=np.int64)
    a, b, c = (array[triangles[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return array, triangles


def icosphere(subdivisions: int, radius: float) -> tuple[Floats, Integers]:
    """A sphere about the origin: the icosahedron with each triangle split in four, ``subdivisions`` times."""
    subdivisions = require_count("subdivisions", subdivisions, 0)
    points, triangles = icosahedron()
    for _ in range(subdivisions):
        edges = undirected_edges(triangles, len(points))
        middle = points[edges.low] + points[edges.high]
        ab, ac, bc = (edges.of_pair + len(points)).T
        a, b, c = triangles.T
        points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        split = [(a, ab, ac), (ab, b, bc), (ac, bc, c), (ab, bc, ac)]
        triangles = np.concatenate([np.stack(corners, axis=1) for corners in split])
    return points * radius, triangles


def torus(major: float, minor: float, n_major: int, n_minor: int) -> tuple[Floats, Integers]:
    """A torus about the z axis: a tube of the radius ``minor`` along a circle of the radius ``major``."""
    n_major = require_count("n_major", n_major, 3)
    n_minor = require_count("n_minor", n_minor, 3)
    i, j = np.divmod(np.arange(n_major * n_minor), n_minor)
    u, v = 2 * np.pi * i / n_major, 2 * np.pi * j / n_minor
    r = major + minor * np.cos(v)
    points = np.stack([r * np.cos(u), r * np.sin(u), minor * np.sin(v)], axis=1)
    next_i, next_j = (i + 1) % n_major * n_minor, (j + 1) % n_minor
    quad = (i * n_minor + j, next_i + j, next_i + next_j, i * n_minor + next_j)
    return points, _split_quads(*quad)


def grid(nx: int, ny: int, size: tuple[float, float]) -> tuple[Floats, Integers]:
    """A rectangle in the plane z = 0 with a corner at the origin, in nx x ny squares of two triangles each."""
    nx = require_count("nx", nx, 1)
    ny = require_count("ny", ny, 1)
    x, y = np.meshgrid(np.linspace(0, size[0], nx + 1), np.linspace(0, size[1], ny + 1), indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    i, j = np.divmod(np.arange(nx * ny), ny)
    corner = i * (ny + 1) + j
    return points, _split_quads(corner, corner + ny + 1, corner + ny + 2, corner + 1)


def box(shape: tuple[int, int, int], size: tuple[float, float, float]) -> tuple[Floats, Integers]:
    """A box with a corner at the origin, in ``shape`` cubes of six tetrahedra each."""
    nx, ny, nz = (require_count(name, n, 1) for name, n in zip(("nx", "ny", "nz"), shape, strict=True))
    shape = (nx, ny, nz)
    axes = [np.linspace(0, extent, n + 1) for extent, n in zip(size, shape, strict=True)]
    points = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    cubes = np.stack([axis.ravel() for axis in np.meshgrid(*map(np.arange, shape), indexing="ij")], axis=1)
    return points, split_cubes(cubes, shape)


def split_cubes(cubes: Integers, shape: tuple[int, int, int]) -> Integers:
    """The tetrahedra of cubes, given by their indices (n, 3), of a lattice of ``shape`` cubes.

    The points of the lattice are numbered with the last axis fastest; six tetrahedra a cube, in the cubes' order.
    """
    strides = np.array([(shape[1] + 1) * (shape[2] + 1), shape[2] + 1, 1])
    corner = np.arange(8)
    offsets = np.stack([corner & 1, corner >> 1 & 1, corner >> 2 & 1], axis=1) @ strides
    return ((cubes @ strides)[:, None, None] + offsets[KUHN]).reshape(-1, 4)


def ball(resolution: int, radius: float) -> tuple[Floats, Integers]:
    """A ball about the origin: the 20 tetrahedra from the centre to an icosahedron, each split in resolution cubed.

    The points lie on ``resolution`` concentric spheres, so that no element is much flatter than the others.
    """
    n = require_count("resolution", resolution, 1)
    corners, triangles = icosahedron()
    # Walks 0 <= z <= y <= x <= n of a Kuhn lattice fill a simplex; the weights of its four corners follow.
    cubes = np.stack([axis.ravel() for axis in np.indices((n, n, n))], axis=1)
    lattice = np.stack([axis.ravel() for axis in np.indices((n + 1, n + 1, n + 1))], axis=1)
    split = split_cubes(cubes, (n, n, n))
    x, y, z = lattice.T
    inside = (x >= y) & (y >= z)
    split = split[inside[split].all(axis=1)]
    weights = np.stack([n - x, x - y, y - z, z], axis=1)
    # Sorting a triangle's corners gives a shared side the same split in both of its tetrahedra.
    rows = np.zeros((len(triangles), len(lattice), 12), dtype=np.int64)
    for triangle, order in enumerate(np.sort(triangles, axis=1)):
        rows[triangle][:, order] = weights[:, 1:]
    shifts = np.arange(len(triangles))[:, None, None] * len(lattice)
    cells = (split[None] + shifts).reshape(-1, 4)
    used, inverse = np.unique(rows.reshape(-1, 12), axis=0, return_inverse=True)
    return _round_ball(used, inverse.reshape(-1)[cells], corners, n, radius)


def _round_ball(weights: Integers, cells: Integers, corners: Floats, n: int, radius: float) -> tuple[Floats, Integers]:
    flat = weights @ corners
    layer = weights.sum(axis=1, keepdims=True) * (radius / n)
    points = flat * (layer / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), np.finfo(float).tiny))
    used = np.zeros(len(points), dtype=bool)
    used[cells] = True
    number = np.cumsum(used) - 1
    points, cells = points[used], number[cells]
    a, b, c, d = (points[cells[:, i]] for i in range(4))
    inverted = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    cells[inverted, 2:] = cells[inverted, :1:-1]
    return points, cells


def _split_quads(a: Integers, b: Integers, c: Integers, d: Integers) -> Integers:
    return np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)


def require_count(name: str, value: Any, least: int) -> int:
    """``value`` as Python's integer.

    Raises:
        ValueError: it is no integer, or less than ``least``.
    """
    try:
        count = operator.index(value)
    except TypeError:
        count = least - 1
    if count < least or isinstance(value, bool):
        raise ValueError(f"{name} should be an integer >= {least}, not {value!r}")
    return count
