"""Systems that solvers are tried on, as relations and as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

import ebb


class System:
    """A sparse matrix of blocks in the rows of a relation, by its dense form, and fields x and b."""

    def __init__(self, blocks: np.ndarray, b: np.ndarray, scalar: Any = ebb.float64) -> None:
        n = len(blocks)
        tail, head = np.nonzero(np.abs(blocks).sum(axis=(2, 3)) if blocks.ndim == 4 else blocks)
        # In no order: a solver groups by itself.
        order = np.random.default_rng(5).permutation(len(tail))
        tail, head = tail[order], head[order]
        size = blocks.shape[2:]
        self.rows = ebb.Relation("rows", size=n)
        self.entries = ebb.Relation("entries", size=len(tail))
        self.entries.new_field("tail", self.rows, init=tail)
        self.entries.new_field("head", self.rows, init=head)
        self.entries.new_field("a", ebb.matrix(scalar, *size) if size else scalar, init=blocks[tail, head])
        unknown = ebb.vector(scalar, size[0]) if size else scalar
        self.rows.new_field("x", unknown, init=0.0)
        self.rows.new_field("b", unknown, init=b)
        self.dense = blocks.transpose(0, 2, 1, 3).reshape(n * size[0], -1) if size else blocks
        self.right = b.ravel()

    @property
    def x(self) -> np.ndarray:
        return self.rows.x.to_numpy().ravel().astype(np.float64)

    def residual(self) -> float:
        """Relative to b."""
        return float(np.linalg.norm(self.right - self.dense @ self.x) / np.linalg.norm(self.right))


def symmetric(n: int, size: int, shift: float, seed: int = 0) -> np.ndarray:
    """Symmetric blocks of shape (n, n, size, size) along a band, whose least eigenvalue is ``shift``."""
    rng = np.random.default_rng(seed)
    near = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= 2
    full = rng.normal(size=(n, size, n, size)) * near[:, None, :, None]
    full = full.reshape(n * size, n * size)
    full = full + full.T
    full += (shift - np.linalg.eigvalsh(full)[0]) * np.eye(n * size)
    return full.reshape(n, size, n, size).transpose(0, 2, 1, 3)
