"""More stencils than the 7 points: all 27 with a weight by distance, 7 that wrap around, and 5 in two dimensions."""

from __future__ import annotations

from itertools import product

import numpy as np

from benchmarks.constants import STENCIL_CENTER, STENCIL_SIDE
from benchmarks.data import SEED, Arrays

WEIGHTS = (0.28, 0.06, 0.02, 0.015)
"""Of the cell, those that share a face with it, an edge, a corner: 1 together."""

JACOBI = 0.25


def plane(n: int) -> dict[str, np.ndarray]:
    old = np.random.default_rng(SEED).random((n, n), np.float32)
    return {"old": old, "new": old}


def stencil27_steps(arrays: Arrays, steps: int) -> Arrays:
    old = arrays["old"].astype(np.float64)
    n = len(old)
    for _ in range(steps):
        new = old.copy()
        new[1:-1, 1:-1, 1:-1] = 0
        for move in product((-1, 0, 1), repeat=3):
            part = tuple(slice(1 + step, n - 1 + step) for step in move)
            new[1:-1, 1:-1, 1:-1] += WEIGHTS[sum(map(abs, move))] * old[part]
        old = new
    return {"old": old}


def periodic_steps(arrays: Arrays, steps: int) -> Arrays:
    old = arrays["old"].astype(np.float64)
    for _ in range(steps):
        sides = sum(np.roll(old, step, axis) for axis in range(3) for step in (-1, 1))
        old = STENCIL_CENTER * old + STENCIL_SIDE * sides
    return {"old": old}


def jacobi_steps(arrays: Arrays, steps: int) -> Arrays:
    old = arrays["old"].astype(np.float64)
    for _ in range(steps):
        new = old.copy()
        new[1:-1, 1:-1] = JACOBI * (old[:-2, 1:-1] + old[2:, 1:-1] + old[1:-1, :-2] + old[1:-1, 2:])
        old = new
    return {"old": old}
