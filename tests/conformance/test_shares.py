"""What threads take of one another's shares: no result depends on who runs which rows."""

from __future__ import annotations

import numpy as np
import pytest

import ebb

from .harness import kernel_of, names_row, rejects

ROWS = 40_000
THREADS = (1, 2, 3, 7)


class OneByOne:
    """In the place of Python's pool: threads that run one after the other, in the order ``by`` of their numbers.

    So the first of them does the work of all, and takes every share but its own from the end.
    """

    by = staticmethod(list)
    waves = 0

    def __init__(self, threads):
        self.threads = threads

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        return None

    def map(self, run, numbers):
        OneByOne.waves += 1
        return [run(number) for number in self.by(numbers)]


ORDERS = {
    "ascending": list,
    "descending": lambda numbers: list(numbers)[::-1],
    "without the first": lambda numbers: list(numbers)[1:],
}


@pytest.fixture(params=ORDERS)
def one_by_one(monkeypatch, request):
    monkeypatch.setattr(OneByOne, "by", staticmethod(ORDERS[request.param]))
    for name in ("ebb.runtime.cpu.openmp", "ebb.runtime.threads.openmp"):
        monkeypatch.setattr(name, lambda: None)
    monkeypatch.setattr("concurrent.futures.ThreadPoolExecutor", OneByOne)
    before = OneByOne.waves
    yield
    assert OneByOne.waves > before


def uneven(last):
    """Rows of which those from three quarters on take some hundred times as long, and what kernels do with them."""
    rows = ebb.Relation("rows", size=ROWS)
    cells = ebb.Relation("cells", size=ROWS // 2)
    random = np.random.default_rng(1)
    rows.new_field("x", ebb.float32, init=random.random(ROWS))
    rows.new_field("y", ebb.float32)
    near = np.minimum(np.arange(ROWS) // 2 + random.integers(0, 50, ROWS), ROWS // 2 - 1)
    rows.new_field("cell", cells, init=near)
    cells.new_field("sum", ebb.float32)
    total = ebb.Global(ebb.float32, 0.0)

    @ebb.kernel
    def work(r: rows):
        y = r.x
        turns = last if ebb.id(r) > 3 * ROWS // 4 else 2
        i = 0
        while i < turns:
            y = y * ebb.float32(0.99) + ebb.sin(y)
            i += 1
        r.y = y
        total.value += y

    @ebb.kernel
    def gather(r: rows):
        r.cell.sum += r.y

    def run(threads):
        total.value = 0.0
        cells.sum.fill(0.0)
        with ebb.backend("cpu", threads=threads):
            work(rows)
            gather(rows)
        return total.data.tobytes(), rows.y.to_numpy().tobytes(), cells.sum.to_numpy().tobytes()

    return run


def test_rows_that_take_very_different_time_have_the_same_bits():
    run = uneven(200)
    assert len({run(threads) for threads in THREADS for _ in range(3)}) == 1


def test_one_thread_takes_the_shares_of_all(one_by_one):
    run = uneven(5)
    assert len({run(threads) for threads in THREADS}) == 1


@pytest.mark.parametrize("bad", [[0], [ROWS - 1], [9_999, 30_000], [13_400, 13_300, 27_000], range(26_000, 26_900)])
def test_the_first_failure_of_other_threads_shares(one_by_one, bad):
    rows = ebb.Relation("rows", size=ROWS)
    sound = np.ones(ROWS, bool)
    sound[list(bad)] = False
    rows.new_field("sound", ebb.bool_, init=sound)
    kernel = kernel_of("assert r.sound", rows=rows)
    for threads in THREADS:
        with ebb.backend("cpu", threads=threads):
            for _ in range(2):
                assert names_row(rejects(ebb.KernelAssertionError, "E401", lambda: kernel(rows)), min(bad))
