"""A step of a fluid among frequencies without its transforms: the kernels of ``examples/fluids_fft.py``.

There is no viscosity and no transform, so that steps can go on: velocities stay as they are, waves are projected and
then only projected again, and particles move on.
"""

from __future__ import annotations

import numpy as np

from benchmarks.data import SEED, Arrays

FLUID_DT = 0.09
SPREAD = 0.0
"""The viscosity times the step. It is no constant of any of the programs."""


def fluid(n: int) -> dict[str, np.ndarray]:
    """Eddies on n x n cells, waves by chance, and a particle in each cell."""
    rng = np.random.default_rng(SEED)
    x, y = 2 * np.pi * np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n] * 2, indexing="ij"))
    waves = rng.standard_normal((2, n, n // 2 + 1, 2)).astype(np.float32)
    cells = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1)
    pos = (cells + rng.random((n, n, 2))) / n
    return {
        "u": (0.2 * np.sin(y) + 0.1 * np.cos(3 * x)).astype(np.float32),
        "v": (0.2 * np.cos(x) - 0.1 * np.sin(2 * y)).astype(np.float32),
        "waves_u": waves[0],
        "waves_v": waves[1],
        "pos": pos.reshape(-1, 2).astype(np.float32),
    }


def fluid_outputs(carried_u: np.ndarray, carried_v: np.ndarray, waves: Arrays, pos: np.ndarray) -> Arrays:
    """What is compared: for positions how far they are from the middle, where those that wrap do not jump."""
    return {"carried_u": carried_u, "carried_v": carried_v, **waves, "off": np.abs(pos - 0.5)}


def fluid_steps(arrays: Arrays, steps: int) -> Arrays:
    w = np.stack([arrays["u"], arrays["v"]], axis=-1).astype(np.float64)
    n, pos = len(w), arrays["pos"].astype(np.float64)
    before = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1) - FLUID_DT * n * w
    low = np.floor(before).astype(int)
    carried = np.zeros_like(w)
    for corner in np.ndindex(2, 2):
        weight = np.prod(np.where(corner, before - low, 1 - before + low), axis=-1)
        i, j = np.moveaxis((low + corner) % n, -1, 0)
        carried += weight[..., None] * w[i, j]
    for _ in range(steps):
        i, j = np.moveaxis(np.floor(pos * n).astype(int) % n, -1, 0)
        pos = (pos + FLUID_DT * w[i, j]) % 1
    i, ky = np.arange(n)[:, None, None], np.arange(n // 2 + 1)[:, None]
    kx = np.where(2 * i <= n, i, i - n)
    u, v = arrays["waves_u"].astype(np.float64), arrays["waves_v"].astype(np.float64)
    along = (kx * u + ky * v) / np.maximum(kx * kx + ky * ky, 1)
    return fluid_outputs(carried[..., 0], carried[..., 1], {"waves_u": u - kx * along, "waves_v": v - ky * along}, pos)
