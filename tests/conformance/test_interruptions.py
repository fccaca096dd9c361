"""Launches that meet other threads, forks, interrupts and output that fails: state stays whole."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from contextlib import redirect_stdout

import numpy as np
import pytest

import ebb

from .harness import kernel_of

LINKS, NODES = 20_000, 100


def network():
    nodes, links = ebb.Relation("nodes", size=NODES), ebb.Relation("links", size=LINKS)
    random = np.random.default_rng(5)
    for name in ("a", "b"):
        links.new_field(name, nodes, init=random.integers(0, NODES, LINKS))
    links.new_field("x", ebb.float64, init=np.arange(LINKS))
    links.new_field("y", ebb.float64)
    nodes.new_field("total", ebb.float64)
    links.group_by("a")
    flip = kernel_of("r.a, r.b = r.b, r.a", "r: links", links=links)
    text = """
    r.total = 0.0
    for link in ebb.where(links.a, r):
        r.total += link.x
    """
    return nodes, links, flip, kernel_of(text, "r: nodes", nodes=nodes, links=links)


def work(links):
    text = """
    for i in range(100):
        r.y += r.x
    """
    return kernel_of(text, "r: links", links=links)


def run_all(*functions):
    """Runs each function in a thread of its own; raises what any of them raises."""
    failures = []

    def guarded(function):
        try:
            function()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=guarded, args=(function,)) for function in functions]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []


def test_one_thread_launches_while_another_sorts_the_rows(compiled):
    nodes, links, flip, sums = network()
    heavy = work(links)

    def sort():
        for _ in range(6):
            flip(links)
            sums(nodes)

    run_all(lambda: [heavy(links) for _ in range(6)], sort)
    x = np.arange(LINKS, dtype=float)
    np.testing.assert_array_equal(links.x.to_numpy(), x)
    np.testing.assert_array_equal(links.y.to_numpy(), 600 * x)
    np.testing.assert_array_equal(nodes.total.to_numpy(), np.bincount(links.a.to_numpy(), x, NODES))


def test_one_thread_swaps_and_sorts_while_another_runs_a_step(compiled):
    rows = ebb.Relation("rows", size=LINKS)
    for start, name in enumerate("xyz"):
        rows.new_field(name, ebb.int64, init=start)
    with ebb.capture() as step:
        work_on = """
        for i in range(100):
            r.x += r.y - r.y
        """
        kernel_of(work_on, "r: rows", rows=rows)(rows)
        rows.swap("x", "y")
    step.run(100)
    over = threading.Event()

    def run():
        for _ in range(5):
            step.run(101)
        over.set()

    def disturb():
        while not over.wait(0.01):
            rows.swap("y", "z")
            rows.permute(np.arange(LINKS)[::-1])

    run_all(run, disturb)
    assert len({field.address for field in rows.fields.values()}) == 3
    found = np.sort([field.to_numpy() for field in rows.fields.values()], axis=0)
    np.testing.assert_array_equal(found, np.broadcast_to([[0], [1], [2]], (3, LINKS)))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_fork_while_another_thread_launches():
    nodes, links, _, sums = network()
    heavy = work(links)
    heavy(links)
    stop = threading.Event()

    def launch_on():
        while not stop.is_set():
            heavy(links)

    thread = threading.Thread(target=launch_on)
    thread.start()
    try:
        for _ in range(5):
            child = os.fork()
            if child == 0:
                signal.alarm(20)  # a child that hangs ends by it
                sums(nodes)
                os._exit(0)
            assert os.waitpid(child, 0)[1] == 0
    finally:
        stop.set()
        thread.join()


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="there are no timers")
def test_an_interrupt_leaves_no_failure_for_the_next_launch(compiled):
    rows = ebb.Relation("rows", size=50_000)
    rows.new_field("x", ebb.float64)
    text = """
    for i in range(100):
        r.x += 1.0
    assert ebb.id(r) != bad
    """
    program = kernel_of(text, "r: rows, bad: ebb.int64", rows=rows)
    program(rows, -1)

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        for delay in np.linspace(1e-4, 2e-2, 20):
            signal.setitimer(signal.ITIMER_REAL, delay)
            try:
                program(rows, rows.size - 1)
            except (KeyboardInterrupt, ebb.KernelAssertionError):
                pass
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
            program(rows, -1)
    finally:
        signal.signal(signal.SIGALRM, before)


class Reacting(io.StringIO):
    """Output that does something when a line is written."""

    def __init__(self, react):
        super().__init__()
        self.react = react

    def write(self, text):
        react, self.react = self.react, lambda: None
        react()
        return super().write(text)


def printing():
    rows = ebb.Relation("rows", size=3)
    rows.new_field("x", ebb.int32, init=[5, 6, 7])
    text = """
    print(r.x)
    assert ebb.id(r) != bad
    """
    return rows, kernel_of(text, "r: rows, bad: ebb.int64", rows=rows)


def test_output_that_fails_leaves_nothing_for_the_next_launch(backend):
    rows, program = printing()

    def fail():
        raise OSError("full")

    with redirect_stdout(Reacting(fail)), pytest.raises(OSError, match="full"):
        program(rows, 2)
    with redirect_stdout(io.StringIO()) as printed:
        program(rows, -1)
    assert printed.getvalue() == "5\n6\n7\n"


def test_output_that_launches(backend):
    rows, program = printing()
    other = ebb.Relation("other", size=2)
    other.new_field("n", ebb.int32)
    count = kernel_of("r.n += 1", "r: other", other=other)
    with redirect_stdout(Reacting(lambda: count(other))) as printed:
        program(rows, -1)
    assert printed.getvalue() == "5\n6\n7\n"
    assert other.n.to_numpy().tolist() == [1, 1]


def test_breakpoint_hook_that_launches(monkeypatch):
    rows = ebb.Relation("rows", size=2)
    rows.new_field("n", ebb.int32)
    other = ebb.Relation("other", size=2)
    other.new_field("n", ebb.int32)
    count = kernel_of("r.n += 1", "r: other", other=other)
    program = kernel_of("r.n += 2\nbreakpoint()", "r: rows", rows=rows)
    monkeypatch.setattr(sys, "breakpointhook", lambda: count(other))
    with ebb.backend("reference"):
        program(rows)
    assert rows.n.to_numpy().tolist() == other.n.to_numpy().tolist() == [2, 2]
