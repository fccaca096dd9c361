"""Spring-mass steps (the paper's figure 1) against plain C++ and against the reference interpreter, in one run.

    python benchmarks/spring_mass.py --tets 200000 --threads 1

Needs g++. Prints medians, their spread and ratios; ``--json FILE`` keeps them.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import ebb
from ebb.domains import TetMesh

FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")
DT = 1e-4
STIFFNESS = 1.0


class EbbProgram:
    """The program of the paper's figure 1 on a box of tetrahedra."""

    def __init__(self, mesh: TetMesh) -> None:
        vertices, edges = mesh.vertices, mesh.edges
        dt, K = DT, STIFFNESS  # noqa: N806 - the paper's names
        rng = np.random.default_rng(1)
        edges.new_field("rest_len", ebb.float32)
        vertices.new_field("mass", ebb.float32, init=1.0)
        stretched = vertices.pos.to_numpy() * 1.1 + 0.01 * rng.standard_normal((vertices.size, 3))
        vertices.new_field("q", ebb.vec3f, init=stretched)
        vertices.new_field("qd", ebb.vec3f, init=0.0)
        vertices.new_field("force", ebb.vec3f, init=0.0)

        @ebb.kernel
        def init_len(e: edges):
            e.rest_len = ebb.float32(ebb.length(e.head.pos - e.tail.pos))

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

        init_len(edges)
        self.vertices, self.edges = vertices, edges
        self.forces, self.apply = compute_internal_forces, apply_forces

    def step(self) -> None:
        self.forces(self.vertices)
        self.apply(self.vertices)


class CppProgram:
    """The same step by hand, on copies of the same arrays."""

    def __init__(self, program: EbbProgram, folder: Path) -> None:
        library = folder / "spring_mass.so"
        source = Path(__file__).with_suffix(".cpp")
        subprocess.run(["g++", *FLAGS, "-o", str(library), str(source)], check=True)
        self.program = ctypes.CDLL(str(library))
        vertices, edges = program.vertices, program.edges
        tail, head = edges.tail.to_numpy(), edges.head.to_numpy()
        by_tail = np.argsort(tail, kind="stable")
        self.first = np.searchsorted(tail[by_tail], np.arange(vertices.size + 1)).astype(np.int32)
        self.head = head[by_tail].astype(np.int32)
        self.rest_len = edges.rest_len.to_numpy()[by_tail].copy()
        self.q, self.qd, self.force, self.mass = (
            getattr(vertices, name).to_numpy().copy() for name in ("q", "qd", "force", "mass")
        )
        self.size = vertices.size

    def step(self) -> None:
        def at(array: np.ndarray) -> ctypes.c_void_p:
            return ctypes.c_void_p(array.ctypes.data)

        size = ctypes.c_int64(self.size)
        self.program.internal_forces(
            size,
            at(self.first),
            at(self.head),
            at(self.rest_len),
            at(self.q),
            at(self.force),
            ctypes.c_float(STIFFNESS),
        )
        self.program.apply_forces(size, at(self.q), at(self.qd), at(self.force), at(self.mass), ctypes.c_float(DT))


def alternate(first: Callable[[], None], second: Callable[[], None], runs: int) -> tuple[list[float], list[float]]:
    """Seconds of ``runs`` turns of each, taken in turn so that a drift of the machine hits both."""
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(runs + 1):
        for function, kept in zip((first, second), times, strict=True):
            start = time.perf_counter()
            function()
            kept.append(time.perf_counter() - start)
    return times[0][1:], times[1][1:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tets", type=int, default=200_000, help="about how many tetrahedra")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()

    n = max(1, round((options.tets / 6) ** (1 / 3)))
    ebb.set_backend("cpu", threads=options.threads)
    mesh = TetMesh.box(n, n, n)
    program = EbbProgram(mesh)
    print(f"{mesh.tetrahedra.size} tets, {mesh.vertices.size} vertices, {mesh.edges.size} directed edges, float32")

    with tempfile.TemporaryDirectory() as folder:
        peer = CppProgram(program, Path(folder))
        program.step()
        peer.step()
        error = float(np.abs(program.vertices.q.to_numpy() - peer.q).max())
        assert error < 1e-5, f"the two programs differ by {error}"
        ours, theirs = alternate(program.step, peer.step, options.runs)

    with ebb.backend("reference"):
        start = time.perf_counter()
        program.step()
        reference = time.perf_counter() - start

    rows = {
        f"ebb, {options.threads} thread(s)": ours,
        f"C++ {' '.join(FLAGS[:3])}, 1 thread": theirs,
        "ebb, reference interpreter": [reference],
    }
    base = statistics.median(theirs)
    for name, times in rows.items():
        median = statistics.median(times)
        print(
            f"{name:40} {median * 1e3:10.3f} ms  [{min(times) * 1e3:.3f}, {max(times) * 1e3:.3f}]"
            f"  {median / base:8.2f} x C++"
        )
    if options.json:
        options.json.write_text(json.dumps({name: times for name, times in rows.items()}, indent=1))


if __name__ == "__main__":
    main()
