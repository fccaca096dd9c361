"""Soft bodies of tetrahedra: mass, stiffness, and implicit steps in time, whatever the material.

A body is a `TetMesh` with self edges: its edges are the sparsity of the matrices, and ``t.e[i, j]`` is the block by
which corner j of a tetrahedron acts on corner i. The law of the material is two kernels over the tetrahedra (`Law`),
which fem_stvk.py, fem_neohookean.py and fem_corotational.py give; this module has all that they share.

Elements are linear: F = I + sum_j u_j outer g_j, where u_j is the displacement of corner j and g_j the gradient of its
shape function (Sifakis and Barbic, "FEM simulation of 3D deformable solids", SIGGRAPH 2012 course notes, part 1,
chapter 4; DOI 10.1145/2343483.2343501). A step is backward Euler, linearised about the present state: with
D = a M + b K and A = M + h D + h^2 K,

    A dv = h (f_ext - f_int(q) - (h K + D) v),   v += dv,   q += h v

which Vega FEM takes too (Barbic, Sin and Schroeder, 2012), or Newton's iteration for the step that is not linearised
(``newton`` of `SoftBody.step`). Fixed vertices are removed from the system. Units are those of the mesh: with metres,
kilograms and seconds, moduli are in pascals.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import ebb
from ebb.domains import TetMesh
from ebb.solvers import ConjugateGradients, Reason

LARGE = 50_000
"""Vertices from which on it matters where they lie in memory."""

kinetic = ebb.Global(ebb.float64, 0.0)
elastic = ebb.Global(ebb.float64, 0.0)
momentum = ebb.Global(ebb.vec3d, 0.0)
smallest = ebb.Global(ebb.float64, 0.0)


# What a law of a material is made from.


@ebb.func
def shape_gradients(t):
    """The gradients of the four shape functions, the rows of a 4 x 3 matrix."""
    b = t.gradients
    return [
        [-b[0, 0] - b[1, 0] - b[2, 0], -b[0, 1] - b[1, 1] - b[2, 1], -b[0, 2] - b[1, 2] - b[2, 2]],
        [b[0, 0], b[0, 1], b[0, 2]],
        [b[1, 0], b[1, 1], b[1, 2]],
        [b[2, 0], b[2, 1], b[2, 2]],
    ]


@ebb.func
def deformation(t):
    """The deformation gradient F: how the tetrahedron has been stretched and turned."""
    b, u = t.gradients, t.v[0].q
    moved = ebb.outer(t.v[1].q - u, b[0]) + ebb.outer(t.v[2].q - u, b[1]) + ebb.outer(t.v[3].q - u, b[2])
    return ebb.identity(3) + moved


@dataclass(frozen=True)
class Law:
    """The law of a material.

    Attributes:
        name: of the law.
        assemble: a kernel over tetrahedra that adds internal forces, the gradient of the energy, to ``t.v[i].force``,
            and ``scale`` (its parameter) times the stiffness, which is their derivative, to ``t.e[i, j].A``.
        energy: a kernel over tetrahedra that adds the elastic energy to ``fem.elastic``.
        bears_inversion: whether the law says what a tetrahedron does whose volume has become negative.
    """

    name: str
    assemble: ebb.Kernel
    energy: ebb.Kernel
    bears_inversion: bool


@dataclass(frozen=True)
class Material:
    """Young's modulus, Poisson's ratio and the mass density, for all tetrahedra or for the ``rows`` of some."""

    young: float
    poisson: float
    density: float
    rows: npt.NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        for name, value in (("young", self.young), ("density", self.density)):
            if not (value > 0 and math.isfinite(value)):
                raise ValueError(f"{name} is {value:g}, and must be a positive number")
        if not -1 < self.poisson < 0.5:
            raise ValueError(
                f"poisson is {self.poisson:g}, and must lie between -1 and 0.5, both excluded (0.5 would be a body "
                "that nothing compresses, of which linear tetrahedra lock: take 0.49 at most)"
            )

    @property
    def mu(self) -> float:
        """The shear modulus, Lame's second parameter."""
        return self.young / (2 * (1 + self.poisson))

    @property
    def lam(self) -> float:
        """Lame's first parameter."""
        return self.young * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))


class StepError(Exception):
    """A step that cannot be made. The body is in the state from before it."""


GIVES_WAY = (
    "The stiffness is not positive definite, as where a body is crushed: take shorter steps, or another material."
)
ADVICE = {
    Reason.CURVATURE: GIVES_WAY,
    Reason.PRECONDITIONER: GIVES_WAY,
    Reason.NOT_FINITE: "A force or a stiffness is infinite, or no number.",
    Reason.LIMIT: "Take a larger tolerance, or shorter steps.",
    Reason.ROUNDING: "The stiffness is singular or nearly so, as of a body that can move as a whole.",
}


# The kernels that all laws share.


@ebb.kernel
def init_elements(t, own: ebb.float64, other: ebb.float64):
    origin = ebb.vec3d(t.v[0].pos)
    a, b, c = ebb.vec3d(t.v[1].pos) - origin, ebb.vec3d(t.v[2].pos) - origin, ebb.vec3d(t.v[3].pos) - origin
    t.gradients = ebb.inverse([[a.x, b.x, c.x], [a.y, b.y, c.y], [a.z, b.z, c.z]])
    mass = t.material.density * t.volume
    for i in range(4):
        t.v[i].mass += mass / 4
        for j in range(4):
            t.e[i, j].mass += own * mass if i == j else other * mass


@ebb.kernel
def begin_vertices(v):
    v.q0 = v.q
    v.qd0 = v.qd
    v.force = [0, 0, 0]


@ebb.kernel
def clear_forces(v):
    v.force = [0, 0, 0]


@ebb.kernel
def begin_matrix(e, scale: ebb.float64):
    e.A = scale * e.mass * ebb.identity(3)


@ebb.kernel
def balance(v, h: ebb.float64, mass: ebb.float64, whole: ebb.float64):
    rhs = h * (v.load - v.force)
    for e in v.edges:
        rhs += e.mass * (e.head.qd0 + mass * e.head.qd) - whole * (e.A @ e.head.qd)
    v.rhs = rhs
    v.dv = [0, 0, 0]


@ebb.kernel
def balance_at_rest(v):
    v.rhs = v.load - v.force
    v.dv = [0, 0, 0]


@ebb.kernel
def advance(v, share: ebb.float64, h: ebb.float64):
    v.qd += share * v.dv
    v.q = v.q0 + h * v.qd


@ebb.kernel
def retreat(v):
    v.q = v.q0
    v.qd = v.qd0


@ebb.kernel
def measure_compression(t):
    smallest.value = min(smallest.value, ebb.det(deformation(t)))


@ebb.kernel
def measure_motion(v):
    total = ebb.zeros(ebb.vec3d)
    for e in v.edges:
        total += e.mass * e.head.qd
    momentum.value += total
    kinetic.value += 0.5 * ebb.dot(v.qd, total)


@dataclass(frozen=True)
class Step:
    """What a step took: iterations of the linear solver, seconds of assembly and of solving, Newton's iterations."""

    iterations: int
    assembly: float
    solve: float
    newton: int = 1


@dataclass(frozen=True)
class Damping:
    """Rayleigh's: D = mass M + stiffness K, in 1 / second and in seconds."""

    mass: float = 0.0
    stiffness: float = 0.0

    def __post_init__(self) -> None:
        if not (0 <= self.mass < math.inf and 0 <= self.stiffness < math.inf):
            raise ValueError(f"damping is ({self.mass:g}, {self.stiffness:g}), and must be 0 or more")


class SoftBody:
    """A body that moves and bends: a mesh with its fields, the law of its material, and steps in time.

    The vertices have ``q`` and ``qd``, their displacements from ``pos`` and their velocities, ``mass`` (each a quarter
    of its tetrahedra's), ``load`` (the external force) and ``force`` (the internal one, as last assembled). The edges
    have ``mass``, the entries of the mass matrix, and ``A``, the blocks of the matrix of the last step.
    """

    def __init__(
        self,
        mesh: TetMesh,
        law: Law,
        materials: Sequence[Material],
        *,
        fixed: npt.ArrayLike = (),
        damping: Damping = Damping(),
        lumped: bool = False,
    ) -> None:
        """Give the mesh its fields; the body is at rest.

        Args:
            mesh: with self edges, and positions in float64.
            law: how the material answers to deformation.
            materials: what it is made of; together they have all tetrahedra, and later ones win.
            fixed: the rows of the vertices that do not move.
            damping: Rayleigh's.
            lumped: whether the mass matrix is diagonal, rather than consistent with the shape functions.

        Raises:
            ValueError: a fixed vertex that is none, or a tetrahedron without material.
        """
        self.mesh, self.law, self.damping = mesh, law, damping
        vertices, edges, tetrahedra = mesh.vertices, mesh.edges, mesh.tetrahedra
        if vertices.size > LARGE:
            vertices.reorder()  # kernels would have it done later, when there are matrices to move
        for name in ("q", "qd", "q0", "qd0", "dv", "rhs", "load", "force"):
            vertices.new_field(name, ebb.vec3d, init=0.0)
        vertices.new_field("mass", ebb.float64, init=0.0)
        edges.new_field("mass", ebb.float64, init=0.0)
        edges.new_field("A", ebb.mat3d, init=0.0)
        tetrahedra.new_field("gradients", ebb.mat3d)
        self.materials = ebb.Relation("materials", size=len(materials))
        for name in ("mu", "lam", "density"):
            self.materials.new_field(name, ebb.float64, init=[getattr(each, name) for each in materials])
        tetrahedra.new_field("material", self.materials, init=_of_each(tetrahedra.size, materials))
        # The consistent mass is the integral of the products of two shape functions (Zienkiewicz and Taylor, 2000).
        own, other = (1 / 4, 0.0) if lumped else (1 / 10, 1 / 20)
        init_elements(tetrahedra, own, other)
        self.fixed = _as_mask(vertices.size, fixed)
        movable = ~self.fixed & (vertices.mass.to_numpy() > 0)  # a vertex of no tetrahedron stays where it is
        free = None if movable.all() else vertices.new_subset("free", movable)
        self.solver = ConjugateGradients(
            vertices.dv, vertices.rhs, matrix=edges.A, preconditioner="block-jacobi", rows=free
        )
        self._scale = 0.0

    def set_load(self, gravity: npt.ArrayLike = (0.0, 0.0, 0.0), force: npt.ArrayLike = 0.0) -> None:
        """Set the external forces: of gravity, which each corner takes a quarter of, and others, one row a vertex."""
        weight = np.outer(self.mesh.vertices.mass.to_numpy(), np.asarray(gravity, dtype=np.float64))
        self.mesh.vertices.load.load(weight + np.asarray(force, dtype=np.float64))

    def assemble(self, mass: float, stiffness: float) -> None:
        """Add the internal forces as they are now to ``force``, and set ``A`` to ``mass`` M + ``stiffness`` K."""
        begin_matrix(self.mesh.edges, mass)
        self.law.assemble(self.mesh.tetrahedra, stiffness)

    def step(self, dt: float, tolerance: float = 1e-6, newton: int = 1, newton_tolerance: float = 1e-6) -> Step:
        """Advance by ``dt``.

        Args:
            dt: in seconds.
            tolerance: the linear solver stops when the residual has become smaller by this factor.
            newton: 1 for the linearised step, else the most of Newton's iterations that may be taken.
            newton_tolerance: Newton's iteration stops when the residual is this much smaller than the largest yet.

        Raises:
            StepError: a solve or the iteration does not converge, or tetrahedra turn over; the state is then as before.
        """
        a, b = self.damping.mass, self.damping.stiffness
        # The residual of the step that is not linearised is M (qd0 - qd) + h (f_ext - f_int(q) - D qd), q = q0 + h qd,
        # and h b K = part (A - (1 + h a) M). The first iteration starts from q0, which is qd = 0; counted from qd = qd0
        # on, as the linearised step counts, it solves A dv = M qd0 + h (f_ext - f_int(q0)) - A qd.
        part = b / (b + dt)

        def prepare(number: int) -> None:
            self.assemble(1 + dt * a, dt * (b + dt))
            mass, whole = (0.0, 1.0) if number == 0 else ((part - 1) * (1 + dt * a), part)
            balance(self.mesh.vertices, dt, mass, whole)

        return self._iterate(prepare, dt, tolerance, newton, newton_tolerance)

    def find_rest(self, tolerance: float = 1e-6, newton: int = 50, newton_tolerance: float = 1e-9) -> Step:
        """Move the body to where internal and external forces are in balance, and stop it there.

        The arguments are those of `step`.

        Raises:
            StepError: it does not converge, or the fixed vertices leave the body free to move as a whole.
        """
        check_held(self.mesh.vertices.pos.to_numpy()[self.fixed])
        self.mesh.vertices.qd.fill(0.0)

        def prepare(number: int) -> None:
            self.assemble(0.0, 1.0)
            balance_at_rest(self.mesh.vertices)

        # With a step of 1 second, the "velocity" is the displacement.
        done = self._iterate(prepare, 1.0, tolerance, newton, newton_tolerance)
        self.mesh.vertices.qd.fill(0.0)
        return done

    def _iterate(
        self, prepare: Callable[[int], None], h: float, tolerance: float, newton: int, newton_tolerance: float
    ) -> Step:
        iterations, assembly, solve = 0, 0.0, 0.0
        for number in range(newton):
            started = time.perf_counter()
            (clear_forces if number else begin_vertices)(self.mesh.vertices)
            prepare(number)
            assembled = time.perf_counter()
            enough = newton_tolerance * self._scale if number else 0.0
            result = self.solver.solve(tolerance, absolute=enough)
            iterations += result.iterations
            assembly, solve = assembly + assembled - started, solve + time.perf_counter() - assembled
            self._scale = max(self._scale, float(result.residuals[0]))
            if not result.converged:
                self._fail(f"the linear solver stops: {result}. {ADVICE.get(result.reason, '')}")
            if number and result.iterations == 0:
                break
            self._advance(h, halvings=20 if newton > 1 else 0)
        else:
            if newton > 1:
                self._fail(f"Newton's iteration does not converge in {newton} iterations")
        return Step(iterations, assembly, solve, number + 1)

    def _advance(self, h: float, halvings: int) -> None:
        """Take the solution, or where tetrahedra would turn over, which the law does not bear, half of it and so on."""
        advance(self.mesh.vertices, 1.0, h)
        if self.law.bears_inversion:
            return
        for halving in range(halvings + 1):
            if self.compression() > 0:
                return
            if halving < halvings:
                advance(self.mesh.vertices, -(0.5 ** (halving + 1)), h)
        self._fail("tetrahedra turn over, which the material does not bear: take a shorter step, or more of Newton's")

    def _fail(self, text: str) -> None:
        retreat(self.mesh.vertices)
        raise StepError(text)

    def compression(self) -> float:
        """The least ratio of the volume of a tetrahedron now to that at rest; below 0 where one has turned over."""
        smallest.value = math.inf
        measure_compression(self.mesh.tetrahedra)
        return smallest.value

    def energy(self) -> tuple[float, float]:
        """The kinetic and the elastic energy."""
        kinetic.value, momentum.value, elastic.value = 0.0, 0.0, 0.0
        measure_motion(self.mesh.vertices)
        self.law.energy(self.mesh.tetrahedra)
        return kinetic.value, elastic.value


def check_held(points: npt.NDArray[np.float64]) -> None:
    """Check that a body that is held at ``points``, shape (n, 3), cannot move as a whole."""
    spread = points - points.mean(axis=0) if len(points) else points
    sizes = np.linalg.svd(spread, compute_uv=False) if len(points) > 2 else np.zeros(3)
    if sizes[1] <= 1e-6 * sizes[0]:
        raise StepError(
            f"{len(points)} vertices are fixed, and a body at rest needs three at least that are not on one line: "
            "else it can move as a whole, and has no place of its own"
        )


def _as_mask(size: int, rows: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    numbers = np.asarray(rows, dtype=np.int64).ravel()
    if numbers.size and not (numbers.min() >= 0 and numbers.max() < size):
        wrong = int(numbers[(numbers < 0) | (numbers >= size)][0])
        raise ValueError(f"fixed vertex {wrong} is none of the {size} vertices, which are numbered from 0")
    mask = np.zeros(size, dtype=np.bool_)
    mask[numbers] = True
    return mask


def _of_each(size: int, materials: Sequence[Material]) -> npt.NDArray[np.int64]:
    """The number of each tetrahedron's material."""
    numbers = np.full(size, -1)
    for number, material in enumerate(materials):
        numbers[slice(None) if material.rows is None else material.rows] = number
    without = np.flatnonzero(numbers < 0)
    if len(without):
        raise ValueError(f"{len(without)} tetrahedra have no material, the first is {without[0]}")
    return numbers
