"""Ebb: relations of the same rows, kernels over them."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

import ebb
from benchmarks.constants import AXPY_FACTOR, DT, PARTICLE_DT, PCG_ITERATIONS, STENCIL_CENTER, STENCIL_SIDE, STIFFNESS
from benchmarks.data import Arrays
from benchmarks.fluids import fluid_outputs
from benchmarks.solids import CG_ITERATIONS, DAMPING, DENSITY, GRAVITY, POISSON, SOLID_DT, TOLERANCE, YOUNG
from benchmarks.systems import Prepared, Programs, ebb_stencils
from ebb.domains import TetMesh

if os.environ["BENCHMARKS_SYSTEM"] == "reference":
    ebb.set_backend("reference")
else:
    ebb.set_backend("cpu", threads=int(os.environ["EBB_NUM_THREADS"]))


def version() -> str:
    return ebb.__version__


def mesh(arrays: Arrays, size: int) -> tuple[ebb.Relation, ebb.Relation]:
    """Vertices and their edges, as the domains of meshes have them."""
    vertices = ebb.Relation("vertices", size=size)
    edges = ebb.Relation("edges", size=len(arrays["tail"]))
    edges.new_field("tail", vertices, init=arrays["tail"])
    edges.new_field("head", vertices, init=arrays["head"])
    if "first" in arrays:
        edges.group_by("tail")

        @vertices.member("edges")
        def edges_of(v):
            return ebb.where(edges.tail, v)

    return vertices, edges


def springs(arrays: Arrays, code: str) -> Prepared:
    """The program of the paper's figure 1, its forces gathered or scattered."""
    vertices, edges = mesh(arrays, len(arrays["q"]))
    dt, K = DT, STIFFNESS  # noqa: N806 - the paper's names
    edges.new_field("rest_len", ebb.float32, init=arrays["rest_len"])
    vertices.new_field("mass", ebb.float32, init=arrays["mass"])
    vertices.new_field("q", ebb.vec3f, init=arrays["q"])
    vertices.new_field("qd", ebb.vec3f, init=arrays["qd"])
    vertices.new_field("force", ebb.vec3f, init=0.0)

    @ebb.kernel
    def gather(v: vertices):
        for e in v.edges:
            dq = e.head.q - v.q
            v.force += K * (e.rest_len * ebb.normalize(dq) - dq)

    @ebb.kernel
    def scatter(e: edges):
        dq = e.head.q - e.tail.q
        e.tail.force += K * (e.rest_len * ebb.normalize(dq) - dq)

    @ebb.kernel
    def scatter_to_both(e: edges):
        dq = e.head.q - e.tail.q
        pull = K * (e.rest_len * ebb.normalize(dq) - dq)
        e.tail.force += pull
        e.head.force -= pull

    @ebb.kernel
    def apply_forces(v: vertices):
        qdd = v.force / v.mass
        v.q += v.qd * dt + 0.5 * qdd * dt * dt
        v.qd += qdd * dt
        v.force = [0, 0, 0]

    forces = {"gather": gather, "scatter": scatter, "both-ends": scatter_to_both}[code]
    rows = vertices if code == "gather" else edges

    def run(steps: int) -> None:
        for _ in range(steps):
            forces(rows)
            apply_forces(vertices)

    return Prepared(run, lambda: {"q": vertices.q.to_numpy(), "qd": vertices.qd.to_numpy()})


def axpy_rows(arrays: Arrays) -> tuple[ebb.Relation, ebb.Kernel]:
    rows = ebb.Relation("rows", size=len(arrays["x"]))
    rows.new_field("x", ebb.float32, init=arrays["x"])
    rows.new_field("y", ebb.float32, init=arrays["y"])
    a = AXPY_FACTOR

    @ebb.kernel
    def axpy(r: rows):
        r.y = a * r.x + r.y

    return rows, axpy


def streaming(arrays: Arrays) -> Prepared:
    rows, axpy = axpy_rows(arrays)

    def run(steps: int) -> None:
        for _ in range(steps):
            axpy(rows)

    return Prepared(run, lambda: {"y": rows.y.to_numpy()})


def captured(arrays: Arrays) -> Prepared:
    rows, axpy = axpy_rows(arrays)
    with ebb.capture() as step:
        axpy(rows)
    return Prepared(step.run, lambda: {"y": rows.y.to_numpy()})


def stencil(arrays: Arrays) -> Prepared:
    cells = ebb.Relation("cells", shape=arrays["old"].shape)
    cells.new_field("old", ebb.float32, init=arrays["old"])
    cells.new_field("new", ebb.float32, init=arrays["new"])
    cells.new_subset("interior", (slice(1, -1),) * 3)
    center, side = STENCIL_CENTER, STENCIL_SIDE

    @cells.member("__call__")
    def neighbor(c, i, j, k):
        return ebb.affine(cells, [[1, 0, 0, i], [0, 1, 0, j], [0, 0, 1, k]], c)

    @ebb.kernel
    def relax(c: cells):
        sides = c(-1, 0, 0).old + c(1, 0, 0).old + c(0, -1, 0).old + c(0, 1, 0).old + c(0, 0, -1).old + c(0, 0, 1).old
        c.new = center * c.old + side * sides

    def run(steps: int) -> None:
        for _ in range(steps):
            relax(cells.interior)
            cells.swap("old", "new")

    return Prepared(run, lambda: {"old": cells.old.to_numpy()})


def heat(arrays: Arrays) -> Prepared:
    vertices, edges = mesh(arrays, len(arrays["old"]))
    edges.new_field("weight", ebb.float32, init=arrays["weight"])
    for name in ("rate", "old", "new"):
        vertices.new_field(name, ebb.float32, init=arrays[name])

    @ebb.kernel
    def diffuse(v: vertices):
        flow = ebb.float32(0)
        for e in v.edges:
            flow += e.weight * (e.head.old - v.old)
        v.new = v.old + v.rate * flow

    def run(steps: int) -> None:
        for _ in range(steps):
            diffuse(vertices)
            vertices.swap("old", "new")

    return Prepared(run, lambda: {"old": vertices.old.to_numpy()})


along, rz = ebb.Global(ebb.float64, 0.0), ebb.Global(ebb.float64, 0.0)


@ebb.kernel
def start(v):
    v.x = 0
    v.r = v.b
    v.p = v.b / v.diagonal
    rz.value += v.r * v.p


@ebb.kernel
def multiply(v):
    product = v.diagonal * v.p
    for e in v.edges:
        product -= e.weight * e.head.p
    v.product = product
    along.value += v.p * product


@ebb.kernel
def update(v, alpha: ebb.float32):
    v.x += alpha * v.p
    v.r -= alpha * v.product
    rz.value += v.r * v.r / v.diagonal


@ebb.kernel
def turn(v, beta: ebb.float32):
    v.p = v.r / v.diagonal + beta * v.p


def pcg(arrays: Arrays) -> Prepared:
    vertices, edges = mesh(arrays, len(arrays["b"]))
    edges.new_field("weight", ebb.float32, init=arrays["weight"])
    for name in ("diagonal", "b"):
        vertices.new_field(name, ebb.float32, init=arrays[name])
    for name in ("x", "r", "p", "product"):
        vertices.new_field(name, ebb.float32, init=0.0)

    def solve() -> None:
        rz.value = 0
        start(vertices)
        for _ in range(PCG_ITERATIONS):
            along.value = 0
            multiply(vertices)
            before = rz.value
            rz.value = 0
            update(vertices, before / along.value)
            turn(vertices, rz.value / before)

    def run(steps: int) -> None:
        for _ in range(steps):
            solve()

    return Prepared(run, lambda: {"x": vertices.x.to_numpy()})


def particles(arrays: Arrays, code: str) -> Prepared:
    """Each particle finds the dual cell that it is in; or it has a key of it, as in the figure of the paper."""
    from ebb.domains import Grid2D, Particles

    grid = Grid2D(arrays["vel"].shape[:2], extent=1.0, periodic=True)
    grid.cells.new_field("vel", ebb.vec2f, init=arrays["vel"])
    dust = Particles(arrays["pos"])
    dt = PARTICLE_DT

    @ebb.func
    def carried(pos, d):
        x, y = d.local(pos)
        low = (1 - x) * d.cell(0, 0).vel + x * d.cell(1, 0).vel
        high = (1 - x) * d.cell(0, 1).vel + x * d.cell(1, 1).vel
        return grid.wrap(pos + dt * ((1 - y) * low + y * high))

    @ebb.kernel
    def advect(p: dust):
        p.pos = carried(p.pos, grid.dual_locate(p.pos))

    @ebb.kernel
    def advect_by_keys(p: dust):
        p.pos = carried(p.pos, p.dual_cell)
        p.dual_cell = grid.dual_locate(p.pos)

    if code == "particles-keys":
        dust.couple(grid, cell=None)
    kernel = advect_by_keys if code == "particles-keys" else advect

    def run(steps: int) -> None:
        for _ in range(steps):
            kernel(dust)

    return Prepared(run, lambda: {"pos": dust.pos.to_numpy()})


def find_examples() -> None:
    sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))


def fluid(arrays: Arrays) -> Prepared:
    """The kernels of the example, on the benchmark's numbers."""
    find_examples()
    from fluids_fft import Fluid

    example = Fluid(len(arrays["u"]), viscosity=0.0)
    cells, waves, dust = example.grid.cells, example.frequencies, example.particles
    for name in ("u", "v"):
        cells.fields[name].load(arrays[name])
        waves.fields[name].load(arrays[f"waves_{name}"])
    dust.pos.load(arrays["pos"])

    def run(steps: int) -> None:
        for _ in range(steps):
            example.advect()
            example.diffuse_and_project()
            example.move()

    def outputs() -> Arrays:
        found = {f"waves_{name}": waves.fields[name].to_numpy() for name in ("u", "v")}
        return fluid_outputs(cells.carried_u.to_numpy(), cells.carried_v.to_numpy(), found, dust.pos.to_numpy())

    return Prepared(run, outputs)


def solid_mesh(arrays: Arrays) -> TetMesh:
    mesh = TetMesh.from_arrays(arrays["points"], arrays["corners"], self_edges=True, precision=ebb.float64)
    assert (mesh.edges.head.to_numpy() == arrays["head"]).all()
    return mesh


def soft_body(arrays: Arrays, law: str) -> tuple[TetMesh, Any]:
    """The body of an example, and its mesh."""
    find_examples()
    import fem

    mesh, material = solid_mesh(arrays), fem.Material(YOUNG, POISSON, DENSITY)
    fixed = np.flatnonzero(arrays["free"] == 0)
    body = fem.SoftBody(
        mesh, importlib.import_module(law).LAW, [material], fixed=fixed, damping=fem.Damping(0.0, DAMPING)
    )
    body.set_load(GRAVITY)
    mesh.vertices.q.load(arrays["moved"])
    return mesh, body


def solid_assembly(arrays: Arrays, law: str) -> Prepared:
    mesh, body = soft_body(arrays, law)
    from fem import clear_forces

    def run(steps: int) -> None:
        for _ in range(steps):
            clear_forces(mesh.vertices)
            body.assemble(0.0, 1.0)

    return Prepared(run, lambda: {"force": mesh.vertices.force.to_numpy(), "stiffness": mesh.edges.A.to_numpy()})


def solid_solver(arrays: Arrays) -> Prepared:
    from ebb.solvers import ConjugateGradients

    mesh = solid_mesh(arrays)
    vertices, edges = mesh.vertices, mesh.edges
    edges.new_field("A", ebb.mat3d, init=arrays["matrix"])
    vertices.new_field("b", ebb.vec3d, init=arrays["b"])
    vertices.new_field("x", ebb.vec3d, init=0.0)
    solver = ConjugateGradients(vertices.x, vertices.b, edges.A, preconditioner="jacobi")

    def run(steps: int) -> None:
        for _ in range(steps):
            vertices.x.fill(0.0)
            solver.solve(tolerance=0.0, most_iterations=CG_ITERATIONS)

    return Prepared(run, lambda: {"x": vertices.x.to_numpy()})


def solid(arrays: Arrays, law: str) -> Prepared:
    mesh, body = soft_body(arrays, law)

    def run(steps: int) -> None:
        for _ in range(steps):
            body.step(SOLID_DT, TOLERANCE)

    return Prepared(run, lambda: {"moved": mesh.vertices.q.to_numpy(), "velocity": mesh.vertices.qd.to_numpy()})


PROGRAMS: Programs = {
    **ebb_stencils.PROGRAMS,
    "fluid": fluid,
    "solid-assembly": lambda arrays: solid_assembly(arrays, "fem_stvk"),
    "rubber-assembly": lambda arrays: solid_assembly(arrays, "fem_neohookean"),
    "solid-solver": solid_solver,
    "solid": lambda arrays: solid(arrays, "fem_stvk"),
    "rubber": lambda arrays: solid(arrays, "fem_neohookean"),
    "gather": lambda arrays: springs(arrays, "gather"),
    "scatter": lambda arrays: springs(arrays, "scatter"),
    "both-ends": lambda arrays: springs(arrays, "both-ends"),
    "streaming": streaming,
    "stencil": stencil,
    "heat": heat,
    "pcg": pcg,
    "particles": lambda arrays: particles(arrays, "particles"),
    "particles-keys": lambda arrays: particles(arrays, "particles-keys"),
    "captured": captured,
}
