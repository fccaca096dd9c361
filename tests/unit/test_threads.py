from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from both_backends import checked
from kir_forms import OnRows, binary, read, reduce_global, write

from ebb.backends.cpu import cpu_backend
from ebb.errors import BackendError
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.runtime import threads
from ebb.types.types import float32, int64

SIZE = 20_000


@pytest.fixture
def summing():
    relation = Relation("rows", size=SIZE)
    relation.new_field("x", float32, init=np.random.default_rng(1).normal(size=SIZE))
    relation.new_field("y", float32)
    on = OnRows(relation)
    x = read(relation.x, on.row)
    total = Global(float32, 0.0)
    return on.kernel(write(relation.y, on.row, binary("*", x, x)), reduce_global(total, "+", x)), total


def launch(kernel, total, count):
    total.value = 0.0
    cpu_backend(count).prepare(checked(kernel)).bind(kernel.relation).run(())
    return total.data.tobytes(), kernel.relation.y.data.tobytes()


def test_the_number_of_threads(monkeypatch):
    monkeypatch.delenv("EBB_NUM_THREADS", raising=False)
    assert 1 <= threads.thread_count() <= threads.MOST_THREADS
    monkeypatch.setenv("EBB_NUM_THREADS", "3")
    assert threads.thread_count() == 3 and threads.thread_count(5) == 5


@pytest.mark.parametrize("count", [0, -1, 2.5, True, "4", 10**6])
def test_what_is_no_number_of_threads(count):
    with pytest.raises(BackendError) as caught:
        cpu_backend(count)
    assert caught.value.codes == ("E603",)


@pytest.mark.parametrize("text", ["0", "many", "-2", "1.5"])
def test_a_wrong_environment_names_itself(monkeypatch, text):
    monkeypatch.setenv("EBB_NUM_THREADS", text)
    with pytest.raises(BackendError, match="EBB_NUM_THREADS"):
        cpu_backend()


def test_python_threads_where_there_is_no_openmp(monkeypatch, summing):
    expected = launch(*summing, 1)
    monkeypatch.setattr("ebb.runtime.cpu.openmp", lambda: None)
    monkeypatch.setattr("ebb.runtime.threads.openmp", lambda: None)
    assert launch(*summing, 3) == expected
    assert "Python threads" in threads.describe_threads()


def test_launches_from_several_python_threads(summing):
    kernel, _ = summing
    counter = Global(int64, 0)
    on = OnRows(kernel.relation)
    from kir_forms import const

    executable = cpu_backend(2).prepare(checked(on.kernel(reduce_global(counter, "+", const(1, int64)))))

    def work():
        for _ in range(50):
            with threads.launching():  # as kernels do
                executable.bind(kernel.relation).run(())

    workers = [threading.Thread(target=work) for _ in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert counter.value == 200 * SIZE


def _launch_in_child(kernel, total, pipe):
    pipe.send(launch(kernel, total, 2))


@pytest.mark.skipif(sys.platform == "win32", reason="there is no fork")
def test_a_forked_process_runs_on_one_thread(summing):
    expected = launch(*summing, 2)
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    child = context.Process(target=_launch_in_child, args=(*summing, there))
    child.start()
    assert here.poll(60), "the child hangs"
    assert here.recv() == expected
    child.join(60)
    assert child.exitcode == 0


def test_small_launches_are_not_worth_threads(monkeypatch):
    monkeypatch.setattr(threads, "GRAIN", 25_000.0)
    assert [threads.worthwhile_threads(work) for work in (0.0, 30e3, 50e3, 1e6, 1e9)] == [1, 1, 2, 40, 40_000]
    monkeypatch.setattr(threads, "GRAIN_OF_PYTHON", 1e6)
    monkeypatch.setattr(threads, "openmp", lambda: None)
    assert [threads.worthwhile_threads(work) for work in (0.0, 50e3, 1e6, 2e6)] == [1, 1, 1, 2]


WAITING = """
import os
from ebb.runtime.threads import openmp
print(openmp() is not None, *(name for name in ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT") if name in os.environ))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other runtimes are told through the environment")
def test_how_threads_wait_is_not_passed_on():
    """Programs that a program starts, OpenMP ones say, wait as they are used to."""
    environment = {
        name: value for name, value in os.environ.items() if name not in ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
    }
    found = subprocess.run(
        [sys.executable, "-c", WAITING], env=environment, text=True, capture_output=True, timeout=60, check=True
    )
    assert found.stdout.split() == ["True"]
