"""Smoke rises, and dye is stirred: Stable Fluids, in two and three dimensions.

The Navier-Stokes equations of an incompressible fluid, by the steps of Stam, "Stable Fluids", SIGGRAPH 1999, section 2:

1. forces: what has been emitted is warm, and rises;
2. advection: the velocity and the dye of a cell are those of the place that the fluid has come from, interpolated
   between the centres of cells around it: ``d.cell(i, j)`` of the dual cell ``d`` that this place is in. ``linear`` is
   Stam's; ``maccormack`` goes there and back, and makes good half of what is lost on the way (Selle, Fedkiw, Kim, Liu
   and Rossignac, "An Unconditionally Stable MacCormack Method", 2008): less of what is small is smeared out;
3. diffusion, implicit, so that no step is too long;
4. projection: a pressure takes the divergence out of the flow through the faces of cells, and out of the velocity.
   What alternates from cell to cell along its own direction cancels at the faces, and would stay for ever: a filter
   takes it out (Shapiro, "Smoothing, filtering, and boundary effects", 1970), and hardly changes anything longer.

The equations of the last two are solved by ``multigrid.py``. The fluid is in a periodic box, or within walls: no fluid
goes through them, and with a viscosity it sticks to them. Interpolation keeps no sums: so the dye is scaled after each
step to what it was, which is known, since none leaves the box.

What kernels do at a cell, in two and in three dimensions, is in ``fluid_stencils.py``, what is in the box at the start
in ``fluid_scenes.py``.

    python examples/stable_fluids.py --save out/smoke.png --animate out/smoke.gif
    python examples/stable_fluids.py --scene dye --save out/dye.png
    python examples/stable_fluids.py --dimensions 3 --grid 64 --save out/smoke3d.png
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

import ebb
from animation import Film, check_outputs, draw_fluid, save_moments
from fluid_scenes import SCENES, centers, make_grid, taylor_green
from fluid_stencils import (
    below_2d,
    below_3d,
    difference_2d,
    difference_3d,
    held_2d,
    held_3d,
    outflow_2d,
    outflow_3d,
    ripple_2d,
    ripple_3d,
    sample_2d,
    sample_3d,
)
from multigrid import METHODS, Hierarchy, Solved, Solver, Walls
from options import Backend, Threads, finite, positive

ADVECTIONS = ("linear", "maccormack")


# ---- The simulation ----


@dataclass(frozen=True)
class Physics:
    """What the fluid is like, and how it is computed.

    Attributes:
        viscosity: kinematic, in square metres a second.
        diffusion: of the dye, likewise.
        buoyancy: how fast a unit of dye is accelerated upwards, along the last axis, in metres a second squared.
        advection: one of ``ADVECTIONS``.
        method: of the solver, one of ``multigrid.METHODS``.
        tolerance: of the solver.
    """

    viscosity: float = 0.0
    diffusion: float = 0.0
    buoyancy: float = 0.0
    advection: str = "maccormack"
    method: str = "multigrid"
    tolerance: float = 1e-3


class Fluid:
    """A fluid on a grid. ``step`` advances it; cells have ``vel`` and ``dye``, faces ``flow``, which has no divergence.

    Attributes:
        grid: a ``Grid2D`` or ``Grid3D`` of cubic cells.
        time: that has passed, in seconds.
        drift: by how much, as a share, the interpolation changed the sum of a dye at most in the last step, before it
            was scaled back.
    """

    def __init__(self, grid: Any, physics: Physics) -> None:
        """Fluid at rest, without dye; load ``grid.cells.vel``, ``dye`` and ``source`` to give it some."""
        self.grid, self.physics, self.time = grid, physics, 0.0
        precision, ndim, cells = grid.precision, len(grid.shape), grid.cells
        vector, inks = ebb.vector(precision, ndim), ebb.vector(precision, 3)
        for name, kind in (("vel", vector), ("dye", inks)):
            for prefix in ("", "new_") if physics.advection == "linear" else ("", "new_", "next_"):
                cells.new_field(prefix + name, kind)
        cells.new_field("source", inks)
        cells.new_field("pressure", precision)
        cells.new_field("divergence", precision)
        for faces in grid.faces:
            faces.new_field("flow", precision)
        self.total, self.carried = ebb.Global(ebb.vec3d, 0.0), ebb.Global(ebb.vec3d, 0.0)
        self.energy, self.fastest = ebb.Global(ebb.float64, 0.0), ebb.Global(precision, 0.0)
        hierarchy = Hierarchy(grid)
        self._pressure = Solver(hierarchy, "pressure", "divergence", method=physics.method)
        self._diffusers = self._make_diffusers(hierarchy)
        self._define_forces(precision, vector, inks)
        self._define_advection(precision, ndim)
        self._define_projection(precision, ndim)

    def step(self, dt: float) -> Solved:
        """Advance by ``dt`` seconds; says what the projection took."""
        cells = self.grid.cells
        self.total.value = 0.0
        self._emit(cells, dt)
        self._advance(dt)
        for field, coefficient, solver in self._diffusers:
            solver.shift.value = 1 / (coefficient * dt)
            self._weigh(cells, f"{field}_before", field, 1 / (coefficient * dt))
            solver.solve(self.physics.tolerance)
        self.carried.value = 0.0
        self._add_dye(cells)
        self._scale_dye(cells)
        solved = self.project()
        self.time += dt
        return solved

    def project(self) -> Solved:
        """Take the divergence out of the velocity."""
        cells, faces = self.grid.cells, self.grid.faces
        self._find_ripples(cells)
        self._take_ripples(cells)
        for collect, each in zip(self._collect, faces, strict=True):
            collect(each.inside)
        self._diverge(cells)
        solved = self._pressure.solve(self.physics.tolerance)
        for push, each in zip(self._push, faces, strict=True):
            push(each.inside)
        self._push_cells(cells)
        return solved

    @property
    def drift(self) -> float:
        """By how much the interpolation changed the sum of the dye most in the last step, as a share of it."""
        before, after = self.total.value, self.carried.value
        return float(np.max(np.abs(after - before) / np.maximum(before, 1e-300)))

    def measure(self) -> tuple[float, float]:
        """The kinetic energy, for a density of 1, and the largest speed."""
        self.energy.value, self.fastest.value = 0.0, 0.0
        self._measure(self.grid.cells)
        return float(self.energy.value) * float(np.prod(self.grid.spacing)), float(self.fastest.value)

    def _make_diffusers(self, hierarchy: Hierarchy) -> list[tuple[str, float, Solver]]:
        cells, found = self.grid.cells, []
        for field, coefficient, walls in (
            ("vel", self.physics.viscosity, Walls.HELD),
            ("dye", self.physics.diffusion, Walls.INSULATED),
        ):
            if coefficient > 0:
                cells.new_field(f"{field}_before", cells.fields[field].type)
                solver = Solver(hierarchy, field, f"{field}_before", walls=walls, method=self.physics.method, shift=1.0)
                found.append((field, coefficient, solver))
        return found

    def _advance(self, dt: float) -> None:
        cells = self.grid.cells
        self._advect(cells, dt)
        if self.physics.advection == "maccormack":
            self._make_good(cells, dt)
        for field in ("vel", "dye"):
            cells.swap(field, f"new_{field}" if self.physics.advection == "linear" else f"next_{field}")

    def _define_forces(self, precision: Any, vector: Any, inks: Any) -> None:
        total, carried, energy, fastest = self.total, self.carried, self.energy, self.fastest
        up = np.zeros(vector.shape)
        up[-1] = self.physics.buoyancy
        rise = ebb.constant(up.tolist(), vector)

        @ebb.kernel
        def emit(c, dt: precision):
            c.dye += dt * c.source
            c.vel += dt * (c.dye.x + c.dye.y + c.dye.z) * rise
            total.value += ebb.vec3d(c.dye)

        @ebb.kernel
        def weigh(c, target: str, field: str, factor: precision):
            c[target] = factor * c[field]

        @ebb.kernel
        def add_dye(c):
            carried.value += ebb.vec3d(c.dye)

        @ebb.kernel
        def scale_dye(c):
            for ink in range(3):
                if carried.value[ink] > 0:
                    c.dye[ink] *= precision(total.value[ink] / carried.value[ink])

        @ebb.kernel
        def measure(c):
            energy.value += 0.5 * ebb.float64(ebb.dot(c.vel, c.vel))
            fastest.value = max(fastest.value, ebb.length(c.vel))

        self._emit, self._weigh, self._add_dye, self._scale_dye = emit, weigh, add_dye, scale_dye
        self._measure = measure

    def _define_advection(self, precision: Any, ndim: int) -> None:
        grid = self.grid
        sample, held = (sample_2d, held_2d) if ndim == 2 else (sample_3d, held_3d)

        @ebb.func
        def carried_from(c, dt):
            halfway = c.center - 0.5 * dt * c.vel
            return c.center - dt * sample(grid.dual_locate(halfway), halfway, "vel")

        @ebb.kernel
        def advect(c, dt: precision):
            place = carried_from(c, dt)
            d = grid.dual_locate(place)
            c.new_vel = sample(d, place, "vel")
            c.new_dye = sample(d, place, "dye")

        @ebb.kernel
        def make_good(c, dt: precision):
            place, goal = carried_from(c, dt), carried_from(c, -dt)
            d, e = grid.dual_locate(place), grid.dual_locate(goal)
            c.next_vel = held(c.new_vel + 0.5 * (c.vel - sample(e, goal, "new_vel")), d, "vel")
            c.next_dye = held(c.new_dye + 0.5 * (c.dye - sample(e, goal, "new_dye")), d, "dye")

        self._advect, self._make_good = advect, make_good

    def _define_projection(self, precision: Any, ndim: int) -> None:
        outflow, difference, below = (
            (outflow_2d, difference_2d, below_2d) if ndim == 2 else (outflow_3d, difference_3d, below_3d)
        )
        ripple, per_length = ripple_2d if ndim == 2 else ripple_3d, 1 / self.grid.spacing[0]

        def face_kernels(axis: int) -> tuple[ebb.Kernel, ebb.Kernel]:
            unit = tuple(int(other == axis) for other in range(ndim))

            @ebb.kernel
            def collect(f):
                f.flow = 0.5 * (below(f, unit).vel[axis] + f.cell(0, 0).vel[axis])

            @ebb.kernel
            def push(f):
                f.flow -= per_length * (f.cell(0, 0).pressure - below(f, unit).pressure)

            return collect, push

        @ebb.kernel
        def find_ripples(c):
            c.new_vel = 0.25 * ripple(c, "vel")

        @ebb.kernel
        def take_ripples(c):
            c.vel -= 0.25 * ripple(c, "new_vel")

        @ebb.kernel
        def diverge(c):
            c.divergence = -per_length * outflow(c)

        @ebb.kernel
        def push_cells(c):
            c.vel -= 0.5 * per_length * difference(c)

        self._collect, self._push = zip(*(face_kernels(axis) for axis in range(ndim)), strict=True)
        self._find_ripples, self._take_ripples = find_ripples, take_ripples
        self._diverge, self._push_cells = diverge, push_cells


# ---- The program ----


def main(
    scene: Annotated[str, typer.Option(help=", ".join(SCENES))] = "smoke",
    dimensions: Annotated[int, typer.Option(help="2 or 3", min=2, max=3)] = 2,
    grid: Annotated[
        int | None, typer.Option(help="cells along the width; 256 in the plane, 64 in space", min=4)
    ] = None,
    steps: Annotated[int, typer.Option(min=1)] = 300,
    dt: Annotated[float | None, typer.Option(help="the length of a step in seconds", callback=positive)] = None,
    viscosity: Annotated[float | None, typer.Option(help="square metres a second", min=0, callback=finite)] = None,
    diffusion: Annotated[float, typer.Option(help="of the dye, square metres a second", min=0, callback=finite)] = 0.0,
    box: Annotated[str, typer.Option(help="periodic or walled; by default as the scene is")] = "",
    solver: Annotated[str, typer.Option(help=", ".join(METHODS))] = "multigrid",
    advection: Annotated[str, typer.Option(help=", ".join(ADVECTIONS))] = "maccormack",
    tolerance: Annotated[float, typer.Option(help="of the solver", min=0, callback=finite)] = 1e-3,
    backend: Backend = "cpu",
    threads: Threads = None,
    save: Annotated[Path | None, typer.Option(help="a picture (.png) of four moments")] = None,
    frames: Annotated[Path | None, typer.Option(help="a folder for a PNG file each few steps")] = None,
    animate: Annotated[Path | None, typer.Option(help="an animated file of those frames (.gif, .webp, .png)")] = None,
    every: Annotated[int, typer.Option(help="steps from one frame to the next", min=1)] = 3,
    height: Annotated[int, typer.Option(help="of frames, in pixels, about", min=1)] = 480,
) -> None:
    """Let a fluid flow: smoke that rises, dye that is stirred, vortices that decay."""
    console = Console(highlight=False)
    check_choices(scene, box, solver, advection)
    check_outputs(save, frames, animate)
    chosen = SCENES[scene]
    physics = Physics(
        chosen.viscosity if viscosity is None else viscosity, diffusion, chosen.buoyancy, advection, solver, tolerance
    )
    try:
        ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
        cells = grid or (256 if dimensions == 2 else 64)
        periodic = chosen.periodic if not box else box == "periodic"
        fluid = Fluid(make_grid(chosen, cells, dimensions, periodic), physics)
        chosen.fill(fluid.grid)
        console.print(f"{scene} in {fluid.grid}, {advection} advection, {solver}")
        shots = Shots(fluid, chosen.look, height, steps, every)
        try:
            with Film(frames, animate) as film:
                run(shots, film, steps, chosen.dt if dt is None else dt, console)
        finally:
            if save is not None and shots.moments:
                save_moments(save, shots.moments)
        if scene == "vortices" and all(fluid.grid.periodic):
            console.print(f"off the closed form by {error_of_vortices(fluid):.2e} of the largest speed at the start")
        for written in (save, frames, animate):
            if written is not None and written.exists():
                console.print(f"saved {written}", soft_wrap=True)
    except ebb.EbbError as error:
        raise SystemExit(str(error)) from None


def check_choices(scene: str, box: str, solver: str, advection: str) -> None:
    """Refuse what is wrong with the options that are one of several words."""
    for option, value, words in (
        ("scene", scene, tuple(SCENES)),
        ("box", box or "periodic", ("periodic", "walled")),
        ("solver", solver, METHODS),
        ("advection", advection, ADVECTIONS),
    ):
        if value not in words:
            raise typer.BadParameter(f"is one of {', '.join(words)}, not {value!r}", param_hint=f"--{option}")


class Shots:
    """The pictures that are taken of a fluid: frames, and four moments of its life."""

    def __init__(self, fluid: Fluid, look: str, height: int, steps: int, every: int) -> None:
        """Frames come every so many steps."""
        self.fluid, self.look, self.height, self.every = fluid, look, height, every
        self._when = {max(1, steps * quarter // 4) for quarter in range(1, 5)}
        self.moments: list[np.ndarray] = []

    def take(self, number: int, film: Film) -> None:
        """Take what is due after that step."""
        frame = film.wanted and number % self.every == 0
        if frame or number in self._when:
            dye = self.fluid.grid.cells.dye.to_numpy()
            if frame:
                film.add(draw_fluid(dye, self.look, self.height))
            if number in self._when:
                self.moments.append(draw_fluid(dye, self.look, max(self.height, 720)))


def run(shots: Shots, film: Film, steps: int, dt: float, console: Console) -> None:
    """Make all steps, and tell from time to time how the fluid is. Ctrl-C ends it, and what there is will be saved."""
    fluid = shots.fluid
    heading = f"{'time':>9}{'energy':>12}{'fastest':>10}{'dye':>12}{'scaled by':>11}{'cycles':>8}{'residual':>10}"
    console.print(heading, style="bold")
    spent, first = 0.0, 0.0
    try:
        for number in track(range(1, steps + 1), "flowing", console=console, transient=True):
            start = time.perf_counter()
            solved = fluid.step(dt)
            elapsed = time.perf_counter() - start
            first, spent = (elapsed, spent) if number == 1 else (first, spent + elapsed)
            shots.take(number, film)
            if number % max(1, steps // 10) == 0 or number == steps:
                console.print(describe(fluid, solved))
    except KeyboardInterrupt:
        console.print(f"interrupted after {fluid.time:.3f} s of the fluid's time")
        return
    console.print(f"{steps} steps of {dt:g} s; the first, with the compilation of its kernels, took {first:.2f} s")
    if steps > 1:
        console.print(f"{1e3 * spent / (steps - 1):.2f} ms for each of the others")


def describe(fluid: Fluid, solved: Solved) -> str:
    """A line of the table; it ends the program if the fluid has burst."""
    energy, fastest = fluid.measure()
    if not np.isfinite(energy):
        raise SystemExit(f"the velocity is no number any more after {fluid.time:g} s: take smaller steps or forces")
    dye = float(np.sum(fluid.total.value)) * float(np.prod(fluid.grid.spacing))
    return (
        f"{fluid.time:8.3f}s{energy:12.5f}{fastest:10.4f}{dye:12.6f}{fluid.drift:11.1e}"
        f"{solved.turns:8}{solved.residuals[-1]:10.1e}"
    )


def error_of_vortices(fluid: Fluid) -> float:
    """How far the velocity of any cell is from the closed form; its largest speed was 1."""
    decay = np.exp(-8 * pi**2 * fluid.physics.viscosity * fluid.time)
    exact = decay * taylor_green(centers(fluid.grid))
    return float(np.abs(fluid.grid.cells.vel.to_numpy() - exact).max())


if __name__ == "__main__":
    typer.run(main)
