"""Copies on devices against NumPy: whoever looks, after any operations anywhere, sees what was written last.

The sequences are long and drawn evenly, not by Hypothesis: to go wrong takes several operations that fit together.
"""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.relations.family import family_of
from ebb.runtime.buffer import Layout
from fake_device import FakeDevice, run_on

NUMBERS = ("a", "b", "c")
WIDE = ("u", "w")
EVERY = (*NUMBERS, *WIDE, "key")
LENGTH = 150


class World:
    """Fields and a global that two devices, a backend and the host write in turn, beside arrays."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.devices = [FakeDevice("first"), FakeDevice("second")]
        self.size = size = seed % 5
        self.rows, self.targets = ebb.Relation("rows", size=size), ebb.Relation("targets", size=3)
        self.model = {name: np.arange(size, dtype=np.float32) for name in NUMBERS}
        self.model |= {name: np.zeros((size, 5), np.float32) for name in WIDE}
        self.model["key"] = np.zeros(size, np.int32)
        for name in NUMBERS:
            self.rows.new_field(name, ebb.float32, self.model[name])
        for name in WIDE:
            self.rows.new_field(name, ebb.vector(ebb.float32, 5))
        self.rows.new_field("key", self.targets, 0)
        self.rows.new_subset("some", np.arange(size) % 2 == 0)
        self.targets.new_field("sum", ebb.float32)
        self.total = ebb.Global(ebb.float32, 1)
        self.sum = np.float32(1)
        self.define()

    def define(self) -> None:
        rows, targets, total = self.rows, self.targets, self.total

        @ebb.kernel
        def add(row: rows, to: str, by: str):
            row[to] = (row[to] + row[by]) % 64

        @ebb.kernel
        def move(row: rows):
            row.u = row.w + row.a

        @ebb.kernel
        def add_up(row: rows):
            total.value += row.c

        @ebb.kernel
        def gather(t: targets):
            t.sum = 0.0
            for row in ebb.where(rows.key, t):
                t.sum += row.b

        with ebb.capture() as step:
            total.value = 2
            add(rows, "a", "b")
            rows.swap("a", "b")
            add_up(rows)
        self.add, self.move, self.add_up, self.gather, self.step = add, move, add_up, gather, step

    def field(self, *names):
        """One of the fields of these names, and its name."""
        name = str(self.random.choice(names))
        return self.rows.fields[name], name

    def device(self):
        return self.devices[self.random.integers(2)]

    # On a device

    def change_there(self):
        field, name = self.field(*NUMBERS)
        run_on(self.device(), lambda values: np.copyto(values, (values + 1) % 64), changed=[field])
        self.model[name] = (self.model[name] + 1) % 64

    def read_there(self):
        field, name = self.field(*NUMBERS)
        seen, device = [], self.device()
        run_on(device, lambda values: seen.append(values.copy()), field)
        if self.size:
            device.wait()
            ids = self.rows.storage.identities_of(np.arange(self.size))
            assert np.array_equal(seen[0], self.model[name][ids])

    def overwrite_there(self):
        (source, name), (target, to) = self.field(*WIDE), self.field(*WIDE)
        if name != to:
            run_on(self.device(), lambda s, t: np.copyto(t, (s + 3) % 64), source, overwritten=[target])
            self.model[to] = (self.model[name] + 3) % 64

    def write_keys_there(self):
        key = self.random.integers(3)
        run_on(self.device(), lambda keys: keys.fill(key), overwritten=[self.rows.key])
        self.model["key"] = np.full(self.size, key)

    def reduce_there(self):
        run_on(self.device(), lambda c, total: np.copyto(total, c.sum()), self.rows.c, changed=[self.total])
        self.sum = self.model["c"].sum()

    # On the backend

    def change_here(self):
        (_, to), (_, by) = self.field(*NUMBERS), self.field(*NUMBERS)
        some = self.random.integers(2)
        for _ in range(self.random.integers(1, 12)):  # often enough for the fast path
            self.add(self.rows.some if some else self.rows, to, by)
            part = slice(None, None, 2 if some else 1)
            self.model[to] = self.model[to].copy()
            self.model[to][part] = (self.model[to][part] + self.model[by][part]) % 64

    def move_here(self):
        self.move(self.rows)
        self.model["u"] = self.model["w"] + self.model["a"][:, np.newaxis]

    def reduce_here(self):
        self.total.value = 1
        self.add_up(self.rows)
        self.sum = 1 + self.model["c"].sum()

    def run_the_step(self):
        times = self.random.integers(1, 4)
        self.step.run(times)
        for _ in range(times):
            self.model["a"], self.model["b"] = self.model["b"], (self.model["a"] + self.model["b"]) % 64
        self.sum = 2 + self.model["c"].sum()

    def gather_here(self):
        self.rows.group_by("key")
        self.gather(self.targets)
        expected = np.bincount(self.model["key"], self.model["b"], minlength=3)
        assert np.array_equal(self.targets.sum.to_numpy(), expected)

    # On the host

    def load(self):
        field, name = self.field(*NUMBERS)
        self.model[name] = self.random.integers(64, size=self.size).astype(np.float32)
        field.load(self.model[name])

    def fill(self):
        field, name = self.field(*NUMBERS, *WIDE)
        value = self.random.integers(64)
        field.fill(value)
        self.model[name] = np.full_like(self.model[name], value)

    def copy(self):
        (source, name), (target, to) = self.field(*NUMBERS), self.field(*NUMBERS)
        self.rows.copy(source, target)
        self.model[to] = self.model[name]

    def write_a_view(self):
        field, name = self.field(*NUMBERS)
        with field.view(write=True) as view:
            view[...] = (view + 1) % 64
        self.model[name] = (self.model[name] + 1) % 64

    def set_global(self):
        self.sum = np.float32(self.random.integers(64))
        self.total.value = self.sum

    def swap(self):
        left, right = [("a", "b"), ("b", "c"), ("u", "w")][self.random.integers(3)]
        self.rows.swap(left, right)
        self.model[left], self.model[right] = self.model[right], self.model[left]

    def permute(self):
        self.rows.permute(self.random.permutation(self.size))

    def change_the_layout(self):
        family = family_of(self.field(*WIDE)[0])
        family.layout = list(Layout)[self.random.integers(2)]
        family.convert(*family.members)

    def look(self):
        field, name = self.field(*EVERY)
        assert np.array_equal(field.to_numpy(), self.model[name])

    def look_at_the_global(self):
        assert self.total.value == self.sum

    def report(self):
        """One copy of each is valid, and to say so moves nothing."""
        moves = [len(device.moves) for device in self.devices]
        found = {entry.name: entry for entry in ebb.memory().entries}
        entries = [found[f"rows.{name}"] for name in EVERY]
        assert all(entry.host_valid or any(copy.valid for copy in entry.devices) for entry in entries)
        assert [len(device.moves) for device in self.devices] == moves

    def look_at_everything(self):
        for name in EVERY:
            assert np.array_equal(self.rows.fields[name].to_numpy(), self.model[name]), name
        self.look_at_the_global()


OPERATIONS = [name for name in vars(World) if name not in ("define", "field", "device") and not name.startswith("_")]


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("seed", range(16))
def test_whoever_looks_sees_what_was_written_last(backend: str, seed: int) -> None:
    with ebb.backend(backend):
        world, chosen = World(seed), []
        try:
            for _ in range(LENGTH):
                chosen.append(str(world.random.choice(OPERATIONS)))
                getattr(world, chosen[-1])()
        except AssertionError as error:
            raise AssertionError(f"after {' '.join(chosen)}") from error
        world.look_at_everything()
