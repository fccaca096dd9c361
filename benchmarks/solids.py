"""Beams of tetrahedra by finite elements: the stiffness, the solver and the steps of ``examples/fem.py``.

A beam of 2n x n x n cubes, 2 m long, is fixed at one end; St. Venant-Kirchhoff's material, or the neo-Hookean one, in
doubles.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from benchmarks.data import SEED, Arrays

Elements: TypeAlias = tuple[np.ndarray, np.ndarray]
"""Of each tetrahedron the forces on its corners, and the blocks of its stiffness, over its volume."""

Law: TypeAlias = Callable[[np.ndarray, np.ndarray], Elements]
"""From the deformation gradients and the gradients of the shape functions."""

YOUNG, POISSON, DENSITY = 1e6, 0.3, 1000.0
LAMBDA = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
MU = YOUNG / (2 * (1 + POISSON))
GRAVITY = (0.0, -9.81, 0.0)
DAMPING = 1e-3
"""Of the stiffness, in seconds; there is none of the mass."""

SOLID_DT = 0.01
TOLERANCE = 1e-6
CG_ITERATIONS = 100
MOST_ITERATIONS = 10_000


@lru_cache(maxsize=2)
def beam(n: int) -> dict[str, np.ndarray]:
    """A beam at rest, and its displacements when it has been shaken."""
    import ebb
    from ebb.domains import TetMesh

    mesh = TetMesh.box(2 * n, n, n, (2.0, 1.0, 1.0), self_edges=True, precision=ebb.float64)
    points, corners = mesh.vertices.pos.to_numpy(), mesh.tetrahedra.v.to_numpy()
    sides = points[corners[:, 1:]] - points[corners[:, :1]]
    tail, size = mesh.edges.tail.to_numpy(), len(points)
    entries, volume = mesh.tetrahedra.e.to_numpy().astype(np.int32), np.linalg.det(sides) / 6
    mass = DENSITY * volume[:, None, None] * (1 + np.eye(4)) / 20
    shaken = np.random.default_rng(SEED).standard_normal(points.shape)
    return {
        "points": points,
        "corners": corners.astype(np.int32),
        "entries": entries.reshape(-1, 16),
        "first": np.searchsorted(tail, np.arange(size + 1)).astype(np.int32),
        "tail": tail.astype(np.int32),
        "head": mesh.edges.head.to_numpy().astype(np.int32),
        "diagonal": mesh.vertices.diag.to_numpy().astype(np.int32),
        "inverse": np.linalg.inv(sides).transpose(0, 2, 1),
        "volume": volume,
        "mass": np.bincount(entries.ravel(), mass.ravel(), len(tail)),
        "load": np.bincount(corners.ravel(), np.repeat(DENSITY * volume / 4, 4), size)[:, None] * np.array(GRAVITY),
        "free": (points[:, 0] > 0).astype(np.float64),
        "moved": 0.02 / n * shaken,
    }


def beam_at_rest(n: int) -> dict[str, np.ndarray]:
    return {**beam(n), "moved": np.zeros_like(beam(n)["moved"])}


def beam_system(n: int) -> dict[str, np.ndarray]:
    """The matrix of the first step of a beam that has been shaken, and any right-hand side."""
    arrays = beam(n)
    _, stiffness = assembled(arrays, arrays["moved"], stvk)
    matrix = step_matrix(arrays, stiffness)
    right = np.random.default_rng(SEED + 1).standard_normal(arrays["points"].shape)
    names = ("points", "corners", "first", "tail", "head", "diagonal")
    return {**{name: arrays[name] for name in names}, "matrix": matrix, "b": right}


def step_matrix(arrays: Arrays, stiffness: np.ndarray) -> np.ndarray:
    h = SOLID_DT
    return (h * DAMPING + h * h) * stiffness + arrays["mass"][:, None, None] * np.eye(3)


# ---- What must come out ----


def assembled(arrays: Arrays, moved: np.ndarray, law: Law) -> tuple[np.ndarray, np.ndarray]:
    """Internal forces, a row a vertex, and the stiffness, a block an edge."""
    corners, inverse = arrays["corners"], arrays["inverse"]
    gradients = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    f = np.eye(3) + np.einsum("tia,tib->tab", moved[corners], gradients)
    forces, blocks = law(f, gradients)
    forces *= arrays["volume"][:, None, None]
    blocks *= arrays["volume"][:, None, None, None, None]
    return (
        summed(corners.ravel(), forces.reshape(-1, 3), len(moved)),
        summed(arrays["entries"].ravel(), blocks.reshape(-1, 9), len(arrays["head"])).reshape(-1, 3, 3),
    )


def stvk(f: np.ndarray, gradients: np.ndarray) -> Elements:
    """P = F S, S = lambda tr(E) I + 2 mu E, E = (F^T F - I) / 2."""
    strain = (np.einsum("tka,tkb->tab", f, f) - np.eye(3)) / 2
    stress = LAMBDA * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 2 * MU * strain
    pushed, pulled = np.einsum("tab,tib->tia", f, gradients), np.einsum("tab,tib->tia", stress, gradients)
    forces = np.einsum("tab,tib->tia", f, pulled)
    blocks = np.einsum("tia,tja->tij", gradients, pulled)[..., None, None] * np.eye(3)
    blocks += LAMBDA * np.einsum("tia,tjb->tijab", pushed, pushed)
    blocks += MU * np.einsum("tja,tib->tijab", pushed, pushed)
    blocks += MU * np.einsum("tia,tja,tbc,tdc->tijbd", gradients, gradients, f, f, optimize=True)
    return forces, blocks


def neohookean(f: np.ndarray, gradients: np.ndarray) -> Elements:
    """P = mu (F - F^-T) + lambda ln J F^-T."""
    inverse = np.linalg.inv(f).transpose(0, 2, 1)
    pressure = LAMBDA * np.log(np.linalg.det(f)) - MU
    pushed = np.einsum("tab,tib->tia", inverse, gradients)
    forces = MU * np.einsum("tab,tib->tia", f, gradients) + pressure[:, None, None] * pushed
    blocks = MU * np.einsum("tia,tja->tij", gradients, gradients)[..., None, None] * np.eye(3)
    blocks += LAMBDA * np.einsum("tia,tjb->tijab", pushed, pushed)
    blocks -= np.einsum("t,tja,tib->tijab", pressure, pushed, pushed)
    return forces, blocks


def summed(rows: np.ndarray, values: np.ndarray, size: int) -> np.ndarray:
    return np.stack([np.bincount(rows, column, size) for column in values.T], axis=1)


def multiply(arrays: Arrays, matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    products = np.einsum("eab,eb->ea", matrix, x[arrays["head"]])
    return np.add.reduceat(products, arrays["first"][:-1])


def solve(
    arrays: Arrays, matrix: np.ndarray, b: np.ndarray, free: np.ndarray, tolerance: float, most: int
) -> np.ndarray:
    """By conjugate gradients, preconditioned by the diagonal, in the rows that are free."""
    preconditioner = free[:, None] / np.einsum("eaa->ea", matrix[arrays["diagonal"]])
    x, r = np.zeros_like(b), b * free[:, None]
    p = preconditioner * r
    rz, enough = (r * p).sum(), tolerance * np.linalg.norm(r)
    for _ in range(most):
        product = multiply(arrays, matrix, p) * free[:, None]
        alpha = rz / (p * product).sum()
        x, r = x + alpha * p, r - alpha * product
        if np.linalg.norm(r) <= enough:
            break
        z = preconditioner * r
        rz, before = (r * z).sum(), rz
        p = z + rz / before * p
    return x


def assembly_steps(arrays: Arrays, steps: int, law: Law = stvk) -> Arrays:
    force, stiffness = assembled(arrays, arrays["moved"], law)
    return {"force": force, "stiffness": stiffness}


def solver_steps(arrays: Arrays, steps: int) -> Arrays:
    return {"x": solve(arrays, arrays["matrix"], arrays["b"], np.ones(len(arrays["b"])), 0.0, CG_ITERATIONS)}


def solid_steps(arrays: Arrays, steps: int, law: Law = stvk) -> Arrays:
    moved, velocity, h = arrays["moved"], np.zeros_like(arrays["moved"]), SOLID_DT
    for _ in range(steps):
        force, stiffness = assembled(arrays, moved, law)
        right = h * (arrays["load"] - force - multiply(arrays, stiffness, velocity) * (h + DAMPING))
        matrix = step_matrix(arrays, stiffness)
        velocity = velocity + solve(arrays, matrix, right, arrays["free"], TOLERANCE / 100, MOST_ITERATIONS)
        moved = moved + h * velocity
    return {"moved": moved, "velocity": velocity}
