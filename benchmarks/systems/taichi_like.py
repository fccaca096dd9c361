"""Taichi, and Quadrants, its fork with the same API: which of them, the worker says.

Types in signatures are objects here, not strings, because these systems read them so: this file must not import
annotations from the future.
"""

import importlib
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.constants import AXPY_FACTOR, DT, PCG_ITERATIONS, STENCIL_CENTER, STENCIL_SIDE, STIFFNESS
from benchmarks.data import Arrays
from benchmarks.systems import Prepared, Programs

ti: Any = importlib.import_module(os.environ["BENCHMARKS_SYSTEM"])
ti.init(arch=ti.cpu, cpu_max_num_threads=int(os.environ["BENCHMARKS_THREADS"]), log_level=ti.WARN, offline_cache=True)

Vectors = ti.types.ndarray(dtype=ti.types.vector(3, ti.f32), ndim=1)
Floats = ti.types.ndarray(dtype=ti.f32, ndim=1)
Integers = ti.types.ndarray(dtype=ti.i32, ndim=1)
Grid = ti.types.ndarray(dtype=ti.f32, ndim=3)


def version() -> str:
    return ".".join(map(str, ti.__version__))


def array(values: np.ndarray) -> Any:
    """A flat array of numbers, or of vectors where ``values`` has three columns."""
    dtype = ti.i32 if values.dtype == np.int32 else ti.f32
    if values.ndim == 2:
        made = ti.Vector.ndarray(values.shape[1], dtype, shape=len(values))
    else:
        made = ti.ndarray(dtype, shape=values.shape)
    made.from_numpy(np.ascontiguousarray(values))
    return made


def repeat(step: Callable[[], Any]) -> Callable[[int], None]:
    def run(steps: int) -> None:
        for _ in range(steps):
            step()
        ti.sync()

    return run


@ti.func
def pull(dq, rest_len, stiffness):
    length = dq.norm()
    scale = 0.0
    if length > 0:
        scale = rest_len / length
    return stiffness * (scale * dq - dq)


@ti.kernel
def gather(first: Integers, head: Integers, rest_len: Floats, q: Vectors, force: Vectors, stiffness: ti.f32):
    for v in range(q.shape[0]):
        total = force[v]
        own = q[v]
        for e in range(first[v], first[v + 1]):
            total += pull(q[head[e]] - own, rest_len[e], stiffness)
        force[v] = total


@ti.kernel
def scatter(tail: Integers, head: Integers, rest_len: Floats, q: Vectors, force: Vectors, stiffness: ti.f32):
    for e in range(tail.shape[0]):
        t = tail[e]
        force[t] += pull(q[head[e]] - q[t], rest_len[e], stiffness)


@ti.kernel
def scatter_to_both(tail: Integers, head: Integers, rest_len: Floats, q: Vectors, force: Vectors, stiffness: ti.f32):
    for e in range(tail.shape[0]):
        t = tail[e]
        h = head[e]
        f = pull(q[h] - q[t], rest_len[e], stiffness)
        force[t] += f
        force[h] -= f


@ti.kernel
def move(q: Vectors, qd: Vectors, force: Vectors, mass: Floats, dt: ti.f32):
    for v in range(q.shape[0]):
        qdd = force[v] / mass[v]
        q[v] = q[v] + qd[v] * dt + 0.5 * qdd * dt * dt
        qd[v] = qd[v] + qdd * dt
        force[v] = ti.Vector([0.0, 0.0, 0.0])


def springs(arrays: Arrays, forces: Callable[..., None], index: str) -> Prepared:
    given = [array(arrays[name]) for name in (index, "head")]
    rest_len, q, qd, mass = (array(arrays[name]) for name in ("rest_len", "q", "qd", "mass"))
    force = array(np.zeros_like(arrays["q"]))

    def step() -> None:
        forces(*given, rest_len, q, force, STIFFNESS)
        move(q, qd, force, mass, DT)

    return Prepared(repeat(step), lambda: {"q": q.to_numpy(), "qd": qd.to_numpy()})


@ti.kernel
def axpy(a: ti.f32, x: Floats, y: Floats):
    for i in range(x.shape[0]):
        y[i] = a * x[i] + y[i]


def streaming(arrays: Arrays) -> Prepared:
    x, y = array(arrays["x"]), array(arrays["y"])
    return Prepared(repeat(lambda: axpy(AXPY_FACTOR, x, y)), lambda: {"y": y.to_numpy()})


@ti.kernel
def relax(old: Grid, new: Grid, center: ti.f32, side: ti.f32):
    for i, j, k in ti.ndrange((1, old.shape[0] - 1), (1, old.shape[1] - 1), (1, old.shape[2] - 1)):
        sides = old[i - 1, j, k] + old[i + 1, j, k] + old[i, j - 1, k] + old[i, j + 1, k]
        new[i, j, k] = center * old[i, j, k] + side * (sides + old[i, j, k - 1] + old[i, j, k + 1])


def stencil(arrays: Arrays) -> Prepared:
    state = [array(arrays["old"]), array(arrays["new"])]

    def step() -> None:
        relax(*state, STENCIL_CENTER, STENCIL_SIDE)
        state.reverse()

    return Prepared(repeat(step), lambda: {"old": state[0].to_numpy()})


@ti.kernel
def diffuse(first: Integers, head: Integers, weight: Floats, rate: Floats, old: Floats, new: Floats):
    for v in range(old.shape[0]):
        own = old[v]
        flow = 0.0
        for e in range(first[v], first[v + 1]):
            flow += weight[e] * (old[head[e]] - own)
        new[v] = own + rate[v] * flow


def heat(arrays: Arrays) -> Prepared:
    given = [array(arrays[name]) for name in ("first", "head", "weight", "rate")]
    state = [array(arrays["old"]), array(arrays["new"])]

    def step() -> None:
        diffuse(*given, *state)
        state.reverse()

    return Prepared(repeat(step), lambda: {"old": state[0].to_numpy()})


@ti.kernel
def start(diagonal: Floats, b: Floats, x: Floats, r: Floats, p: Floats) -> ti.f64:
    rz = ti.cast(0.0, ti.f64)
    for v in range(b.shape[0]):
        x[v] = 0.0
        r[v] = b[v]
        p[v] = b[v] / diagonal[v]
        rz += ti.cast(r[v] * p[v], ti.f64)
    return rz


@ti.kernel
def multiply(first: Integers, head: Integers, weight: Floats, diagonal: Floats, p: Floats, product: Floats) -> ti.f64:
    along = ti.cast(0.0, ti.f64)
    for v in range(p.shape[0]):
        total = diagonal[v] * p[v]
        for e in range(first[v], first[v + 1]):
            total -= weight[e] * p[head[e]]
        product[v] = total
        along += ti.cast(p[v] * total, ti.f64)
    return along


@ti.kernel
def update(alpha: ti.f32, diagonal: Floats, p: Floats, product: Floats, x: Floats, r: Floats) -> ti.f64:
    rz = ti.cast(0.0, ti.f64)
    for v in range(p.shape[0]):
        x[v] = x[v] + alpha * p[v]
        rest = r[v] - alpha * product[v]
        r[v] = rest
        rz += ti.cast(rest * rest / diagonal[v], ti.f64)
    return rz


@ti.kernel
def turn(beta: ti.f32, diagonal: Floats, r: Floats, p: Floats):
    for v in range(p.shape[0]):
        p[v] = r[v] / diagonal[v] + beta * p[v]


def pcg(arrays: Arrays) -> Prepared:
    index = [array(arrays[name]) for name in ("first", "head", "weight")]
    diagonal, b = array(arrays["diagonal"]), array(arrays["b"])
    x, r, p, product = (array(np.zeros_like(arrays["b"])) for _ in range(4))

    def solve() -> None:
        rz = start(diagonal, b, x, r, p)
        for _ in range(PCG_ITERATIONS):
            alpha = rz / multiply(*index, diagonal, p, product)
            rz, before = update(alpha, diagonal, p, product, x, r), rz
            turn(rz / before, diagonal, r, p)

    return Prepared(repeat(solve), lambda: {"x": x.to_numpy()})


PROGRAMS: Programs = {
    "gather": lambda arrays: springs(arrays, gather, "first"),
    "scatter": lambda arrays: springs(arrays, scatter, "tail"),
    "both-ends": lambda arrays: springs(arrays, scatter_to_both, "tail"),
    "streaming": streaming,
    "stencil": stencil,
    "heat": heat,
    "pcg": pcg,
}
