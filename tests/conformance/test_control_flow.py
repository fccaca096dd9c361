"""Statements: assignment, branches, loops, and what of Python a kernel does not have."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import kernel_of, rejects, rows_with, sizes_for


def run(body, x, x_type=ebb.int32, out_type=ebb.int32, **names):
    """What ``body`` leaves in ``r.out``, with ``r.x`` one of ``x`` in each row."""
    rows = rows_with(x=(x_type, x), out=(out_type, np.zeros(len(x))))
    kernel_of(body, rows=rows, **names)(rows)
    return rows.out.to_numpy()


def in_python(body, x):
    """What Python makes of the same lines."""

    class Row:
        out = 0

    lines = "\n".join("    " + line for line in body.splitlines())
    namespace = {}
    exec(f"def program(r):\n{lines}\n", namespace)

    def one(value):
        row = Row()
        row.x = int(value)
        namespace["program"](row)
        return row.out

    return [one(value) for value in x]


PROGRAMS = {
    "if": "if r.x > 3:\n    r.out = 1",
    "if else": "if r.x % 2 == 0:\n    r.out = r.x // 2\nelse:\n    r.out = 3 * r.x + 1",
    "elif": """
if r.x < 2:
    r.out = 10
elif r.x < 4:
    r.out = 20
elif r.x < 6:
    r.out = 30
else:
    r.out = 40
""",
    "nested if": "if r.x > 1:\n    if r.x < 5:\n        r.out = 1\n    else:\n        r.out = 2",
    "a variable set in both branches": "if r.x > 3:\n    y = 1\nelse:\n    y = 2\nr.out = y * 10",
    "for range": "s = 0\nfor i in range(r.x):\n    s += i\nr.out = s",
    "for range of two": "s = 0\nfor i in range(2, r.x):\n    s += i * i\nr.out = s",
    "for range of three": "s = 0\nfor i in range(r.x, 0, -2):\n    s = s * 10 + i\nr.out = s",
    "for range with a step": "s = 0\nfor i in range(0, 20, r.x + 1):\n    s += i\nr.out = s",
    "the loop variable keeps its last value": "i = -1\nfor i in range(r.x):\n    pass\nr.out = i",
    "assigning the loop variable changes nothing": "n = 0\nfor i in range(r.x):\n    i += 100\n    n += 1\nr.out = n",
    "the bounds are evaluated once": "n = r.x\ns = 0\nfor i in range(n):\n    n += 1\n    s += 1\nr.out = s",
    "nested for": "s = 0\nfor i in range(r.x):\n    for j in range(i):\n        s += i * j\nr.out = s",
    "break": "s = 0\nfor i in range(100):\n    if i * i > r.x:\n        break\n    s += i\nr.out = s",
    "continue": "s = 0\nfor i in range(10):\n    if i % (r.x + 1) != 0:\n        continue\n    s += i\nr.out = s",
    "break leaves the inner loop only": """
s = 0
for i in range(4):
    for j in range(10):
        if j > r.x:
            break
        s += 1
r.out = s
""",
    "while": """
n = r.x
c = 0
while n != 1 and n > 0:
    n = n // 2 if n % 2 == 0 else 3 * n + 1
    c += 1
r.out = c
""",
    "while True with break": "i = 0\nwhile True:\n    if i * i >= r.x:\n        break\n    i += 1\nr.out = i",
    "while with continue": """
i = 0
s = 0
while i < 10:
    i += 1
    if i % 3 == 0:
        continue
    s += i
r.out = s + r.x
""",
    "return": "r.out = 1\nif r.x > 3:\n    return\nr.out = 2",
    "return from a loop": "for i in range(10):\n    r.out = i\n    if i == r.x:\n        return\nr.out = 99",
    "tuple assignment swaps": "a, b = r.x, 7\na, b = b, a\nr.out = a * 100 + b",
    "fibonacci": "a, b = 0, 1\nfor _ in range(r.x):\n    a, b = b, a + b\nr.out = a",
    "chained assignment": "a = b = r.x\na += 1\nr.out = a * 10 + b",
    "pass": "pass\nr.out = r.x",
    "gcd": "a = r.x\nb = 24\nwhile b != 0:\n    a, b = b, a % b\nr.out = a",
    "a loop over a literal tuple": "for k in (1, 10, 100):\n    r.out += k * r.x",
    "a loop over tuples": "for a, b in ((1, 2), (3, 4)):\n    r.out += a * b * r.x",
    "break from an unrolled loop": "for k in (1, 2, 3, 4):\n    if k > r.x:\n        break\n    r.out += k",
    "continue in an unrolled loop": "for k in (1, 2, 3, 4):\n    if k == r.x:\n        continue\n    r.out += k",
    "a docstring": "'''What this does.'''\nr.out = r.x",
}


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_means_what_it_means_in_python(backend, program):
    body = PROGRAMS[program].strip("\n")
    x = np.arange(9)
    np.testing.assert_array_equal(run(body, x), in_python(body, x))


def test_for_else_is_python_or_an_error():
    body = "for i in range(5):\n    if i == r.x:\n        break\nelse:\n    r.out = 1"
    try:
        out = run(body, [2, 7])
    except ebb.KernelSyntaxError as error:
        assert any(code.startswith("E1") for code in error.codes)
    else:
        np.testing.assert_array_equal(out, [0, 1])


def test_newton_iteration(backend):
    x = np.array([0.25, 2.0, 1e6])
    body = """
        y = r.x
        for _ in range(60):
            y = 0.5 * (y + r.x / y)
        r.out = y
    """
    out = run(body, x, ebb.float64, ebb.float64)
    np.testing.assert_allclose(out, np.sqrt(x), rtol=1e-14)


def test_mandelbrot(backend):
    cells = ebb.Relation("cells", shape=(12, 16))
    cells.new_field("count", ebb.int32)

    @ebb.kernel
    def escape(c: cells):
        ij = ebb.coords(c)
        cx = -2.0 + 3.0 * ij[1] / 16
        cy = -1.0 + 2.0 * ij[0] / 12
        x = y = 0.0
        n = 0
        while x * x + y * y <= 4 and n < 30:
            x, y = x * x - y * y + cx, 2 * x * y + cy
            n += 1
        c.count = n

    escape(cells)
    for (i, j), n in np.ndenumerate(cells.count.to_numpy()):
        z, c, expected = 0, complex(-2 + 3 * j / 16, -1 + 2 * i / 12), 0
        while abs(z) ** 2 <= 4 and expected < 30:
            z, expected = z * z + c, expected + 1
        assert n == expected


def test_all_sizes(backend):
    for size in sizes_for(backend):
        x = np.arange(size)
        out = run("s = 0\nfor i in range(r.x % 7):\n    s += i\nr.out = s", x)
        m = x % 7
        np.testing.assert_array_equal(out, m * (m - 1) // 2)


def test_the_loop_variable_over_a_tuple_is_known_at_compile_time(backend):
    rows = rows_with(v=(ebb.vec3d, [[1, 2, 3]]), out=(ebb.float64, [0]))

    @ebb.kernel
    def program(r: rows):
        for axis in (2, 0):
            r.out = r.out * 10 + r.v[axis]

    program(rows)
    assert rows.out.to_numpy()[0] == 31


def test_a_loop_over_funcs_and_field_names(backend):
    rows = rows_with(a=(ebb.float64, [4]), b=(ebb.float64, [9]))

    @ebb.kernel
    def program(r: rows):
        for name in ("a", "b"):
            for f in (ebb.sqrt, ebb.exp):
                r[name] = f(r[name])

    program(rows)
    np.testing.assert_allclose([rows.a.to_numpy()[0], rows.b.to_numpy()[0]], np.exp([2, 3]))


def test_vectors_as_variables_are_values(backend):
    rows = rows_with(v=(ebb.vec3d, [[1, 2, 3]]), w=(ebb.vec3d, [[0, 0, 0]]))

    @ebb.kernel
    def program(r: rows):
        a = r.v
        b = a
        b[0] = 100
        b.y += 5
        r.w = b + 1000 * a

    program(rows)
    np.testing.assert_array_equal(rows.v.to_numpy(), [[1, 2, 3]])
    np.testing.assert_array_equal(rows.w.to_numpy(), [[1100, 2007, 3003]])


def test_tuple_assignment_of_a_vector(backend):
    rows = rows_with(v=(ebb.vec3d, [[1, 2, 3]]))

    @ebb.kernel
    def program(r: rows):
        x, y, z = r.v
        r.v = [z, x, y]

    program(rows)
    np.testing.assert_array_equal(rows.v.to_numpy(), [[3, 1, 2]])


def test_empty_query_and_range(backend):
    assert run("r.out = 5\nfor i in range(r.x):\n    r.out = 6", [0, -3, 1]).tolist() == [5, 5, 6]


LACKING = {
    "lambda": "f = lambda x: x",
    "try": "try:\n    r.x = 1\nexcept ValueError:\n    pass",
    "with": "with r:\n    r.x = 1",
    "list comprehension": "y = [i for i in range(3)]",
    "generator": "y = sum(i for i in range(3))",
    "set comprehension": "y = {i for i in range(3)}",
    "dict comprehension": "y = {i: i for i in range(3)}",
    "yield": "yield r.x",
    "import": "import math",
    "from import": "from math import sin",
    "class": "class C:\n    pass",
    "nested def": "def f(x):\n    return x",
    "starred": "a, *b = 1, 2, 3",
    "walrus": "if (y := r.x) > 1:\n    r.x = y",
    "f-string": "y = f'{r.x}'",
    "string": "y = 'text'",
    "del": "y = 1\ndel y",
    "global": "global y\ny = 1",
    "raise": "raise ValueError",
    "match": "match r.x:\n    case 1:\n        r.x = 2",
    "is": "y = r is r",
    "in": "y = r.x in [1, 2]",
    "slice": "y = r.v[0:2]",
    "assert with a computed message": "assert r.x > 0, r.x",
    "return of a value": "return r.x",
    "async for": "async def f():\n    pass",
}


@pytest.mark.parametrize("construct", LACKING)
def test_python_that_kernels_lack(construct):
    rows = rows_with(x=(ebb.int32, [1]), v=(ebb.vec3d, [[1, 2, 3]]))
    kernel = kernel_of(LACKING[construct], rows=rows)
    rejects(ebb.KernelSyntaxError, "E1", lambda: kernel(rows))
    assert rows.x.to_numpy()[0] == 1


@pytest.mark.parametrize(
    "signature",
    ["r: rows, *args", "r: rows, **options", "*args", "", "r: rows, a, /, *, b=1, **c", "r: 5", "r: 'rows2'"],
)
def test_signatures_that_kernels_lack(signature):
    rows = rows_with(x=(ebb.int32, [1]))
    with pytest.raises(ebb.EbbError):
        kernel_of("pass", signature, rows=rows).check(rows)


@pytest.mark.parametrize("body", ["r.x", "r.x + 1", "1", "r.x == 2", "ebb.sqrt(r.x)", "r.x\n+ 1", "[1, 2]", "-r.x"])
def test_an_expression_that_does_nothing_is_an_error(body):
    rows = rows_with(x=(ebb.int32, [1]))
    kernel = kernel_of(body, rows=rows)
    with pytest.raises((ebb.KernelSyntaxError, ebb.KernelTypeError)) as caught:
        kernel(rows)
    assert caught.value.codes


@pytest.mark.parametrize(
    "body",
    [
        "if r.x > 0:\n    y = 1\nr.x = y",
        "for i in range(r.x):\n    y = i\nr.x = y",
        "for i in range(r.x):\n    pass\nr.x = i",
        "while r.x > 5:\n    y = 1\nr.x = y",
        "r.x = y\ny = 1",
        "r.x = gravity\ngravity = 1",
    ],
)
def test_a_variable_that_may_be_unset(body):
    rows = rows_with(x=(ebb.int32, [1]))
    error = rejects(ebb.KernelTypeError, "E1", lambda: kernel_of(body, rows=rows, gravity=1)(rows))
    assert "unset" in str(error) or "before it is assigned" in str(error)


def test_all_errors_are_reported_at_once():
    rows = rows_with(x=(ebb.int32, [1]), v=(ebb.vec3d, [[1, 2, 3]]))
    kernel = kernel_of("r.x = r.y\nr.x = r.v\nr.v = [1, 2]\nfoo(r.x)", rows=rows)
    error = rejects(ebb.KernelTypeError, "E", lambda: kernel.check(rows))
    assert len(error.diagnostics) == 4


def test_a_loop_goes_over_the_vector_that_a_name_was(backend):
    rows = rows_with(x=(ebb.float64, [0]), v=(ebb.vec3d, [[1, 2, 3]]))
    kernel_of("v = r.v\nfor c in v:\n    v = v * 2.0\n    r.x += c\nr.v = v", rows=rows)(rows)
    assert rows.x.to_numpy()[0] == 6
    np.testing.assert_array_equal(rows.v.to_numpy(), [[8, 16, 24]])
