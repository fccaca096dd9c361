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
from benchmarks.stencils import JACOBI, WEIGHTS
from benchmarks.systems import Prepared, Programs

ti: Any = importlib.import_module(os.environ["BENCHMARKS_SYSTEM"])
ti.init(arch=ti.cpu, cpu_max_num_threads=int(os.environ["BENCHMARKS_THREADS"]), log_level=ti.WARN, offline_cache=True)

Field = ti.template()


def version() -> str:
    return ".".join(map(str, ti.__version__))


def field(values: np.ndarray) -> Any:
    """A dense field of numbers, or of vectors where ``values`` has two dimensions: faster here than an ndarray."""
    dtype = ti.i32 if values.dtype == np.int32 else ti.f32
    if values.ndim == 2:
        made = ti.Vector.field(values.shape[1], dtype, shape=len(values))
    else:
        made = ti.field(dtype, shape=values.shape)
    made.from_numpy(values)
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
def gather(first: Field, head: Field, rest_len: Field, q: Field, force: Field, stiffness: ti.f32):
    for v in q:
        total = force[v]
        own = q[v]
        for e in range(first[v], first[v + 1]):
            total += pull(q[head[e]] - own, rest_len[e], stiffness)
        force[v] = total


@ti.kernel
def scatter(tail: Field, head: Field, rest_len: Field, q: Field, force: Field, stiffness: ti.f32):
    for e in tail:
        t = tail[e]
        force[t] += pull(q[head[e]] - q[t], rest_len[e], stiffness)


@ti.kernel
def scatter_to_both(tail: Field, head: Field, rest_len: Field, q: Field, force: Field, stiffness: ti.f32):
    for e in tail:
        t = tail[e]
        h = head[e]
        f = pull(q[h] - q[t], rest_len[e], stiffness)
        force[t] += f
        force[h] -= f


@ti.kernel
def move(q: Field, qd: Field, force: Field, mass: Field, dt: ti.f32):
    for v in q:
        qdd = force[v] / mass[v]
        q[v] = q[v] + qd[v] * dt + 0.5 * qdd * dt * dt
        qd[v] = qd[v] + qdd * dt
        force[v] = ti.Vector([0.0, 0.0, 0.0])


def springs(arrays: Arrays, forces: Callable[..., None], index: str) -> Prepared:
    given = [field(arrays[name]) for name in (index, "head")]
    rest_len, q, qd, mass = (field(arrays[name]) for name in ("rest_len", "q", "qd", "mass"))
    force = field(np.zeros_like(arrays["q"]))

    def step() -> None:
        forces(*given, rest_len, q, force, STIFFNESS)
        move(q, qd, force, mass, DT)

    return Prepared(repeat(step), lambda: {"q": q.to_numpy(), "qd": qd.to_numpy()})


@ti.kernel
def axpy(a: ti.f32, x: Field, y: Field):
    for i in x:
        y[i] = a * x[i] + y[i]


def streaming(arrays: Arrays) -> Prepared:
    x, y = field(arrays["x"]), field(arrays["y"])
    return Prepared(repeat(lambda: axpy(AXPY_FACTOR, x, y)), lambda: {"y": y.to_numpy()})


@ti.kernel
def relax(old: Field, new: Field, center: ti.f32, side: ti.f32):
    for i in range(1, old.shape[0] - 1):  # three loops: a third of the time of one over ti.ndrange
        for j in range(1, old.shape[1] - 1):
            for k in range(1, old.shape[2] - 1):
                sides = old[i - 1, j, k] + old[i + 1, j, k] + old[i, j - 1, k] + old[i, j + 1, k]
                new[i, j, k] = center * old[i, j, k] + side * (sides + old[i, j, k - 1] + old[i, j, k + 1])


@ti.func
def faces(old: ti.template(), i, j, k):
    return old[i - 1, j, k] + old[i + 1, j, k] + old[i, j - 1, k] + old[i, j + 1, k]


@ti.func
def corners(old: ti.template(), i, j, k):
    return old[i - 1, j - 1, k] + old[i - 1, j + 1, k] + old[i + 1, j - 1, k] + old[i + 1, j + 1, k]


@ti.func
def weighted(old: ti.template(), i, j, k, own, face, edge):
    return own * old[i, j, k] + face * faces(old, i, j, k) + edge * corners(old, i, j, k)


@ti.kernel
def relax27(old: Field, new: Field, w0: ti.f32, w1: ti.f32, w2: ti.f32, w3: ti.f32):
    for i in range(1, old.shape[0] - 1):
        for j in range(1, old.shape[1] - 1):
            for k in range(1, old.shape[2] - 1):
                middle = weighted(old, i, j, k, w0, w1, w2)
                new[i, j, k] = middle + weighted(old, i, j, k - 1, w1, w2, w3) + weighted(old, i, j, k + 1, w1, w2, w3)


@ti.kernel
def relax_around(old: Field, new: Field, center: ti.f32, side: ti.f32):
    for i in range(old.shape[0]):
        n = old.shape[0]
        for j in range(n):
            for k in range(n):
                sides = old[(i - 1) % n, j, k] + old[(i + 1) % n, j, k]
                sides += old[i, (j - 1) % n, k] + old[i, (j + 1) % n, k]
                sides += old[i, j, (k - 1) % n] + old[i, j, (k + 1) % n]
                new[i, j, k] = center * old[i, j, k] + side * sides


@ti.kernel
def relax_plane(old: Field, new: Field, side: ti.f32):
    for i in range(1, old.shape[0] - 1):
        for j in range(1, old.shape[1] - 1):
            new[i, j] = side * (old[i - 1, j] + old[i + 1, j] + old[i, j - 1] + old[i, j + 1])


def numbers_of(values: np.ndarray) -> Any:
    """A dense field of numbers, of any number of dimensions."""
    made = ti.field(ti.f32, shape=values.shape)
    made.from_numpy(values)
    return made


def stencil(arrays: Arrays, kernel: Callable[..., None], *numbers: float) -> Prepared:
    state = [numbers_of(arrays["old"]), numbers_of(arrays["new"])]

    def step() -> None:
        kernel(*state, *numbers)
        state.reverse()

    return Prepared(repeat(step), lambda: {"old": state[0].to_numpy()})


@ti.kernel
def diffuse(first: Field, head: Field, weight: Field, rate: Field, old: Field, new: Field):
    for v in old:
        own = old[v]
        flow = 0.0
        for e in range(first[v], first[v + 1]):
            flow += weight[e] * (old[head[e]] - own)
        new[v] = own + rate[v] * flow


def heat(arrays: Arrays) -> Prepared:
    given = [field(arrays[name]) for name in ("first", "head", "weight", "rate")]
    state = [field(arrays["old"]), field(arrays["new"])]

    def step() -> None:
        diffuse(*given, *state)
        state.reverse()

    return Prepared(repeat(step), lambda: {"old": state[0].to_numpy()})


@ti.kernel
def start(diagonal: Field, b: Field, x: Field, r: Field, p: Field) -> ti.f64:
    rz = ti.cast(0.0, ti.f64)
    for v in b:
        x[v] = 0.0
        r[v] = b[v]
        p[v] = b[v] / diagonal[v]
        rz += ti.cast(r[v] * p[v], ti.f64)
    return rz


@ti.kernel
def multiply(first: Field, head: Field, weight: Field, diagonal: Field, p: Field, product: Field) -> ti.f64:
    along = ti.cast(0.0, ti.f64)
    for v in p:
        total = diagonal[v] * p[v]
        for e in range(first[v], first[v + 1]):
            total -= weight[e] * p[head[e]]
        product[v] = total
        along += ti.cast(p[v] * total, ti.f64)
    return along


@ti.kernel
def update(alpha: ti.f32, diagonal: Field, p: Field, product: Field, x: Field, r: Field) -> ti.f64:
    rz = ti.cast(0.0, ti.f64)
    for v in p:
        x[v] = x[v] + alpha * p[v]
        rest = r[v] - alpha * product[v]
        r[v] = rest
        rz += ti.cast(rest * rest / diagonal[v], ti.f64)
    return rz


@ti.kernel
def turn(beta: ti.f32, diagonal: Field, r: Field, p: Field):
    for v in p:
        p[v] = r[v] / diagonal[v] + beta * p[v]


def pcg(arrays: Arrays) -> Prepared:
    index = [field(arrays[name]) for name in ("first", "head", "weight")]
    diagonal, b = field(arrays["diagonal"]), field(arrays["b"])
    x, r, p, product = (field(np.zeros_like(arrays["b"])) for _ in range(4))

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
    "stencil": lambda arrays: stencil(arrays, relax, STENCIL_CENTER, STENCIL_SIDE),
    "stencil-27": lambda arrays: stencil(arrays, relax27, *WEIGHTS),
    "stencil-periodic": lambda arrays: stencil(arrays, relax_around, STENCIL_CENTER, STENCIL_SIDE),
    "jacobi": lambda arrays: stencil(arrays, relax_plane, JACOBI),
    "heat": heat,
    "pcg": pcg,
}
