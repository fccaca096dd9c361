"""Particles are carried by a flow on a grid.

The velocities lie at the centres of cells. Each particle has a key of the dual cell that it is in, between the centres
around it, and takes what these have by bilinear interpolation: ``p.dual_cell.cell(i, j)``. It moves by a Runge-Kutta
method of order 2 or 4, and finds its next dual cell itself. In the end the particles are counted in cells, and spread
over them by the weights of the interpolation, which keeps their mass. Three flows:

- ``gyre``: two vortices side by side in a closed box, whose border swings to and fro, so that they mix (Shadden, Lekien
  and Marsden, "Definition and properties of Lagrangian coherent structures", 2005);
- ``cells``: the steady vortices of Taylor and Green, in a periodic square: particles go around on streamlines for ever;
- ``abc``: the steady flow of Arnold, Beltrami and Childress, chaotic, in a periodic box: the same in three dimensions.

    python examples/grid_particles.py --save out/gyre.png
    python examples/grid_particles.py --flow abc --grid 64 --save out/abc.png
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import product
from math import pi
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

import ebb
import software
from ebb.domains import Grid2D, Grid3D, Particles
from options import Backend, Threads, check_output, positive

A, B = 3**0.5, 2**0.5
"""Of the flow of Arnold, Beltrami and Childress; C is 1."""


# ---- Flows ----


@ebb.func
def double_gyre(at, t):
    swing = 0.25 * ebb.sin(0.2 * pi * t)
    f = swing * at.x * at.x + (1 - 2 * swing) * at.x
    slope = 2 * swing * at.x + 1 - 2 * swing
    u = -0.1 * pi * ebb.sin(pi * f) * ebb.cos(pi * at.y)
    return [u, 0.1 * pi * ebb.cos(pi * f) * ebb.sin(pi * at.y) * slope]


@ebb.func
def vortex_cells(at, t):
    x, y = 2 * pi * at.x, 2 * pi * at.y
    return [ebb.sin(x) * ebb.cos(y), -ebb.cos(x) * ebb.sin(y)]


@ebb.func
def arnold_beltrami_childress(at, t):
    u = A * ebb.sin(at.z) + ebb.cos(at.y)
    v = B * ebb.sin(at.x) + A * ebb.cos(at.z)
    return [u, v, ebb.sin(at.y) + B * ebb.cos(at.x)]


@dataclass(frozen=True)
class Flow:
    """A velocity in closed form, in a box from the origin on. ``shape`` counts cells for each of ``--grid``."""

    velocity: Any
    shape: tuple[int, ...]
    extent: tuple[float, ...]
    periodic: bool
    steady: bool
    dt: float


FLOWS = {
    "gyre": Flow(double_gyre, (2, 1), (2.0, 1.0), periodic=False, steady=False, dt=0.05),
    "cells": Flow(vortex_cells, (1, 1), (1.0, 1.0), periodic=True, steady=True, dt=0.005),
    "abc": Flow(arnold_beltrami_childress, (1, 1, 1), (2 * pi,) * 3, periodic=True, steady=True, dt=0.05),
}


# ---- Interpolation ----


@ebb.func
def bilinear(d, pos, field):
    x1, y1 = d.local(pos)
    x0, y0 = 1 - x1, 1 - y1
    return (
        x0 * y0 * d.cell(0, 0)[field]
        + x1 * y0 * d.cell(1, 0)[field]
        + x0 * y1 * d.cell(0, 1)[field]
        + x1 * y1 * d.cell(1, 1)[field]
    )


@ebb.func
def trilinear(d, pos, field):
    x1, y1, z1 = d.local(pos)
    x0, y0, z0 = 1 - x1, 1 - y1, 1 - z1
    low = (
        x0 * y0 * d.cell(0, 0, 0)[field]
        + x1 * y0 * d.cell(1, 0, 0)[field]
        + x0 * y1 * d.cell(0, 1, 0)[field]
        + x1 * y1 * d.cell(1, 1, 0)[field]
    )
    high = (
        x0 * y0 * d.cell(0, 0, 1)[field]
        + x1 * y0 * d.cell(1, 0, 1)[field]
        + x0 * y1 * d.cell(0, 1, 1)[field]
        + x1 * y1 * d.cell(1, 1, 1)[field]
    )
    return z0 * low + z1 * high


# ---- The simulation ----


class Tracers:
    """Particles in a flow: ``step`` moves them, ``deposit`` gives them to the cells."""

    def __init__(self, flow: Flow, cells: int, positions: np.ndarray | int, order: int = 2, precision: Any = None):
        """A grid with ``cells`` cells along a side of the length 1 of its shape, and particles at ``positions``.

        One number stands for so many particles, spread evenly by chance.
        """
        precision = ebb.float32 if precision is None else precision
        ndim, shape = len(flow.shape), tuple(cells * n for n in flow.shape)
        self.flow, self.order, self.time = flow, order, 0.0
        make = Grid2D if ndim == 2 else Grid3D
        self.grid = make(shape, extent=flow.extent, periodic=flow.periodic, precision=precision)
        if isinstance(positions, int):
            self.particles = Particles.random(positions, (0.0,) * ndim, flow.extent, precision=precision)
        else:
            self.particles = Particles(positions, precision=precision)
        self.particles.couple(self.grid)
        vector = ebb.vector(precision, ndim)
        for name in ("vel", "half_vel", "next_vel"):  # now, half a step later, a step later
            self.grid.cells.new_field(name, vector)
        self.grid.cells.new_field("count", ebb.int32)
        self.grid.cells.new_field("mass", precision)
        self._fill = fill_kernel(flow)
        self._advect = advect_kernel(self.grid, order)
        self._deposit = deposit_kernel(ndim)
        for name in ("vel", "half_vel", "next_vel"):
            self._fill(self.grid.cells, 0.0, name)

    def step(self, dt: float) -> None:
        """Carry all particles on by ``dt``."""
        cells = self.grid.cells
        if not self.flow.steady:
            self._fill(cells, self.time + dt / 2, "half_vel")
            self._fill(cells, self.time + dt, "next_vel")
        self._advect(self.particles, dt)
        if not self.flow.steady:
            cells.swap("vel", "next_vel")
        self.time += dt

    def deposit(self) -> None:
        """Count the particles in each cell, and spread a mass of 1 for each over the cells around it."""
        self.grid.cells.count.fill(0)
        self.grid.cells.mass.fill(0)
        self.particles.locate()
        self._deposit(self.particles)


def fill_kernel(flow: Flow) -> ebb.Kernel:
    """Sets a field of cells to the velocity at their centres."""
    velocity = flow.velocity

    @ebb.kernel
    def fill(c, t: ebb.float32, field: str):
        c[field] = velocity(c.center, t)

    return fill


def advect_kernel(grid: Any, order: int) -> ebb.Kernel:
    """Moves a particle by the midpoint rule or the classical Runge-Kutta method, and finds where it is then.

    What would leave a closed box stays at its wall.
    """
    interpolate = bilinear if len(grid.shape) == 2 else trilinear
    origin, walls = grid.origin, grid.extent

    @ebb.func
    def held(pos):
        return ebb.clamp(pos, origin, walls)

    stay = grid.wrap if all(grid.periodic) else held

    @ebb.func
    def velocity(pos, field):
        return interpolate(grid.dual_locate(pos), pos, field)

    @ebb.kernel
    def midpoint(p, dt: ebb.float32):
        first = interpolate(p.dual_cell, p.pos, "vel")
        p.pos = stay(p.pos + dt * velocity(p.pos + 0.5 * dt * first, "half_vel"))
        p.dual_cell = grid.dual_locate(p.pos)

    @ebb.kernel
    def runge_kutta(p, dt: ebb.float32):
        first = interpolate(p.dual_cell, p.pos, "vel")
        second = velocity(p.pos + 0.5 * dt * first, "half_vel")
        third = velocity(p.pos + 0.5 * dt * second, "half_vel")
        fourth = velocity(p.pos + dt * third, "next_vel")
        p.pos = stay(p.pos + (first + 2 * second + 2 * third + fourth) * dt / 6)
        p.dual_cell = grid.dual_locate(p.pos)

    return {2: midpoint, 4: runge_kutta}[order]


def deposit_kernel(ndim: int) -> ebb.Kernel:
    """Gives a particle to its cell, and its mass to those around it, by the weights of the interpolation."""
    corners = tuple(product((0, 1), repeat=ndim))

    @ebb.func
    def share(upper, at):
        return at if upper == 1 else 1 - at

    @ebb.kernel
    def deposit_2d(p):
        p.cell.count += 1
        at = ebb.clamp(p.dual_cell.local(p.pos), 0, 1)
        for i, j in corners:
            p.dual_cell.cell(i, j).mass += share(i, at.x) * share(j, at.y)

    @ebb.kernel
    def deposit_3d(p):
        p.cell.count += 1
        at = ebb.clamp(p.dual_cell.local(p.pos), 0, 1)
        for i, j, k in corners:
            p.dual_cell.cell(i, j, k).mass += share(i, at.x) * share(j, at.y) * share(k, at.z)

    return deposit_2d if ndim == 2 else deposit_3d


# ---- Pictures ----


def origin_colors(origin: np.ndarray, extent: tuple[float, ...]) -> np.ndarray:
    """A colour for each particle, RGB from 0 to 1: its hue says how far along x it began, its light how far along y."""
    along, up = origin[:, 0] / extent[0], origin[:, 1] / extent[1]
    stops = np.array(
        [(0.11, 0.26, 0.52), (0.18, 0.55, 0.60), (0.95, 0.80, 0.45), (0.86, 0.40, 0.28), (0.50, 0.12, 0.25)]
    )
    color = np.stack([np.interp(along, np.linspace(0, 1, len(stops)), channel) for channel in stops.T], axis=1)
    return color + 0.35 * (np.floor(8 * up) % 2)[:, None] * (1 - color)


def draw(points: np.ndarray, colors: np.ndarray, extent: tuple[float, ...], height: int) -> np.ndarray:
    """A picture of the particles from above, (rows, columns, 3) from 0 to 255: paper where there are none."""
    width = round(height * extent[0] / extent[1])
    column, row = ((points[:, d] / extent[d] * n).astype(int).clip(0, n - 1) for d, n in ((0, width), (1, height)))
    pixel = (height - 1 - row) * width + column
    count = np.bincount(pixel, minlength=width * height)
    ink = np.stack([np.bincount(pixel, channel, width * height) for channel in colors.T], axis=1)
    cover = 1 - np.exp(-2.5 * count / max(len(points) / (width * height), 1e-9))[:, None]
    image = 0.97 * (1 - cover) + ink / np.maximum(count, 1)[:, None] * cover
    return 255 * image.reshape(height, width, 3)


def save_moments(path: Path, moments: list[np.ndarray], origin: np.ndarray, extent: tuple[float, ...]) -> None:
    """Draw the particles at several moments side by side."""
    path.parent.mkdir(parents=True, exist_ok=True)
    colors, height = origin_colors(origin, extent), 420
    gap = np.full((height, 12, 3), 255.0)
    parts = [part for points in moments for part in (draw(points, colors, extent, height), gap)]
    software.write_png(path, np.concatenate(parts[:-1], axis=1))


# ---- The program ----


def main(
    flow: Annotated[str, typer.Option(help="gyre, cells or abc")] = "gyre",
    particles: Annotated[int, typer.Option(help="how many", min=1)] = 1_000_000,
    grid: Annotated[int, typer.Option(help="cells along the shortest side", min=2)] = 256,
    steps: Annotated[int, typer.Option(min=1)] = 400,
    dt: Annotated[float | None, typer.Option(help="the length of a step in seconds", callback=positive)] = None,
    order: Annotated[int, typer.Option(help="of the Runge-Kutta method: 2 or 4")] = 2,
    backend: Backend = "cpu",
    threads: Threads = None,
    sort: Annotated[
        int | None, typer.Option(help="steps between sortings of particles by cells; 0: none", min=0)
    ] = None,
    save: Annotated[Path | None, typer.Option(help="a picture (.png) of four moments")] = None,
) -> None:
    """Carry particles through a flow on a grid."""
    console = Console(highlight=False)
    check_output("--save", save, ".png")
    if flow not in FLOWS or order not in (2, 4):
        raise SystemExit(f"--flow is one of {', '.join(FLOWS)}, and --order 2 or 4")
    try:
        ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
        tracers = Tracers(FLOWS[flow], grid, particles, order)
        console.print(f"{particles} particles on {tracers.grid}")
        origin = tracers.particles.pos.to_numpy()
        if sort is None:
            sort = 50 if backend == "cpu" else 0  # the processor does it, and would have to fetch them from a device
        moments = carry(tracers, steps, FLOWS[flow].dt if dt is None else dt, sort, console)
        report_masses(tracers, console)
        if save is not None:
            save_moments(save, [origin, *moments], origin, FLOWS[flow].extent)
            console.print(f"saved {save}")
    except ebb.EbbError as error:
        raise SystemExit(str(error)) from None


def carry(tracers: Tracers, steps: int, dt: float, sort: int, console: Console) -> list[np.ndarray]:
    """Make all steps, and tell the time that they take; returns the positions at three moments."""
    pictures, moments, spent = {steps // 4, steps // 2, steps}, [], 0.0
    start = time.perf_counter()
    tracers.step(dt)
    wait_for(tracers)
    first = time.perf_counter() - start
    for number in track(range(1, steps + 1), "carrying", console=console, transient=True):
        start = time.perf_counter()
        if sort and number % sort == 1 % sort:
            tracers.particles.reorder()  # who lies together in memory then reads the same velocities
        if number > 1:
            tracers.step(dt)
        if number in pictures:
            wait_for(tracers)
        spent += time.perf_counter() - start
        if number in pictures:
            moments.append(tracers.particles.pos.to_numpy())
    console.print(f"{steps} steps of {dt:g} s; the first, with the compilation of its kernels, took {first:.2f} s")
    if steps > 1:
        each = spent / (steps - 1) / tracers.particles.size
        console.print(f"{spent:.2f} s for the others: {1e9 * each:.2f} ns a particle a step")
    return moments


def wait_for(tracers: Tracers) -> None:
    """Wait for a device that still computes."""
    tracers.particles.pos.view()


def report_masses(tracers: Tracers, console: Console) -> None:
    """Say what the cells have been given."""
    tracers.deposit()
    count, mass = tracers.grid.cells.count.to_numpy(), tracers.grid.cells.mass.to_numpy()
    total, empty = mass.sum(dtype=np.float64), int((count == 0).sum())
    console.print(f"counted in cells: {count.sum()} particles, at most {count.max()} in one, {empty} cells empty")
    console.print(f"spread over cells: a mass of {total:.3f}, {total / tracers.particles.size - 1:+.1e} off")


if __name__ == "__main__":
    typer.run(main)
