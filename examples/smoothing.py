"""Noise is smoothed out of a surface of triangles and quadrangles, and out of a solid of polyhedra.

The vertices of a surface move towards the centres of the faces around them, weighted by area, and then back by a little
more, which takes the noise off without shrinking what it lies on (Taubin, "A Signal Processing Approach to Fair Surface
Design", 1995). Those of a solid move towards the centres of the cells around them, weighted by volume (Laplacian
smoothing), so that cells grow round and none is folded into another. What lies on the boundary stays.

    python examples/smoothing.py --save out/smoothing.png
    python examples/smoothing.py --mesh surface --method laplace --noise 0.5
    python examples/smoothing.py --mesh part.vtu --save smooth.vtu
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

import ebb
from ebb.domains import PolyMesh, TetMesh
from options import Backend, Threads, check_output, finite
from pictures import CLAY, Surface, save_strip

STEPS = 40
FORWARD = 0.6  # of the way to the mean of what is around a vertex
BACKWARD = 0.62  # with FORWARD: waves longer than some 14 faces stay (Taubin, section 3: 1 / 0.6 - 1 / 0.62 = 0.054)
SURFACES = (".vtu", ".vtk", ".ply", ".obj", ".off")
SOLIDS = (".vtu",)

NOISE = 0.35  # of the mean length of the edges at a vertex

SLATE = np.array([0.55, 0.64, 0.70])
ROUND = np.array([0.36, 0.58, 0.62])

bend = ebb.Global(ebb.float64, 0.0)
sharpest = ebb.Global(ebb.float64, 0.0)
volume = ebb.Global(ebb.float64, 0.0)
roundness = ebb.Global(ebb.float64, 0.0)
flattest = ebb.Global(ebb.float64, 0.0)
folded = ebb.Global(ebb.int64, 0)


@ebb.kernel
def shake(v, amount: ebb.float32):
    length, count = ebb.float32(0), 0
    for other in v.neighbors:
        length += ebb.length(other.pos - v.pos)
        count += 1
    v.new_pos = v.pos + amount * length / count * ebb.vec3f([ebb.randn(), ebb.randn(), ebb.randn()])


@ebb.kernel
def measure_faces(f):
    f.middle = f.center
    f.normal = f.area


@ebb.kernel
def measure_cells(c):
    middle = c.center
    inside, outside, wrong = ebb.float32(0), ebb.float32(0), 0
    for s in c.sides:
        pyramid = s.sign * ebb.dot(s.face.normal, s.face.middle - middle) / 3
        inside += pyramid
        outside += ebb.length(s.face.normal)
        if pyramid <= 0:
            wrong += 1
    c.middle, c.inside, c.wrong = middle, inside, wrong
    # 1 for a ball, less for anything else; 0.52 for a cube.
    c.roundness = 36 * 3.14159265 * inside * abs(inside) / outside**3


@ebb.kernel
def relax_on_faces(v, factor: ebb.float32):
    way, weight = ebb.zeros(ebb.vec3f), ebb.float32(0)
    for f in v.faces:
        area = ebb.length(f.normal)
        way += area * (f.middle - v.pos)
        weight += area
    v.new_pos = v.pos + factor * way / weight


@ebb.kernel
def relax_on_cells(v, factor: ebb.float32):
    way, weight = ebb.zeros(ebb.vec3f), ebb.float32(0)
    for c in v.cells:
        way += abs(c.inside) * (c.middle - v.pos)
        weight += abs(c.inside)
    v.new_pos = v.pos + factor * way / weight


# How good a mesh is.


@ebb.kernel
def measure_bends(e):
    total = ebb.zeros(ebb.vec3f)
    for f in e.faces:
        total += ebb.normalize(f.normal)
    angle = 2 * ebb.acos(min(1.0, ebb.length(total) / 2)) * 57.29578
    bend.value += angle
    sharpest.value = max(sharpest.value, angle)


@ebb.kernel
def measure_volume_below(f):
    volume.value += f.middle.z * f.normal.z


@ebb.kernel
def measure_roundness(c):
    roundness.value += c.roundness
    flattest.value = min(flattest.value, c.roundness)
    folded.value += c.wrong
    volume.value += c.inside


@dataclass(frozen=True)
class Quality:
    """What smoothing is to better, by name, and the volume: of a solid, or between a surface and the plane z = 0."""

    figures: dict[str, float]
    volume: float


def landscape(n: int) -> PolyMesh:
    """Hills of n x n squares, every second in two triangles, on a square of side 1 about the origin."""
    flat = PolyMesh.grid(n, n, split="checkered")
    points = flat.vertices.pos.to_numpy().astype(np.float64) - [0.5, 0.5, 0.0]
    x, y = points[:, 0], points[:, 1]
    points[:, 2] = 0.12 + 0.34 * np.exp(-14 * ((x + 0.1) ** 2 + y**2)) + 0.2 * np.exp(-40 * ((x - 0.26) ** 2 + y**2))
    faces, offsets = faces_of(flat)
    return PolyMesh.from_arrays(points, faces, face_offsets=offsets)


def foam(n: int) -> PolyMesh:
    """A cube of side 1 of polyhedra, most of 14 faces."""
    return PolyMesh.dual(TetMesh.box(n, n, n))


def faces_of(mesh: PolyMesh) -> tuple[np.ndarray, np.ndarray]:
    """The corners of all faces, and where those of each begin, and at last end."""
    counts = np.bincount(mesh.corners.face.to_numpy(), minlength=mesh.faces.size)
    return mesh.corners.vertex.to_numpy(), np.concatenate([[0], np.cumsum(counts)])


def prepare(mesh: PolyMesh, noise: float, seed: int) -> None:
    """Give the mesh its fields, and shake what is not on the boundary."""
    mesh.vertices.new_field("new_pos", ebb.vec3f, init=mesh.vertices.pos)
    mesh.faces.new_field("middle", ebb.vec3f, init=0.0)
    mesh.faces.new_field("normal", ebb.vec3f, init=0.0)
    mesh.cells.new_field("middle", ebb.vec3f, init=0.0)
    for name in ("inside", "roundness"):
        mesh.cells.new_field(name, ebb.float32, init=0.0)
    mesh.cells.new_field("wrong", ebb.int32, init=0)
    ebb.seed(seed)
    shake(mesh.vertices.interior, noise)
    mesh.vertices.swap("pos", "new_pos")
    observe(mesh)


def observe(mesh: PolyMesh) -> None:
    """Compute what faces and cells are now."""
    measure_faces(mesh.faces)
    measure_cells(mesh.cells)


def step(mesh: PolyMesh, method: str) -> None:
    """Move the vertices once."""
    if mesh.cells.size:
        _move(mesh, relax_on_cells, FORWARD)
    else:
        _move(mesh, relax_on_faces, FORWARD)
        if method == "taubin":
            _move(mesh, relax_on_faces, -BACKWARD)


def _move(mesh: PolyMesh, relax: ebb.Kernel, factor: float) -> None:
    mesh.vertices.copy("pos", "new_pos")
    relax(mesh.vertices.interior, factor)
    mesh.vertices.swap("pos", "new_pos")
    observe(mesh)


def measure(mesh: PolyMesh) -> Quality:
    """How good the mesh is now."""
    bend.value, sharpest.value, volume.value = 0.0, 0.0, 0.0
    roundness.value, flattest.value, folded.value = 0.0, np.inf, 0
    if mesh.cells.size:
        measure_roundness(mesh.cells)
        figures = {"roundness": roundness.value / mesh.cells.size, "least": flattest.value, "folded": folded.value}
    else:
        measure_bends(mesh.edges.interior)
        measure_volume_below(mesh.faces)
        figures = {"bend": bend.value / max(1, mesh.edges.interior.size), "sharpest": sharpest.value}
    return Quality(figures, volume.value)


def smooth(mesh: PolyMesh, steps: int, method: str, console: Console) -> None:
    """Make all steps, and tell from time to time how good the mesh has become."""
    quality = measure(mesh)
    console.print("".join(f"{name:>13}" for name in ("step", *quality.figures, "volume")), style="bold")
    console.print(row(0, quality))
    for number in track(range(1, steps + 1), "smoothing", console=console, transient=True):
        step(mesh, method)
        if number % max(1, steps // 5) == 0 or number == steps:
            console.print(row(number, measure(mesh)))


def row(number: int, quality: Quality) -> str:
    """A line of the table."""
    return "".join(f"{value:13.6g}" for value in (number, *quality.figures.values(), quality.volume))


# What is shown.


def shown(mesh: PolyMesh) -> Surface:
    """The faces of a surface, or of a solid those of the half behind, flat; round cells are blue, others red."""
    corners, offsets = faces_of(mesh)
    if mesh.cells.size:
        chosen, colors = cut_open(mesh)
    else:
        chosen = np.arange(mesh.faces.size)
        colors = np.where((np.diff(offsets) == 3)[:, None], CLAY, SLATE)
    points = mesh.vertices.pos.to_numpy()
    middles = mesh.faces.middle.to_numpy()
    counts = np.diff(offsets)[chosen]
    first = np.concatenate([[0], np.cumsum(counts)])
    # Every face has points of its own, so that it is drawn flat: its corners, and its middle, about which it is a fan.
    fan = np.repeat(np.arange(len(chosen)), counts)
    place = np.arange(len(fan))
    after = np.where(place + 1 == first[1:][fan], first[:-1][fan], place + 1)
    own = corners[offsets[:-1][chosen][fan] + place - first[:-1][fan]]
    return Surface(
        np.concatenate([points[own], middles[chosen]]),
        np.stack([place, after, len(fan) + fan], axis=1),
        np.concatenate([colors[fan], colors]),
    )


def cut_open(mesh: PolyMesh) -> tuple[np.ndarray, np.ndarray]:
    """The faces around the cells of the half behind, and the colours of those cells."""
    centres = mesh.cells.middle.to_numpy()
    kept = centres[:, 1] >= np.median(centres[:, 1])
    face, cell = mesh.sides.face.to_numpy(), mesh.sides.cell.to_numpy()
    seen = kept[cell] & (np.bincount(face, kept[cell], mesh.faces.size) == 1)[face]
    share = np.clip((mesh.cells.roundness.to_numpy() - 0.35) / 0.35, 0, 1)[cell[seen], None]
    return face[seen], share * ROUND + (1 - share) * CLAY


def placed(shape: Surface) -> Surface:
    """The shape with its middle over the origin, on the floor."""
    low, high = shape.points.min(axis=0), shape.points.max(axis=0)
    return Surface(shape.points - [*(low + high)[:2] / 2, low[2]], shape.triangles, shape.colors)


def save_meshes(path: Path, meshes: list[PolyMesh], moments: list[Surface], console: Console) -> None:
    """A picture of the meshes before and after, or the smooth mesh."""
    if path.suffix.lower() == ".png":
        console.print(f"drawn by {save_strip(path, [placed(m) for m in moments], elevation=32)}", markup=False)
    else:
        meshes[0].save(path)
    console.print(f"saved {path}", soft_wrap=True)


def load_meshes(mesh: str, size: int) -> dict[str, PolyMesh]:
    """The meshes that an option means, by what they are called."""
    made = {"surface": lambda: landscape(3 * size), "solid": lambda: foam(size)}
    if mesh == "both":
        return {name: make() for name, make in made.items()}
    return {mesh: made[mesh]() if mesh in made else PolyMesh.load(mesh)}


def check_options(mesh: str, method: str, save: Path | None) -> None:
    """Refuse, before anything is computed, what would fail at its end."""
    if method not in ("taubin", "laplace"):
        raise typer.BadParameter(f"--method should be taubin or laplace, not {method!r}")
    check_output("--save", save, ".png", *SURFACES)
    if mesh == "both" and save is not None and save.suffix.lower() != ".png":
        raise typer.BadParameter("two meshes do not go into one file: choose one by --mesh, or save a picture (.png)")


def main(
    mesh: Annotated[str, typer.Option(help="surface, solid, both, or a file of polygons or polyhedra")] = "both",
    size: Annotated[int, typer.Option(help="polyhedra along a side, and a third of the squares", min=2)] = 12,
    steps: Annotated[int, typer.Option(min=1)] = STEPS,
    method: Annotated[str, typer.Option(help="of a surface: taubin, or laplace, which shrinks it")] = "taubin",
    noise: Annotated[
        float | None,
        typer.Option(help=f"of the length of edges; by default {NOISE}, and none in a file", min=0, callback=finite),
    ] = None,
    seed: Annotated[int, typer.Option(help="of the noise")] = 1,
    backend: Backend = "cpu",
    threads: Threads = None,
    save: Annotated[Path | None, typer.Option(help="a picture (.png), or the smooth mesh (.vtu, .off, ...)")] = None,
) -> None:
    """Smooth a surface of triangles and quadrangles, and a solid of polyhedra."""
    console = Console(highlight=False)
    check_options(mesh, method, save)
    try:
        ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
        meshes, moments = load_meshes(mesh, size), []
        if any(chosen.cells.size for chosen in meshes.values()):
            check_output("--save", save, ".png", *SOLIDS)
        for name, chosen in meshes.items():
            made = name in ("surface", "solid")
            prepare(chosen, (NOISE if made else 0.0) if noise is None else noise, seed)
            console.print(f"{name}: {chosen}, {steps} steps", markup=False, soft_wrap=True)
            moments.append(shown(chosen))
            smooth(chosen, steps, method, console)
            moments.append(shown(chosen))
        if save is not None:
            save_meshes(save, list(meshes.values()), moments, console)
    except ebb.EbbError as error:
        raise SystemExit(str(error)) from None


if __name__ == "__main__":
    typer.run(main)
