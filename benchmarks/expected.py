"""What the programs must compute: the same in NumPy and float64, written for clearness alone."""

from __future__ import annotations

import numpy as np

from benchmarks.constants import AXPY_FACTOR, DT, PARTICLE_DT, PCG_ITERATIONS, STENCIL_CENTER, STENCIL_SIDE, STIFFNESS
from benchmarks.data import Arrays


def spring_steps(arrays: Arrays, steps: int) -> Arrays:
    q, qd, mass, rest = (arrays[name].astype(np.float64) for name in ("q", "qd", "mass", "rest_len"))
    tail, head, directed = arrays["tail"], arrays["head"], "first" in arrays
    for _ in range(steps):
        dq = q[head] - q[tail]
        pull = STIFFNESS * ((rest / np.linalg.norm(dq, axis=1))[:, None] * dq - dq)
        force = sum_by_row(tail, pull, len(q))
        if not directed:
            force -= sum_by_row(head, pull, len(q))
        qdd = force / mass[:, None]
        q, qd = q + qd * DT + 0.5 * qdd * DT**2, qd + qdd * DT
    return {"q": q, "qd": qd}


def sum_by_row(row: np.ndarray, values: np.ndarray, size: int) -> np.ndarray:
    return np.stack([np.bincount(row, column, size) for column in values.T], axis=1)


def axpy_steps(arrays: Arrays, steps: int) -> Arrays:
    return {"y": arrays["y"] + steps * AXPY_FACTOR * arrays["x"].astype(np.float64)}


def stencil_steps(arrays: Arrays, steps: int) -> Arrays:
    old, inner = arrays["old"].astype(np.float64), np.s_[1:-1]
    for _ in range(steps):
        new = old.copy()
        sides = old[:-2, inner, inner] + old[2:, inner, inner] + old[inner, :-2, inner] + old[inner, 2:, inner]
        sides += old[inner, inner, :-2] + old[inner, inner, 2:]
        new[inner, inner, inner] = STENCIL_CENTER * old[inner, inner, inner] + STENCIL_SIDE * sides
        old = new
    return {"old": old}


def heat_steps(arrays: Arrays, steps: int) -> Arrays:
    old, weight, rate = (arrays[name].astype(np.float64) for name in ("old", "weight", "rate"))
    tail, head = arrays["tail"], arrays["head"]
    for _ in range(steps):
        old = old + rate * np.bincount(tail, weight * (old[head] - old[tail]), len(old))
    return {"old": old}


def particle_steps(arrays: Arrays, steps: int) -> Arrays:
    pos, vel = (arrays[name].astype(np.float64) for name in ("pos", "vel"))
    n = len(vel)
    for _ in range(steps):
        at = pos * n - 0.5
        first = np.floor(at).astype(int)
        (x, y), (i, j) = (at - first).T[:, :, None], first.T % n
        ahead, above = (i + 1) % n, (j + 1) % n
        low = (1 - x) * vel[i, j] + x * vel[ahead, j]
        high = (1 - x) * vel[i, above] + x * vel[ahead, above]
        pos = (pos + PARTICLE_DT * ((1 - y) * low + y * high)) % 1
    return {"pos": pos}


def pcg_steps(arrays: Arrays, steps: int) -> Arrays:
    """A step solves from the start, so their number does not matter."""
    weight, diagonal, b = (arrays[name].astype(np.float64) for name in ("weight", "diagonal", "b"))
    x, r = np.zeros_like(b), b
    p = z = r / diagonal
    rz = r @ z
    for _ in range(PCG_ITERATIONS):
        product = diagonal * p - np.bincount(arrays["tail"], weight * p[arrays["head"]], len(p))
        alpha = rz / (p @ product)
        x, r = x + alpha * p, r - alpha * product
        z = r / diagonal
        rz, before = r @ z, rz
        p = z + rz / before * p
    return {"x": x}
