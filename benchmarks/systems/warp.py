"""Warp on the CPU, which runs on one thread. Types in signatures are objects, as Warp reads them."""

import os

import numpy as np
import warp as wp

from benchmarks.constants import AXPY_FACTOR, DT, PCG_ITERATIONS, STENCIL_CENTER, STENCIL_SIDE, STIFFNESS
from benchmarks.data import Arrays
from benchmarks.stencils import JACOBI
from benchmarks.systems import Prepared, Programs

wp.config.quiet = True
wp.config.kernel_cache_dir = os.environ["WARP_CACHE_PATH"]
wp.init()

# A module for each kernel, so that none compiles the others with it.
kernel = wp.kernel(module="unique", enable_backward=False, module_options={"fast_math": True})
Vectors, Floats, Integers = wp.array(dtype=wp.vec3), wp.array(dtype=float), wp.array(dtype=int)
Doubles, Grid = wp.array(dtype=wp.float64), wp.array3d(dtype=float)
Plane = wp.array2d(dtype=float)


def version() -> str:
    return wp.__version__


def array(values: np.ndarray) -> wp.array:
    if values.ndim == 2:
        return wp.array(values, dtype=wp.vec3, device="cpu")
    return wp.array(values, dtype=int if values.dtype == np.int32 else float, device="cpu")


def launch(launched: wp.Kernel, dim: int | tuple[int, ...], *inputs: object) -> None:
    wp.launch(launched, dim=dim, inputs=inputs, device="cpu")


@wp.func
def pull(dq: wp.vec3, rest_len: float, stiffness: float):
    return stiffness * (rest_len * wp.normalize(dq) - dq)


@kernel
def gather(first: Integers, head: Integers, rest_len: Floats, q: Vectors, force: Vectors, stiffness: float):
    v = wp.tid()
    own = q[v]
    total = force[v]
    for e in range(first[v], first[v + 1]):
        total += pull(q[head[e]] - own, rest_len[e], stiffness)
    force[v] = total


@kernel
def scatter(tail: Integers, head: Integers, rest_len: Floats, q: Vectors, force: Vectors, stiffness: float):
    e = wp.tid()
    t = tail[e]
    wp.atomic_add(force, t, pull(q[head[e]] - q[t], rest_len[e], stiffness))


@kernel
def scatter_to_both(tail: Integers, head: Integers, rest_len: Floats, q: Vectors, force: Vectors, stiffness: float):
    e = wp.tid()
    t = tail[e]
    h = head[e]
    f = pull(q[h] - q[t], rest_len[e], stiffness)
    wp.atomic_add(force, t, f)
    wp.atomic_sub(force, h, f)


@kernel
def move(q: Vectors, qd: Vectors, force: Vectors, mass: Floats, dt: float):
    v = wp.tid()
    qdd = force[v] / mass[v]
    q[v] = q[v] + qd[v] * dt + 0.5 * qdd * dt * dt
    qd[v] = qd[v] + qdd * dt
    force[v] = wp.vec3(0.0, 0.0, 0.0)


def springs(arrays: Arrays, forces: wp.Kernel, index: str) -> Prepared:
    given = [array(arrays[name]) for name in (index, "head", "rest_len")]
    q, qd, mass = (array(arrays[name]) for name in ("q", "qd", "mass"))
    force = wp.zeros_like(q)
    rows = len(q) if index == "first" else len(given[0])

    def run(steps: int) -> None:
        for _ in range(steps):
            launch(forces, rows, *given, q, force, STIFFNESS)
            launch(move, len(q), q, qd, force, mass, DT)

    return Prepared(run, lambda: {"q": q.numpy(), "qd": qd.numpy()})


@kernel
def axpy(a: float, x: Floats, y: Floats):
    i = wp.tid()
    y[i] = a * x[i] + y[i]


def streaming(arrays: Arrays) -> Prepared:
    x, y = array(arrays["x"]), array(arrays["y"])

    def run(steps: int) -> None:
        for _ in range(steps):
            launch(axpy, len(x), AXPY_FACTOR, x, y)

    return Prepared(run, lambda: {"y": y.numpy()})


def captured(arrays: Arrays) -> Prepared:
    """A recorded launch, which Warp replays from Python; its graphs need a GPU."""
    x, y = array(arrays["x"]), array(arrays["y"])
    recorded = wp.launch(axpy, dim=len(x), inputs=[AXPY_FACTOR, x, y], device="cpu", record_cmd=True)

    def run(steps: int) -> None:
        for _ in range(steps):
            recorded.launch()

    return Prepared(run, lambda: {"y": y.numpy()})


@kernel
def relax(old: Grid, fresh: Grid, center: float, side: float):
    a, b, c = wp.tid()
    i = a + 1
    j = b + 1
    k = c + 1
    sides = old[i - 1, j, k] + old[i + 1, j, k] + old[i, j - 1, k] + old[i, j + 1, k]
    fresh[i, j, k] = center * old[i, j, k] + side * (sides + old[i, j, k - 1] + old[i, j, k + 1])


@kernel
def relax_plane(old: Plane, fresh: Plane, side: float):
    a, b = wp.tid()
    i = a + 1
    j = b + 1
    fresh[i, j] = side * (old[i - 1, j] + old[i + 1, j] + old[i, j - 1] + old[i, j + 1])


def stencil(arrays: Arrays, relaxing: wp.Kernel, *numbers: float) -> Prepared:
    state = [wp.array(arrays[name], dtype=float, device="cpu") for name in ("old", "new")]
    inner = tuple(n - 2 for n in arrays["old"].shape)

    def run(steps: int) -> None:
        for _ in range(steps):
            launch(relaxing, inner, *state, *numbers)
            state.reverse()

    return Prepared(run, lambda: {"old": state[0].numpy()})


@kernel
def diffuse(first: Integers, head: Integers, weight: Floats, rate: Floats, old: Floats, fresh: Floats):
    v = wp.tid()
    own = old[v]
    flow = float(0.0)  # noqa: UP018 - a variable, to Warp
    for e in range(first[v], first[v + 1]):
        flow += weight[e] * (old[head[e]] - own)
    fresh[v] = own + rate[v] * flow


def heat(arrays: Arrays) -> Prepared:
    given = [array(arrays[name]) for name in ("first", "head", "weight", "rate")]
    state = [array(arrays[name]) for name in ("old", "new")]

    def run(steps: int) -> None:
        for _ in range(steps):
            launch(diffuse, len(state[0]), *given, *state)
            state.reverse()

    return Prepared(run, lambda: {"old": state[0].numpy()})


@kernel
def start(diagonal: Floats, b: Floats, x: Floats, r: Floats, p: Floats, rz: Doubles):
    v = wp.tid()
    z = b[v] / diagonal[v]
    x[v] = 0.0
    r[v] = b[v]
    p[v] = z
    wp.atomic_add(rz, 0, wp.float64(b[v] * z))


@kernel
def multiply(
    first: Integers, head: Integers, weight: Floats, diagonal: Floats, p: Floats, product: Floats, along: Doubles
):
    v = wp.tid()
    total = diagonal[v] * p[v]
    for e in range(first[v], first[v + 1]):
        total -= weight[e] * p[head[e]]
    product[v] = total
    wp.atomic_add(along, 0, wp.float64(p[v] * total))


@kernel
def update(alpha: float, diagonal: Floats, p: Floats, product: Floats, x: Floats, r: Floats, rz: Doubles):
    v = wp.tid()
    x[v] = x[v] + alpha * p[v]
    rest = r[v] - alpha * product[v]
    r[v] = rest
    wp.atomic_add(rz, 0, wp.float64(rest * rest / diagonal[v]))


@kernel
def turn(beta: float, diagonal: Floats, r: Floats, p: Floats):
    v = wp.tid()
    p[v] = r[v] / diagonal[v] + beta * p[v]


def pcg(arrays: Arrays) -> Prepared:
    index = [array(arrays[name]) for name in ("first", "head", "weight")]
    diagonal, b = array(arrays["diagonal"]), array(arrays["b"])
    x, r, p, product = (wp.zeros_like(b) for _ in range(4))
    total = wp.zeros(1, dtype=wp.float64, device="cpu")
    value = total.numpy()  # the same memory
    n = len(b)

    def summed(launched: wp.Kernel, *inputs: object) -> float:
        value[0] = 0.0
        launch(launched, n, *inputs, total)
        return float(value[0])

    def solve() -> None:
        rz = summed(start, diagonal, b, x, r, p)
        for _ in range(PCG_ITERATIONS):
            alpha = rz / summed(multiply, *index, diagonal, p, product)
            rz, before = summed(update, alpha, diagonal, p, product, x, r), rz
            launch(turn, n, rz / before, diagonal, r, p)

    def run(steps: int) -> None:
        for _ in range(steps):
            solve()

    return Prepared(run, lambda: {"x": x.numpy()})


PROGRAMS: Programs = {
    "gather": lambda arrays: springs(arrays, gather, "first"),
    "scatter": lambda arrays: springs(arrays, scatter, "tail"),
    "both-ends": lambda arrays: springs(arrays, scatter_to_both, "tail"),
    "streaming": streaming,
    "captured": captured,
    "stencil": lambda arrays: stencil(arrays, relax, STENCIL_CENTER, STENCIL_SIDE),
    "jacobi": lambda arrays: stencil(arrays, relax_plane, JACOBI),
    "heat": heat,
    "pcg": pcg,
}
