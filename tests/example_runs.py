"""The examples at small sizes, a step at a time."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import ebb
from ebb.domains import Grid2D, Grid3D, PolyMesh, TetMesh, TriMesh

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))

import fem
import fem_stvk
import fluids_fft
import grid_particles
import heat
import lulesh
import rendermesh
import smoothing
import spring_mass
import stable_fluids
from bodies import Body

Example = tuple[Callable[[int], object], tuple[ebb.Relation, ...]]
"""What advances an example and gives the numbers that it prints, and the relations that it keeps its state in."""


def falling_body() -> Example:
    skin = TriMesh.icosphere(1, 0.5)
    body = Body("ball", TetMesh.from_surface(skin, resolution=3), skin)
    spring_mass.prepare(body, 0.01)
    body.solid.vertices.qd.load([0.3, 0.0, -1.0])
    dt = spring_mass.stable_step(body.solid)

    def step(number: int) -> object:
        spring_mass.step(body.solid, dt)
        spring_mass.surface(body)
        energy = spring_mass.measure(body.solid)
        return energy.kinetic, energy.elastic, energy.height

    return step, (body.solid.vertices, body.solid.edges, body.solid.tetrahedra, body.skin.vertices)


def heated_torus() -> Example:
    mesh = TriMesh.torus(1, 0.4, 8, 5)
    heat.prepare(mesh, np.random.default_rng(2).random(mesh.vertices.size))
    dt = heat.stable_step(mesh, 1.0)
    return lambda number: (heat.step(mesh, dt, 1.0), *heat.totals(mesh)), (mesh.vertices, mesh.edges, mesh.triangles)


def twisted_torus() -> Example:
    skin = TriMesh.torus(1.0, 0.4, 8, 5)
    solid = TetMesh.from_surface(skin, resolution=4)
    rendermesh.couple(skin, solid)

    def step(number: int) -> object:
        rendermesh.deform(skin, solid, 0.05 * number)
        return rendermesh.distance(skin)

    return step, (skin.vertices, solid.vertices)


def carried_particles(flow: str, order: int) -> Example:
    chosen = grid_particles.FLOWS[flow]
    start = np.random.default_rng(1).random((60, len(chosen.shape))) * chosen.extent
    tracers = grid_particles.Tracers(chosen, 4, start, order)

    def step(number: int) -> object:
        tracers.step(chosen.dt)
        tracers.deposit()
        return tracers.time

    return step, (tracers.particles, tracers.grid.cells)


def flowing(scene: str, shape: tuple[int, ...], physics: stable_fluids.Physics) -> Example:
    chosen = stable_fluids.SCENES[scene]
    make = Grid2D if len(shape) == 2 else Grid3D
    grid = make(shape, extent=tuple(n / shape[0] for n in shape), periodic=chosen.periodic)
    fluid = stable_fluids.Fluid(grid, physics)
    chosen.fill(grid)

    def step(number: int) -> object:
        return fluid.step(0.05).turns, *fluid.measure()

    return step, (grid.cells, *grid.faces)


VISCOUS = stable_fluids.Physics(1e-3, buoyancy=1.0, advection="linear", method="gauss-seidel", tolerance=0.1)


def stirred_fluid() -> Example:
    fluid = fluids_fft.Fluid(12)

    def step(number: int) -> object:
        fluids_fft.drag(fluid, 20 * number, fluids_fft.FORCE)
        fluid.step()
        return float(fluid.velocity().max())

    return step, (fluid.grid.cells, fluid.particles)


def smoothed(mesh: PolyMesh) -> Example:
    smoothing.prepare(mesh, 0.2, 3)

    def step(number: int) -> object:
        smoothing.step(mesh, "taubin" if number % 2 else "laplace")
        quality = smoothing.measure(mesh)
        return *quality.figures.values(), quality.volume

    return step, tuple(relation for relation in (mesh.vertices, mesh.faces, mesh.cells) if relation.size)


def hanging_body() -> Example:
    mesh = TetMesh.box(1, 1, 1, self_edges=True, precision=ebb.float64)
    body = fem.SoftBody(mesh, fem_stvk.LAW, [fem.Material(1000.0, 0.3, 2.0)], fixed=[0, 1, 2, 3])
    body.set_load((0.0, 0.0, -9.81))

    def step(number: int) -> object:
        body.step(0.02, tolerance=1e-4)
        return body.energy()

    return step, (mesh.vertices, mesh.edges, mesh.tetrahedra)


def blast(mesh: str) -> Example:
    sedov = lulesh.Sedov(3, regions=3, mesh=mesh)

    def step(number: int) -> object:
        sedov.run(1)
        return sedov.time, sedov.dt, *sedov.symmetry(), sedov.origin_energy()

    return step, (sedov.zones, sedov.nodes)


EXAMPLES: dict[str, Callable[[], Example]] = {
    "spring_mass": falling_body,
    "heat": heated_torus,
    "rendermesh": twisted_torus,
    "fluids_fft": stirred_fluid,
    "lulesh unstructured": lambda: blast("unstructured"),
    "lulesh on a grid": lambda: blast("grid"),
    "smoothing of a surface": lambda: smoothed(smoothing.landscape(4)),
    "smoothing of a solid": lambda: smoothed(PolyMesh.dual(TetMesh.box(2, 1, 1))),
    "fem_stvk": hanging_body,
    "grid_particles in a plane": lambda: carried_particles("gyre", 4),
    "stable_fluids in a plane": lambda: flowing("dye", (4, 4), stable_fluids.Physics(tolerance=0.1)),
    "stable_fluids in space": lambda: flowing("smoke", (4, 2, 4), VISCOUS),
    "grid_particles in space": lambda: carried_particles("abc", 2),
}
