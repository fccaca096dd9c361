"""Boxes of fluid, and what is in them at the start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

import ebb
from ebb.domains import Grid2D, Grid3D


@dataclass(frozen=True)
class Scene:
    """A box, and what is in it at the start.

    Attributes:
        height: of the box, for a width of 1; in space it is as deep as wide.
        periodic: whether it wraps; else it has walls.
        viscosity: of the fluid, in square metres a second.
        buoyancy: how fast a unit of dye is accelerated upwards, in metres a second squared.
        dt: the length of a step in seconds.
        look: of pictures, ``smoke`` or ``ink``.
        fill: gives the cells of the grid of a new fluid their velocity, dye and sources.
    """

    height: float
    periodic: bool
    viscosity: float
    buoyancy: float
    dt: float
    look: str
    fill: Callable[[Any], None]


def centers(grid: Any) -> np.ndarray:
    """The centres of all cells, of the shape (nx, ny[, nz], ndim)."""
    axes = [h * (np.arange(n) + 0.5) for n, h in zip(grid.shape, grid.spacing, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def blobs(places: np.ndarray, balls: tuple[tuple[Any, float, int], ...], softness: float) -> np.ndarray:
    """For each place three amounts from 0 to 1: of the ink of each ball (its centre, radius and ink) that it is in."""
    amounts = np.zeros((*places.shape[:-1], 3))
    for center, radius, ink in balls:
        distance = np.linalg.norm(places - np.asarray(center), axis=-1)
        amounts[..., ink] += 0.5 - 0.5 * np.tanh((distance - radius) / softness)
    return amounts


def fill_smoke(grid: Any) -> None:
    """Three vents of warm smoke at the floor, each a little different; in space, air that turns winds the plumes."""
    places, strength, softness = centers(grid), 3.0, 0.008
    if places.shape[-1] == 2:
        vents = (((0.33, 0.10), 0.050, 0), ((0.53, 0.07), 0.045, 1), ((0.70, 0.12), 0.040, 2))
    else:
        vents = (((0.34, 0.42, 0.16), 0.09, 0), ((0.55, 0.66, 0.13), 0.08, 1), ((0.66, 0.36, 0.19), 0.07, 2))
        strength, softness = 0.6, 0.025
        x, y = pi * places[..., 0], pi * places[..., 1]
        swirl = np.stack([-np.sin(x) * np.cos(y), np.cos(x) * np.sin(y), 0 * x], axis=-1)
        grid.cells.vel.load(0.4 * swirl)
    grid.cells.source.load(strength * blobs(places, vents, softness))


def fill_dye(grid: Any) -> None:
    """Two jets against each other, shaken a little, which roll up, and inks on both sides of where they meet."""
    places, ndim = centers(grid), len(grid.shape)
    x, y = places[..., 0], places[..., -1]
    velocity = np.zeros(places.shape)
    velocity[..., 0] = np.tanh((y - 0.25) / 0.03) * np.tanh((0.75 - y) / 0.03)
    velocity[..., -1] = 0.06 * np.sin(4 * pi * x) + 0.03 * np.sin(6 * pi * x + 1)
    if ndim == 3:
        velocity[..., -1] *= 1 + 0.5 * np.sin(2 * pi * places[..., 1])
    grid.cells.vel.load(velocity)
    inks = np.zeros((*x.shape, 3))
    inks[..., 0] = 0.5 + 0.5 * np.tanh((np.abs(y - 0.5) - 0.25) / -0.02)
    inks[..., 1] = np.exp(-(((y - 0.25) / 0.05) ** 2))
    inks[..., 2] = np.exp(-(((y - 0.75) / 0.05) ** 2))
    grid.cells.dye.load(1.3 * inks)


def taylor_green(places: np.ndarray) -> np.ndarray:
    """The vortices of Taylor and Green, in a box with sides of 1: steady but for their decay."""
    x, y = 2 * pi * places[..., 0], 2 * pi * places[..., 1]
    velocity = np.zeros(places.shape)
    velocity[..., 0], velocity[..., 1] = np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)
    return velocity


def fill_vortices(grid: Any) -> None:
    """The vortices of Taylor and Green, and two inks as a chessboard."""
    places = centers(grid)
    grid.cells.vel.load(taylor_green(places))
    board = (np.floor(4 * places).sum(axis=-1) % 2)[..., None]
    grid.cells.dye.load(np.concatenate([board, 1 - board, 0 * board], axis=-1))


SCENES = {
    "smoke": Scene(1.5, False, 0.0, 2.2, 0.02, "smoke", fill_smoke),
    "dye": Scene(1.0, True, 0.0, 0.0, 0.01, "ink", fill_dye),
    "vortices": Scene(1.0, True, 1e-3, 0.0, 0.01, "ink", fill_vortices),
}


def make_grid(scene: Scene, cells: int, ndim: int, periodic: bool, precision: Any = ebb.float32) -> Any:
    """A grid of ``cells`` cubic cells along the width of the scene; its height is rounded to what coarsens well."""
    step = 8 if cells % 8 == 0 else 1
    tall = max(2, step * round(cells * scene.height / step))
    shape = (cells,) * (ndim - 1) + (tall,)
    make = Grid2D if ndim == 2 else Grid3D
    return make(shape, extent=tuple(n / cells for n in shape), periodic=periodic, precision=precision)
