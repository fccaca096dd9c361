"""Heat spreads over a surface.

Explicit diffusion dT/dt = D laplace(T) on a triangle mesh, with the cotangent Laplacian and a third of the area of its
triangles for each vertex (Meyer, Desbrun, Schroeder and Barr, "Discrete Differential-Geometry Operators for
Triangulated 2-Manifolds", 2003). The total heat stays what it was, and no vertex gets hotter or colder than all were at
the start. The smallest triangles bound the time step: on a scan, with its slivers, heat needs many steps to get far.

    python examples/heat.py --save out/heat.png
    python examples/heat.py --mesh bunny --save out/heat.png
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

import ebb
from bodies import bunny_surface, fitted
from ebb.domains import TriMesh
from options import Backend, Threads, check_output, finite, positive
from pictures import Surface, save_strip

hottest = ebb.Global(ebb.float64, 0.0)
coldest = ebb.Global(ebb.float64, 0.0)
change = ebb.Global(ebb.float64, 0.0)
heat = ebb.Global(ebb.float64, 0.0)
fastest = ebb.Global(ebb.float64, 0.0)


@ebb.kernel
def init_weights(t):
    a, b, c = ebb.vec3d(t.v[0].pos), ebb.vec3d(t.v[1].pos), ebb.vec3d(t.v[2].pos)
    twice_area = ebb.length(ebb.cross(b - a, c - a))
    for i in range(3):
        t.v[i].area += twice_area / 6
    # The cotangent of the angle opposite an edge, in both directions of the edge. Where it is negative (the angle is
    # obtuse) it counts as 0: else heat could flow from cold to hot, and a vertex leave the range of its neighbours.
    at_c = max(0.0, ebb.dot(a - c, b - c) / twice_area) / 2
    t.e01.weight += at_c
    t.e10.weight += at_c
    at_a = max(0.0, ebb.dot(b - a, c - a) / twice_area) / 2
    t.e12.weight += at_a
    t.e21.weight += at_a
    at_b = max(0.0, ebb.dot(c - b, a - b) / twice_area) / 2
    t.e20.weight += at_b
    t.e02.weight += at_b


@ebb.kernel
def find_fastest(v):
    weight = 0.0
    for e in v.edges:
        weight += e.weight
    fastest.value = max(fastest.value, weight / v.area)


@ebb.kernel
def diffuse(v, step: ebb.float64):
    flow = 0.0
    for e in v.edges:
        flow += e.weight * (e.head.T - v.T)
    v.new_T = v.T + step * flow / v.area


@ebb.kernel
def measure_change(v):
    change.value = max(change.value, abs(v.new_T - v.T))


@ebb.kernel
def measure(v):
    hottest.value = max(hottest.value, v.T)
    coldest.value = min(coldest.value, v.T)
    heat.value += v.area * v.T


def prepare(mesh: TriMesh, start: np.ndarray) -> None:
    """Give the mesh its fields; ``start`` is the temperature of each vertex."""
    mesh.vertices.new_field("area", ebb.float64, init=0.0)
    mesh.vertices.new_field("T", ebb.float64, init=start)
    mesh.vertices.new_field("new_T", ebb.float64, init=start)
    mesh.edges.new_field("weight", ebb.float64, init=0.0)
    init_weights(mesh.triangles)


def stable_step(mesh: TriMesh, diffusivity: float) -> float:
    """The longest step, in seconds, with which each new value is a mean of old ones with weights >= 0."""
    fastest.value = 0.0
    find_fastest(mesh.vertices)
    return 1 / (diffusivity * fastest.value)


def step(mesh: TriMesh, dt: float, diffusivity: float) -> float:
    """Advance by ``dt`` and return the largest change of temperature."""
    change.value = 0.0
    diffuse(mesh.vertices, dt * diffusivity)
    measure_change(mesh.vertices)
    mesh.vertices.swap("T", "new_T")
    return change.value


def totals(mesh: TriMesh) -> tuple[float, float, float]:
    """The lowest and the highest temperature, and the heat: temperature times area."""
    coldest.value, hottest.value, heat.value = np.inf, -np.inf, 0.0
    measure(mesh.vertices)
    return coldest.value, hottest.value, heat.value


def hot_spots(points: np.ndarray, count: int = 7, seed: int = 3) -> np.ndarray:
    """Temperature 1 in discs about chosen points on the side of the viewer, 0 elsewhere, with soft edges."""
    rng = np.random.default_rng(seed)
    front = points[points[:, 1] < np.median(points[:, 1])]
    centres = front[rng.choice(len(front), count, replace=False)]
    distance = np.linalg.norm(points[:, None] - centres, axis=2).min(axis=1) / np.ptp(points, axis=0).max()
    return (1 - np.tanh((distance - 0.09) / 0.008)) / 2


def colors(temperature: np.ndarray) -> np.ndarray:
    """From deep blue through rose to pale yellow, RGB from 0 to 1."""
    stops = np.array([(0.10, 0.15, 0.36), (0.42, 0.20, 0.50), (0.83, 0.32, 0.40), (0.97, 0.62, 0.36), (1.0, 0.93, 0.7)])
    places = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(temperature, places, channel) for channel in stops.T], axis=1)


def load_surface(name: str, console: Console) -> TriMesh:
    """A torus, the bunny, or the surface of a file, 1 m across and upright."""
    if name == "bunny":
        found = bunny_surface(console, "a torus is heated")
        if found is not None:
            return found
        name = "torus"
    if name == "torus":
        return TriMesh.torus(0.34, 0.15, 160, 72)
    surface = TriMesh.load(name, manifold=False)
    return TriMesh.from_arrays(fitted(surface.vertices.pos.to_numpy()), surface.triangles.v.to_numpy(), manifold=False)


def main(
    mesh: Annotated[str, typer.Option(help="torus, bunny, or the file of a surface")] = "torus",
    steps: Annotated[int, typer.Option(help="at most so many", min=1)] = 4000,
    diffusivity: Annotated[float, typer.Option(help="square metres a second", callback=positive)] = 1e-3,
    tolerance: Annotated[
        float, typer.Option(help="stop when no vertex changes by more in a step", min=0, callback=finite)
    ] = 1e-6,
    backend: Backend = "cpu",
    threads: Threads = None,
    save: Annotated[Path | None, typer.Option(help="a picture (.png), or the last state (.vtu, .vtk, .ply)")] = None,
) -> None:
    """Let heat spread over a surface."""
    console = Console(highlight=False)
    check_output("--save", save, ".png", ".vtu", ".vtk", ".ply")
    try:
        ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
        surface = load_surface(mesh, console)
        points = surface.vertices.pos.to_numpy()
        prepare(surface, hot_spots(points))
        dt = stable_step(surface, diffusivity)
        console.print(f"{surface.triangles.size} triangles, at most {steps} steps of {dt:.3g} s")
        moments = diffuse_until(surface, steps, dt, diffusivity, tolerance, console)
        if save is not None:
            save_state(save, surface, points, moments, console)
    except ebb.EbbError as error:
        raise SystemExit(str(error)) from None


def diffuse_until(
    surface: TriMesh, steps: int, dt: float, diffusivity: float, tolerance: float, console: Console
) -> list[np.ndarray]:
    """Step until nothing changes by more than ``tolerance``; returns the temperatures at five moments."""
    console.print(f"{'time':>9}{'coldest':>10}{'hottest':>10}{'heat':>12}{'change':>12}", style="bold")
    # Diffusion slows down with time: each picture comes after four times as many steps as the last.
    pictures, moments = {steps // 4**k for k in range(1, 4)}, [surface.vertices.T.to_numpy()]
    for number in track(range(1, steps + 1), "diffusing", console=console, transient=True):
        largest = step(surface, dt, diffusivity)
        if number in pictures:
            moments.append(surface.vertices.T.to_numpy())
        if number % max(1, steps // 10) == 0 or largest < tolerance:
            low, high, total = totals(surface)
            console.print(f"{number * dt:8.4f}s{low:10.5f}{high:10.5f}{total:12.8f}{largest:12.3e}")
        if largest < tolerance:
            console.print(f"nothing changes by more than {tolerance:g} in a step any more")
            break
    return [*moments, surface.vertices.T.to_numpy()]


def save_state(path: Path, surface: TriMesh, points: np.ndarray, moments: list[np.ndarray], console: Console) -> None:
    """A picture of the moments, or the mesh with its last temperatures."""
    if path.suffix.lower() != ".png":
        surface.save(path, fields=["T"])
        console.print(f"saved {path}")
        return
    upright = points - [0, 0, points[:, 2].min()]
    triangles = surface.triangles.v.to_numpy()
    drawn = save_strip(path, [Surface(upright, triangles, colors(values**0.6)) for values in moments], elevation=32)
    console.print(f"drawn by {drawn}", markup=False)
    console.print(f"saved {path}")


if __name__ == "__main__":
    typer.run(main)
