"""Hot kernels are made of the instructions that they should be made of, counted in the assembly; nothing is timed."""

from __future__ import annotations

import re

import numpy as np
import pytest

import ebb
from ebb.backends.llvm.hooks import Strips
from ebb.backends.target import host
from ebb.domains import TetMesh

WIDEST = next(
    (register for feature, register in (("+avx512f", "zmm"), ("+avx", "ymm")) if feature in host().features.split(",")),
    "xmm",
)
X86 = host().triple.startswith("x86_64")

pytestmark = pytest.mark.skipif(not X86, reason="the instructions are those of x86-64")

strips = pytest.mark.skipif(host().hooks.strips is Strips.NONE, reason="the processor has no masked vector loads")
libmvec = pytest.mark.skipif(
    ("sin", 32) not in host().hooks.vector_math, reason="the C library has no vector functions"
)


def block(kernel, rows, *arguments):
    """The assembly of the function that runs a block of rows."""
    text = kernel.inspect(rows, "asm", *arguments)
    found = re.search(r"^ebb\.block:(.*?)^\.Lfunc_end", text, re.DOTALL | re.MULTILINE)
    return found.group(1) if found else text


def count(text, instruction, register=WIDEST):
    """How many instructions of the name have an operand in such a register."""
    return len(re.findall(rf"^\s+{instruction}\b.*%{register}", text, re.MULTILINE))


@pytest.fixture
def rows():
    relation = ebb.Relation("rows", size=5000)
    for name in ("x", "y"):
        relation.new_field(name, ebb.float32, init=1.0)
        relation.new_field(name * 2, ebb.float64, init=1.0)
    return relation


def test_a_stream_fills_the_widest_registers(rows):
    @ebb.kernel
    def axpy(r: rows, a: ebb.float32):
        r.y = a * r.x + r.y

    text = block(axpy, rows, ebb.float32(2.0))
    assert count(text, r"vfmadd\w*ps" if WIDEST != "xmm" else "mulps") >= 1
    assert count(text, "v?gather\\w+") == 0


def test_a_stream_of_doubles_too(rows):
    @ebb.kernel
    def axpy(r: rows):
        r.yy = 2.0 * r.xx + r.yy

    assert count(block(axpy, rows), r"vfmadd\w*pd" if WIDEST != "xmm" else "mulpd") >= 1


def test_vectors_of_three_are_updated_in_vectors():
    vertices = ebb.Relation("vertices", size=5000)
    vertices.new_field("mass", ebb.float32, init=1.0)
    for name in ("q", "qd", "force"):
        vertices.new_field(name, ebb.vec3f)
    dt = 1e-4

    @ebb.kernel
    def apply_forces(v: vertices):
        qdd = v.force / v.mass
        v.q += v.qd * dt + 0.5 * qdd * dt * dt
        v.qd += qdd * dt
        v.force = [0, 0, 0]

    text = block(apply_forces, vertices)
    assert count(text, "v?divps") >= 3 and count(text, r"v?(fmadd\w*|add)ps") >= 3


def test_conditions_become_masks(rows):
    @ebb.kernel
    def halve(r: rows):
        if r.x > 1.0:
            r.y = 0.5 * r.x
        else:
            r.y = r.x if r.y < 0.0 else -r.x

    assert count(block(halve, rows), r"v?mulps") >= 1


def test_plain_functions_are_instructions(rows):
    @ebb.kernel
    def shape(r: rows):
        r.y = min(max(r.x, 0.0), 1.0) + abs(r.y) + ebb.sqrt(r.x)

    text = block(shape, rows)
    assert count(text, r"v?sqrtps") >= 1 and count(text, r"v?minps") >= 1 and "call" not in text


@libmvec
def test_sines_of_rows_are_taken_by_vectors(rows):
    @ebb.kernel
    def wave(r: rows):
        r.y = ebb.sin(r.x)
        r.yy = ebb.exp(r.xx)

    text = block(wave, rows)
    assert re.search(r"_ZGV[de]N\d+v_sinf", text) and re.search(r"_ZGV[de]N\d+v_exp\b", text)
    assert not re.search(r"\b(sinf|exp)@PLT", text)


def test_a_stencil_loads_its_neighbours_side_by_side():
    cells = ebb.Relation("cells", shape=(60, 70))
    cells.new_field("u", ebb.float32, init=1.0)
    cells.new_field("w", ebb.float32)
    cells.new_subset("interior", np.s_[1:-1, 1:-1])

    @cells.member("__call__")
    def offset(c, di, dj):
        return ebb.affine(cells, [[1, 0, di], [0, 1, dj]], c)

    @ebb.kernel
    def laplace(c: cells):
        c.w = c(1, 0).u + c(-1, 0).u + c(0, 1).u + c(0, -1).u - 4.0 * c.u

    text = block(laplace, cells.interior)
    assert count(text, r"v?addps") >= 3
    assert count(text, r"v?gather\w+") == 0 and count(text, r"vinsertps", "xmm") == 0


def spring_forces():
    vertices, edges = ebb.Relation("vertices", size=50), ebb.Relation("edges", size=300)
    rng = np.random.default_rng(0)
    vertices.new_field("q", ebb.vec3f, init=rng.random((50, 3)))
    vertices.new_field("force", ebb.vec3f)
    for name in ("tail", "head"):
        edges.new_field(name, vertices, init=rng.integers(0, 50, 300))
    edges.new_field("rest_len", ebb.float32, init=0.5)
    edges.group_by("tail")

    @vertices.member
    def edges_of(v):
        return ebb.where(edges.tail, v)

    @ebb.kernel
    def forces(v: vertices):
        for e in v.edges_of:
            dq = e.head.q - v.q
            v.force += e.rest_len * ebb.normalize(dq) - dq

    return forces, vertices


@strips
def test_query_loops_do_eight_turns_at_once():
    forces, vertices = spring_forces()
    text = block(forces, vertices)
    assert count(text, "vsqrtps", "ymm") == 1 and count(text, "vdivps", "ymm") == 1
    assert count(text, r"v(sqrt|div)ss", "xmm") == 0 and count(text, r"v?gather\w+", "ymm") == 0
    assert len(re.findall(r"vunpck[lh]p[sd].*%ymm", text)) >= 6
    assert text.count("vinsertf128") == 4  # the rows of eight heads, in pairs


def test_query_loops_of_little_work_stay_turn_by_turn():
    mesh = TetMesh.box(2, 2, 2)
    vertices, edges = mesh.vertices, mesh.edges
    edges.new_field("weight", ebb.float32)
    vertices.new_field("old", ebb.float32)
    vertices.new_field("new", ebb.float32)

    @ebb.kernel
    def diffuse(v: vertices):
        for e in v.edges:
            v.new += e.weight * (e.head.old - v.old)

    assert "strip" not in diffuse.inspect(vertices, "llvm")


def matrix_edges():
    mesh = TetMesh.box(2, 2, 2, self_edges=True)
    mesh.edges.new_field("block", ebb.mat3d)
    for name in ("p", "y"):
        mesh.vertices.new_field(name, ebb.vec3d)
    mesh.tetrahedra.new_field("g", ebb.matrix(ebb.float64, 4, 3), init=1.0)
    return mesh


def test_products_of_matrices_and_vectors_stay_turn_by_turn():
    vertices = matrix_edges().vertices

    @ebb.kernel
    def multiply(v: vertices):
        y = ebb.zeros(ebb.vec3d)
        for e in v.edges:
            y += e.block @ e.head.p
        v.y = y

    assert "strip" not in multiply.inspect(vertices, "llvm")


def test_loops_over_corners_are_written_out():
    tetrahedra = matrix_edges().tetrahedra

    @ebb.kernel
    def assemble(t: tetrahedra):
        g = t.g
        for i in range(4):
            for j in range(4):
                t.e[i, j].block += ebb.outer(g[i], g[j]) + 2 * ebb.outer(g[j], g[i])

    text = assemble.inspect(tetrahedra, "llvm")
    body = text[text.index("@ebb.block(") :].split("\n}")[0]
    assert "alloca" not in body and body.count("phi ") == 1
    assert body.count("call void @llvm.prefetch") == 16 * 2  # two lines of the cache for each block of 72 bytes


def test_short_rows_look_ahead_by_themselves():
    tetrahedra = matrix_edges().tetrahedra

    @ebb.kernel
    def spread(t: tetrahedra):
        for i in range(4):
            t.v[i].p += t.g[i]

    assert "prefetch" not in spread.inspect(tetrahedra, "llvm")


def test_only_fastmath_reassociates_and_approximates(rows):
    def body(r: rows):
        r.y = (r.x + r.y) - r.x + r.y / 3.0

    plain = block(ebb.kernel(body), rows)
    fast = block(ebb.kernel(fastmath=True)(body), rows)
    assert count(plain, r"v?subps") >= 1 and count(fast, r"v?subps") == 0
    assert count(plain, r"v?divps") >= 1 and count(fast, r"v?divps") == 0


def test_only_fastmath_regroups_the_sums_of_a_range():
    rows = ebb.Relation("rows", size=100)
    rows.new_field("a", ebb.vector(ebb.float32, 64), init=1.0)
    rows.new_field("y", ebb.float32)

    def body(r: rows):
        total = r.y
        for k in range(64):
            total += r.a[k] * r.a[k]
        r.y = total

    llvm = [ebb.kernel(**options)(body).inspect(rows, "llvm") for options in ({}, {"fastmath": True})]
    assert "reassoc" not in llvm[0].split("define internal", 1)[1].split("ret ", 1)[0]
    assert "reassoc" in llvm[1]
