"""What relations hold beside the bytes of their fields, and that nothing stays behind when they go.

NumPy tells tracemalloc of every array, so the counts are exact. Transient copies do not count: they are gone again.
"""

from __future__ import annotations

import gc
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import ebb

SIZE, TARGETS = 1_000_000, 250_000
ALLOWED = 1.05


class Tally:
    """The bytes that were taken since it was made, against those of fields and indexes."""

    def __init__(self):
        self._before = self._now()

    def overhead(self, *relations):
        """All that is held, less the indexes, as a multiple of the fields."""
        fields = sum(field.data.nbytes for relation in relations for field in relation.fields.values())
        return (self._now() - self._before - sum(map(index_bytes, relations))) / fields

    @staticmethod
    def _now():
        gc.collect()
        return tracemalloc.get_traced_memory()[0]


def index_bytes(relation):
    """Order and rank of a permuted relation, offsets and rows of its groupings."""
    arrays = [relation.storage.order, relation.storage.rank]
    for field in relation.fields.values():
        if field.grouping is not None:
            arrays += [field.grouping.offsets, field.grouping.rows]
    return sum(array.nbytes for array in arrays if array is not None)


@pytest.fixture
def tally():
    """Counts from the start of the test, with all that every program needs once already there."""
    warm = ebb.Relation("warm", size=10)
    warm.new_field("x", ebb.float32)

    @ebb.kernel
    def touch(row: warm):
        row.x += 1.0

    touch(warm)
    tracemalloc.start()
    yield Tally()
    tracemalloc.stop()


def ten_fields(**keys):
    """A relation of a million rows and ten fields, the last of them ``keys`` by name and target."""
    rows = ebb.Relation("rows", size=SIZE)
    generator = np.random.default_rng(3)
    for number in range(10 - len(keys)):
        rows.new_field(f"f{number}", ebb.float32, init=generator.random(SIZE))
    for name, target in keys.items():
        rows.new_field(name, target, init=generator.integers(0, target.size, SIZE))
    return rows


def test_fields_take_their_own_bytes(tally):
    rows = ten_fields()
    assert tally.overhead(rows) < ALLOWED
    total = ebb.Global(ebb.float64, 0.0)

    @ebb.kernel
    def combine(row: rows):
        row.f0 = row.f1 + 2.0 * row.f2

    @ebb.kernel
    def add(row: rows):
        total.value += row.f0

    for _ in range(10):
        combine(rows)
        add(rows)
        rows.swap("f0", "f3")
    assert tally.overhead(rows) < ALLOWED, "after launches"
    rows.f4.load(rows.f5)
    rows.f5.load(rows.f6.to_numpy())
    rows.f6.fill(1.0)
    with rows.f7.view(write=True) as values:
        values += 1.0
    assert tally.overhead(rows) < ALLOWED, "after loads and views"


def test_what_is_grouped_and_permuted_takes_its_indexes_more(tally):
    nodes = ebb.Relation("nodes", size=TARGETS)
    nodes.new_field("total", ebb.float32)
    rows = ten_fields(node=nodes, other=nodes)

    @ebb.kernel
    def shift(row: rows):
        row.f0 = row.f1 + row.f2

    @ebb.kernel
    def gather(node: nodes):
        for row in ebb.where(rows.node, node):
            node.total += row.f0

    for _ in range(10):
        shift(rows)
    rows.group_by("node")
    rows.group_by("other")
    assert tally.overhead(rows, nodes) < ALLOWED, "after a grouping"
    for _ in range(10):
        gather(nodes)
    rows.permute(np.random.default_rng(1).permutation(SIZE))
    nodes.permute(np.random.default_rng(2).permutation(TARGETS))
    assert tally.overhead(rows, nodes) < ALLOWED, "what kernels knew of the old order is gone"
    rows.node.load(np.random.default_rng(4).integers(0, TARGETS, SIZE))
    gather(nodes)
    assert tally.overhead(rows, nodes) < ALLOWED, "after new keys"


def life(number):
    """Makes relations and kernels of every kind that a program could, runs them, and forgets them."""
    nodes = ebb.Relation("nodes", size=100)
    nodes.new_field("total", ebb.float32)
    links = ebb.Relation("links", size=300)
    links.new_field("node", nodes, init=np.arange(300) % 100)
    links.new_field("weight", ebb.float32, init=1.0)
    links.group_by("node")
    grid = ebb.Relation("grid", shape=(8, 8), periodic=True)
    grid.new_field("t", ebb.float32, init=1.0)

    @grid.member
    def below(cell):
        return ebb.affine(grid, [[1, 0, 1], [0, 1, 0]], cell)

    inner = grid.new_subset("inner", np.s_[1:-1, 1:-1])
    spread = ebb.Global(ebb.float64, 0.0)
    factor = float(number)

    @ebb.kernel
    def gather(node: nodes):
        for link in ebb.where(links.node, node):
            node.total += factor * link.weight

    @ebb.kernel
    def scatter(link: links):
        link.node.total += link.weight

    @ebb.kernel
    def diffuse(cell: grid):
        spread.value += cell.t - cell.below.t

    for _ in range(2):
        gather(nodes)
        scatter(links)
        diffuse(grid)
        diffuse(inner)
    nodes.swap("total", "total")
    assert nodes.total.to_numpy()[0] == 6 * (factor + 1)


@pytest.mark.parametrize("lives", [10, pytest.param(70, marks=pytest.mark.slow)])
def test_relations_and_kernels_leave_nothing_behind(lives):
    tracemalloc.start()
    try:
        held = [held_after(lives) for _ in range(3)]
    finally:
        tracemalloc.stop()
    # The first lives fill what Python keeps for reuse.
    assert held[2][0] - held[1][0] < 20, "objects"
    assert held[2][1] - held[1][1] < 4000 * lives, "bytes; a life takes some 60,000"


def held_after(lives):
    """The objects and the bytes that are there after so many lives."""
    for number in range(lives):
        life(number)
    gc.collect()
    return len(gc.get_objects()), tracemalloc.get_traced_memory()[0]


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="nothing tells the size of the process")
def test_machine_code_is_unloaded():
    """What LLVM holds is no memory of Python's. It kept 28 kB of every life while all had one linker."""
    sizes = [held_after(70) and resident() for _ in range(4)]
    # Memory that is free but scattered makes one step in a while; what is kept makes all.
    assert min(np.diff(sizes)) < 1_000_000


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
