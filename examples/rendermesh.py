"""A fine surface follows a coarse solid.

Two meshes, coupled by a key field (Bernstein et al. 2015, "Coupling Domains"): each vertex of the fine surface has the
key of the tetrahedron that holds it, and four weights. A kernel over the surface gathers where its vertices go, and
another their normals. The solid is twisted, or with ``--motion sway`` it is a soft body of finite elements (fem.py),
which is held at its foot and pulled to the side by its weight.

    python examples/rendermesh.py --save out/rendermesh.png
    python examples/rendermesh.py --mesh bunny --motion sway --save out/bunny.png
    python examples/rendermesh.py --mesh dragon_surface.off --solid dragon.veg --motion sway --save out/dragon.png
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

import ebb
import fem
import fem_neohookean
from bodies import bunny_surface, fitted, load_solid
from ebb.domains import TetMesh, TriMesh
from options import Backend, Threads, check_output, finite, positive
from pictures import CLAY, Surface, save_strip

SLATE = np.array([0.55, 0.64, 0.70])

# Of the soft body, for one of the length 1: a tenth of it, at the bottom, is held.
RUBBER = fem.Material(young=1.2e5, poisson=0.4, density=1000.0)
HELD = 0.1
PULL = np.array([9.81, 0.0, -9.81])
MOMENTS = 4

SKINS = (".vtu", ".vtk", ".ply", ".off")

farthest = ebb.Global(ebb.float64, 0.0)


@ebb.kernel
def twist(v, turns: ebb.float32):
    angle = 2 * 3.14159265 * turns * v.pos.z
    c, s = ebb.cos(angle), ebb.sin(angle)
    v.q = [c * v.pos.x - s * v.pos.y, s * v.pos.x + c * v.pos.y, v.pos.z]


@ebb.kernel
def follow(s):
    q = ebb.zeros(ebb.vec3f)
    for i in range(4):
        q += s.weights[i] * s.tet.v[i].q
    s.q = q


@ebb.kernel
def follow_body(s):
    shift = ebb.zeros(ebb.vec3d)
    for i in range(4):
        shift += s.weights[i] * s.tet.v[i].q  # which is a displacement here
    s.q = s.pos + ebb.vec3f(shift)


@ebb.kernel
def find_normals(s):
    total = ebb.zeros(ebb.vec3f)
    for t in s.triangles:
        total += ebb.cross(t.v[1].q - t.v[0].q, t.v[2].q - t.v[0].q)
    s.normal = ebb.normalize(total)


@ebb.kernel
def measure_distance(s):
    farthest.value = max(farthest.value, ebb.length(s.q - s.pos))


class Motion(StrEnum):
    """What the solid does."""

    TWIST = "twist"
    SWAY = "sway"


def couple(skin: TriMesh, solid: TetMesh) -> None:
    """Give both meshes their fields: ``q`` is where a vertex is, and the skin is tied to the solid."""
    solid.vertices.new_field("q", ebb.vec3f, init=solid.vertices.pos)
    tie(skin, solid)


def tie(skin: TriMesh, solid: TetMesh) -> None:
    """Give the skin its fields: ``tet`` and ``weights`` say where in the solid it is, ``q`` where it is now."""
    rows, weights = solid.embed(skin.vertices.pos.to_numpy())
    skin.vertices.new_field("tet", solid.tetrahedra, init=rows)
    skin.vertices.new_field("weights", ebb.vec4f, init=weights)
    skin.vertices.new_field("q", ebb.vec3f, init=skin.vertices.pos)
    skin.vertices.new_field("normal", ebb.vec3f, init=0.0)


def deform(skin: TriMesh, solid: TetMesh, turns: float) -> None:
    """Twist the solid about the z axis by ``turns`` a metre, and let the skin follow."""
    twist(solid.vertices, turns)
    follow(skin.vertices)
    find_normals(skin.vertices)


def soft_body(solid: TetMesh) -> fem.SoftBody:
    """A body of rubber that is held at its foot and pulled to the side; it is as stiff as is right for its size."""
    points = solid.vertices.pos.to_numpy()
    low, size = points[:, 2].min(), float(np.ptp(points, axis=0).max())
    held = np.flatnonzero(points[:, 2] < low + HELD * np.ptp(points[:, 2]))
    rubber = fem.Material(RUBBER.young * size, RUBBER.poisson, RUBBER.density)
    body = fem.SoftBody(solid, fem_neohookean.LAW, [rubber], fixed=held, damping=fem.Damping(0.0, 0.01))
    body.set_load(PULL)
    return body


def sway(skin: TriMesh, body: fem.SoftBody, steps: int, dt: float) -> Iterator[int]:
    """Let the body move, and the skin with it, and give the number of each step that is done."""
    for number in range(1, steps + 1):
        body.step(dt, newton=10)
        follow_body(skin.vertices)
        find_normals(skin.vertices)
        yield number


def distance(skin: TriMesh) -> float:
    """How far the vertex of the skin that is farthest from its first place is from it, in metres."""
    farthest.value = 0.0
    measure_distance(skin.vertices)
    return farthest.value


def load_skin(name: str, console: Console, fit: bool = True) -> TriMesh:
    """A torus on its edge, the bunny, or the surface of a file, 1 m along its longest side if ``fit``."""
    if name == "bunny":
        found = bunny_surface(console, "a torus is twisted")
        if found is not None:
            return found
        name = "torus"
    surface = TriMesh.torus(1.0, 0.42, 240, 100) if name == "torus" else TriMesh.load(name, manifold=False)
    points, triangles = surface.vertices.pos.to_numpy(), surface.triangles.v.to_numpy()
    if name == "torus":
        points = points[:, [0, 2, 1]] * [1, -1, 1]
    return TriMesh.from_arrays(fitted(points) if fit else points, triangles, manifold=False)


def shown(skin: TriMesh, solid: TetMesh, place: np.ndarray) -> list[Surface]:
    """The boundary of the solid, with its facets, whose vertices are at ``place``, and the skin as it is now."""
    floor = [0, 0, solid.vertices.pos.to_numpy()[:, 2].min()]
    facets = place[solid.triangles.v.to_numpy()].reshape(-1, 3)
    return [
        Surface(facets - floor, np.arange(len(facets)).reshape(-1, 3), SLATE),
        Surface(skin.vertices.q.to_numpy() - floor, skin.triangles.v.to_numpy(), CLAY),
    ]


def run(motion: Motion, skin: TriMesh, solid: TetMesh, turns: float, steps: int, dt: float) -> list[Surface]:
    """Move the solid, and the skin with it; what there is to see of it, at moments."""
    if motion is Motion.TWIST:
        couple(skin, solid)
        moments = []
        for share in (0.0, 1.0):
            deform(skin, solid, share * turns)
            moments += shown(skin, solid, solid.vertices.q.to_numpy())
        return moments
    body = soft_body(solid)
    tie(skin, solid)
    rest = solid.vertices.pos.to_numpy()
    moments = shown(skin, solid, rest)
    for number in sway(skin, body, steps, dt):
        if number * (MOMENTS - 1) % steps < MOMENTS - 1:
            moments += shown(skin, solid, rest + solid.vertices.q.to_numpy())
    return moments


def main(
    mesh: Annotated[str, typer.Option(help="torus, bunny, or the file of a surface, closed if there is no solid")] = (
        "torus"
    ),
    solid: Annotated[str | None, typer.Option(help="the file of a solid that holds the surface of the file")] = None,
    resolution: Annotated[int, typer.Option(help="tetrahedra of the solid along its longest side", min=1)] = 12,
    fix_orientation: Annotated[
        bool, typer.Option(help="turn tetrahedra of the solid's file that are inverted while others are not")
    ] = False,
    motion: Annotated[Motion, typer.Option(help="twist: about the z axis; sway: a soft body")] = Motion.TWIST,
    turns: Annotated[float, typer.Option(help="how far the solid is twisted, in turns a metre", callback=finite)] = 0.2,
    steps: Annotated[int, typer.Option(help="of the soft body", min=1)] = 45,
    dt: Annotated[float, typer.Option(help="seconds a step of the soft body", callback=positive)] = 0.01,
    backend: Backend = "cpu",
    threads: Threads = None,
    save: Annotated[Path | None, typer.Option(help="a picture (.png), or the skin (.vtu, .vtk, .ply, .off)")] = None,
) -> None:
    """Move a coarse solid, and let a fine surface follow."""
    console = Console(highlight=False)
    check_output("--save", save, ".png", *SKINS)
    if fix_orientation and solid is None:
        raise typer.BadParameter("there is no --solid whose tetrahedra it could turn", param_hint="--fix-orientation")
    try:
        ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
        skin = load_skin(mesh, console, fit=solid is None)
        options = {"self_edges": True, "precision": ebb.float64} if motion is Motion.SWAY else {}
        if solid is None:
            body = TetMesh.from_surface(skin, resolution=resolution, **options)
        else:
            body = load_solid(solid, fix_orientation, console, **options)
        console.print(f"{skin.vertices.size} points of the skin in {body.tetrahedra.size} tetrahedra")
        moments = run(motion, skin, body, turns, steps, dt)
        how = f"{turns:g} turns a metre" if motion is Motion.TWIST else f"{steps} steps of {dt:g} s"
        console.print(f"after {how}, the skin has moved by {distance(skin):.3g} m at most")
        if save is not None and save.suffix.lower() == ".png":
            console.print(f"drawn by {save_strip(save, moments)}", markup=False)
        elif save is not None:
            skin.save(save, positions="q", fields=["normal"] if save.suffix.lower() in (".vtu", ".vtk") else [])
        if save is not None:
            console.print(f"saved {save}")
    except (ValueError, ebb.EbbError, fem.StepError) as error:
        raise SystemExit(str(error)) from None


if __name__ == "__main__":
    typer.run(main)
