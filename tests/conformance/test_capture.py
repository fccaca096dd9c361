"""Captured steps: they do what the launches, swaps and sets of globals in them do, however often they run."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from backends import runnable

from .harness import kernel_of, rows_with

COUNTS = (0, 1, 2, 3, 7)


class World:
    """A ring of nodes and its links, with a step that gathers, scatters, draws, swaps and reduces."""

    def __init__(self, size):
        self.nodes, self.links = ebb.Relation("nodes", size=size), ebb.Relation("links", size=2 * size)
        nodes, links = self.nodes, self.links
        self.total, self.scale = ebb.Global(ebb.float64, 0.0), ebb.Global(ebb.vec2f, [1.0, 0.5])
        self.dt = 0.25
        nodes.new_field("x", ebb.float32, init=np.linspace(-1, 1, size))
        nodes.new_field("new", ebb.float32)
        nodes.new_field("force", ebb.vec2f)
        nodes.new_field("noise", ebb.float32)
        i = np.arange(size)
        links.new_field("a", nodes, init=np.concatenate([i, i]))
        links.new_field("b", nodes, init=np.concatenate([(i + 1) % max(size, 1), (i + 5) % max(size, 1)]))
        links.group_by("a")
        nodes.new_subset("some", i[::3])
        names = {"nodes": nodes, "links": links, "total": self.total, "scale": self.scale, "world": self}
        self.gather = kernel_of(
            """
            mean = ebb.float32(0.0)
            for link in ebb.where(links.a, r):
                mean += link.b.x
            r.new = r.x + ebb.float32(world.dt) * (mean / 2 - r.x)
            """,
            "r: nodes",
            **names,
        )
        self.scatter = kernel_of("r.b.force += scale.value * (r.a.x - r.b.x)", "r: links", **names)
        self.settle = kernel_of(
            "r.x += h * (r.force.x + r.force.y)\nr.force = 0.0", "r: nodes, h: ebb.float32", **names
        )
        self.draw = kernel_of("r.noise += ebb.float32(ebb.rand() + ebb.randn())", "r", **names)
        self.measure = kernel_of("total.value += ebb.float64(r.x) + ebb.float64(r.noise)", "r", **names)

    def step(self):
        self.scatter(self.links)
        self.settle(self.nodes, 0.125)
        self.gather(self.nodes)
        self.nodes.swap("x", "new")
        self.draw(self.nodes.some)
        self.scale.value = [0.25, 0.5]
        self.total.value = 1.5
        self.measure(self.nodes.some)
        self.draw(self.nodes)

    def state(self):
        fields = [*self.nodes.fields.values(), *self.links.fields.values()]
        return [field.to_numpy() for field in fields] + [np.asarray(self.total), np.asarray(self.scale)]


def assert_same(found, expected):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("size", [0, 1, 20])
def test_a_captured_step_does_what_its_launches_do(backend, size):
    for count in COUNTS:
        plain, captured = World(size), World(size)
        ebb.seed(7)
        for _ in range(2 * count + 1):
            plain.step()
        ebb.seed(7)
        with ebb.capture() as step:
            captured.step()
        step.run(count)
        step.run(count)
        step.run()
        assert_same(captured.state(), plain.state())


def test_plain_launches_and_captured_ones_mix(backend):
    plain, mixed = World(20), World(20)
    ebb.seed(1)
    for _ in range(7):
        plain.step()
    ebb.seed(1)
    mixed.step()
    with ebb.capture() as step:
        mixed.step()
    mixed.step()
    step.run(3)
    mixed.step()
    step.run()
    assert_same(mixed.state(), plain.state())


def test_nothing_runs_while_it_is_recorded(backend):
    world = World(20)
    before = world.state()
    with ebb.capture() as step:
        world.step()
        world.step()
    assert_same(world.state(), before)
    step.run(0)
    assert_same(world.state(), before)
    assert repr(step) == "<captured step: 12 launches, 6 swaps and sets of globals>"


def test_many_runs_of_a_short_step(backend):
    rows = rows_with(n=(ebb.int64, np.arange(3)))
    count = kernel_of("r.n += 1", rows=rows)
    with ebb.capture() as step:
        count(rows)
    times = 1_000_000 if backend == "cpu" else 1000
    step.run(times)
    assert rows.n.to_numpy().tolist() == [times, times + 1, times + 2]


@pytest.mark.parametrize("count", range(5))
def test_swaps_leave_fields_with_the_right_values(backend, count):
    rows = rows_with(a=(ebb.int32, [1]), b=(ebb.int32, [2]), c=(ebb.int32, [3]))
    with ebb.capture() as step:
        rows.swap("a", "b")
        rows.swap("b", "c")
        rows.swap("c", "c")
    step.run(count)
    expected = [1, 2, 3]
    for _ in range(count):
        a, b, c = expected
        expected = [b, c, a]
    assert [int(field.to_numpy()[0]) for field in (rows.a, rows.b, rows.c)] == expected


def test_captured_numbers_are_those_at_the_recording(backend):
    rows = rows_with(x=(ebb.float64, [0.0, 0.0]), v=(ebb.vec2d, [[0, 0], [0, 0]]))
    names = {"a": 2.0, "direction": np.array([1.0, 2.0]), "rows": rows}
    add = kernel_of("r.x += a + b\nr.v += ebb.vec2d(direction)", "r: rows, b: ebb.float64", **names)
    with ebb.capture() as step:
        add(rows, 0.5)
        add(rows, b=100)
    add.__wrapped__.__globals__["a"] = 1000.0
    names["direction"][:] = 77
    step.run(2)
    assert rows.x.to_numpy().tolist() == [2 * (2.5 + 102.0)] * 2
    assert rows.v.to_numpy().tolist() == [[4.0, 8.0]] * 2


def test_globals_keep_what_is_added_to_them(backend):
    rows = rows_with(x=(ebb.int64, np.arange(10)))
    total = ebb.Global(ebb.int64, 0)
    add = kernel_of("total.value += r.x", rows=rows, total=total)
    with ebb.capture() as step:
        add(rows)
        add(rows)
    step.run(3)
    assert total.value == 6 * 45
    total.value = 0
    step.run(1)
    assert total.value == 2 * 45


def test_what_a_set_does_not_take_is_an_error_at_once(backend):
    total = ebb.Global(ebb.int32, 0)
    with pytest.raises(ebb.RelationError), ebb.capture():
        total.value = 2**40
    assert total.value == 0


def test_a_failure_leaves_what_was_done_before_it(backend):
    plain, captured = (rows_with(x=(ebb.int32, [0, 0]), y=(ebb.int32, [1, -3])) for _ in range(2))
    totals = ebb.Global(ebb.int32, 0), ebb.Global(ebb.int32, 0)
    check = kernel_of("assert r.x < 7", "r")

    def step_of(rows, total):
        add = kernel_of("total.value += 1\nr.x += 1", "r", total=total)
        add(rows)
        rows.swap("x", "y")
        check(rows)
        add(rows)

    with ebb.capture() as step:
        step_of(captured, totals[1])
    for _ in range(3):
        with pytest.raises(ebb.KernelAssertionError) as expected:
            for _ in range(50):
                step_of(plain, totals[0])
        with pytest.raises(ebb.KernelAssertionError) as found:
            step.run(50)
        assert str(found.value) == str(expected.value)
        assert totals[0].value == totals[1].value > 0
        assert_same([captured.x, captured.y], [plain.x, plain.y])
        for rows in (plain, captured):
            rows.x.load([0, -5])


def test_random_numbers_are_those_of_the_launches(backend):
    rows, nobody = rows_with(x=(ebb.float64, np.zeros(5))), ebb.Relation("nobody", size=0)
    nobody.new_field("x", ebb.float64)
    draw = kernel_of("r.x = r.x * 2.0 + ebb.rand()", "r")

    def play():
        draw(rows)
        draw(nobody)
        draw(rows)

    ebb.seed(2**40 + 3)
    for _ in range(3):
        play()
    draw(rows)
    expected = rows.x.to_numpy()
    rows.x.fill(0.0)
    with ebb.capture() as step:
        play()
    ebb.seed(2**40 + 3)
    step.run(3)
    draw(rows)
    assert_same([rows.x], [expected])


# ---- The structure changes between runs. ----


def test_a_relation_is_permuted_between_runs(backend):
    plain, captured = World(20), World(20)
    with ebb.capture() as step:
        captured.step()
    order = np.random.default_rng(3).permutation(20)
    for world, run in ((plain, plain.step), (captured, step.run)):
        ebb.seed(1)
        run()
        world.nodes.permute(order)
        run()
        world.links.b.load(np.arange(40) % 20)
        run()
    assert_same(captured.state(), plain.state())


def test_keys_that_a_step_writes_and_follows(backend):
    def world():
        nodes, walkers = ebb.Relation("nodes", size=6), ebb.Relation("walkers", size=4)
        nodes.new_field("next", nodes, init=[1, 2, 3, 4, 5, 0])
        nodes.new_field("other", nodes, init=[5, 4, 3, 2, 1, 0])
        nodes.new_field("visits", ebb.int32)
        walkers.new_field("at", nodes, init=[0, 2, 2, 5])
        walk = kernel_of("r.at = r.at.next", "r: walkers", walkers=walkers)
        visit = kernel_of("r.at.visits += 1", "r: walkers", walkers=walkers)

        def step():
            walk(walkers)
            visit(walkers)
            nodes.swap("next", "other")
            visit(walkers)

        return nodes, walkers, step

    nodes, walkers, step = world()
    for _ in range(7):
        step()
    expected = [walkers.at.to_numpy(), nodes.visits.to_numpy(), nodes.next.to_numpy()]
    nodes, walkers, play = world()
    with ebb.capture() as step:
        play()
    step.run(3)
    step.run(4)
    assert_same([walkers.at, nodes.visits, nodes.next], expected)


def test_swapped_keys_of_which_some_are_unset(backend):
    nodes, walkers = ebb.Relation("nodes", size=3), ebb.Relation("walkers", size=2)
    nodes.new_field("x", ebb.int32, init=[10, 20, 30])
    walkers.new_field("at", nodes, init=[0, 1])
    walkers.new_field("to", nodes)
    walkers.new_field("x", ebb.int32)
    look = kernel_of("r.x = r.at.x", "r: walkers", walkers=walkers)
    with ebb.capture() as step:
        walkers.swap("at", "to")
        walkers.swap("at", "to")
        look(walkers)
        walkers.swap("at", "to")
    step.run()
    assert walkers.x.to_numpy().tolist() == [10, 20]
    with pytest.raises(ebb.RelationError, match="E404"):
        step.run()
    assert walkers.to.to_numpy().tolist() == [0, 1]
    walkers.at.load([2, 1])
    step.run()
    assert walkers.x.to_numpy().tolist() == [30, 20]


def test_a_view_is_open_when_the_step_runs(backend):
    rows = rows_with(x=(ebb.int32, [0]), y=(ebb.int32, [0]))
    with ebb.capture() as step:
        kernel_of("r.x += 1", "r")(rows)
        rows.swap("x", "y")
    for field in (rows.x, rows.y):
        with field.view(write=True), pytest.raises(ebb.RelationError, match=f"E512.*{field.path}"):
            step.run()
    step.run(2)
    assert (rows.x.to_numpy()[0], rows.y.to_numpy()[0]) == (1, 1)


def test_another_backend_is_chosen_between_runs():
    rows = rows_with(x=(ebb.float32, [0.0]))
    with ebb.capture() as step:
        kernel_of("r.x = r.x * 0.5 + 1.0", "r")(rows)
    names = runnable("reference", "cpu", "opencl", "reference")
    for name in names:
        with ebb.backend(name):
            step.run()
    assert rows.x.to_numpy()[0] == 2 - 0.5 ** (len(names) - 1)


# ---- What cannot be recorded. ----


def test_kernels_are_checked_when_they_are_recorded(backend):
    rows = rows_with(x=(ebb.int32, [0]), y=(ebb.float64, [0.0]))
    for wrong in ("r.x = r.y", "r.z = 1"):
        with pytest.raises(ebb.KernelTypeError), ebb.capture() as step:
            kernel_of("r.x += 1", "r")(rows)
            kernel_of(wrong, "r")(rows)
        step.run()
    assert rows.x.to_numpy()[0] == 0


def test_an_exception_leaves_nothing_recorded_and_launches_run_again(backend):
    rows = rows_with(x=(ebb.int32, [0]))
    add = kernel_of("r.x += 1", "r")
    with pytest.raises(ZeroDivisionError), ebb.capture() as step:
        add(rows)
        raise ZeroDivisionError
    step.run(5)
    assert rows.x.to_numpy()[0] == 0
    add(rows)
    assert rows.x.to_numpy()[0] == 1


def host_steps():
    rows = rows_with(x=(ebb.int32, [0]), y=(ebb.int32, [0]))
    other = ebb.Relation("other", size=2)
    other.new_field("key", rows, init=0)
    total = ebb.Global(ebb.int32, 0)
    with ebb.capture() as done:
        pass
    return {
        "load": lambda: rows.x.load(1),
        "fill": lambda: rows.x.fill(1),
        "read": lambda: rows.x.to_numpy(),
        "array": lambda: np.asarray(rows.x),
        "dlpack": lambda: np.from_dlpack(rows.x),
        "view": lambda: rows.x.view(),
        "write": lambda: rows.x.view(write=True),
        "copy": lambda: rows.copy("x", "y"),
        "field": lambda: rows.new_field("z", ebb.int32),
        "group": lambda: other.group_by("key"),
        "permute": lambda: other.permute([1, 0]),
        "reorder": lambda: other.reorder(),
        "value": lambda: total.value,
        "global": lambda: np.asarray(total),
        "seed": lambda: ebb.seed(1),
        "set_backend": lambda: ebb.set_backend("reference"),
        "backend": lambda: ebb.backend("reference").__enter__(),
        "run": lambda: done.run(),
        "capture": lambda: ebb.capture().__enter__(),
        "print": lambda: kernel_of("print(r.x)", "r")(rows),
    }


@pytest.mark.parametrize("name", host_steps())
def test_what_the_host_does_is_an_error(backend, name):
    action = host_steps()[name]
    with ebb.capture() as step, pytest.raises(ebb.BackendError, match="E607"):
        action()
    step.run()


@pytest.mark.parametrize("count", [-1, 1.0, "2", True, None])
def test_what_is_no_number_of_times(count):
    with ebb.capture() as step:
        pass
    with pytest.raises(ebb.BackendError, match="E608"):
        step.run(count)


def test_keys_are_written_and_looked_up(backend):
    nodes, links = ebb.Relation("nodes", size=2), ebb.Relation("links", size=2)
    links.new_field("a", nodes, init=[0, 1])
    links.new_field("b", nodes, init=[1, 1])
    nodes.new_field("n", ebb.int32)
    links.group_by("a")
    names = {"nodes": nodes, "links": links}
    turn = kernel_of("r.a = r.b", "r: links", **names)
    count = kernel_of("for link in ebb.where(links.a, r):\n    r.n += 1", "r: nodes", **names)
    for actions in ([lambda: turn(links), lambda: count(nodes)], [lambda: links.swap("a", "b"), lambda: count(nodes)]):
        for order in (actions, actions[::-1]):
            with pytest.raises(ebb.BackendError, match=r"E609.*links\.a"), ebb.capture():
                for action in order:
                    action()
    with ebb.capture() as one:
        turn(links)
    with ebb.capture() as other:
        count(nodes)
    one.run()
    other.run()
    assert nodes.n.to_numpy().tolist() == [0, 2]


def test_a_kernel_is_explained_while_it_is_recorded(backend):
    world = World(20)
    with ebb.capture() as step:
        world.gather(world.nodes)
        world.gather.check(world.nodes)
        assert "READ" in world.gather.explain(world.nodes)
        assert world.gather.inspect(world.nodes, "kir")
    step.run()
