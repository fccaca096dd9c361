"""The text of each stage for the kernels of the contract's program: a change of the compiler shows in the review."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ebb
from ebb.compiler import lir, lir_print
from ebb.compiler.lower import Launched, facts_of, lower

HERE = Path(__file__).parent


def mesh() -> tuple[ebb.Relation, ebb.Relation]:
    vertices = ebb.Relation("vertices", size=4)
    vertices.new_field("pos", ebb.vec3f, init=[[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    vertices.new_field("mass", ebb.float32, init=1.0)
    for name in ("q", "qd", "force"):
        vertices.new_field(name, ebb.vec3f, init=0.0)
    edges = ebb.Relation("edges", size=8)
    edges.new_field("tail", vertices, init=np.repeat(np.arange(4), 2))
    edges.new_field("head", vertices, init=[1, 3, 0, 2, 1, 3, 2, 0])
    edges.new_field("rest_len", ebb.float32, init=1.0)
    edges.group_by("tail")

    @vertices.member("edges")
    def edges_of(v):
        return ebb.where(edges.tail, v)

    return vertices, edges


def grid() -> ebb.Relation:
    cells = ebb.Relation("cells", shape=(4, 6), periodic=(False, True))
    cells.new_field("T", ebb.float64, init=0.0)
    cells.new_field("new_T", ebb.float64, init=0.0)

    @cells.member("__call__")
    def offset(c, di, dj):
        return ebb.affine(cells, [[1, 0, di], [0, 1, dj]], c)

    return cells


def program() -> dict[str, tuple[ebb.Kernel, ebb.Relation]]:
    """The kernels of section 2 of the design, and those that show what else there is, with their relations."""
    (vertices, edges), cells = mesh(), grid()
    dt = 1e-4
    K = ebb.constant(1.0, ebb.float32)
    E = ebb.Global(ebb.float64, 0.0)
    top = ebb.Global(ebb.float64, 0.0)

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

    @ebb.kernel
    def scatter(e: edges):
        e.head.mass += 0.5
        e.tail.mass += 0.5

    @ebb.kernel
    def diffuse(c: cells):
        c.new_T = 0.5 * c.T + 0.25 * (c(0, 1).T + c(0, -1).T)
        top.value = max(top.value, c.new_T)

    on = {"init_len": edges, "scatter": edges, "diffuse": cells}
    kernels = (init_len, compute_internal_forces, apply_forces, measure_total_energy, scatter, diffuse)
    return {kernel.__name__: (kernel, on.get(kernel.__name__, vertices)) for kernel in kernels}


PROGRAM = program()


@pytest.mark.parametrize("stage", ["kir", "lir"])
@pytest.mark.parametrize("name", PROGRAM)
def test_stage_reads_as_before(name: str, stage: str, golden) -> None:
    kernel, relation = PROGRAM[name]
    golden(HERE / f"{name}.{stage}", kernel.inspect(relation, stage).rstrip() + "\n")


@pytest.mark.parametrize("name", ["measure_total_energy", "compute_internal_forces"])
def test_programs_for_groups_read_as_before(name: str, golden) -> None:
    kernel, relation = PROGRAM[name]
    checked = kernel._find_launch(relation, ()).specialisation.checked
    facts, precision = facts_of(checked.kernel), lir.Precision.CONTRACT
    program = lower(checked.kernel, checked.phases, (), facts, Launched.ALL, precision, group_size=64)
    golden(HERE / f"{name}.groups.lir", lir_print.text(program))


def test_text_of_a_stage_names_no_data() -> None:
    """The text is a key of the cache: what it says must not depend on sizes or addresses."""
    first, second = program(), program()
    for name, (kernel, relation) in first.items():
        again, other = second[name]
        assert kernel.inspect(relation, "lir") == again.inspect(other, "lir")
