"""Numba: compiled loops over NumPy arrays, parallel where several threads are asked for.

Numba has no atomics on the CPU, so the loops that scatter run on one thread.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable

import numba
import numpy as np
from numba import njit, prange

from benchmarks.constants import AXPY_FACTOR, DT, PCG_ITERATIONS, STENCIL_CENTER, STENCIL_SIDE, STIFFNESS
from benchmarks.data import Arrays, aligned
from benchmarks.stencils import JACOBI, WEIGHTS
from benchmarks.systems import Prepared, Programs

OPTIONS = {"fastmath": True, "error_model": "numpy", "cache": True}
serial = njit(**OPTIONS)
jit = njit(parallel=int(os.environ["NUMBA_NUM_THREADS"]) > 1, **OPTIONS)
HALF, ZERO = np.float32(0.5), np.float32(0)


def version() -> str:
    return numba.__version__


@serial
def pull(q, tail, head, rest_len, stiffness):
    dx, dy, dz = q[head, 0] - q[tail, 0], q[head, 1] - q[tail, 1], q[head, 2] - q[tail, 2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    scale = rest_len / length if length > ZERO else ZERO
    return stiffness * (scale * dx - dx), stiffness * (scale * dy - dy), stiffness * (scale * dz - dz)


@jit
def gather(first, head, rest_len, q, force, stiffness):
    for v in prange(len(q)):
        fx, fy, fz = force[v, 0], force[v, 1], force[v, 2]
        for e in range(first[v], first[v + 1]):
            x, y, z = pull(q, v, head[e], rest_len[e], stiffness)
            fx += x
            fy += y
            fz += z
        force[v, 0], force[v, 1], force[v, 2] = fx, fy, fz


@serial
def scatter(tail, head, rest_len, q, force, stiffness):
    for e in range(len(tail)):
        t = tail[e]
        x, y, z = pull(q, t, head[e], rest_len[e], stiffness)
        force[t, 0] += x
        force[t, 1] += y
        force[t, 2] += z


@serial
def scatter_to_both(tail, head, rest_len, q, force, stiffness):
    for e in range(len(tail)):
        t, h = tail[e], head[e]
        x, y, z = pull(q, t, h, rest_len[e], stiffness)
        force[t, 0] += x
        force[t, 1] += y
        force[t, 2] += z
        force[h, 0] -= x
        force[h, 1] -= y
        force[h, 2] -= z


@jit
def move(q, qd, force, mass, dt):
    for v in prange(len(q)):
        for i in range(3):
            qdd = force[v, i] / mass[v]
            q[v, i] += qd[v, i] * dt + HALF * qdd * dt * dt
            qd[v, i] += qdd * dt
            force[v, i] = ZERO


def springs(arrays: Arrays, forces: Callable[..., None], *index: str) -> Prepared:
    q, qd, mass, rest_len = (arrays[name] for name in ("q", "qd", "mass", "rest_len"))
    given = [arrays[name] for name in index]
    force = aligned(np.zeros_like(q))
    stiffness, dt = np.float32(STIFFNESS), np.float32(DT)

    def run(steps: int) -> None:
        for _ in range(steps):
            forces(*given, rest_len, q, force, stiffness)
            move(q, qd, force, mass, dt)

    return Prepared(run, lambda: {"q": q, "qd": qd})


@jit
def axpy(a, x, y):
    for i in prange(len(x)):
        y[i] = a * x[i] + y[i]


def streaming(arrays: Arrays) -> Prepared:
    a, x, y = np.float32(AXPY_FACTOR), arrays["x"], arrays["y"]

    def run(steps: int) -> None:
        for _ in range(steps):
            axpy(a, x, y)

    return Prepared(run, lambda: {"y": y})


@jit
def relax(old, new, center, side):
    for i in prange(1, old.shape[0] - 1):
        for j in range(1, old.shape[1] - 1):
            for k in range(1, old.shape[2] - 1):
                sides = old[i - 1, j, k] + old[i + 1, j, k] + old[i, j - 1, k] + old[i, j + 1, k]
                new[i, j, k] = center * old[i, j, k] + side * (sides + old[i, j, k - 1] + old[i, j, k + 1])


@jit
def relax27(old, new, w0, w1, w2, w3):
    for i in prange(1, old.shape[0] - 1):
        for j in range(1, old.shape[1] - 1):
            for k in range(1, old.shape[2] - 1):
                middle = weighted(old, i, j, k, w0, w1, w2)
                new[i, j, k] = middle + weighted(old, i, j, k - 1, w1, w2, w3) + weighted(old, i, j, k + 1, w1, w2, w3)


@serial
def faces(old, i, j, k):
    return old[i - 1, j, k] + old[i + 1, j, k] + old[i, j - 1, k] + old[i, j + 1, k]


@serial
def corners(old, i, j, k):
    return old[i - 1, j - 1, k] + old[i - 1, j + 1, k] + old[i + 1, j - 1, k] + old[i + 1, j + 1, k]


@serial
def weighted(old, i, j, k, own, face, edge):
    return own * old[i, j, k] + face * faces(old, i, j, k) + edge * corners(old, i, j, k)


@jit
def relax_around(old, new, center, side):
    n = old.shape[0]
    for i in prange(n):
        for j in range(n):
            below, above = old[(i - 1) % n, j], old[(i + 1) % n, j]
            left, right, own = old[i, (j - 1) % n], old[i, (j + 1) % n], old[i, j]
            for k in range(n):
                before, after = own[k - 1 if k > 0 else n - 1], own[k + 1 if k < n - 1 else 0]
                new[i, j, k] = center * own[k] + side * (below[k] + above[k] + left[k] + right[k] + before + after)


@jit
def relax_plane(old, new, side):
    for i in prange(1, old.shape[0] - 1):
        for j in range(1, old.shape[1] - 1):
            new[i, j] = side * (old[i - 1, j] + old[i + 1, j] + old[i, j - 1] + old[i, j + 1])


def stencil(arrays: Arrays, kernel: Callable[..., None], *numbers: float) -> Prepared:
    state = [arrays["old"], arrays["new"]]
    given = [np.float32(number) for number in numbers]

    def run(steps: int) -> None:
        for _ in range(steps):
            kernel(*state, *given)
            state.reverse()

    return Prepared(run, lambda: {"old": state[0]})


@jit
def diffuse(first, head, weight, rate, old, new):
    for v in prange(len(old)):
        flow = ZERO
        for e in range(first[v], first[v + 1]):
            flow += weight[e] * (old[head[e]] - old[v])
        new[v] = old[v] + rate[v] * flow


def heat(arrays: Arrays) -> Prepared:
    state = [arrays["old"], arrays["new"]]
    given = [arrays[name] for name in ("first", "head", "weight", "rate")]

    def run(steps: int) -> None:
        for _ in range(steps):
            diffuse(*given, *state)
            state.reverse()

    return Prepared(run, lambda: {"old": state[0]})


@jit
def start(diagonal, b, x, r, p):
    rz = 0.0
    for v in prange(len(b)):
        x[v] = ZERO
        r[v] = b[v]
        p[v] = b[v] / diagonal[v]
        rz += r[v] * p[v]
    return rz


@jit
def multiply(first, head, weight, diagonal, p, product):
    along = 0.0
    for v in prange(len(p)):
        total = diagonal[v] * p[v]
        for e in range(first[v], first[v + 1]):
            total -= weight[e] * p[head[e]]
        product[v] = total
        along += p[v] * total
    return along


@jit
def update(alpha, diagonal, p, product, x, r):
    rz = 0.0
    for v in prange(len(p)):
        x[v] += alpha * p[v]
        r[v] -= alpha * product[v]
        rz += r[v] * r[v] / diagonal[v]
    return rz


@jit
def turn(beta, diagonal, r, p):
    for v in prange(len(p)):
        p[v] = r[v] / diagonal[v] + beta * p[v]


def pcg(arrays: Arrays) -> Prepared:
    first, head, weight, diagonal, b = (arrays[name] for name in ("first", "head", "weight", "diagonal", "b"))
    x, r, p, product = (aligned(np.zeros_like(b)) for _ in range(4))

    def run(steps: int) -> None:
        for _ in range(steps):
            rz = start(diagonal, b, x, r, p)
            for _ in range(PCG_ITERATIONS):
                alpha = rz / multiply(first, head, weight, diagonal, p, product)
                rz, before = update(np.float32(alpha), diagonal, p, product, x, r), rz
                turn(np.float32(rz / before), diagonal, r, p)

    return Prepared(run, lambda: {"x": x})


PROGRAMS: Programs = {
    "gather": lambda arrays: springs(arrays, gather, "first", "head"),
    "scatter": lambda arrays: springs(arrays, scatter, "tail", "head"),
    "both-ends": lambda arrays: springs(arrays, scatter_to_both, "tail", "head"),
    "streaming": streaming,
    "stencil": lambda arrays: stencil(arrays, relax, STENCIL_CENTER, STENCIL_SIDE),
    "stencil-27": lambda arrays: stencil(arrays, relax27, *WEIGHTS),
    "stencil-periodic": lambda arrays: stencil(arrays, relax_around, STENCIL_CENTER, STENCIL_SIDE),
    "jacobi": lambda arrays: stencil(arrays, relax_plane, JACOBI),
    "heat": heat,
    "pcg": pcg,
}
