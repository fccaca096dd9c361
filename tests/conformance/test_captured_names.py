"""Captured names follow Python: globals, closures, attributes, arrays, tuples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

import ebb

from .harness import define, kernel_of, rejects, rows_with

GRAVITY = -9.81
OFFSETS = ((1, 2), (3, 4))


@dataclass
class Material:
    density: float = 2.0
    stiffness: float = 10.0


STEEL = Material(density=8.0)


def test_a_global_of_the_module(backend):
    rows = rows_with(v=(ebb.float64, [0, 1]))

    @ebb.kernel
    def fall(r: rows):
        r.v += GRAVITY * 0.1

    fall(rows)
    np.testing.assert_allclose(rows.v.to_numpy(), [-0.981, 0.019])


def test_a_global_that_changes_between_two_launches(backend):
    rows = rows_with(x=(ebb.float64, [0]))
    names = define(
        """
        scale = 1.0

        @ebb.kernel
        def add(r: rows):
            r.x += scale
        """,
        rows=rows,
    )
    names["add"](rows)
    names["scale"] = 10.0
    names["add"](rows)
    names["scale"] = -0.5
    names["add"](rows)
    assert rows.x.to_numpy()[0] == 10.5


def test_a_closure_variable_that_changes(backend):
    rows = rows_with(x=(ebb.float64, [0]))
    step = 1.0

    @ebb.kernel
    def add(r: rows):
        r.x += step

    for step in (1.0, 2.0, 4.0):  # noqa: B007
        add(rows)
    assert rows.x.to_numpy()[0] == 7


def test_a_number_that_becomes_another_type(backend):
    rows = rows_with(x=(ebb.float64, [0]))
    step = 1

    @ebb.kernel
    def add(r: rows):
        r.x += step / 2

    add(rows)
    step = 0.25
    add(rows)
    step = np.float32(3)
    add(rows)
    assert rows.x.to_numpy()[0] == 0.5 + 0.125 + 1.5


def test_a_number_needed_at_compile_time(backend):
    rows = rows_with(v=(ebb.vec3d, [[1, 2, 3]]), x=(ebb.float64, [0]))
    axis = 0

    @ebb.kernel
    def pick(r: rows):
        r.x = r.v[axis]

    for axis in (0, 2, 1):
        pick(rows)
        assert rows.x.to_numpy()[0] == axis + 1


def test_a_compile_time_number_out_of_range_is_an_error_at_its_launch():
    rows = rows_with(v=(ebb.vec3d, [[1, 2, 3]]), x=(ebb.float64, [0]))
    axis = 1

    @ebb.kernel
    def pick(r: rows):
        r.x = r.v[axis]

    pick(rows)
    axis = 3
    with pytest.raises((ebb.KernelTypeError, ebb.BoundsError)):
        pick(rows)
    assert rows.x.to_numpy()[0] == 2


def test_captured_bools_and_ints(backend):
    rows = rows_with(x=(ebb.int32, [1, 2]))
    enabled, times = True, 3

    @ebb.kernel
    def program(r: rows):
        if enabled:
            for _ in range(times):
                r.x *= 2

    program(rows)
    enabled, times = False, 9
    program(rows)
    enabled, times = True, 1
    program(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), [16, 32])


def test_python_arithmetic_on_captured_numbers(backend):
    rows = rows_with(x=(ebb.float32, [1.0]))
    dx, n = 0.1, 7

    @ebb.kernel
    def program(r: rows):
        r.x = r.x * (dx * dx / (2 * n)) + math.sqrt(dx) ** n

    program(rows)
    np.testing.assert_allclose(rows.x.to_numpy(), [0.01 / 14 + math.sqrt(0.1) ** 7], rtol=1e-6)


def test_attributes_of_captured_objects(backend):
    rows = rows_with(x=(ebb.float64, [1.0]))
    local = Material(stiffness=3.0)
    config = SimpleNamespace(solver=SimpleNamespace(omega=0.5))

    @ebb.kernel
    def program(r: rows):
        r.x = STEEL.density * local.stiffness * config.solver.omega + math.pi

    program(rows)
    assert rows.x.to_numpy()[0] == 12 + math.pi
    local.stiffness = 5.0
    config.solver.omega = 1.0
    program(rows)
    assert rows.x.to_numpy()[0] == 40 + math.pi


def test_numpy_scalars_have_their_type(backend):
    rows = rows_with(x=(ebb.float64, [1.0]))
    third = np.float32(1 / 3)
    many = np.int64(2**40)

    @ebb.kernel
    def program(r: rows):
        r.x = r.x * third + many

    program(rows)
    assert rows.x.to_numpy()[0] == float(np.float32(1 / 3)) + 2**40


def test_a_numpy_float64_does_not_fit_float32():
    rows = rows_with(x=(ebb.float32, [1.0]))
    step = np.float64(0.1)

    @ebb.kernel
    def program(r: rows):
        r.x = r.x * step

    rejects(ebb.KernelTypeError, "E2", lambda: program(rows))


def test_small_arrays_are_vectors_and_matrices(backend):
    rows = rows_with(v=(ebb.vec3d, [[1, 2, 3]]))
    g = np.array([0.0, -10.0, 0.0])
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    @ebb.kernel
    def program(r: rows):
        r.v = R @ r.v + g * 0.5 + [g[1], R[1, 0], 0.0]

    program(rows)
    np.testing.assert_array_equal(rows.v.to_numpy(), [[-2 - 10, 1 - 5 + 1, 3]])


def test_an_array_that_changes_in_place_and_by_name(backend):
    rows = rows_with(v=(ebb.vec2d, [[0, 0]]))
    wind = np.array([1.0, 0.0])

    @ebb.kernel
    def blow(r: rows):
        r.v += wind

    blow(rows)
    wind[1] = 5.0
    blow(rows)
    wind = np.array([0.0, 100.0])
    blow(rows)
    np.testing.assert_array_equal(rows.v.to_numpy(), [[2, 105]])


def test_an_array_that_changes_its_shape_respecialises(backend):
    rows = rows_with(x=(ebb.float64, [0]))
    weights = np.array([1.0, 2.0])

    @ebb.kernel
    def total(r: rows):
        r.x = ebb.dot(weights, weights)

    total(rows)
    assert rows.x.to_numpy()[0] == 5
    weights = np.array([1.0, 2.0, 3.0])
    total(rows)
    assert rows.x.to_numpy()[0] == 14


def test_a_captured_tuple_unrolls(backend):
    cells = ebb.Relation("cells", shape=(5, 5), periodic=(True, True))
    cells.new_field("x", ebb.float64, init=lambda i, j: i * 5 + j)
    cells.new_field("y", ebb.float64, init=0.0)
    neighbours = ((1, 0), (-1, 0), (0, 1), (0, -1))

    @cells.member("__call__")
    def offset(c, di, dj):
        return ebb.affine(cells, [[1, 0, di], [0, 1, dj]], c)

    @ebb.kernel
    def smooth(c: cells):
        for di, dj in neighbours:
            c.y += 0.25 * c(di, dj).x

    smooth(cells)
    x = np.arange(25.0).reshape(5, 5)
    np.testing.assert_allclose(
        cells.y.to_numpy(), sum(np.roll(x, s, a) for a in (0, 1) for s in (-1, 1)) / 4, atol=1e-14
    )


def test_a_captured_tuple_is_indexed(backend):
    rows = rows_with(x=(ebb.int32, [0]))

    @ebb.kernel
    def program(r: rows):
        r.x = OFFSETS[1][0] * 10 + OFFSETS[0][1]

    program(rows)
    assert rows.x.to_numpy()[0] == 32


def test_a_captured_tuple_that_changes(backend):
    rows = rows_with(x=(ebb.int32, [0]))
    terms = (1, 2)

    @ebb.kernel
    def program(r: rows):
        for term in terms:
            r.x += term

    program(rows)
    terms = (10, 20, 30)
    program(rows)
    assert rows.x.to_numpy()[0] == 63


def test_captured_funcs_and_relations_through_namespaces(backend):
    @ebb.func
    def double(x):
        return 2 * x

    mesh = SimpleNamespace(rows=rows_with(x=(ebb.float64, [4])), double=double, total=ebb.Global(ebb.float64, 0.0))

    @ebb.kernel
    def program(r: mesh.rows):
        r.x = mesh.double(r.x)
        mesh.total.value += r.x

    program(mesh.rows)
    assert mesh.rows.x.to_numpy()[0] == mesh.total.value == 8


def test_a_name_that_becomes_another_relation_respecialises(backend):
    first, second = (ebb.Relation(name, shape=(3,), periodic=(True,)) for name in ("first", "second"))
    rows = ebb.Relation("rows", shape=(3,))
    rows.new_field("x", ebb.float64, init=0.0)
    for grid, scale in ((first, 1), (second, 10)):
        grid.new_field("y", ebb.float64, init=np.arange(3.0) * scale)
    target = first

    @ebb.kernel
    def program(r: rows):
        r.x += ebb.affine(target, [[1, 0]], r).y

    program(rows)
    target = second
    program(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), np.arange(3) * 11)


def test_locals_shadow_captured_names_as_in_python(backend):
    rows = rows_with(x=(ebb.float64, [0]))

    @ebb.kernel
    def program(r: rows):
        GRAVITY = 3.0
        for OFFSETS in range(3):
            r.x += GRAVITY * OFFSETS

    program(rows)
    assert rows.x.to_numpy()[0] == 9


WRONG = {
    "an undefined name": ("r.x = undefined_name", ebb.KernelTypeError),
    "a misspelt name": ("r.x = gravty", ebb.KernelTypeError),
    "a string": ("r.x = text", ebb.KernelSyntaxError),
    "a string in a dict": ("r.x = table['a']", ebb.KernelSyntaxError),
    "a large array": ("r.x = big[0, 0, 0]", ebb.KernelTypeError),
    "a complex number": ("r.x = z", ebb.KernelTypeError),
    "None": ("r.x = nothing", ebb.KernelSyntaxError),
    "an assigned field of a relation": ("rows.x = 5", ebb.KernelTypeError),
    "a field without a row": ("r.x = rows.x", ebb.KernelTypeError),
    "a Python function": ("r.x = len(r)", ebb.KernelTypeError),
    "print's result": ("r.x = print(1)", ebb.KernelTypeError),
    "a function of NumPy": ("r.x = np.linalg.norm(r.x)", ebb.KernelTypeError),
    "an attribute that is not there": ("r.x = math.sine(r.x)", ebb.KernelTypeError),
    "a field that is not there": ("r.x = r.velocty", ebb.KernelTypeError),
    "a builtin that is not there": ("r.x = ebb.squareroot(r.x)", ebb.KernelTypeError),
}


@pytest.mark.parametrize("case", WRONG)
def test_names_that_mean_nothing_in_a_kernel(case):
    body, exception = WRONG[case]
    rows = rows_with(x=(ebb.float64, [1]), velocity=(ebb.float64, [0]))
    captured = {"gravity": 1.0, "text": "a", "table": {"a": "b"}, "big": np.zeros((2, 2, 2)), "z": 1j, "nothing": None}
    kernel = kernel_of(body, rows=rows, math=math, **captured)
    rejects(exception, "E", lambda: kernel(rows))
    assert rows.x.to_numpy()[0] == 1


@pytest.mark.parametrize("body", ["gravity = gravity + 1", "global gravity\ngravity = 2.0", "gravity += 1"])
def test_captured_names_are_not_assigned(body):
    rows = rows_with(x=(ebb.float64, [1]))
    kernel = kernel_of(body, rows=rows, gravity=1.0)
    with pytest.raises((ebb.KernelTypeError, ebb.KernelSyntaxError)):
        kernel(rows)


def test_a_misspelt_name_suggests_the_nearest():
    rows = rows_with(x=(ebb.float64, [1]), velocity=(ebb.float64, [0]))
    for body, nearest in (("r.x = gravty", "gravity"), ("r.x = r.velocty", "velocity"), ("r.x = ebb.sqr(1.0)", "sqrt")):
        kernel = kernel_of(body, rows=rows, gravity=1.0)
        assert nearest in str(rejects(ebb.KernelTypeError, "E1", lambda: kernel(rows)))


GUARDED = {
    "a conditional": "r.x = 1.0 / steps if steps > 0 else 5.0",
    "a branch": "r.x = 5.0\nif steps > 0:\n    r.x = 1.0 / steps",
    "a lazy 'and'": "r.x = 5.0\nif steps > 0 and 4 // steps == 2:\n    r.x = 0.5",
    "after a return": "r.x = 5.0\nif steps == 0:\n    return\nr.x = 0.5 + 0 % steps",
    "a power": "r.x = 5.0 if steps == 0 else 2.0 ** 2 * steps ** -3",
    "an unrolled loop": "r.x = 5.0\nfor n in (0, steps):\n    r.x = 1.0 / n if n > 0 else r.x",
    "a function": "r.x = 5.0 if steps == 0 else 0.1 * math.floor(10 / steps)",
}


@pytest.mark.parametrize("case", GUARDED)
def test_a_division_that_no_row_comes_to_does_not_raise(backend, case):
    rows = rows_with(x=(ebb.float64, [0]))
    names = _program(GUARDED[case], rows=rows, steps=0)
    for steps, expected in ((0, 5.0), (2, 0.5), (0, 5.0)):
        names["steps"] = steps
        names["program"](rows)
        assert rows.x.to_numpy()[0] == expected


@pytest.mark.parametrize("text", ["min(low, high)", "max(-low, -high)", "pow(2, low)"])
def test_a_function_whose_type_depends_on_the_values(backend, text):
    rows = rows_with(n=(ebb.int32, [0]))
    names = _program(f"r.n = {text}", rows=rows, low=1, high=1.5)
    names["program"](rows)
    assert rows.n.to_numpy()[0] == eval(text, {"low": 1, "high": 1.5})
    names["low"] = -1 if "pow" in text else 2
    rejects(ebb.KernelTypeError, "E2", lambda: names["program"](rows))


def _program(body, **names):
    lines = body.replace("\n", "\n    ")
    return define(f"@ebb.kernel\ndef program(r: rows):\n    {lines}\n", math=math, **names)
