"""A fluid in a periodic square, with its diffusion and its pressure solved among frequencies: NVIDIA's FluidsGL.

The Navier-Stokes equations of an incompressible fluid, by the method of Stam, "Stable Fluids", SIGGRAPH 1999, in the
form of "A Simple Fluid Solver based on the FFT", 2001, with the constants of the sample of NVIDIA's CUDA toolkit
(Goodnight, "CUDA/OpenGL Fluid Simulation", 2007). A step is:

1. a brush drags the fluid along: cells up to 4 away from it get ``force / (1 + x**4 + y**4)``;
2. advection: the velocity of a cell is that of the place that the fluid has come from, interpolated between the four
   centres of cells around it, ``d.cell(i, j)`` of the dual cell ``d`` that this place is in;
3. a Fourier transform takes both components of the velocity to the relation ``frequencies``;
4. there diffusion is a division, and the projection on flows without divergence is one in the plane: what points along
   the wave is taken out. The transform back gives the new velocity;
5. particles, one a cell to begin with, move with the velocity of the cell that they are in.

The transforms are NumPy's and SciPy's, or those of ``device_transforms.py`` on devices if there is a library for them.
They read the memory of fields and write the memory of fields: rows go from ``cells`` to ``frequencies`` and back,
columns are transformed where they lie, and nothing is copied. A cell takes 32 bytes: two components of its velocity,
now and carried on, as much among frequencies, and a position.

    python examples/fluids_fft.py --save out/fluid.png
    python examples/fluids_fft.py --grid 1024 --steps 100 --dump out/fluid.npz --dump-at 1,10,100
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from math import pi, sin
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

import ebb
from device_transforms import CudaTransforms, DeviceTransforms, transforms_on
from ebb.domains import Grid2D, Particles
from grid_particles import save_moments
from options import Backend, check_output, finite, positive
from outputs import save_arrays

DT, VISCOSITY, FORCE, RADIUS = 0.09, 0.0025, 5.8, 4
"""Of the sample: seconds, in the units of its frequencies, a cell along a side, and cells."""


# ---- Transforms ----


class Transforms:
    """Fourier transforms of real fields on a square grid, on the memory of the fields.

    The transform of a field of n x n numbers has n x (n // 2 + 1) complex ones; the rest are their conjugates. They lie
    in a field of pairs. Along rows NumPy goes from one field to the other, along columns SciPy works in place; without
    SciPy NumPy does that too, at a quarter of the speed.

    Attributes:
        package: what transforms columns.
        copies: how often a library has put its result elsewhere, so that it had to be copied into the field.
        seconds: spent so far.
    """

    def __init__(self, threads: int) -> None:
        """Transforms on so many threads."""
        self.copies, self.seconds = 0, 0.0
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads)
        try:
            import scipy.fft
        except ImportError:
            self.package, self._columns = "NumPy", (np.fft.fft, np.fft.ifft)
        else:
            self.package, self._columns = "SciPy", (scipy.fft.fft, scipy.fft.ifft)

    def forward(self, field: ebb.Field, spectrum: ebb.Field) -> None:
        """Set ``spectrum`` to the transform of ``field``."""
        values, start = field.view(), time.perf_counter()
        with spectrum.view(write=True) as pairs:
            numbers = complex_numbers(pairs)
            self._each_row(lambda rows: np.fft.rfft(values[rows], axis=1, out=numbers[rows]), len(values))
            self._along_columns(self._columns[0], numbers)
        self.seconds += time.perf_counter() - start

    def inverse(self, spectrum: ebb.Field, field: ebb.Field) -> None:
        """Set ``field`` to the inverse transform of ``spectrum``, whose values are lost."""
        with spectrum.view(write=True) as pairs, field.view(write=True) as values:
            numbers, n, start = complex_numbers(pairs), values.shape[1], time.perf_counter()
            self._along_columns(self._columns[1], numbers)
            self._each_row(lambda rows: np.fft.irfft(numbers[rows], n, axis=1, out=values[rows]), len(values))
            self.seconds += time.perf_counter() - start

    def _each_row(self, transform: Any, count: int) -> None:
        """Call ``transform`` on equal shares of the rows, each on a thread."""
        bounds = [count * share // self._threads for share in range(self._threads + 1)]
        for _ in self._pool.map(transform, map(slice, bounds, bounds[1:])):
            pass  # but what a thread raises is raised here

    def _along_columns(self, transform: Any, numbers: np.ndarray) -> None:
        if self.package == "NumPy":
            transform(numbers, axis=0, out=numbers)
            return
        found = transform(numbers, axis=0, overwrite_x=True, workers=self._threads)
        if address(found) != address(numbers):  # SciPy may overwrite its argument, and nowhere says that it will
            self.copies += 1
            numbers[...] = found


def complex_numbers(pairs: np.ndarray) -> np.ndarray:
    """The same memory as complex numbers."""
    return pairs.view(np.complex64)[..., 0]


def address(array: np.ndarray) -> int:
    return array.__array_interface__["data"][0]


# ---- The simulation ----


class Fluid:
    """A fluid in the unit square: ``push`` drags it, ``step`` goes on by ``dt``.

    Attributes:
        grid: n x n cells, with the velocity ``u``, ``v`` in sides of the square a second.
        frequencies: n x (n // 2 + 1) waves, with the transforms of the components as pairs ``u``, ``v``: the wave in
            row i has i, or i - n, periods along the first axis, that in column j has j along the second.
        particles: one a cell, with ``pos`` from 0 to 1.
    """

    def __init__(
        self,
        n: int,
        viscosity: float = VISCOSITY,
        dt: float = DT,
        threads: int = 1,
        seed: int = 0,
        transforms: Transforms | DeviceTransforms | CudaTransforms | None = None,
    ) -> None:
        """A fluid at rest on n x n cells, with a particle somewhere in each, by chance.

        Args:
            n: cells along a side.
            viscosity: as the sample has it.
            dt: the length of a step in seconds.
            threads: for transforms on the host.
            seed: of where the particles are.
            transforms: what transforms; by default that is done on the host.
        """
        self.n, self.viscosity, self.dt = n, viscosity, dt
        self.grid = Grid2D((n, n), extent=1.0, periodic=True)
        self.frequencies = ebb.Relation("frequencies", shape=(n, n // 2 + 1))
        self.particles = Particles(jittered(n, seed))
        self.brush = ebb.Relation("brush", shape=(2 * RADIUS + 1, 2 * RADIUS + 1))
        for name in ("u", "v", "carried_u", "carried_v"):
            self.grid.cells.new_field(name, ebb.float32)
        for name in ("u", "v"):
            self.frequencies.new_field(name, ebb.vec2f)
        self.transforms = Transforms(threads) if transforms is None else transforms
        self._define_motion()
        self._define_solution()

    def push(self, place: Sequence[float], change: Sequence[float]) -> None:
        """Add ``change`` to the velocity of the cell at ``place``, and less to those around it."""
        cell = [int(x % 1 * self.n) for x in place]
        self._push(self.brush, cell, change)

    def step(self) -> None:
        """Go on by ``dt``."""
        self.advect()
        self.solve()
        self.move()

    def advect(self) -> None:
        """Carry the velocity on, into ``carried_u`` and ``carried_v``."""
        self._advect(self.grid.cells, self.dt)

    def solve(self) -> None:
        """Diffuse and project what has been carried on: the new velocity."""
        cells, waves = self.grid.cells, self.frequencies
        self.transforms.forward(cells.carried_u, waves.u)
        self.transforms.forward(cells.carried_v, waves.v)
        self.diffuse_and_project()
        self.transforms.inverse(waves.u, cells.u)
        self.transforms.inverse(waves.v, cells.v)

    def diffuse_and_project(self) -> None:
        """Diffuse and project the velocity among frequencies."""
        self._diffuse_and_project(self.frequencies, self.viscosity * self.dt)

    def move(self) -> None:
        """Move the particles."""
        self._move(self.particles, self.dt)

    def velocity(self) -> np.ndarray:
        """A copy of the velocity, of the shape (n, n, 2)."""
        return np.stack([self.grid.cells.u.view(), self.grid.cells.v.view()], axis=-1)

    def _define_motion(self) -> None:
        grid, cells, brush, particles = self.grid, self.grid.cells, self.brush, self.particles

        @ebb.kernel
        def push(b: brush, at: ebb.vec2i, change: ebb.vec2f):
            off = ebb.coords(b) - RADIUS
            share = 1 / (1 + ebb.float32(off.x**4 + off.y**4))
            c = ebb.row_at(cells, at + off)
            c.u += share * change.x
            c.v += share * change.y

        @ebb.kernel
        def advect(c: cells, dt: ebb.float32):
            before = c.center - dt * [c.u, c.v]
            d = grid.dual_locate(before)
            x, y = d.local(before)
            sw, se, nw, ne = (1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y
            c00, c10, c01, c11 = d.cell(0, 0), d.cell(1, 0), d.cell(0, 1), d.cell(1, 1)
            c.carried_u = sw * c00.u + se * c10.u + nw * c01.u + ne * c11.u
            c.carried_v = sw * c00.v + se * c10.v + nw * c01.v + ne * c11.v

        @ebb.kernel
        def move(p: particles, dt: ebb.float32):
            c = grid.locate(p.pos)
            p.pos = grid.wrap(p.pos + dt * [c.u, c.v])

        self._push, self._advect, self._move = push, advect, move

    def _define_solution(self) -> None:
        frequencies, n = self.frequencies, ebb.constant(self.n, ebb.int32)

        @ebb.kernel
        def diffuse_and_project(f: frequencies, spread: ebb.float32):
            i, j = ebb.coords(f)
            kx, ky = ebb.float32(i if 2 * i <= n else i - n), ebb.float32(j)
            square = kx * kx + ky * ky
            decay = 1 / (1 + spread * square)
            along = 1 / max(square, 1) * (kx * f.u + ky * f.v)  # of the mean, whose square is 0, nothing
            f.u = decay * (f.u - kx * along)
            f.v = decay * (f.v - ky * along)

        self._diffuse_and_project = diffuse_and_project


def jittered(n: int, seed: int) -> np.ndarray:
    """A place in each of n x n cells of the unit square, (n * n, 2), in float32."""
    places = np.random.default_rng(seed).random((n, n, 2), dtype=np.float32)
    places[..., 0] += np.arange(n, dtype=np.float32)[:, None]
    places[..., 1] += np.arange(n, dtype=np.float32)
    places /= n
    return places.reshape(-1, 2)


def stroke(number: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where the brush is at a step, and how far it goes until the next."""

    def place(turn: float) -> tuple[float, float]:
        return 0.5 + 0.34 * sin(2 * pi * 3 * turn / 200), 0.5 + 0.3 * sin(2 * pi * 2 * turn / 200 + 0.7)

    here, there = place(number), place(number + 1)
    return here, (there[0] - here[0], there[1] - here[1])


def drag(fluid: Fluid, number: int, force: float) -> None:
    """The brush of step ``number``: the sample's force, times the step and how far the brush goes."""
    place, way = stroke(number)
    fluid.push(place, [force * fluid.n * fluid.dt * along for along in way])


# ---- The program ----


def main(
    grid: Annotated[int, typer.Option(help="cells along a side", min=2)] = 512,
    steps: Annotated[int, typer.Option(min=1)] = 200,
    dt: Annotated[float, typer.Option(help="the length of a step in seconds", callback=positive)] = DT,
    viscosity: Annotated[float, typer.Option(help="as the sample has it", min=0, callback=finite)] = VISCOSITY,
    force: Annotated[float, typer.Option(help="of the brush, for each cell along a side", callback=finite)] = FORCE,
    backend: Backend = "cpu",
    threads: Annotated[int | None, typer.Option(help="for cpu and the transforms; by default all", min=1)] = None,
    save: Annotated[Path | None, typer.Option(help="a picture (.png) of the particles at four moments")] = None,
    dump: Annotated[Path | None, typer.Option(help="a file (.npz) for velocity and positions")] = None,
    dump_at: Annotated[str, typer.Option(help="after which steps: 1,10,100; by default the last")] = "",
) -> None:
    """Drag a fluid around in a periodic square."""
    console = Console(highlight=False)
    moments = parsed_moments(dump_at, steps)
    check_output("--save", save, ".png")
    check_output("--dump", dump, ".npz")
    try:
        ebb.set_backend(backend, **({} if threads is None or backend != "cpu" else {"threads": threads}))
        fluid = Fluid(grid, viscosity, dt, transforms=transforms_for(backend, threads or processors()))
        each = ebb.memory().host_bytes / grid**2
        console.print(f"{grid * grid} cells and as many particles, {each:.1f} bytes for both")
    except ebb.EbbError as error:
        raise SystemExit(str(error)) from None
    record = Record(fluid, moments, save is not None, dump is not None, steps)
    try:
        run(fluid, record, steps, force, console)
    except ebb.EbbError as error:
        record.keep_last()
        raise SystemExit(str(error)) from None
    finally:
        record.write(save, dump, console)
    describe_transforms(fluid, backend, console)


def parsed_moments(text: str, steps: int) -> list[int]:
    """The steps that ``text`` names."""
    try:
        found = sorted({int(part) for part in text.split(",")}) if text.strip() else [steps]
    except ValueError:
        raise typer.BadParameter(
            f"takes numbers of steps, 1,10,100, and not {text!r}", param_hint="--dump-at"
        ) from None
    if not 1 <= found[0] <= found[-1] <= steps:
        raise typer.BadParameter(f"takes steps from 1 to {steps}, and not {text!r}", param_hint="--dump-at")
    return found


class Record:
    """What is kept of a run for its files."""

    def __init__(self, fluid: Fluid, moments: list[int], pictures: bool, dumps: bool, steps: int) -> None:
        """Positions at four moments for pictures; the whole state at ``moments`` for dumps."""
        self._fluid = fluid
        self._begin = fluid.particles.pos.to_numpy() if pictures else None
        self._pictures = {steps * part // 4 for part in (1, 2, 4)} if pictures else set[int]()
        self._moments = set(moments) if dumps else set[int]()
        self._seen = list[np.ndarray]()
        self._arrays = dict[str, np.ndarray]()
        self._step = 0

    def take(self, number: int) -> None:
        """Keep what is wanted of the state after step ``number``."""
        self._step = number
        if number in self._pictures:
            self._seen.append(self._fluid.particles.pos.to_numpy())
        if number in self._moments:
            self._keep(number)

    def keep_last(self) -> None:
        """Keep the state after a step that failed, with the velocity from before it."""
        if self._moments:
            self._keep(self._step)

    def _keep(self, number: int) -> None:
        self._arrays[f"velocity_{number}"] = self._fluid.velocity()
        self._arrays[f"particles_{number}"] = self._fluid.particles.pos.to_numpy()

    def write(self, save: Path | None, dump: Path | None, console: Console) -> None:
        """Write the files."""
        if dump is not None:
            steps = sorted({int(name.rsplit("_", 1)[1]) for name in self._arrays})
            save_arrays(dump, steps=np.array(steps), dt=self._fluid.dt, viscosity=self._fluid.viscosity, **self._arrays)
            console.print(f"saved {dump}")
        if save is not None and self._begin is not None:
            save_moments(save, [self._begin, *self._seen], self._begin, (1.0, 1.0))
            console.print(f"saved {save}")


def run(fluid: Fluid, record: Record, steps: int, force: float, console: Console) -> None:
    """Make all steps, and tell the time that they take."""
    first, spent = 0.0, 0.0
    for number in track(range(1, steps + 1), "flowing", console=console, transient=True):
        start = time.perf_counter()
        drag(fluid, number - 1, force)
        fluid.step()
        if number == 1 or number == steps:
            fluid.particles.pos.view()  # waits for a device that still computes
        spent += time.perf_counter() - start
        if number == 1:
            first, spent = spent, 0.0
            if isinstance(fluid.transforms, Transforms):
                fluid.transforms.seconds = 0.0
        record.take(number)
    console.print(f"{steps} steps of {fluid.dt:g} s; the first, with compilation, took {first:.2f} s")
    if steps > 1:
        text = f"{1e3 * spent / (steps - 1):.2f} ms each of the others"
        if isinstance(fluid.transforms, Transforms):
            text += f", {1e3 * fluid.transforms.seconds / (steps - 1):.2f} ms of them in transforms"
        console.print(text)
    speed = np.hypot(fluid.grid.cells.u.view(), fluid.grid.cells.v.view())
    console.print(f"the fastest cell flows at {speed.max():.3f}, the mean at {speed.mean():.3f} sides a second")


def transforms_for(backend: str, threads: int) -> Transforms | DeviceTransforms | CudaTransforms:
    """Transforms where kernels run, if there is a library for it, and else on the host."""
    return transforms_on(backend) or Transforms(threads)


def describe_transforms(fluid: Fluid, backend: str, console: Console) -> None:
    """Tell what has transformed, and where it has read and written."""
    cells, waves, transforms = fluid.grid.cells, fluid.frequencies, fluid.transforms
    if not isinstance(transforms, Transforms):
        console.print(f"transforms by {transforms.package} on the device, in the memory of kernels, 0 copies:")
    else:
        console.print(
            f"transforms by NumPy along rows, {transforms.package} along columns, {transforms.copies} copies:"
        )
    for name in ("u", "v"):
        fields = cells.fields[f"carried_{name}"], waves.fields[name], cells.fields[name]
        places = [f"{field.path} at {place_of(field, transforms):#x}" for field in fields]
        console.print("  " + " to ".join(places), soft_wrap=True)
    if isinstance(transforms, Transforms) and backend in ("opencl", "cuda"):
        moved = "velocities and transforms were moved to and from the device at each step"
        console.print(f"  on the host: {moved}", soft_wrap=True)
        package, extra = ("reikna", "fft") if backend == "opencl" else ("cuFFT", "cufft")
        console.print(f"  with {package} they stay there: pip install ebblang[{extra}]", markup=False)


def place_of(field: ebb.Field, transforms: Transforms | DeviceTransforms | CudaTransforms) -> int:
    """Where the field was transformed: an address, or OpenCL's handle of the memory."""
    return address(field.view()) if isinstance(transforms, Transforms) else transforms.memory[field.path]


def processors() -> int:
    """How many processors the process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


if __name__ == "__main__":
    typer.run(main)
