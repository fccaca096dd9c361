"""The program that every decision is tested against (design, section 2), verbatim, and its energy in NumPy."""

from __future__ import annotations

import re

import numpy as np
import pytest

from ebb.domains import TetMesh

from .harness import define

PROGRAM = """
import ebb
from ebb.domains import TetMesh

dragon = TetMesh.load("dragon.veg")
vertices, edges = dragon.vertices, dragon.edges

dt = 1e-4
K = ebb.constant(1.0, ebb.float32)
E = ebb.Global(ebb.float64, 0.0)

edges.new_field("rest_len", ebb.float32)
vertices.new_field("mass", ebb.float32, init=1.0)
vertices.new_field("q", ebb.vec3f, init=vertices.pos)
vertices.new_field("qd", ebb.vec3f, init=0.0)
vertices.new_field("force", ebb.vec3f, init=0.0)

@ebb.kernel
def init_len(e: edges):
    e.rest_len = ebb.length(e.head.pos - e.tail.pos)

@ebb.kernel
def compute_internal_forces(v: vertices):
    for e in v.edges:
        dq = e.head.q - v.q
        v.force += K * (e.rest_len * ebb.normalize(dq) - dq)

@ebb.kernel
def apply_forces(v: vertices):
    qdd = v.force / v.mass
    v.q += v.qd * dt + 0.5 * qdd * dt * dt
    v.qd += qdd * dt
    v.force = [0, 0, 0]

@ebb.kernel
def measure_total_energy(v: vertices):
    E.value += 0.5 * v.mass * ebb.dot(v.qd, v.qd)

init_len(edges)
for step in range(10_000):
    compute_internal_forces(vertices)
    apply_forces(vertices)
    if step % 1000 == 999:
        E.value = 0
        measure_total_energy(vertices)
        print("energy:", E.value)
"""


@pytest.fixture
def dragon(tmp_path, monkeypatch):
    """A mesh ``dragon.veg`` in the working folder."""
    monkeypatch.chdir(tmp_path)
    TetMesh.box(3, 2, 2).save("dragon.veg")
    return TetMesh.load("dragon.veg")


def numpy_energies(mesh, steps, every, dt=1e-4, start=None):
    """The same method in NumPy, in float32."""
    q = mesh.vertices.pos.to_numpy().astype(np.float32)
    tail, head = mesh.edges.tail.to_numpy(), mesh.edges.head.to_numpy()
    rest = np.linalg.norm(q[head] - q[tail], axis=1)[:, None]
    q = q if start is None else start.astype(np.float32)
    qd, energies = np.zeros_like(q), []
    for step in range(steps):
        dq = q[head] - q[tail]
        length = np.linalg.norm(dq, axis=1)[:, None]
        force = np.zeros_like(q)
        # The sign of the program: the rest length along the edge, less the edge.
        np.add.at(force, tail, rest * dq / length - dq)
        q = q + qd * np.float32(dt) + np.float32(0.5 * dt * dt) * force
        qd = qd + force * np.float32(dt)
        if step % every == every - 1:
            energies.append(0.5 * (qd.astype(float) ** 2).sum())
    return energies


def printed(text):
    return [float(number) for number in re.findall(r"energy: (\S+)", text)]


def test_the_program_verbatim(dragon, capsys):
    define(PROGRAM)
    energies = printed(capsys.readouterr().out)
    assert len(energies) == 10
    # At rest the springs pull by rounding alone, so that nothing moves.
    assert max(energies) < 1e-9


def test_the_program_on_each_backend_moves_as_numpy_says(backend, dragon, capsys):
    """Fewer and longer steps, from a stretched start: the numbers printed are those of the method."""
    text = PROGRAM.replace("range(10_000)", "range(60)").replace("step % 1000 == 999", "step % 20 == 19")
    text = text.replace("dt = 1e-4", "dt = 1e-2").replace(
        "init_len(edges)\n", "init_len(edges)\nvertices.q.load(1.3 * vertices.pos.to_numpy())\n"
    )
    define(text)
    energies = printed(capsys.readouterr().out)
    stretched = 1.3 * dragon.vertices.pos.to_numpy()
    expected = numpy_energies(dragon, 60, 20, dt=1e-2, start=stretched)
    assert min(expected) > 1e-3
    np.testing.assert_allclose(energies, expected, rtol=1e-4)


def test_both_forces_of_a_spring_cancel(backend, dragon):
    names = define(PROGRAM.replace("range(10_000)", "range(0)"))
    vertices = names["vertices"]
    vertices.q.load(vertices.pos.to_numpy() * [1.5, 0.75, 1.0])
    names["compute_internal_forces"](vertices)
    force = vertices.force.to_numpy()
    assert abs(force).max() > 0.1
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-4)
