"""Captured steps on cpu: run by machine code, in slices, on any number of threads, beside launches of other threads."""

from __future__ import annotations

import signal
import sys
import threading
import time

import numpy as np
import pytest

import ebb
from ebb.backends.cpu.replay import SLICE_SECONDS
from ebb.capture import Step
from ebb.runtime.threads import launching

SIZE = 40_000


@pytest.fixture
def natively(monkeypatch):
    """No step is replayed by Python."""

    def fail(*_):
        raise AssertionError("Python replays the step")

    monkeypatch.setattr(Step, "_replay_in_python", fail)


class Mesh:
    """Vertices of a shuffled ring with edges both ways, and a step that scatters, gathers and swaps."""

    def __init__(self):
        random = np.random.default_rng(4)
        self.vertices, self.edges = ebb.Relation("vertices", size=SIZE), ebb.Relation("edges", size=2 * SIZE)
        vertices, edges = self.vertices, self.edges
        vertices.new_field("x", ebb.vec3f, init=random.normal(size=(SIZE, 3)))
        vertices.new_field("new", ebb.vec3f)
        vertices.new_field("force", ebb.vec3f)
        vertices.new_field("frame", ebb.mat3f, init=np.eye(3))
        vertices.new_field("old_frame", ebb.mat3f)
        ring = random.permutation(SIZE)
        edges.new_field("tail", vertices, init=np.concatenate([ring, np.roll(ring, 1)]))
        edges.new_field("head", vertices, init=np.concatenate([np.roll(ring, 1), ring]))
        self.energy = energy = ebb.Global(ebb.float32, 0.0)

        @ebb.kernel
        def pull(e: edges):
            e.tail.force += ebb.normalize(e.head.x - e.tail.x)

        @ebb.kernel
        def move(v: vertices):
            v.new = v.x + 0.01 * v.force
            v.old_frame = v.frame * 0.5 + ebb.transpose(v.frame)
            energy.value += ebb.dot(v.force, v.force)
            v.force = 0.0

        self.pull, self.move = pull, move

    def step(self):
        self.pull(self.edges)
        self.move(self.vertices)
        self.vertices.swap("x", "new")
        self.vertices.swap("frame", "old_frame")

    def state(self):
        return [field.to_numpy().tobytes() for field in self.vertices.fields.values()] + [self.energy.value]


def rows_of(size=1, type=ebb.float64):
    rows = ebb.Relation("rows", size=size)
    rows.new_field("x", type)
    return rows


def test_the_same_bits_for_any_number_of_threads_captured_or_not(natively):
    with ebb.backend("cpu", threads=1):
        plain = Mesh()
        for _ in range(11):
            plain.step()
    for threads in (1, 2, 3, 7):
        with ebb.backend("cpu", threads=threads):
            mesh = Mesh()
            with ebb.capture() as step:
                mesh.step()
            step.run(4)
            step.run(7)
        assert mesh.state() == plain.state()


def test_a_repeated_run_looks_at_nothing_again(natively, monkeypatch):
    rows = rows_of()

    @ebb.kernel
    def add(r: rows):
        r.x += 1.0

    with ebb.capture() as step:
        add(rows)
        add(rows)
    step.run()
    monkeypatch.setattr("ebb.launch.Launch.settle", lambda *_: pytest.fail("settled again"))
    for _ in range(10):
        step.run(3)
    assert rows.x.to_numpy()[0] == 62.0


def test_the_structure_changes_and_the_step_is_prepared_again(natively):
    rows = rows_of(5)
    rows.new_field("next", rows, init=[1, 2, 3, 4, 0])

    @ebb.kernel
    def add(r: rows):
        r.x = r.next.x + 1.0

    @ebb.kernel
    def fill(r: rows):
        r.next.x += 1.0

    with ebb.capture() as step:
        fill(rows)
    for order in ([4, 3, 2, 1, 0], [1, 0, 2, 3, 4]):
        step.run(2)
        rows.permute(order)
    rows.next.load([0, 0, 0, 0, 0])
    step.run(1)
    assert rows.x.to_numpy().tolist() == [9.0, 4.0, 4.0, 4.0, 4.0]


@pytest.mark.parametrize("threads", [1, 3])
def test_without_openmp_python_replays(monkeypatch, threads):
    monkeypatch.setattr("ebb.backends.cpu.backend.openmp", lambda: None)
    monkeypatch.setattr("ebb.runtime.cpu.openmp", lambda: None)
    with ebb.backend("cpu", threads=threads):
        mesh, plain = Mesh(), Mesh()
        with ebb.capture() as step:
            mesh.step()
        step.run(2)
        for _ in range(2):
            plain.step()
    assert mesh.state() == plain.state()


@pytest.mark.skipif(sys.platform == "win32", reason="there is no setitimer")
def test_an_interrupt_ends_a_long_run_between_two_turns(natively):
    rows = ebb.Relation("rows", size=10_000)
    for name in ("x", "y"):
        rows.new_field(name, ebb.int64)

    @ebb.kernel
    def count(r: rows):
        r.x += 1

    with ebb.capture() as step:
        count(rows)
        rows.swap("x", "y")
    step.run(100)

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 2 * SLICE_SECONDS)
        start = time.perf_counter()
        with pytest.raises(KeyboardInterrupt):
            step.run(10**12)
        assert time.perf_counter() - start < 600 * SLICE_SECONDS
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    x, y = rows.x.to_numpy(), rows.y.to_numpy()
    assert (x == x[0]).all() and (y == y[0]).all()
    assert x[0] - y[0] in (0, 1, -1) and x[0] > 50
    total = x[0] + y[0]
    step.run(2)
    assert rows.x.to_numpy()[0] + rows.y.to_numpy()[0] == total + 2


def test_another_thread_launches_while_this_one_records():
    rows = rows_of()
    seen = []

    @ebb.kernel
    def add(r: rows):
        r.x += 1.0

    def work():
        for _ in range(20):
            add(rows)
        seen.append(rows.x.to_numpy()[0])

    add(rows)
    with ebb.capture() as step:
        add(rows)
        other = threading.Thread(target=work)
        other.start()
        other.join()
        add(rows)
    assert seen == [21.0]
    step.run(2)
    assert rows.x.to_numpy()[0] == 25.0


def test_a_launch_waits_for_a_running_step(natively):
    rows = rows_of()

    @ebb.kernel
    def add(r: rows):
        r.x += 1.0

    with ebb.capture() as step:
        add(rows)
    step.run()
    threads = [threading.Thread(target=step.run, args=(1000,)) for _ in range(3)]
    threads += [threading.Thread(target=lambda: [add(rows) for _ in range(100)]) for _ in range(2)]
    with launching():
        for thread in threads:
            thread.start()
        assert rows.x.to_numpy()[0] == 1.0
    for thread in threads:
        thread.join()
    assert rows.x.to_numpy()[0] == 3201.0


def test_swapped_fields_that_come_to_lie_in_columns(natively):
    """The layout of fields with many components is decided while a step is prepared."""
    results = []
    for captured in (False, True):
        rows = ebb.Relation("rows", size=20_000)
        for name in ("a", "b"):
            rows.new_field(name, ebb.mat3d, init=np.arange(180_000).reshape(-1, 3, 3))

        @ebb.kernel
        def turn(r: rows):
            r.a = ebb.transpose(r.b) * 0.5 + r.a @ r.b * 1e-6

        def play(rows=rows, turn=turn):
            turn(rows)
            rows.swap("a", "b")

        if captured:
            with ebb.capture() as step:
                play()
            step.run(5)
        else:
            for _ in range(5):
                play()
        results.append([rows.a.to_numpy(), rows.b.to_numpy()])
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


def test_swapped_fields_of_which_one_alone_would_lie_in_columns(natively):
    rows = ebb.Relation("rows", size=SIZE)
    rows.new_field("old", ebb.mat3d, init=np.eye(3))
    rows.new_field("new", ebb.mat3d, init=np.eye(3))
    rows.new_field("sum", ebb.float64)

    @ebb.kernel
    def change(r: rows):
        r.new = 2.0 * ebb.inverse(r.new + ebb.transpose(r.new)) @ r.new

    @ebb.kernel
    def add(r: rows):
        for i in range(2):
            r.sum += r.old[0, i]

    with ebb.capture() as step:
        change(rows)
        add(rows)
        rows.swap("old", "new")
    step.run(20)
    assert rows.old.buffer.layout is rows.new.buffer.layout
    assert rows.sum.to_numpy()[[0, -1]].tolist() == [20.0, 20.0]


def test_a_recording_generator_that_another_thread_closes():
    rows = rows_of()

    @ebb.kernel
    def add(r: rows):
        r.x += 1.0

    def recording():
        with ebb.capture():
            add(rows)
            yield

    abandoned = recording()
    next(abandoned)
    thread = threading.Thread(target=abandoned.close)
    thread.start()
    thread.join()
    before = rows.x.to_numpy()
    add(rows)
    np.testing.assert_array_equal(rows.x.to_numpy(), before + 1.0)


def test_a_step_keeps_what_it_uses():
    rows = rows_of()

    def make():
        scale = ebb.Global(ebb.vec3d, 2.0)

        @ebb.kernel
        def add(r: rows):
            r.x += scale[0]

        with ebb.capture() as step:
            add(rows)
            scale.value = 1.0
        return step

    step = make()
    step.run(3)
    assert rows.x.to_numpy()[0] == 4.0
