"""Plain C++ by g++, called through ctypes: one thread without OpenMP, several with it."""

from __future__ import annotations

import ctypes
import hashlib
import os
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.constants import (
    AXPY_FACTOR,
    DT,
    FMA_PER_STEP,
    PARTICLE_DT,
    PCG_ITERATIONS,
    STENCIL_CENTER,
    STENCIL_SIDE,
    STIFFNESS,
)
from benchmarks.data import Arrays, aligned
from benchmarks.fluids import FLUID_DT, SPREAD, fluid_outputs
from benchmarks.solids import CG_ITERATIONS, DAMPING, LAMBDA, MOST_ITERATIONS, MU, SOLID_DT, TOLERANCE
from benchmarks.stencils import JACOBI, WEIGHTS
from benchmarks.systems import Prepared, Programs

THREADS = int(os.environ["OMP_NUM_THREADS"])
FLAGS = ("-O3", "-march=native", "-ffast-math", "-std=c++17", "-shared", "-fPIC")
SOURCE = "kernels.cpp"


def version() -> str:
    first = subprocess.run(["g++", "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
    return f"{first} {' '.join(FLAGS[:3])}"


@cache
def library(source: str = SOURCE) -> ctypes.CDLL:
    """The functions of a source file beside this one, compiled if they are not yet."""
    file = Path(__file__).with_name(source)
    flags = (*FLAGS, *(("-fopenmp",) if THREADS > 1 else ()))
    key = hashlib.sha256(file.read_bytes() + repr((flags, version())).encode()).hexdigest()[:16]
    path = Path(os.environ["BENCHMARKS_CACHE"]) / f"{file.stem}-{key}.so"
    if not path.exists():
        made = path.with_suffix(f".{os.getpid()}")
        done = subprocess.run(["g++", *flags, "-o", str(made), str(file)], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"g++ {' '.join(flags)} failed:\n{done.stderr}")
        made.replace(path)
    return ctypes.CDLL(str(path))


def convert(argument: object) -> object:
    match argument:
        case np.ndarray():
            return ctypes.c_void_p(argument.ctypes.data)
        case float():
            return ctypes.c_float(argument)
        case int():
            return ctypes.c_int64(argument)
        case _:
            return argument


def bind(name: str, *arguments: object, source: str = SOURCE) -> Callable[[int], None]:
    """Calls of that function with these arguments, converted once."""
    function = getattr(library(source), name)
    function.restype = None
    converted = [convert(argument) for argument in arguments]

    def run(steps: int, kept: object = arguments) -> None:  # the memory lives as long as its addresses
        for _ in range(steps):
            function(*converted)

    return run


def some(arrays: Arrays, *names: str) -> Callable[[], Arrays]:
    return lambda: {name: arrays[name] for name in names}


def springs(arrays: Arrays, name: str, *index: object) -> Prepared:
    force = aligned(np.zeros_like(arrays["q"]))
    moved = (arrays["rest_len"], arrays["q"], arrays["qd"], force, arrays["mass"], STIFFNESS, DT)
    return Prepared(bind(name, len(force), *index, *moved), some(arrays, "q", "qd"))


def gather(arrays: Arrays) -> Prepared:
    return springs(arrays, "gather", arrays["first"], arrays["head"])


def scatter(arrays: Arrays) -> Prepared:
    return springs(arrays, "scatter", len(arrays["tail"]), arrays["tail"], arrays["head"])


def both_ends(arrays: Arrays) -> Prepared:
    return springs(arrays, "both_ends", len(arrays["tail"]), arrays["tail"], arrays["head"])


def streaming(arrays: Arrays) -> Prepared:
    return Prepared(bind("axpy", len(arrays["x"]), AXPY_FACTOR, arrays["x"], arrays["y"]), some(arrays, "y"))


def captured(arrays: Arrays) -> Prepared:
    """Calls through a pointer, so that the compiler cannot inline what it repeats."""
    times = library().axpy_times
    times.restype = None
    arguments = [convert(x) for x in (library().axpy, len(arrays["x"]), AXPY_FACTOR, arrays["x"], arrays["y"])]
    return Prepared(lambda steps: times(ctypes.c_int64(steps), *arguments), some(arrays, "y"))


def alternate(there: Callable[[int], None], back: Callable[[int], None], old: np.ndarray, new: np.ndarray) -> Prepared:
    """Steps from ``old`` to ``new`` and the next from ``new`` to ``old``."""
    state = {"old": old, "new": new}

    def run(steps: int) -> None:
        for _ in range(steps):
            (there if state["old"] is old else back)(1)
            state["old"], state["new"] = state["new"], state["old"]

    return Prepared(run, lambda: {"old": state["old"]})


def stencil(arrays: Arrays) -> Prepared:
    old, new = arrays["old"], arrays["new"]
    numbers = (STENCIL_CENTER, STENCIL_SIDE)
    there, back = (bind("stencil", len(old), a, b, *numbers) for a, b in ((old, new), (new, old)))
    return alternate(there, back, old, new)


def more_stencils(arrays: Arrays, name: str, *numbers: float) -> Prepared:
    old, new = arrays["old"], arrays["new"]
    there, back = (bind(name, len(old), a, b, *numbers, source="stencils.cpp") for a, b in ((old, new), (new, old)))
    return alternate(there, back, old, new)


def heat(arrays: Arrays) -> Prepared:
    old, new = arrays["old"], arrays["new"]
    given = (len(old), *(arrays[name] for name in ("first", "head", "weight", "rate")))
    return alternate(bind("heat", *given, old, new), bind("heat", *given, new, old), old, new)


def particles(arrays: Arrays) -> Prepared:
    pos, vel = arrays["pos"], arrays["vel"]
    return Prepared(bind("particles", len(pos), len(vel), pos, vel, PARTICLE_DT), some(arrays, "pos"))


def particles_keys(arrays: Arrays) -> Prepared:
    pos, vel = arrays["pos"], arrays["vel"]
    i, j = np.floor(pos * len(vel) - np.float32(0.5)).astype(np.int32).T % len(vel)
    given = (len(pos), len(vel), pos, aligned(i * len(vel) + j), vel, PARTICLE_DT)
    return Prepared(bind("particles_keys", *given), some(arrays, "pos"))


def pcg(arrays: Arrays) -> Prepared:
    given = [arrays[name] for name in ("first", "head", "weight", "diagonal", "b")]
    x, r, p, product = (aligned(np.zeros_like(arrays["b"])) for _ in range(4))
    return Prepared(bind("pcg", PCG_ITERATIONS, len(x), *given, x, r, p, product), lambda: {"x": x})


def fluid(arrays: Arrays) -> Prepared:
    u, v, pos = (arrays[name] for name in ("u", "v", "pos"))
    carried, waves = [aligned(np.zeros_like(u)) for _ in "uv"], {name: arrays[name] for name in ("waves_u", "waves_v")}
    run = bind("fluid", len(u), u, v, *carried, *waves.values(), pos, FLUID_DT, SPREAD, source="fluids.cpp")
    return Prepared(run, lambda: fluid_outputs(*carried, waves, pos))


def doubles(*numbers: float) -> tuple[ctypes.c_double, ...]:
    return tuple(map(ctypes.c_double, numbers))


def zeros(*shape: int) -> np.ndarray:
    return aligned(np.zeros(shape))


def elements(arrays: Arrays) -> tuple[object, ...]:
    given = (arrays[name] for name in ("corners", "entries", "inverse", "volume"))
    return (len(arrays["corners"]), *given, *doubles(LAMBDA, MU))


def solid_assembly(arrays: Arrays, law: str) -> Prepared:
    size = len(arrays["points"])
    force, stiffness = zeros(size, 3), zeros(len(arrays["head"]), 3, 3)
    given = (size, arrays["first"], *elements(arrays), arrays["moved"], force, stiffness)
    return Prepared(bind(law, *given, source="fem.cpp"), lambda: {"force": force, "stiffness": stiffness})


def solid_solver(arrays: Arrays) -> Prepared:
    size, diagonal = len(arrays["b"]), np.einsum("eaa->ea", arrays["matrix"][arrays["diagonal"]])
    x, r, p, product = (zeros(size, 3) for _ in range(4))
    system = (arrays["first"], arrays["head"], arrays["matrix"], aligned(1 / diagonal), arrays["b"])
    run = bind("block_cg", CG_ITERATIONS, *doubles(0.0), size, *system, x, r, p, product, source="fem.cpp")
    return Prepared(run, lambda: {"x": x})


def solid(arrays: Arrays, law: str) -> Prepared:
    size = len(arrays["points"])
    moved, velocity, matrix = arrays["moved"], zeros(size, 3), zeros(len(arrays["head"]), 3, 3)
    force, *work = (zeros(size, 3) for _ in range(7))
    mesh = (size, *(arrays[name] for name in ("first", "head", "diagonal")), *elements(arrays))
    given = (*(arrays[name] for name in ("mass", "load", "free")), *doubles(SOLID_DT, 0.0, DAMPING))
    limits = (MOST_ITERATIONS, *doubles(TOLERANCE))
    run = bind(f"{law}_step", *limits, *mesh, *given, moved, velocity, force, matrix, *work, source="fem.cpp")
    return Prepared(run, lambda: {"moved": moved, "velocity": velocity})


def triad(arrays: Arrays) -> Prepared:
    a, b, c = (arrays[name] for name in "abc")
    return Prepared(bind("triad", len(a), a, b, c, 3.0), some(arrays, "a"))


def fma(arrays: Arrays) -> Prepared:
    return Prepared(bind("fma_chains", FMA_PER_STEP, ctypes.c_int(THREADS), arrays["a"]), some(arrays, "a"))


PROGRAMS: Programs = {
    "gather": gather,
    "scatter": scatter,
    "both-ends": both_ends,
    "streaming": streaming,
    "captured": captured,
    "stencil": stencil,
    "stencil-27": lambda arrays: more_stencils(arrays, "stencil27", *WEIGHTS),
    "stencil-periodic": lambda arrays: more_stencils(arrays, "periodic", STENCIL_CENTER, STENCIL_SIDE),
    "jacobi": lambda arrays: more_stencils(arrays, "jacobi", JACOBI),
    "heat": heat,
    "pcg": pcg,
    "particles": particles,
    "particles-keys": particles_keys,
    "fluid": fluid,
    "solid-assembly": lambda arrays: solid_assembly(arrays, "stvk"),
    "rubber-assembly": lambda arrays: solid_assembly(arrays, "neohookean"),
    "solid-solver": solid_solver,
    "solid": lambda arrays: solid(arrays, "stvk"),
    "rubber": lambda arrays: solid(arrays, "neohookean"),
    "triad": triad,
    "fma": fma,
}
