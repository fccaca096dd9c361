"""The inputs: NumPy arrays, made once by the driver and given to all systems alike."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from benchmarks.constants import PARTICLE_CELLS

Arrays = Mapping[str, np.ndarray]

SEED = 1
ALIGNMENT = 64


def save(arrays: Arrays, path: Path) -> None:
    np.savez(path, **arrays)


def load(path: Path) -> dict[str, np.ndarray]:
    """The arrays, aligned to cache lines as a good C++ program would have them."""
    with np.load(path) as stored:
        return {name: aligned(stored[name]) for name in stored.files}


def aligned(array: np.ndarray) -> np.ndarray:
    memory = np.empty(array.nbytes + ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT
    copy = memory[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


# --- meshes ---------------------------------------------------------------------------------------------------------


def directed_edges(tail: np.ndarray, head: np.ndarray, size: int) -> dict[str, np.ndarray]:
    """Edges sorted by tail, then head, and where those of each vertex start: what a CSR loop needs."""
    order = np.lexsort((head, tail))
    tail, head = tail[order], head[order]
    first = np.searchsorted(tail, np.arange(size + 1))
    return {"first": first.astype(np.int32), "tail": tail.astype(np.int32), "head": head.astype(np.int32)}


@lru_cache(maxsize=2)
def box(n: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Points, corners and edges of a box of n^3 cubes of six tetrahedra each (Kuhn's)."""
    from ebb.domains import TetMesh

    mesh = TetMesh.box(n, n, n)
    edges = directed_edges(mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy(), mesh.vertices.size)
    return mesh.vertices.pos.to_numpy().astype(np.float64), mesh.tetrahedra.v.to_numpy(), edges


def springs(n: int) -> dict[str, np.ndarray]:
    """A box of springs, stretched and shaken; each spring is an edge in both directions."""
    points, _, edges = box(n)
    rng = np.random.default_rng(SEED)
    rest = np.linalg.norm(points[edges["head"]] - points[edges["tail"]], axis=1)
    return {
        **edges,
        "rest_len": rest.astype(np.float32),
        "q": (points * 1.1 + 0.5 / n * rng.standard_normal(points.shape)).astype(np.float32),
        "qd": np.zeros(points.shape, np.float32),
        "mass": rng.uniform(0.5, 2.0, len(points)).astype(np.float32),
    }


def shuffled(arrays: Arrays) -> dict[str, np.ndarray]:
    """The same springs with the vertices in a random order; edges are sorted by their new tails."""
    size = len(arrays["q"])
    place = np.random.default_rng(SEED + 1).permutation(size)  # of each vertex, its new number
    old = np.argsort(place)
    tail, head = place[arrays["tail"]], place[arrays["head"]]
    return {
        **directed_edges(tail, head, size),
        "rest_len": arrays["rest_len"][np.lexsort((head, tail))],
        **{name: arrays[name][old] for name in ("q", "qd", "mass")},
    }


def undirected(arrays: Arrays) -> dict[str, np.ndarray]:
    """The same springs, each once."""
    once = arrays["tail"] < arrays["head"]
    kept = {name: arrays[name][once] for name in ("tail", "head", "rest_len")}
    return {**{name: arrays[name] for name in ("q", "qd", "mass")}, **kept}


def rows(n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(SEED)
    return {"x": rng.random(n, np.float32), "y": rng.random(n, np.float32)}


def grid(n: int) -> dict[str, np.ndarray]:
    old = np.random.default_rng(SEED).random((n, n, n), np.float32)
    return {"old": old, "new": old}


def particles(n: int) -> dict[str, np.ndarray]:
    """Points by chance in the unit square, and steady vortices at the centres of cells, from one to the next of which
    no point goes, so that none wraps around by an error of rounding."""
    at = 2 * np.pi * (np.arange(PARTICLE_CELLS) + 0.5) / PARTICLE_CELLS
    x, y = np.meshgrid(at, at, indexing="ij")
    vel = np.stack([np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)], axis=-1)
    pos = np.random.default_rng(SEED).uniform(0.001, 0.999, (n, 2))
    return {"pos": pos.astype(np.float32), "vel": vel.astype(np.float32)}


def surface(n: int) -> dict[str, np.ndarray]:
    """Heat on a torus of 2 n by n vertices: cotangent weights, and time step by area for each vertex."""
    from ebb.domains import TriMesh

    mesh = TriMesh.torus(1.0, 0.4, 2 * n, n)
    points, corners = mesh.vertices.pos.to_numpy().astype(np.float64), mesh.triangles.v.to_numpy()
    size = len(points)
    edges = directed_edges(mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy(), size)
    weight, area = np.zeros(len(edges["head"])), np.zeros(size)
    for i in range(3):
        a, b, c = (corners[:, (i + k) % 3] for k in range(3))
        twice = np.linalg.norm(np.cross(points[b] - points[a], points[c] - points[a]), axis=1)
        cotangent = np.einsum("ij,ij->i", points[a] - points[c], points[b] - points[c]) / twice
        area += np.bincount(a, twice / 6, size)
        add_to_edges(weight, edges, size, a, b, np.maximum(cotangent, 0) / 2)
    fastest = (np.bincount(edges["tail"], weight, size) / area).max()
    return {
        **edges,
        "weight": weight.astype(np.float32),
        "rate": (0.9 / fastest / area).astype(np.float32),
        "old": np.random.default_rng(SEED).random(size, np.float32),
        "new": np.zeros(size, np.float32),
    }


def laplacian(n: int) -> dict[str, np.ndarray]:
    """Linear finite elements on a box with shaken points: ``diagonal * x - sum(weight * x[head]) = b``."""
    points, corners, edges = box(n)
    rng = np.random.default_rng(SEED)
    points, size = points + rng.uniform(-0.1 / n, 0.1 / n, points.shape), len(points)
    sides = points[corners[:, 1:]] - points[corners[:, :1]]
    volume = np.linalg.det(sides) / 6
    gradients = np.linalg.inv(sides).transpose(0, 2, 1)
    gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)
    stiffness = np.einsum("t,tix,tjx->tij", volume, gradients, gradients)
    weight = np.zeros(len(edges["head"]))
    for i in range(4):
        for j in range(i):
            add_to_edges(weight, edges, size, corners[:, i], corners[:, j], -stiffness[:, i, j])
    mass = np.bincount(corners.ravel(), np.repeat(volume / 4, 4), size)
    diagonal = np.bincount(edges["tail"], weight, size) + 10 * mass
    return {
        **edges,
        "weight": weight.astype(np.float32),
        "diagonal": diagonal.astype(np.float32),
        "b": rng.standard_normal(size).astype(np.float32),
    }


def add_to_edges(
    weight: np.ndarray, edges: Arrays, size: int, a: np.ndarray, b: np.ndarray, of_pair: np.ndarray
) -> None:
    """Adds ``of_pair`` to the weights of the edges from ``a`` to ``b`` and back."""
    keys = edges["tail"].astype(np.int64) * size + edges["head"]
    for start, end in ((a, b), (b, a)):
        weight += np.bincount(np.searchsorted(keys, start.astype(np.int64) * size + end), of_pair, len(keys))
