"""Kernels as objects: where they may be defined, what they are launched with, when they are checked anew."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import textwrap
import threading

import numpy as np
import pytest

import ebb

from .harness import define, rejects, rows_with

ROWS = rows_with(x=(ebb.float64, [1, 2, 3]))


@ebb.kernel
def module_kernel(r: ROWS):
    r.x *= 2


class Simulation:
    """A program as a class: relations as attributes, kernels made in ``__init__`` and in the body."""

    particles = rows_with(x=(ebb.float64, [0, 0]), v=(ebb.float64, [1, 2]))

    @ebb.kernel
    def drift(p: particles, dt: ebb.float64):
        p.x += p.v * dt

    def __init__(self, gravity):
        self.gravity = gravity
        self.bodies = rows_with(v=(ebb.float64, [0, 1]))
        bodies = self.bodies

        @ebb.kernel
        def fall(b: bodies):
            b.v += self.gravity

        self.fall = fall

    def step(self):
        self.fall(self.bodies)


def test_a_kernel_of_the_module(backend):
    ROWS.x.load([1, 2, 3])
    module_kernel(ROWS)
    np.testing.assert_array_equal(ROWS.x.to_numpy(), [2, 4, 6])


def test_kernels_of_a_class(backend):
    Simulation.particles.x.fill(0)
    Simulation.drift(Simulation.particles, 0.5)
    np.testing.assert_array_equal(Simulation.particles.x.to_numpy(), [0.5, 1])
    moon, earth = Simulation(-1.6), Simulation(-9.8)
    moon.step()
    earth.step()
    moon.gravity = 100.0
    moon.step()
    np.testing.assert_allclose(moon.bodies.v.to_numpy(), [98.4, 99.4])
    np.testing.assert_allclose(earth.bodies.v.to_numpy(), [-9.8, -8.8])


def test_kernels_made_by_a_function_do_not_share_what_they_capture(backend):
    rows = rows_with(x=(ebb.float64, [1]))

    def make(factor):
        @ebb.kernel
        def scale(r: rows):
            r.x *= factor

        return scale

    double, triple = make(2.0), make(3.0)
    double(rows)
    triple(rows)
    double(rows)
    assert rows.x.to_numpy()[0] == 12


@pytest.mark.parametrize("future", ["", "from __future__ import annotations\n"], ids=["eager", "text"])
def test_annotations_in_a_file_with_and_without_the_future_import(backend, tmp_path, future):
    path = tmp_path / "simulation.py"
    path.write_text(
        future
        + textwrap.dedent("""
            import ebb

            rows = ebb.Relation("rows", size=3)
            rows.new_field("x", ebb.float64, init=1.0)

            @ebb.kernel
            def at_module(r: rows, a: ebb.float64):
                r.x += a

            def local():
                mine = ebb.Relation("mine", size=2)
                mine.new_field("x", ebb.float64, init=5.0)

                @ebb.func
                def twice(x: ebb.float64):
                    return 2 * x

                @ebb.kernel
                def inside(m: mine, b: ebb.float32 = 0.5):
                    m.x = twice(m.x) + b

                inside(mine)
                return mine.x.to_numpy()
        """)
    )
    spec = importlib.util.spec_from_file_location("simulation", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.at_module(module.rows, 2)
    np.testing.assert_array_equal(module.rows.x.to_numpy(), [3, 3, 3])
    np.testing.assert_array_equal(module.local(), [10.5, 10.5])


def test_a_kernel_from_exec_with_its_source_in_linecache(backend):
    rows = rows_with(x=(ebb.float64, [1]))
    define("@ebb.kernel\ndef program(r: rows):\n    r.x += 41\n", rows=rows)["program"](rows)
    assert rows.x.to_numpy()[0] == 42


BARE = "def program(r: rows):\n    r.x += 41\n"


def test_a_kernel_from_a_bare_string_says_what_to_do():
    rows = rows_with(x=(ebb.float64, [1]))
    namespace = {"ebb": ebb, "rows": rows}
    exec(f"@ebb.kernel\n{BARE}", namespace)
    error = rejects(ebb.KernelSyntaxError, "E101", lambda: namespace["program"](rows))
    assert "source=" in str(error)


def test_a_kernel_from_a_bare_string_with_its_source(backend):
    rows = rows_with(x=(ebb.float64, [1]))
    namespace = {"rows": rows}
    exec(BARE, namespace)
    ebb.kernel(source=BARE)(namespace["program"])(rows)
    assert rows.x.to_numpy()[0] == 42
    text = f"# a comment\n@ebb.kernel(source=text)\n{BARE}"
    namespace = {"ebb": ebb, "rows": rows, "text": text}
    exec(text, namespace)
    namespace["program"](rows)
    assert rows.x.to_numpy()[0] == 83


def test_odd_layouts_of_source(backend):
    """Column-0 lines in a docstring, text before the characters that are counted, decorators on several lines."""
    rows = rows_with(x=(ebb.float64, [1]))

    # fmt: off
    @ebb.kernel(
        block_size=128,
        fastmath=False,
    )
    def program(
        r: rows,
        # größer: a comment
        a: ebb.float64 = 2.0,
    ):
        """A docstring
with a line at column 0.
"""
        text_é = 1.0; r.x += (a  # noqa: E702
+ text_é)
        if r.x > 0: r.x *= 2; r.x += 1  # noqa: E701, E702
    # fmt: on

    program(rows)
    assert rows.x.to_numpy()[0] == 9


def test_two_kernels_of_one_name(backend):
    rows = rows_with(x=(ebb.float64, [1]))

    @ebb.kernel
    def program(r: rows):
        r.x += 1

    first = program

    @ebb.kernel
    def program(r: rows):
        r.x *= 10

    program(rows)
    first(rows)
    assert rows.x.to_numpy()[0] == 11


def test_a_kernel_under_another_decorator(backend):
    rows = rows_with(x=(ebb.float64, [1]))
    seen = []

    def register(kernel):
        seen.append(kernel)
        return kernel

    @register
    @ebb.kernel
    def program(r: rows):
        r.x += 1

    seen[0](rows)
    assert rows.x.to_numpy()[0] == 2


def test_a_lambda_is_no_kernel():
    rows = rows_with(x=(ebb.float64, [1]))
    rejects(ebb.KernelSyntaxError, "E1", lambda: ebb.kernel(lambda r: None)(rows))


@pytest.mark.parametrize("thing", [5, "text", len, np.sqrt, Simulation], ids=repr)
def test_what_is_no_kernel_at_all(thing):
    with pytest.raises((ebb.KernelSyntaxError, TypeError)):
        ebb.kernel(thing)(ROWS)


# ---- Relations ----


def test_a_bare_row_is_typed_at_each_launch(backend):
    first, second = rows_with(x=(ebb.float64, [1, 2])), rows_with(x=(ebb.vec3f, [[1, 2, 3]]))

    @ebb.kernel
    def double(r):
        r.x *= 2

    double(first)
    double(second)
    double(first)
    np.testing.assert_array_equal(first.x.to_numpy(), [4, 8])
    np.testing.assert_array_equal(second.x.to_numpy(), [[2, 4, 6]])


def test_a_bare_row_of_a_relation_that_lacks_the_field():
    rows = rows_with(y=(ebb.float64, [1, 2]))

    @ebb.kernel
    def double(r):
        r.x *= 2

    rejects(ebb.KernelTypeError, "E1", lambda: double(rows))


def test_another_relation_is_an_error():
    rows, others = rows_with(x=(ebb.float64, [1])), rows_with(x=(ebb.float64, [1]))

    @ebb.kernel
    def double(r: rows):
        r.x *= 2

    rejects(ebb.KernelTypeError, "E261", lambda: double(others))
    assert others.x.to_numpy()[0] == 1


def test_a_field_added_later_is_seen(backend):
    rows = rows_with(x=(ebb.float64, [1]))

    @ebb.kernel
    def program(r: rows):
        r.x = r.late + 1

    rejects(ebb.KernelTypeError, "E1", lambda: program(rows))
    rows.new_field("late", ebb.float64, init=10.0)
    program(rows)
    assert rows.x.to_numpy()[0] == 11


def test_a_wrong_kernel_never_runs_and_stays_wrong():
    rows = rows_with(x=(ebb.float64, [1]))

    @ebb.kernel
    def program(r: rows):
        r.x = 5.0
        r.x = r.nothing

    for _ in range(2):
        rejects(ebb.KernelTypeError, "E127", lambda: program(rows))
    assert rows.x.to_numpy()[0] == 1


# ---- Beyond launching ----


def test_check_checks_without_running(backend):
    rows = rows_with(x=(ebb.float64, [1]))

    @ebb.kernel
    def program(r: rows, a):
        r.x += a

    assert program.check(rows, 1.0) is None
    assert rows.x.to_numpy()[0] == 1
    rejects(ebb.KernelTypeError, "E2", lambda: program.check(rows, np.array([1.0, 2.0])))


def test_explain_tells_phases_and_reductions(backend):
    vertices, edges = rows_with(x=(ebb.float64, [1, 2])), ebb.Relation("edges", size=3)
    edges.new_field("head", vertices, init=[0, 1, 1])
    edges.new_field("w", ebb.float64, init=1.0)

    @ebb.kernel
    def scatter(e: edges):
        e.head.x += e.w

    text = scatter.explain(edges)
    assert "REDUCE(+)" in text and "READ" in text and "x" in text and "w" in text
    np.testing.assert_array_equal(vertices.x.to_numpy(), [1, 2])


def test_inspect_shows_each_stage():
    rows = rows_with(x=(ebb.float64, [1]))

    @ebb.kernel
    def program(r: rows):
        r.x += 1

    with ebb.backend("cpu"):
        stages = {stage: program.inspect(rows, stage) for stage in ("kir", "lir", "llvm", "asm")}
        rejects(ebb.KernelTypeError, "E265", lambda: program.inspect(rows, "nothing"))
    assert all(text.strip() for text in stages.values())
    assert len(set(stages.values())) == 4
    assert "define" in stages["llvm"] and "x" in stages["kir"]
    with ebb.backend("reference"):
        assert program.inspect(rows, "kir") == stages["kir"]
    assert rows.x.to_numpy()[0] == 1


def test_a_kernel_looks_like_its_function():
    @ebb.kernel
    def documented(r: ROWS):
        """What it does."""
        r.x += 0

    assert documented.__name__ == "documented"
    assert documented.__doc__ == "What it does."
    assert "documented" in repr(documented)


def test_fastmath_is_a_hint(backend):
    rows = rows_with(x=(ebb.float32, [1, 2, 3]))

    @ebb.kernel(fastmath=True)
    def program(r: rows):
        r.x = r.x * 0.5 + r.x * 0.25 + ebb.sqrt(r.x)

    program(rows)
    x = np.array([1, 2, 3])
    np.testing.assert_allclose(rows.x.to_numpy(), 0.75 * x + np.sqrt(x), rtol=1e-6)


def test_many_launches_with_changing_parameters(backend):
    rows = rows_with(x=(ebb.float64, [0]))

    @ebb.kernel
    def add(r: rows, a: ebb.float64):
        r.x += a

    for a in range(100):
        add(rows, a)
    assert rows.x.to_numpy()[0] == 4950


def test_the_error_shows_file_line_and_source():
    rows = rows_with(x=(ebb.float64, [1]))

    @ebb.kernel
    def program(r: rows):
        r.x = 1.0
        r.x = r.y  # here

    error = rejects(ebb.KernelTypeError, "E127", lambda: program(rows))
    line = sys._getframe().f_lineno - 3
    text = str(error)
    assert "test_launch.py" in text and f"line {line}" in text
    assert "r.x = r.y  # here" in text
    lines = text.splitlines()
    at = next(i for i, each in enumerate(lines) if "# here" in each)
    shown, carets = lines[at], lines[at + 1]
    assert shown[carets.index("^") : carets.rindex("^") + 1] == "y"


def test_launches_from_several_python_threads(backend):
    shared = rows_with(x=(ebb.float64, np.arange(2000)), y=(ebb.float64, np.zeros(2000)))
    own = [rows_with(y=(ebb.float64, np.zeros(50))) for _ in range(3)]
    messages = []

    @ebb.kernel
    def add(r, amount):
        r.y += amount

    @ebb.kernel
    def fail(r: shared):
        assert r.x != 1234

    def work(rows, amount):
        for _ in range(20):
            add(rows, amount)
            if backend != "reference":
                messages.append(str(rejects(ebb.KernelAssertionError, "E401", lambda: fail(shared))).splitlines()[0])

    threads = [threading.Thread(target=work, args=(rows, amount)) for amount, rows in enumerate(own)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for amount, rows in enumerate(own):
        np.testing.assert_array_equal(rows.y.to_numpy(), np.full(50, 20.0 * amount))
    if backend != "reference":
        assert len(messages) == 60 and len(set(messages)) == 1 and "rows[1234]" in messages[0]


def test_breakpoint_in_a_kernel_on_the_reference(monkeypatch):
    rows, seen = rows_with(x=(ebb.float64, [1, 2])), []

    @ebb.kernel
    def program(r: rows):
        y = r.x * 10
        if r.x > 1:
            breakpoint()
        r.x = y

    def look():
        frame = sys._getframe(1)
        seen.append((frame.f_lineno, float(frame.f_locals["y"])))

    monkeypatch.setattr(sys, "breakpointhook", look)
    with ebb.backend("reference"):
        program(rows)
    assert seen == [(program.source.node.body[1].body[0].lineno, 20.0)]
    np.testing.assert_array_equal(rows.x.to_numpy(), [10, 20])


def test_a_program_on_standard_input(tmp_path):
    path = tmp_path / "program.py"
    path.write_text(
        "import ebb\nrows = ebb.Relation('rows', size=2)\nrows.new_field('x', ebb.int32)\n"
        "@ebb.kernel\ndef add(r: rows):\n    r.x += 7\nadd(rows)\nprint(rows.x.to_numpy().tolist())\n"
    )
    with path.open() as program:
        process = subprocess.run([sys.executable, "-"], stdin=program, capture_output=True, text=True, check=False)
    assert process.stdout == "[7, 7]\n", process.stderr
