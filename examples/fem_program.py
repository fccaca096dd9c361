"""The command line of the finite element programs: options, the mesh and its material, files, pictures, the summary."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer
from rich.console import Console

import ebb
from bodies import SURFACES, load_solid
from ebb.domains import TetMesh, TriMesh
from fem import Damping, Law, Material, SoftBody, Step, StepError, retreat
from options import Backend, Threads, check_output, finite, positive
from outputs import save_arrays, save_text
from pictures import CLAY, Surface, save_strip

MESHES = (".vtu", ".vtk", ".veg")
RESCUE = Path("last_good_state.npz")
SIDES = {f"{axis}{sign}": (number, sign) for number, axis in enumerate("xyz") for sign in "-+"}

# For each axis that is up, the rotation that makes it z.
UPRIGHT = (np.eye(3)[[2, 0, 1]], np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), np.eye(3))


@ebb.kernel
def find_place(v):
    v.place = ebb.vec3d(v.pos) + v.q


# What is given.


def load_mesh(name: str, resolution: int, refine: int, fix_orientation: bool, console: Console) -> TetMesh:
    """A bar, or the solid of a file, with self edges and positions in float64.

    Args:
        name: ``bar``: 1 x 0.2 x 0.2; a file of a solid, or of a closed surface, which is filled.
        resolution: how many cubes lie along the longest side, where the tetrahedra are made here.
        refine: how often each tetrahedron is divided into eight.
        fix_orientation: whether tetrahedra are turned that are inverted while others are not, rather than an error.
        console: where it is said that some have been turned.
    """
    options = {"self_edges": True, "precision": ebb.float64}
    suffix = Path(name).suffix.lower()
    if name == "bar":
        across = max(2, round(resolution / 5))
        mesh = TetMesh.box(resolution, across, across, (1.0, 0.2, 0.2), **options)
    elif suffix in SURFACES:
        mesh = TetMesh.from_surface(TriMesh.load(name), resolution=resolution, **options)
    else:
        mesh = load_solid(name, fix_orientation, console, **options)
    for _ in range(refine):
        mesh = mesh.refine()
    return mesh


def materials_of(mesh: TetMesh, young: float | None, poisson: float | None, density: float | None) -> list[Material]:
    """The materials of a VEG file, or one for all; what an option sets wins over the file."""

    def made(values: tuple[float, float, float], rows: npt.NDArray[np.int64] | None) -> Material:
        of_file = {"density": values[0], "young": values[1], "poisson": values[2]}
        options = {"density": density, "young": young, "poisson": poisson}
        chosen = {name: of_file[name] if value is None else value for name, value in options.items()}
        return Material(**chosen, rows=rows)

    found = [] if mesh.regions else [made((1000.0, 4e5, 0.4), None)]
    for region in mesh.regions:
        material = region.material
        if material.model.upper() != "ENU" or len(material.parameters) != 3:
            raise ValueError(f"material {material.name!r} is {material.model}, and must be ENU: density, E and nu")
        density_, young_, poisson_ = material.parameters
        try:
            found.append(made((density_, young_, poisson_), region.rows))
        except ValueError as error:
            raise ValueError(f"material {material.name!r}: {error}") from None
    return found


def fixed_vertices(given: str, points: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """The rows of the vertices to fix: those of a file, or of a side such as ``x-``: all within 1% of its plane.

    A file is .npy, or a text of numbers with commas or space between, where what follows a # on a line does not count.
    Numbers are from 0 on, but in a .bou file of Vega's from 1 on.
    """
    if given in SIDES:
        axis, sign = SIDES[given]
        low, high = points[:, axis].min(), points[:, axis].max()
        depth = 0.01 * float(np.ptp(points, axis=0).max())
        return np.flatnonzero(points[:, axis] <= low + depth if sign == "-" else points[:, axis] >= high - depth)
    try:
        if given.endswith(".npy"):
            rows = np.load(given)
        else:
            lines = [line.partition("#")[0] for line in Path(given).read_text().splitlines()]
            rows = np.array([float(word) for word in " ".join(lines).replace(",", " ").split()])
    except (OSError, ValueError) as error:
        raise ValueError(
            f"--fixed {given} is neither a file of vertex numbers nor one of {', '.join(SIDES)}: {error}"
        ) from None
    if rows.dtype.kind not in "iuf":
        raise ValueError(f"--fixed {given}: the numbers of vertices are integers, not {rows.dtype}")
    parts = rows[~(rows % 1 == 0)]
    if parts.size:
        raise ValueError(f"--fixed {given}: the numbers of vertices are integers, not {parts[0]:g}")
    return rows.astype(np.int64).ravel() - given.endswith(".bou")


def read_force(path: Path | None, size: int) -> npt.NDArray[np.float64]:
    """The external force on each vertex, shape (n, 3); none without a file."""
    if path is None:
        return np.zeros((size, 3))
    try:
        force = np.load(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"--force {path} cannot be read: {error}") from None
    if force.shape != (size, 3) or force.dtype.kind not in "fiu":
        found = f"{force.dtype} {force.shape}"
        raise ValueError(f"--force {path} must hold numbers of the shape ({size}, 3), and has {found}")
    endless = np.flatnonzero(~np.isfinite(force).all(axis=1))
    if endless.size:
        first = endless[0]
        raise ValueError(f"--force {path} is not finite in {endless.size} rows, the first is {first}: {force[first]}")
    return force.astype(np.float64)


def read_gravity(text: str) -> npt.NDArray[np.float64]:
    """Three numbers with commas between."""
    try:
        gravity = np.array([float(part) for part in text.split(",")])
    except ValueError:
        gravity = np.empty(0)
    if gravity.shape != (3,) or not np.isfinite(gravity).all():
        raise ValueError(f"--gravity is three numbers such as 0,-9.81,0, not {text!r}")
    return gravity


def check_outputs(saves: list[Path], dump: Path | None) -> None:
    """Check before a long run that what comes of it can be written."""
    for path in saves:
        check_output("--save", path, ".png", ".pvd", *MESHES)
    check_output("--dump", dump, ".npz")


# What comes out.


@dataclass
class Record:
    """What is kept of a run: moments for the picture, and if wanted all states and the frames of a VTK series."""

    body: SoftBody
    dt: float
    up: int
    series: list[Path]
    frames: set[int]
    pictured: set[int]
    whole: bool
    steps: list[Step] = field(default_factory=list)
    states: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    moments: list[np.ndarray] = field(default_factory=list)
    written: list[tuple[float, str]] = field(default_factory=list)

    def take(self, number: int, step: Step | None = None) -> None:
        """Keep what is wanted of the state after step ``number``; 0 is the start."""
        vertices = self.body.mesh.vertices
        if step is not None:
            self.steps.append(step)
            if self.whole:
                self.states.append((vertices.q.to_numpy(), vertices.qd.to_numpy()))
        if number in self.pictured:
            self.moments.append(places(self.body))
        if number in self.frames:
            for path in self.series:
                frame = path.with_name(f"{path.stem}_{number:06d}.vtu")
                save_solid(frame, self.body)
            self.written.append((number * self.dt, f"{number:06d}"))

    def save(self, saves: list[Path], dump: Path | None, console: Console) -> None:
        """Write all files."""
        for path in saves:
            if path.suffix.lower() == ".png":
                console.print(f"drawn by {save_picture(path, self)}", markup=False)
            elif path.suffix.lower() == ".pvd":
                save_text(path, collection(path.stem, self.written))
            else:
                save_solid(path, self.body)
        if dump is not None:
            self.dump(dump)
        for path in (*saves, *([] if dump is None else [dump])):
            console.print(f"saved {path}", markup=False)

    def dump(self, path: Path) -> None:
        """Write the displacements and velocities after each step, shape (steps, vertices, 3), and what each took."""
        n = self.body.mesh.vertices.size
        q, qd = (np.array([state[i] for state in self.states]).reshape(-1, n, 3) for i in range(2))
        counts = np.array([step.iterations for step in self.steps], dtype=np.int64)
        assembly, solve = (np.array([getattr(s, name) for s in self.steps]) for name in ("assembly", "solve"))
        save_arrays(path, q=q, v=qd, dt=self.dt, iterations=counts, assembly_s=assembly, solve_s=solve)


def places(body: SoftBody) -> np.ndarray:
    """Where the vertices are, shape (n, 3)."""
    return body.mesh.vertices.pos.to_numpy() + body.mesh.vertices.q.to_numpy()


def save_solid(path: Path, body: SoftBody) -> None:
    """Write the body where it is now, as VTK with displacements and velocities."""
    vertices = body.mesh.vertices
    if "place" not in vertices.fields:
        vertices.new_field("place", ebb.vec3d)
    find_place(vertices)
    body.mesh.save(path, positions="place", fields=[] if path.suffix.lower() == ".veg" else ["q", "qd"])


def save_picture(path: Path, record: Record) -> str:
    """Draw the moments side by side, upright, and say what drew them."""
    triangles = record.body.mesh.triangles.v.to_numpy()
    turned = [points @ UPRIGHT[record.up] for points in record.moments]
    low = np.min([points.min(axis=0) for points in turned], axis=0)
    size = max(float(np.ptp(points, axis=0).max()) for points in turned)
    lift = [0, 0, 0.02]
    return save_strip(path, [Surface((points - low) / size + lift, triangles, CLAY) for points in turned])


def collection(stem: str, written: list[tuple[float, str]]) -> str:
    """A series of VTK files as ParaView opens it, with the time of each."""
    files = "".join(f'<DataSet timestep="{t:.9g}" file="{stem}_{number}.vtu"/>\n' for t, number in written)
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
    return f"{head}{files}</Collection>\n</VTKFile>\n"


# The program.


def program(law: Law) -> Callable[..., None]:
    """The command line of the law's program."""

    def main(
        mesh: Annotated[
            str, typer.Option(help="bar, or a file: a solid (.veg, .npz with V and T, .vtu, ...) or a closed surface")
        ] = "bar",
        young: Annotated[float | None, typer.Option(help="Young's modulus; by default the file's, else 4e5")] = None,
        poisson: Annotated[float | None, typer.Option(help="Poisson's ratio; by default the file's, else 0.4")] = None,
        density: Annotated[float | None, typer.Option(help="by default the file's, else 1000")] = None,
        dt: Annotated[float, typer.Option(help="seconds a step", callback=positive)] = 0.01,
        steps: Annotated[int, typer.Option(help="how many", min=1)] = 100,
        damping_mass: Annotated[
            float, typer.Option(help="a in D = a M + b K, 1 / second", min=0, callback=finite)
        ] = 0.0,
        damping_stiffness: Annotated[
            float, typer.Option(help="b in D = a M + b K, seconds", min=0, callback=finite)
        ] = 0.0,
        gravity: Annotated[str, typer.Option(help="GX,GY,GZ")] = "0,-9.81,0",
        force: Annotated[Path | None, typer.Option(help="an .npy file: the force on each vertex, in rows of 3")] = None,
        fixed: Annotated[
            str | None,
            typer.Option(help="a file of vertex numbers (from 0; .bou from 1), or a side: x- x+ y- y+ z- z+"),
        ] = None,
        lumped_mass: Annotated[
            bool, typer.Option("--lumped-mass", help="a diagonal mass matrix; else the consistent one")
        ] = False,
        tolerance: Annotated[
            float, typer.Option(help="by which the linear solver makes the residual smaller", callback=positive)
        ] = 1e-6,
        newton: Annotated[
            int, typer.Option(help="most of Newton's iterations a step; 1 is the linearised step", min=1)
        ] = 1,
        static: Annotated[
            bool, typer.Option("--static", help="find the place of rest, rather than make steps in time")
        ] = False,
        resolution: Annotated[
            int, typer.Option(help="cubes along the longest side, where tetrahedra are made", min=2)
        ] = 20,
        refine: Annotated[int, typer.Option(help="how often to divide each tetrahedron into eight", min=0)] = 0,
        fix_orientation: Annotated[
            bool, typer.Option(help="turn tetrahedra that are inverted while others are not, rather than stop")
        ] = False,
        dump: Annotated[Path | None, typer.Option(help="an .npz file: q and v after each step")] = None,
        save: Annotated[
            list[Path] | None,
            typer.Option(
                help="a picture (.png), a VTK series (.pvd), or the last state (.vtu, .vtk, .veg); as often as wanted"
            ),
        ] = None,
        frames: Annotated[int, typer.Option(help="files in a VTK series", min=1)] = 50,
        backend: Backend = "cpu",
        threads: Threads = None,
    ) -> None:
        """Let a soft body move under its weight and other forces, or find where it comes to rest."""
        console = Console(highlight=False)
        saves = save or []
        try:
            check_outputs(saves, dump)
            ebb.set_backend(backend, **({} if threads is None else {"threads": threads}))
            solid = load_mesh(mesh, resolution, refine, fix_orientation, console)
            points = solid.vertices.pos.to_numpy()
            chosen = fixed or ("x-" if mesh == "bar" else None)
            body = SoftBody(
                solid,
                law,
                materials_of(solid, young, poisson, density),
                fixed=() if chosen is None else fixed_vertices(chosen, points),
                damping=Damping(damping_mass, damping_stiffness),
                lumped=lumped_mass,
            )
            pull = read_gravity(gravity)
            body.set_load(pull, read_force(force, len(points)))
            steps = 1 if static else steps
            console.print(
                f"{Path(mesh).stem}, {law.name}: {solid.tetrahedra.size} tetrahedra, {len(points)} vertices, "
                f"{int(body.fixed.sum())} of them fixed, " + ("at rest" if static else f"{steps} steps of {dt:g} s"),
                markup=False,
                soft_wrap=True,
            )
            record = Record(
                body,
                dt,
                up=int(np.argmax(np.abs(pull))) if pull.any() else 1,
                series=[path for path in saves if path.suffix.lower() == ".pvd"],
                frames=spread(steps, frames),
                pictured=spread(steps, 4),
                whole=dump is not None,
            )
            advance = (lambda: body.find_rest(tolerance)) if static else (lambda: body.step(dt, tolerance, newton))
            finish(record, simulate(record, steps, advance, console), saves, dump, console)
        except (ValueError, OSError, ebb.EbbError) as error:
            raise SystemExit(str(error)) from None

    return main


def spread(steps: int, count: int) -> set[int]:
    """The start, and at most ``count`` of the steps, as far apart as they can be, with the last among them."""
    count = min(count, steps)
    return {0, *(round(steps * (i + 1) / count) for i in range(count))}


def simulate(record: Record, steps: int, advance: Callable[[], Step], console: Console) -> str | None:
    """Make all steps, a line for each; what went wrong, if a step could not be made."""
    console.print(f"{'step':>6}{'iterations':>12}{'newton':>8}{'assembly':>12}{'solve':>12}", style="bold")
    record.take(0)
    started = time.perf_counter()
    try:
        for number in range(1, steps + 1):
            done = step_or_retreat(record.body, advance)
            record.take(number, done)
            times = f"{1e3 * done.assembly:9.2f} ms{1e3 * done.solve:9.2f} ms"
            console.print(f"{number:6d}{done.iterations:12d}{done.newton:8d}{times}")
    except StepError as failure:
        return f"step {len(record.steps) + 1}: {failure}"
    except KeyboardInterrupt:
        return f"interrupted after {len(record.steps)} steps"
    kinetic, elastic = record.body.energy()
    console.print(f"{time.perf_counter() - started:.2f} s in all; kinetic {kinetic:.6g}, elastic energy {elastic:.6g}")
    return None


def step_or_retreat(body: SoftBody, advance: Callable[[], Step]) -> Step:
    """Make a step; an interrupt leaves the body as it was before."""
    try:
        return advance()
    except KeyboardInterrupt:
        retreat(body.mesh.vertices)
        raise


def finish(record: Record, failure: str | None, saves: list[Path], dump: Path | None, console: Console) -> None:
    """Write what is wanted; after a failure the last good state, also where nothing is."""
    if failure is None:
        record.save(saves, dump, console)
        return
    vertices = record.body.mesh.vertices
    record.moments.append(places(record.body))
    if not saves and dump is None:
        dump = RESCUE
        record.states, record.steps = [(vertices.q.to_numpy(), vertices.qd.to_numpy())], record.steps[-1:]
    console.print("the last good state:", style="yellow")
    record.save(saves, dump, console)
    raise SystemExit(failure)
