"""What is measured: the programs, their inputs, what they must compute, and the least that they must move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import partial

import numpy as np

from benchmarks import data, expected, solids, stencils
from benchmarks import fluids as fluid_data
from benchmarks.constants import FMA_PER_STEP, PCG_ITERATIONS
from benchmarks.data import Arrays


class Scale(Enum):
    """How large the inputs are: those of the published table, those of a first look, those of the smoke test."""

    FULL = "full"
    QUICK = "quick"
    TINY = "tiny"


@dataclass(frozen=True, slots=True)
class Work:
    """What a step at least moves, each array once a pass, and how much it computes.

    What is written without being read counts twice: its cache lines are read first.
    """

    bytes: int
    flops: int


@dataclass(frozen=True, slots=True)
class Program:
    """A program and its input.

    Attributes:
        name: for ``--only``.
        title: for tables.
        code: the name under which systems have it; programs that differ in their data share it.
        sizes: what ``make`` takes at each scale.
        expected: the outputs after so many steps, by NumPy in float64.
        tolerance: of the outputs, relative to the largest number in them.
        work: of a step; None where it does not matter.
        against: programs of Ebb's that run in the same rounds, for a ratio to them.
        systems: which take part.
        threads: with how many; None where the caller says.
        rounds: at most so many.
    """

    name: str
    title: str
    code: str
    make: Callable[[int], Arrays]
    sizes: dict[Scale, int]
    expected: Callable[[Arrays, int], Arrays]
    tolerance: float = 1e-4
    work: Callable[[Arrays], Work] | None = None
    against: tuple[str, ...] = ()
    systems: tuple[str, ...] = ("ebb", "cpp", "numba", "taichi", "quadrants", "warp")
    threads: tuple[int, ...] | None = None
    rounds: int = 1000
    check_steps: int = 3


# An edge: 3 subtractions, 5 for the square, root, division, 3 times 3 for the pull and 3 sums. A vertex: 3 times 9.
SPRING_FLOPS, MOVE_FLOPS = 22, 27


def gather_work(arrays: Arrays) -> Work:
    """Forces read head, rest_len, first, q and add to force; the move reads and writes q, qd, force, and reads mass."""
    edges, vertices = len(arrays["head"]), len(arrays["q"])
    return Work(8 * edges + (4 + 12 + 24 + 3 * 24 + 4) * vertices, SPRING_FLOPS * edges + MOVE_FLOPS * vertices)


def scatter_work(arrays: Arrays) -> Work:
    edges, vertices = len(arrays["head"]), len(arrays["q"])
    return Work(12 * edges + (12 + 24 + 3 * 24 + 4) * vertices, SPRING_FLOPS * edges + MOVE_FLOPS * vertices)


def axpy_work(arrays: Arrays) -> Work:
    return Work(12 * len(arrays["x"]), 2 * len(arrays["x"]))


def stencil_work(flops: int) -> Callable[[Arrays], Work]:
    """One read and one write of each field: what is overwritten need not be read first. Ends of lines count too."""
    return lambda arrays: Work(8 * arrays["old"].size, flops * arrays["old"].size)


def solid_stencil(name: str, title: str, steps: Callable[[Arrays, int], Arrays], flops: int) -> Program:
    """A stencil on 256^3 cells."""
    sizes = {Scale.FULL: 256, Scale.QUICK: 96, Scale.TINY: 6}
    systems = ("ebb", "cpp", "numba", "taichi", "quadrants", *(("warp",) if name == "stencil" else ()))
    return Program(name, title, name, data.grid, sizes, steps, work=stencil_work(flops), systems=systems)


def heat_work(arrays: Arrays) -> Work:
    edges, vertices = len(arrays["head"]), len(arrays["old"])
    return Work(8 * edges + (12 + 8) * vertices, 3 * edges + 2 * vertices)


def pcg_work(arrays: Arrays) -> Work:
    """A product (first, diagonal, p, product), an update (x, r, p, product, diagonal), a direction (r, diagonal, p)."""
    edges, vertices = len(arrays["head"]), len(arrays["b"])
    iteration = Work(8 * edges + (20 + 28 + 16) * vertices, 2 * edges + 14 * vertices)
    return Work(PCG_ITERATIONS * iteration.bytes + 32 * vertices, PCG_ITERATIONS * iteration.flops)


def fluid_work(arrays: Arrays) -> Work:
    """Velocities are read twice and carried on, waves are read and written, positions too: 48 bytes a cell."""
    cells, waves = arrays["u"].size, arrays["waves_u"].size
    return Work((8 + 16 + 8 + 16) * cells + 16 * waves, (2 * 15 + 18) * cells + 15 * waves // 2)


def fluid_program(n: int) -> Program:
    """The kernels of the fluid among frequencies on n x n cells."""
    return Program(
        f"fluid-{n}",
        f"a fluid among frequencies on {n}^2 cells, without its transforms",
        "fluid",
        fluid_data.fluid,
        {Scale.FULL: n, Scale.QUICK: n // 2, Scale.TINY: 8},
        fluid_data.fluid_steps,
        tolerance=3e-3,  # a particle on the border of cells may take the velocity of either
        work=fluid_work,
        systems=("ebb", "cpp"),
    )


TETRAHEDRON_FLOPS = 1300
"""Of forces and stiffness, with ten of the sixteen blocks computed: 850 of them for these, 144 to add all up."""


def assembly_work(arrays: Arrays) -> Work:
    """Forces and stiffness are cleared, then added to; a tetrahedron has 20 keys, 9 gradients and a volume."""
    elements, edges, vertices = len(arrays["corners"]), len(arrays["head"]), len(arrays["points"])
    return Work(160 * elements + 2 * 144 * edges + (2 * 48 + 24) * vertices, TETRAHEDRON_FLOPS * elements)


def solver_work(arrays: Arrays) -> Work:
    """An iteration: 76 bytes a block and 76 a vertex for the product, 168 for the update, 96 for the direction."""
    edges, vertices = len(arrays["head"]), len(arrays["points"])
    times = solids.CG_ITERATIONS
    return Work(times * (76 * edges + (76 + 168 + 96) * vertices), times * (18 * edges + 33 * vertices))


def solid_program(
    code: str,
    text: str,
    make: Callable[[int], Arrays],
    expected_of: Callable[[Arrays, int], Arrays],
    n: int,
    tolerance: float,
    work: Callable[[Arrays], Work] | None = None,
) -> Program:
    """A program of ``solids`` on a beam of 12 n^3 tetrahedra."""
    count = 12 * n**3
    return Program(
        f"{code}-{count}",
        f"{text}, {count:,} tetrahedra",
        code,
        make,
        {Scale.FULL: n, Scale.QUICK: min(n, 12), Scale.TINY: 2},
        expected_of,
        tolerance=tolerance,
        work=work,
        systems=("ebb", "cpp"),
        check_steps=1 if work else 3,
    )


def solid_programs() -> tuple[Program, ...]:
    """Elastic solids: as large as the dragon of the paper's figure, refined twice, and as its bunny."""
    assembly = ("solid-assembly", "forces and stiffness of StVK", solids.beam, solids.assembly_steps)
    solver = (
        "solid-solver",
        f"{solids.CG_ITERATIONS} iterations of CG",
        solids.beam_system,
        solids.solver_steps,
    )
    step = ("solid", "a step of an elastic beam", solids.beam_at_rest, solids.solid_steps)
    rubber, law = "neo-Hookean", partial(partial, law=solids.neohookean)
    sheared = ("rubber-assembly", f"forces and stiffness, {rubber}", solids.beam, law(solids.assembly_steps))
    bounced = ("rubber", f"a step of a beam, {rubber}", solids.beam_at_rest, law(solids.solid_steps))
    return (
        *(solid_program(*assembly, n, 1e-9, assembly_work) for n in (6, 24)),
        *(solid_program(*solver, n, 1e-4, solver_work) for n in (6, 24)),
        solid_program(*step, 6, 1e-4),
        *(solid_program(*sheared, n, 1e-9) for n in (6, 19)),
        *(solid_program(*bounced, n, 1e-4) for n in (6, 19)),
    )


BOX = {Scale.FULL: 52, Scale.QUICK: 24, Scale.TINY: 3}


def springs(
    name: str, text: str, code: str, prepared: Callable[[Arrays], Arrays] = lambda arrays: arrays, against: str = ""
) -> Program:
    """A spring-mass program by ``code`` on the box, ``prepared`` first."""
    return Program(
        name,
        f"spring-mass step, {text}",
        code,
        lambda n: prepared(data.springs(n)),
        BOX,
        expected.spring_steps,
        work=gather_work if code == "gather" else scatter_work,
        against=(against,) if against else (),
    )


def particles(name: str, text: str, against: str = "") -> Program:
    """A million particles carried through a flow on 256^2 cells by steps of Euler's."""
    return Program(
        name,
        f"10^6 particles carried by an interpolated flow, {text}",
        name,
        data.particles,
        {Scale.FULL: 1_000_000, Scale.QUICK: 100_000, Scale.TINY: 50},
        expected.particle_steps,
        tolerance=1e-5,
        against=(against,) if against else (),
        systems=("ebb", "cpp"),
    )


PROGRAMS = (
    springs("gather", "gather over the edges of a vertex", "gather"),
    springs("scatter", "each directed edge adds to its tail", "scatter", against="gather"),
    springs("both-ends", "each undirected edge adds to both ends", "both-ends", data.undirected, "gather"),
    springs("gather-shuffled", "the gather on shuffled rows of the mesh", "gather", data.shuffled, "gather"),
    springs("scatter-shuffled", "the scatter on shuffled rows of the mesh", "scatter", data.shuffled, "scatter"),
    Program(
        "streaming",
        "y = a*x + y, 10^7 rows",
        "streaming",
        data.rows,
        {Scale.FULL: 10_000_000, Scale.QUICK: 1_000_000, Scale.TINY: 1000},
        expected.axpy_steps,
        work=axpy_work,
    ),
    solid_stencil("stencil", "7-point stencil, 256^3 cells", expected.stencil_steps, 8),
    solid_stencil("stencil-27", "27-point stencil, 256^3 cells", stencils.stencil27_steps, 30),
    solid_stencil("stencil-periodic", "7-point stencil, 256^3 cells that wrap", stencils.periodic_steps, 8),
    Program(
        "jacobi",
        "Jacobi iteration, 4096^2 cells",
        "jacobi",
        stencils.plane,
        {Scale.FULL: 4096, Scale.QUICK: 1024, Scale.TINY: 9},
        stencils.jacobi_steps,
        work=stencil_work(4),
    ),
    Program(
        "heat",
        "heat on a torus of triangles, explicit step",
        "heat",
        data.surface,
        {Scale.FULL: 400, Scale.QUICK: 100, Scale.TINY: 6},
        expected.heat_steps,
        work=heat_work,
    ),
    Program(
        "pcg",
        f"{PCG_ITERATIONS} iterations of PCG on a Laplacian of tetrahedra",
        "pcg",
        data.laplacian,
        BOX,
        expected.pcg_steps,
        tolerance=1e-3,
        work=pcg_work,
        check_steps=1,
    ),
    particles("particles", "each finds its cell"),
    particles("particles-keys", "each has a key of its cell, and finds the next", "particles"),
    *(fluid_program(n) for n in (512, 1024, 2048)),
    *solid_programs(),
    Program(
        "launch",
        "one launch on 1 row",
        "streaming",
        data.rows,
        dict.fromkeys(Scale, 1),
        expected.axpy_steps,
        threads=(1,),
    ),
    Program(
        "captured",
        "one launch on 1 row, recorded once and replayed",
        "captured",
        data.rows,
        dict.fromkeys(Scale, 1),
        expected.axpy_steps,
        systems=("ebb", "cpp", "warp"),
        threads=(1,),
    ),
    Program(
        "interpreter",
        "the gather step on a small box, also by the reference interpreter",
        "gather",
        data.springs,
        {Scale.FULL: 12, Scale.QUICK: 8, Scale.TINY: 2},
        expected.spring_steps,
        systems=("ebb", "reference", "cpp"),
        threads=(1,),
        rounds=3,
        check_steps=1,
    ),
)

BY_NAME = {program.name: program for program in PROGRAMS}


def triad(program: Program, working_set: int) -> Program:
    """``a = b + s*c`` over a working set of the size of that program's: what the memory gives at best."""
    n = max(16, working_set // 12 // 16 * 16)
    return Program(
        f"triad-{program.name}",
        "triad over the same working set",
        "triad",
        lambda _: {"a": np.zeros(n, np.float32), **{name: np.ones(n, np.float32) for name in "bc"}},
        program.sizes,
        lambda arrays, _: {"a": arrays["b"] + 3.0 * arrays["c"]},
        work=lambda _: Work(16 * n, 2 * n),
        systems=("cpp",),
    )


FMA = Program(
    "fma",
    "independent fused multiply-adds in registers",
    "fma",
    lambda _: {"a": np.zeros(1, np.float32)},
    dict.fromkeys(Scale, 1),
    lambda arrays, _: {"a": np.zeros(1)},
    work=lambda _: Work(0, 2 * FMA_PER_STEP),
    systems=("cpp",),
)
