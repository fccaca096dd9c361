"""A fine surface follows a coarse solid.

Two meshes, coupled by a key field (Bernstein et al. 2015, "Coupling Domains"): each vertex of the fine surface has the
key of the tetrahedron that holds it, and four weights. The solid is twisted; a kernel over the surface gathers where
its vertices go, and another their normals.

    python examples/rendermesh.py --save out/rendermesh.png
    python examples/rendermesh.py --mesh bunny --save out/rendermesh.png
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

import ebb
from bodies import bunny_scan, fitted, what_bunny_lacks
from ebb.domains import TetMesh, TriMesh
from pictures import CLAY, Surface, save_strip

SLATE = np.array([0.55, 0.64, 0.70])

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
def find_normals(s):
    total = ebb.zeros(ebb.vec3f)
    for t in s.triangles:
        total += ebb.cross(t.v[1].q - t.v[0].q, t.v[2].q - t.v[0].q)
    s.normal = ebb.normalize(total)


@ebb.kernel
def measure_distance(s):
    farthest.value = max(farthest.value, ebb.length(s.q - s.pos))


def couple(skin: TriMesh, solid: TetMesh) -> None:
    """Give both meshes their fields: ``q`` is where a vertex is, ``tet`` and ``weights`` tie the skin to the solid."""
    solid.vertices.new_field("q", ebb.vec3f, init=solid.vertices.pos)
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


def distance(skin: TriMesh) -> float:
    """How far the vertex of the skin that is farthest from its first place is from it, in metres."""
    farthest.value = 0.0
    measure_distance(skin.vertices)
    return farthest.value


def load_skin(name: str, console: Console) -> TriMesh:
    """A torus on its edge, the bunny, or the closed surface of a file, 1 m along its longest side."""
    if name == "bunny":
        lacking = what_bunny_lacks()
        if lacking is None:
            points, triangles = bunny_scan()
            return TriMesh.from_arrays(fitted(points), triangles)
        console.print(f'The bunny needs {lacking} (pip install "ebblang[viz]"): a torus is twisted.', markup=False)
        name = "torus"
    surface = TriMesh.torus(1.0, 0.42, 240, 100) if name == "torus" else TriMesh.load(name)
    points, triangles = surface.vertices.pos.to_numpy(), surface.triangles.v.to_numpy()
    if name == "torus":
        points = points[:, [0, 2, 1]] * [1, -1, 1]
    return TriMesh.from_arrays(fitted(points), triangles)


def shown(skin: TriMesh, solid: TetMesh) -> list[Surface]:
    """The boundary of the solid, with its facets, and the skin, both as they are now."""
    floor = [0, 0, solid.vertices.pos.to_numpy()[:, 2].min()]
    facets = solid.vertices.q.to_numpy()[solid.triangles.v.to_numpy()].reshape(-1, 3)
    return [
        Surface(facets - floor, np.arange(len(facets)).reshape(-1, 3), SLATE),
        Surface(skin.vertices.q.to_numpy() - floor, skin.triangles.v.to_numpy(), CLAY),
    ]


def main(
    mesh: Annotated[str, typer.Option(help="torus, bunny, or the file of a closed surface")] = "torus",
    resolution: Annotated[int, typer.Option(help="tetrahedra of the solid along its longest side", min=1)] = 12,
    turns: Annotated[float, typer.Option(help="how far the solid is twisted, in turns a metre")] = 0.2,
    backend: Annotated[str, typer.Option(help="cpu, opencl, cuda or reference")] = "cpu",
    threads: Annotated[int | None, typer.Option(help="for cpu; by default all cores", min=1)] = None,
    save: Annotated[Path | None, typer.Option(help="a picture (.png), or the skin (.vtu, .vtk, .ply, .off)")] = None,
) -> None:
    """Twist a coarse solid, and let a fine surface follow."""
    console = Console(highlight=False)
    try:
        ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
        skin = load_skin(mesh, console)
        solid = TetMesh.from_surface(skin, resolution=resolution)
        console.print(f"{skin.vertices.size} points of the skin in {solid.tetrahedra.size} tetrahedra")
        couple(skin, solid)
        deform(skin, solid, 0.0)
        console.print(f"untwisted, the skin is off by {distance(skin):.2g} m at most")
        moments = shown(skin, solid)
        deform(skin, solid, turns)
        console.print(f"twisted by {turns:g} turns a metre, it has moved by {distance(skin):.3g} m at most")
        moments += shown(skin, solid)
        if save is not None and save.suffix == ".png":
            console.print(f"drawn by {save_strip(save, moments)}", markup=False)
        elif save is not None:
            skin.save(save, positions="q", fields=["normal"] if save.suffix in (".vtu", ".vtk") else [])
        if save is not None:
            console.print(f"saved {save}")
    except ebb.EbbError as error:
        raise SystemExit(str(error)) from None


if __name__ == "__main__":
    typer.run(main)
