"""A body of springs falls, bounces and settles.

The springs are the edges of a tetrahedral mesh (Bernstein et al. 2015, figure 1), here with gravity, a floor, damping,
and a pressure that keeps the volume of each tetrahedron: with springs alone a squashed body turns inside out.

    python examples/spring_mass.py --save out/ball.png
    python examples/spring_mass.py --mesh bunny --save out/bunny.png
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

import ebb
from bodies import Body, load_body
from ebb.domains import TetMesh
from options import Backend, Threads, check_output, finite, positive
from pictures import CLAY, Surface, save_strip

# In metres, kilograms and seconds, for a body 1 m across.
DENSITY = 1.0
STIFFNESS = 1400.0  # pascals: about Young's modulus of the springs
BULK = 1400.0  # pascals: the pressure for a change of volume
DAMPING = 2e-3  # seconds: by this much the force of a spring follows the rate of its stretch
FRICTION = 12.0  # 1 / second: how fast the floor stops what slides on it
GRAVITY = 9.81
SECONDS = 3.2

kinetic = ebb.Global(ebb.float64, 0.0)
elastic = ebb.Global(ebb.float64, 0.0)
height = ebb.Global(ebb.float64, 0.0)
fastest = ebb.Global(ebb.float64, 0.0)
fastest_spring = ebb.Global(ebb.float64, 0.0)


# What the mesh becomes. The kernels are typed by the relation that they are launched on, so they fit every mesh.


@ebb.kernel
def init_rest_length(e):
    e.rest_len = ebb.length(e.head.pos - e.tail.pos)


@ebb.kernel
def init_mass_and_stiffness(t):
    volume = ebb.float32(t.volume)
    for i in range(4):
        t.v[i].mass += DENSITY * volume / 4
        for j in range(4):
            if i != j:
                rest_len = t.e[i, j].rest_len
                t.e[i, j].stiffness += STIFFNESS * volume / (6 * rest_len * rest_len)


@ebb.kernel
def find_fastest(t):
    # Squared frequencies of one tetrahedron by itself: of its springs (Gershgorin's bound), and with its pressure.
    springs = 0.0
    for i in range(4):
        at_corner = 0.0
        for j in range(4):
            if i != j:
                d = t.v[j].pos - t.v[i].pos
                at_corner += STIFFNESS / (6 * ebb.dot(d, d))
        springs = max(springs, 8 * at_corner / DENSITY)
    n1, n2, n3, volume = gradients(t.v[0].pos, t.v[1].pos, t.v[2].pos, t.v[3].pos)
    n0 = n1 + n2 + n3
    squares = ebb.dot(n0, n0) + ebb.dot(n1, n1) + ebb.dot(n2, n2) + ebb.dot(n3, n3)
    fastest_spring.value = max(fastest_spring.value, springs)
    fastest.value = max(fastest.value, springs + 4 * BULK * squares / (DENSITY * volume * volume))


# A step.


@ebb.kernel
def compute_internal_forces(v):
    for e in v.edges:
        dq = e.head.q - v.q
        length = ebb.length(dq)
        direction = dq / length
        rate = ebb.dot(e.head.qd - v.qd, direction)
        v.force += e.stiffness * (length - e.rest_len + DAMPING * rate) * direction


@ebb.kernel
def keep_volume(t):
    n1, n2, n3, volume = gradients(t.v[0].q, t.v[1].q, t.v[2].q, t.v[3].q)
    pressure = BULK * (1 - volume / ebb.float32(t.volume))
    t.v[0].force -= pressure * (n1 + n2 + n3)
    t.v[1].force += pressure * n1
    t.v[2].force += pressure * n2
    t.v[3].force += pressure * n3


@ebb.kernel
def apply_forces(v, dt: ebb.float32):
    v.qd += (v.force / v.mass - [0, 0, GRAVITY]) * dt
    v.q += v.qd * dt
    if v.q.z < 0:
        v.q.z = 0
        slide = max(0, 1 - FRICTION * dt)
        v.qd = [slide * v.qd.x, slide * v.qd.y, max(0, v.qd.z)]
    v.force = [0, 0, 0]


@ebb.func
def gradients(a, b, c, d):
    """How the volume of a tetrahedron grows as its corners b, c and d move, and the volume."""
    u, v, w = b - a, c - a, d - a
    n = ebb.cross(v, w) / 6
    return n, ebb.cross(w, u) / 6, ebb.cross(u, v) / 6, ebb.dot(u, n)


# What is measured, and shown.


@ebb.kernel
def measure_motion(v):
    kinetic.value += 0.5 * v.mass * ebb.dot(v.qd, v.qd)
    height.value += GRAVITY * v.mass * v.q.z


@ebb.kernel
def measure_springs(e):
    stretch = ebb.length(e.head.q - e.tail.q) - e.rest_len
    elastic.value += 0.25 * e.stiffness * stretch * stretch  # each spring is two edges


@ebb.kernel
def measure_volume(t):
    volume = gradients(t.v[0].q, t.v[1].q, t.v[2].q, t.v[3].q)[3]
    elastic.value += 0.5 * BULK * t.volume * (volume / t.volume - 1) ** 2


@ebb.kernel
def follow(s):
    q = ebb.zeros(ebb.vec3f)
    for i in range(4):
        q += s.weights[i] * s.tet.v[i].q
    s.q = q


@dataclass(frozen=True)
class Energy:
    """The energy of a body, in joules: of its motion, of its springs and volumes, and of its height."""

    kinetic: float
    elastic: float
    height: float

    @property
    def total(self) -> float:
        """All of it; damping and the floor only take from it."""
        return self.kinetic + self.elastic + self.height


def prepare(body: Body, drop: float) -> None:
    """Give the mesh its fields; the lowest point starts ``drop`` metres above the floor z = 0."""
    vertices, edges, tetrahedra = body.solid.vertices, body.solid.edges, body.solid.tetrahedra
    start = vertices.pos.to_numpy()
    start[:, 2] += drop - start[:, 2].min()
    vertices.new_field("mass", ebb.float32, init=0.0)
    vertices.new_field("q", ebb.vec3f, init=start)
    vertices.new_field("qd", ebb.vec3f, init=0.0)
    vertices.new_field("force", ebb.vec3f, init=0.0)
    edges.new_field("rest_len", ebb.float32)
    edges.new_field("stiffness", ebb.float32, init=0.0)
    init_rest_length(edges)
    init_mass_and_stiffness(tetrahedra)
    if body.skin is not None:
        # Each point of the skin is a combination of the corners of the tetrahedron that holds it.
        skin = body.skin.vertices
        rows, weights = body.solid.embed(skin.pos.to_numpy())
        skin.new_field("tet", tetrahedra, init=rows)
        skin.new_field("weights", ebb.vec4f, init=weights)
        skin.new_field("q", ebb.vec3f, init=skin.pos)


def stable_step(mesh: TetMesh) -> float:
    """A time step with which the motion is stable, in seconds.

    No mode of a body is faster than the fastest of its elements by themselves. The explicit scheme (symplectic Euler)
    bears steps up to 2 / omega, less with damping, which here is in proportion to the stiffness of the springs
    (Belytschko, Liu and Moran, "Nonlinear Finite Elements for Continua and Structures", section 6.6). The last tenth is
    for elements that turn stiffer as they are squashed.
    """
    fastest.value = fastest_spring.value = 0.0
    find_fastest(mesh.tetrahedra)
    omega = fastest.value**0.5
    damping_ratio = DAMPING * fastest_spring.value / (2 * omega)
    return 0.9 * 2 / omega * ((1 + damping_ratio**2) ** 0.5 - damping_ratio)


def step(mesh: TetMesh, dt: float) -> None:
    """Advance the body by ``dt`` seconds."""
    compute_internal_forces(mesh.vertices)
    keep_volume(mesh.tetrahedra)
    apply_forces(mesh.vertices, dt)


def measure(mesh: TetMesh) -> Energy:
    """The energy of the body now."""
    for part in (kinetic, elastic, height):
        part.value = 0.0
    measure_motion(mesh.vertices)
    measure_springs(mesh.edges)
    measure_volume(mesh.tetrahedra)
    return Energy(kinetic.value, elastic.value, height.value)


def surface(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """The points of the body's surface now, shape (n, 3), and its triangles, shape (m, 3)."""
    if body.skin is None:
        return body.solid.vertices.q.to_numpy(), body.solid.triangles.v.to_numpy()
    follow(body.skin.vertices)
    return body.skin.vertices.q.to_numpy(), body.skin.triangles.v.to_numpy()


def simulate(body: Body, steps: int, dt: float, console: Console) -> list[np.ndarray]:
    """Let the body fall, print its energy now and then, and return about 120 moments of its surface."""
    console.print(f"{'time':>8}{'kinetic':>11}{'elastic':>11}{'height':>11}{'total':>11}   (joules)", style="bold")
    columns = (TextColumn("falling"), BarColumn(), TextColumn("{task.completed} of {task.total} steps"))
    moments = [surface(body)[0]]
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as progress:
        task = progress.add_task("", total=steps)
        for number in range(1, steps + 1):
            step(body.solid, dt)
            if number % max(1, steps // 120) == 0:
                moments.append(surface(body)[0])
                progress.update(task, completed=number)
            if number % max(1, steps // 12) == 0:
                e = measure(body.solid)
                console.print(f"{number * dt:7.3f}s{e.kinetic:11.5f}{e.elastic:11.5f}{e.height:11.5f}{e.total:11.5f}")
                if not np.isfinite(e.total):
                    raise typer.BadParameter(f"the motion grows without bound: the time step {dt:g} is too large")
    return moments


def choose_moments(moments: list[np.ndarray], count: int = 5) -> list[np.ndarray]:
    """The start, the turning points of the height (hit, top of the bounce, hit, ...), and the end."""
    heights = np.array([points[:, 2].mean() for points in moments])
    rise = np.sign(np.diff(heights))
    turns = np.flatnonzero(rise[1:] * rise[:-1] < 0) + 1
    chosen = [0, *turns[: count - 2].tolist(), len(moments) - 1]
    return [moments[i] for i in sorted(set(chosen))]


def main(
    mesh: Annotated[str, typer.Option(help="ball, bunny, or a file: a solid, or a closed surface to fill")] = "ball",
    steps: Annotated[int | None, typer.Option(help=f"how many; by default {SECONDS} seconds", min=1)] = None,
    dt: Annotated[
        float | None, typer.Option(help="seconds a step; by default what is stable", callback=positive)
    ] = None,
    drop: Annotated[
        float, typer.Option(help="metres from the floor to the lowest point", min=0, callback=finite)
    ] = 0.4,
    resolution: Annotated[int, typer.Option(help="tetrahedra along the longest side", min=2)] = 20,
    backend: Backend = "cpu",
    threads: Threads = None,
    save: Annotated[Path | None, typer.Option(help="a picture (.png), or the last state (.vtu, .vtk, .veg)")] = None,
) -> None:
    """Drop a body of springs on the floor."""
    console = Console(highlight=False)
    check_output("--save", save, ".png", ".vtu", ".vtk", ".veg")
    started = time.perf_counter()
    try:
        ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
        body = load_body(mesh, resolution)
        if body.note:
            console.print(body.note, style="yellow", markup=False)
        prepare(body, drop)
        dt = dt or stable_step(body.solid)
        steps = steps or round(SECONDS / dt)
        console.print(f"{body.name}: {body.solid.tetrahedra.size} tetrahedra, {steps} steps of {dt:.3g} s")
        moments = simulate(body, steps, dt, console)
        if save is not None and save.suffix.lower() == ".png":
            triangles = surface(body)[1]
            drawn = save_strip(save, [Surface(points, triangles, CLAY) for points in choose_moments(moments)])
            console.print(f"drawn by {drawn}", markup=False)
        elif save is not None:
            body.solid.save(save, positions="q", fields=[] if save.suffix.lower() == ".veg" else ["qd"])
        if save is not None:
            console.print(f"saved {save}")
    except ebb.EbbError as error:
        raise SystemExit(str(error)) from None
    console.print(f"{time.perf_counter() - started:.1f} s in all")


if __name__ == "__main__":
    typer.run(main)
