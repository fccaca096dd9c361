"""Soft bodies: the laws of materials, the steps, and what they must agree with."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.sparse import bsr_matrix
from scipy.sparse.linalg import spsolve

import ebb
import fem
import fem_corotational
import fem_neohookean
import fem_stvk
from backends import require
from ebb.domains import TetMesh

LAWS = {"stvk": fem_stvk.LAW, "neohookean": fem_neohookean.LAW, "corotational": fem_corotational.LAW}
RUBBER = fem.Material(young=1000.0, poisson=0.3, density=2.0)


@pytest.fixture(params=LAWS)
def law(request) -> fem.Law:
    return LAWS[request.param]


def box(nx: int, ny: int, nz: int, size=(1.0, 1.0, 1.0)) -> TetMesh:
    return TetMesh.box(nx, ny, nz, size, self_edges=True, precision=ebb.float64)


def side(mesh: TetMesh, axis: int = 0, at: float = 0.0) -> np.ndarray:
    return np.flatnonzero(np.abs(mesh.vertices.pos.to_numpy()[:, axis] - at) < 1e-9)


def bent(body: fem.SoftBody, seed: int = 0) -> np.ndarray:
    """Large displacements, with rotation, stretch and shear, in which no tetrahedron has turned over."""
    rng = np.random.default_rng(seed)
    points = body.mesh.vertices.pos.to_numpy()
    turn = rotation([0.5, -0.8, 1.1])
    stretch = np.array([[1.7, 0.4, 0.1], [0.0, 0.7, -0.2], [0.0, 0.0, 1.2]])
    q = points @ (turn @ stretch).T - points + 0.05 * rng.normal(size=points.shape)
    body.mesh.vertices.q.load(q)
    assert 0.2 < body.compression() < 1.2
    return q


def rotation(axis) -> np.ndarray:
    """The rotation about a vector, by its length (Rodrigues)."""
    angle = np.linalg.norm(axis)
    x, y, z = np.asarray(axis) / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def forces(body: fem.SoftBody, q: np.ndarray) -> np.ndarray:
    body.mesh.vertices.q.load(q)
    body.mesh.vertices.force.fill(0.0)
    body.assemble(0.0, 1.0)
    return body.mesh.vertices.force.to_numpy()


def matrix(mesh: TetMesh) -> bsr_matrix:
    """The matrix of a mesh, whose edges are sorted by tail and head."""
    first = np.searchsorted(mesh.edges.tail.to_numpy(), np.arange(mesh.vertices.size + 1))
    return bsr_matrix((mesh.edges.A.to_numpy(), mesh.edges.head.to_numpy(), first))


def state(body: fem.SoftBody) -> tuple[np.ndarray, np.ndarray]:
    return body.mesh.vertices.q.to_numpy(), body.mesh.vertices.qd.to_numpy()


# The laws.


def test_forces_are_the_slope_of_the_energy_and_the_stiffness_that_of_forces(law):
    body = fem.SoftBody(box(2, 2, 1), law, [RUBBER])
    q = bent(body)
    direction = np.random.default_rng(1).normal(size=q.shape)
    h = 1e-5

    def energy(q: np.ndarray) -> float:
        body.mesh.vertices.q.load(q)
        return body.energy()[1]

    force = forces(body, q)
    stiffness = matrix(body.mesh).toarray()
    assert np.abs(stiffness - stiffness.T).max() < 1e-13 * np.abs(stiffness).max()
    slope = (energy(q + h * direction) - energy(q - h * direction)) / (2 * h)
    assert (force * direction).sum() == pytest.approx(slope, rel=1e-6)
    change = (forces(body, q + h * direction) - forces(body, q - h * direction)) / (2 * h)
    expected = (stiffness @ direction.ravel()).reshape(q.shape)
    assert change == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_rigid_motions_give_no_force_and_no_energy(law):
    body = fem.SoftBody(box(2, 1, 1), law, [RUBBER])
    points = body.mesh.vertices.pos.to_numpy()
    moved = (points - [0.1, 0.2, 0.3]) @ rotation([2.0, -1.0, 0.7]).T + [3.0, -5.0, 1.0]
    assert forces(body, moved - points) == pytest.approx(0, abs=1e-11 * RUBBER.young)
    assert body.energy()[1] == pytest.approx(0, abs=1e-12)


def test_internal_forces_have_neither_resultant_nor_moment(law):
    body = fem.SoftBody(box(2, 1, 2), law, [RUBBER])
    q = bent(body, seed=3)
    force = forces(body, q)
    scale = np.abs(force).sum()
    assert force.sum(axis=0) == pytest.approx(0, abs=1e-12 * scale)
    assert np.cross(q + body.mesh.vertices.pos.to_numpy(), force).sum(axis=0) == pytest.approx(0, abs=1e-12 * scale)


def test_small_strains_are_hookes(law):
    body = fem.SoftBody(box(1, 1, 1), law, [RUBBER])
    points = body.mesh.vertices.pos.to_numpy()
    gradient = 1e-5 * np.array([[1.0, 2.0, -0.5], [0.3, -1.0, 0.7], [0.0, 0.4, 2.0]])
    body.mesh.vertices.q.load(points @ gradient.T)
    strain = (gradient + gradient.T) / 2
    density = RUBBER.mu * (strain**2).sum() + RUBBER.lam / 2 * np.trace(strain) ** 2
    assert body.energy()[1] == pytest.approx(density, rel=1e-4)


def test_patch(law):
    mesh = box(3, 3, 3)
    points = mesh.vertices.pos.to_numpy()
    inside = ((points > 0.01) & (points < 0.99)).all(axis=1)
    assert inside.sum() == 8
    affine = points @ np.array([[0.15, 0.1, 0.0], [-0.05, -0.1, 0.1], [0.1, 0.0, 0.2]])
    body = fem.SoftBody(mesh, law, [RUBBER], fixed=np.flatnonzero(~inside))
    mesh.vertices.q.load(np.where(inside[:, None], affine + 0.03 * np.sin(40 * points), affine))
    body.find_rest(tolerance=1e-10)
    assert mesh.vertices.q.to_numpy() == pytest.approx(affine, abs=1e-9)


def test_a_corotational_body_finds_back_from_being_turned_over():
    mesh = box(1, 1, 1)
    body = fem.SoftBody(mesh, fem_corotational.LAW, [RUBBER], damping=fem.Damping(mass=1.0))
    points = mesh.vertices.pos.to_numpy()
    flat = points * [1.0, 1.0, -0.4] + 0.05 * np.random.default_rng(2).normal(size=points.shape)
    mesh.vertices.q.load(flat - points)
    assert body.compression() < 0
    for _ in range(60):
        body.step(0.02, newton=20)
    assert body.compression() == pytest.approx(1.0, abs=0.1)


def test_rotations_are_rotations():
    things = ebb.Relation("things", size=200)
    rng = np.random.default_rng(5)
    given = rng.normal(size=(200, 3, 3)) * 10.0 ** rng.uniform(-6, 6, size=(200, 1, 1))
    given[0], given[1] = np.eye(3), np.diag([1.0, 1.0, -0.5])
    things.new_field("f", ebb.mat3d, init=given)
    things.new_field("r", ebb.mat3d)
    things.new_field("stretch", ebb.float64)

    @ebb.kernel
    def take(t: things):
        r, stretch = fem_corotational.rotation(t.f)
        t.r = r
        t.stretch = stretch

    take(things)
    u, s, vt = np.linalg.svd(given)
    sign = np.linalg.det(u @ vt)
    s[:, 2] *= sign
    u[:, :, 2] *= sign[:, None]
    # The rotation is as well defined as the two least stretches are far from cancelling each other.
    defined = (s[:, 1] + s[:, 2]) / s[:, 0]
    assert (np.abs(things.r.to_numpy() - u @ vt).max(axis=(1, 2)) < 1e-13 / defined**2).all()
    assert things.stretch.to_numpy() == pytest.approx(s.sum(axis=1), rel=1e-7)


# The steps.


def internal(points, cells, q, material, dtype=np.complex128) -> np.ndarray:
    """St. Venant-Kirchhoff's internal forces, in NumPy, also of complex displacements."""
    x, u = points[cells], q[cells]
    rest = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    f = np.eye(3) + (u[:, 1:] - u[:, :1]).transpose(0, 2, 1) @ np.linalg.inv(rest)
    strain = (f.transpose(0, 2, 1) @ f - np.eye(3)) / 2
    trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
    piola = f @ (material.lam * trace * np.eye(3) + 2 * material.mu * strain)
    pull = piola @ np.linalg.inv(rest).transpose(0, 2, 1) * (np.linalg.det(rest) / 6)[:, None, None]
    total = np.zeros(q.shape, dtype=dtype)
    np.add.at(total, cells[:, 1:], pull.transpose(0, 2, 1))
    np.add.at(total, cells[:, 0], -pull.sum(axis=2))
    return total


def stiffness(points, cells, q, material) -> np.ndarray:
    """The derivative of ``internal`` by complex steps."""
    columns = []
    for k in range(q.size):
        shifted = q.astype(np.complex128)
        shifted.ravel()[k] += 1e-30j
        columns.append(internal(points, cells, shifted, material).imag.ravel() / 1e-30)
    return np.array(columns).T


def mass_matrix(points, cells, material, lumped: bool) -> np.ndarray:
    n = len(points)
    m = np.zeros((n, n))
    for cell in cells:
        volume = np.linalg.det(points[cell[1:]] - points[cell[0]]) / 6
        shares = np.eye(4) / 4 if lumped else (np.ones((4, 4)) + np.eye(4)) / 20
        m[np.ix_(cell, cell)] += material.density * volume * shares
    return np.kron(m, np.eye(3))


@pytest.mark.parametrize("lumped", [False, True])
def test_steps_are_vegas(lumped):
    mesh = box(2, 1, 1, (1.0, 0.5, 0.4))
    points, cells = mesh.vertices.pos.to_numpy(), mesh.tetrahedra.v.to_numpy()
    n, h, a, b, gravity = len(points), 0.03, 0.4, 0.02, np.array([1.0, -9.81, 0.5])
    fixed = side(mesh)
    body = fem.SoftBody(mesh, fem_stvk.LAW, [RUBBER], fixed=fixed, damping=fem.Damping(a, b), lumped=lumped)
    push = 0.2 * np.random.default_rng(4).normal(size=(n, 3))
    body.set_load(gravity, push)

    load = push.copy()
    for cell in cells:
        load[cell] += RUBBER.density * np.linalg.det(points[cell[1:]] - points[cell[0]]) / 6 * gravity / 4
    m = mass_matrix(points, cells, RUBBER, lumped)
    free = np.repeat(~np.isin(np.arange(n), fixed), 3)
    q, v = np.zeros((n, 3)), np.zeros((n, 3))
    for _ in range(5):
        body.step(h, tolerance=1e-12)
        k = stiffness(points, cells, q, RUBBER)
        d = a * m + b * k
        system = m + h * d + h * h * k
        rhs = h * ((load - internal(points, cells, q, RUBBER).real).ravel() - (h * k + d) @ v.ravel())
        dv = np.zeros(3 * n)
        dv[free] = np.linalg.solve(system[np.ix_(free, free)], rhs[free])
        v = v + dv.reshape(n, 3)
        q = q + h * v
    assert np.abs(q).max() > 0.05
    found = state(body)
    assert found[0] == pytest.approx(q, abs=1e-10 * np.abs(q).max())
    assert found[1] == pytest.approx(v, abs=1e-10 * np.abs(v).max())


@pytest.mark.parametrize("damping", [fem.Damping(), fem.Damping(0.5, 0.01)])
def test_newtons_step_is_backward_euler(damping):
    mesh = box(2, 1, 1, (1.0, 0.5, 0.4))
    points, cells = mesh.vertices.pos.to_numpy(), mesh.tetrahedra.v.to_numpy()
    body = fem.SoftBody(mesh, fem_stvk.LAW, [RUBBER], fixed=side(mesh), damping=damping)
    body.set_load((0.0, -9.81, 0.0))
    h = 0.1
    body.step(h, newton=20, newton_tolerance=1e-12)
    before = state(body)
    done = body.step(h, tolerance=1e-8, newton=20, newton_tolerance=1e-12)
    assert 3 <= done.newton < 10
    q, v = state(body)
    k = stiffness(points, cells, q, RUBBER)
    m = mass_matrix(points, cells, RUBBER, lumped=False)
    inertia = m @ (v - before[1]).ravel() / h
    drag = (damping.mass * m + damping.stiffness * k) @ v.ravel()
    balance = inertia + drag + internal(points, cells, q, RUBBER).real.ravel() - mesh.vertices.load.to_numpy().ravel()
    free = np.repeat(~body.fixed, 3)
    assert q == pytest.approx(before[0] + h * v, abs=1e-14)
    assert balance[free] == pytest.approx(0, abs=1e-8 * np.abs(inertia).max())


def test_momentum_in_free_flight(law):
    mesh = box(2, 2, 1)
    body = fem.SoftBody(mesh, law, [RUBBER])
    gravity = np.array([0.3, -9.81, 0.0])
    body.set_load(gravity)
    mesh.vertices.q.load(0.2 * mesh.vertices.pos.to_numpy() * [1.0, -1.0, 0.5])
    mesh.vertices.qd.load(np.random.default_rng(6).normal(size=(mesh.vertices.size, 3)))
    body.energy()
    start, mass = fem.momentum.value.copy(), mesh.vertices.mass.to_numpy().sum()
    assert mass == pytest.approx(RUBBER.density)
    for _ in range(10):
        body.step(0.01, tolerance=1e-12)
    body.energy()
    assert fem.momentum.value == pytest.approx(start + 0.1 * mass * gravity, abs=1e-9)


def test_what_nothing_forces_loses_energy(law):
    mesh = box(3, 1, 1, (1.0, 0.3, 0.3))
    body = fem.SoftBody(mesh, law, [RUBBER], fixed=side(mesh))
    points = mesh.vertices.pos.to_numpy()
    mesh.vertices.q.load(points * points[:, :1] * [0.3, 0.1, 0.0] + 0.2 * points[:, :1] ** 2 * [0, 0, 1])
    energies = [sum(body.energy())]
    for _ in range(40):
        body.step(0.02, tolerance=1e-8, newton=10)
        energies.append(sum(body.energy()))
    assert (np.diff(energies) <= 1e-9 * energies[0]).all()
    assert energies[-1] < 0.7 * energies[0]


def test_a_beam_bends_as_timoshenko_says():
    """A cantilever under its weight; the error falls as the square of the size of its elements."""
    length, side_, young, density, g = 1.0, 0.25, 1e7, 100.0, 9.81
    load, area, inertia = density * g * side_**2, side_**2, side_**4 / 12
    # With nu = 0 the clamped end does not hinder the section, and the coefficient of shear is 5/6 (Timoshenko).
    expected = load * length**4 / (8 * young * inertia) + load * length**2 / (2 * 5 / 6 * young / 2 * area)
    errors = []
    sizes = np.array([3, 5, 9])
    for n in sizes.tolist():
        mesh = box(4 * n, n, n, (length, side_, side_))
        body = fem.SoftBody(mesh, fem_stvk.LAW, [fem.Material(young, 0.0, density)], fixed=side(mesh))
        body.set_load((0.0, -g, 0.0))
        body.find_rest(tolerance=1e-8)
        sag = -mesh.vertices.q.to_numpy()[side(mesh, at=length), 1].mean()
        errors.append(1 - sag / expected)
    orders = np.diff(np.log(errors)) / -np.diff(np.log(sizes))
    assert 0 < errors[-1] < 0.05
    assert 1.5 < orders[0] < orders[1] < 2.2


def test_scipy_solves_the_same_system():
    mesh = box(3, 2, 2)
    body = fem.SoftBody(mesh, fem_neohookean.LAW, [RUBBER], fixed=side(mesh))
    bent(body)
    body.set_load((0.0, -9.81, 0.0))
    body.step(0.01, tolerance=1e-12)
    a = matrix(mesh).tocsr()
    free = np.repeat(~body.fixed, 3)
    expected = spsolve(a[free][:, free], mesh.vertices.rhs.to_numpy().ravel()[free])
    found = mesh.vertices.dv.to_numpy().ravel()
    assert found[free] == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert (found[~free] == 0).all()


@pytest.mark.parametrize("name", ["neohookean", "corotational"])  # of the third, test_backends.py makes sure
@pytest.mark.parametrize("backend", ["reference", "opencl"])
def test_backends_agree(backend, name):
    require(backend)
    law = LAWS[name]

    def run(backend: str):
        with ebb.backend(backend):
            body = fem.SoftBody(box(1, 1, 1), law, [RUBBER], fixed=[0, 1, 2], damping=fem.Damping(0.1, 0.01))
            body.set_load((0.0, -9.81, 0.0))
            counts = [body.step(0.05, tolerance=1e-10).iterations for _ in range(2)]
            return *state(body), np.array(body.energy()), counts

    for found, expected in zip(run(backend), run("cpu"), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_threads_give_the_same_bits(law):
    def run(threads: int):
        with ebb.backend("cpu", threads=threads):
            mesh = box(6, 4, 4)
            body = fem.SoftBody(mesh, law, [RUBBER], fixed=side(mesh))
            body.set_load((0.0, -9.81, 0.0))
            for _ in range(2):
                body.step(0.02)
            return state(body)

    for one, two in zip(run(1), run(2), strict=True):
        np.testing.assert_array_equal(one, two)


# What is wrong.


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ((0.0, 0.3, 1.0), "young is 0"),
        ((math.nan, 0.3, 1.0), "young is nan"),
        ((1e5, 0.5, 1.0), "poisson is 0.5"),
        ((1e5, -1.0, 1.0), "poisson is -1"),
        ((1e5, 0.3, -2.0), "density is -2"),
    ],
)
def test_materials_outside_their_range(values, text):
    with pytest.raises(ValueError, match=text):
        fem.Material(*values)


def test_what_makes_no_body():
    with pytest.raises(ValueError, match="fixed vertex 8 is none of the 8 vertices"):
        fem.SoftBody(box(1, 1, 1), fem_stvk.LAW, [RUBBER], fixed=[0, 8])
    with pytest.raises(ValueError, match="4 tetrahedra have no material, the first is 2"):
        fem.SoftBody(box(1, 1, 1), fem_stvk.LAW, [fem.Material(1.0, 0.0, 1.0, np.array([0, 1]))])
    with pytest.raises(ValueError, match="damping"):
        fem.Damping(-1.0, 0.0)


def test_rest_needs_fixed_vertices():
    mesh = box(2, 1, 1)
    on_a_line = [row for row in side(mesh) if mesh.vertices.pos.to_numpy()[row, 1] == 0]
    for fixed in ([], [0], on_a_line):
        body = fem.SoftBody(box(2, 1, 1), fem_stvk.LAW, [RUBBER], fixed=fixed)
        with pytest.raises(fem.StepError, match=f"{len(fixed)} vertices are fixed"):
            body.find_rest()


def test_newtons_iteration_that_does_not_converge():
    mesh = box(2, 1, 1)
    body = fem.SoftBody(mesh, fem_stvk.LAW, [RUBBER], fixed=side(mesh))
    body.set_load((0.0, -200.0, 0.0))
    before = state(body)
    with pytest.raises(fem.StepError, match="Newton's iteration does not converge in 2 iterations"):
        body.step(0.1, newton=2, newton_tolerance=1e-12)
    np.testing.assert_array_equal(state(body), before)
    assert body.step(0.1, newton=20, newton_tolerance=1e-12).newton > 2


def test_failed_steps_leave_the_state_as_it_was():
    # What is squashed this much gives way: its stiffness is not positive.
    mesh = box(2, 1, 1)
    body = fem.SoftBody(mesh, fem_stvk.LAW, [RUBBER], fixed=side(mesh))
    mesh.vertices.q.load(mesh.vertices.pos.to_numpy() * [-0.6, 0.0, 0.0])
    before = state(body)
    with pytest.raises(fem.StepError, match="not positive definite, as where a body is crushed"):
        body.step(10.0)
    np.testing.assert_array_equal(state(body), before)

    body = fem.SoftBody(box(2, 1, 1), fem_neohookean.LAW, [RUBBER], fixed=side(mesh))
    body.set_load((-3000.0, 0.0, 0.0))
    with pytest.raises(fem.StepError, match="tetrahedra turn over"):
        body.step(0.1)
    assert not np.any(state(body))
    body.set_load(force=math.inf)
    with pytest.raises(fem.StepError, match="finite"):
        body.step(0.1)
    assert not np.any(state(body))
