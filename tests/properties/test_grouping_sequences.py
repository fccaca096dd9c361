"""Grouping against NumPy: after any operations the index, the keys and the dumps are those of a plain model."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from ebb.relations.relation import Relation
from ebb.types.types import int64, vector

Ints = npt.NDArray[np.int64]
FIELDS = ("a", "b", "own")


@given(st.data())
def test_group_by_agrees_with_argsort(data: st.DataObject) -> None:
    targets = data.draw(st.integers(1, 8))
    keys = np.array(data.draw(st.lists(st.integers(0, targets - 1), max_size=40)), dtype=int)
    source = Relation("source", size=keys.size)
    field = source.new_field("key", Relation("target", size=targets), init=keys)
    number = source.new_field("number", int64, init=np.arange(keys.size))
    source.group_by("key")
    assert field.grouping is not None
    assert field.grouping.rows is None
    assert np.array_equal(number.data, np.argsort(keys, kind="stable"))
    assert np.array_equal(field.grouping.offsets, np.searchsorted(np.sort(keys), np.arange(targets + 1)))


class Sequences(RuleBasedStateMachine):
    """Two relations whose rows refer to each other's and to their own, beside arrays in the order of identities."""

    @initialize(size=st.integers(0, 7), others=st.integers(1, 5), seed=st.integers(0, 2**16))
    def make(self, size: int, others: int, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.source, self.target = Relation("source", size=size), Relation("target", size=others)
        self.source.new_field("number", int64, init=np.arange(size))
        self.target.new_field("number", int64, init=np.arange(others))
        self.model: dict[str, Ints] = {}
        for name, to in (("a", self.target), ("b", self.target), ("own", self.source)):
            self.model[name] = self.random.integers(0, max(to.size, 1), size)
            self.source.new_field(name, to, init=self.model[name])
        # Where there is no row to refer to, keys stay unset.
        self.back = self.random.integers(0, max(size, 1), (others, 2))
        self.target.new_field("back", vector(self.source, 2), init=self.back if size else None)
        self.near = self.random.integers(0, others, others)
        self.target.new_field("near", self.target, init=self.near)
        self.up = self.random.integers(0, max(size, 1), others)
        self.target.new_field("up", self.source, init=self.up if size else None)
        self.some = np.flatnonzero(self.random.random(size) < 0.5)
        self.source.new_subset("some", self.some)

    @rule(name=st.sampled_from(FIELDS))
    def group_source(self, name: str) -> None:
        self.source.group_by(name)

    @rule(name=st.sampled_from(("near", "up")))
    def group_target(self, name: str) -> None:
        self.target.group_by(name)

    @rule(name=st.sampled_from(FIELDS))
    def load(self, name: str) -> None:
        keys = self.random.permutation(self.model[name])
        self.source.fields[name].load(keys)
        self.model[name] = keys

    @rule()
    def write(self) -> None:
        """As a kernel does: positions, in storage order."""
        field = self.source.fields["own"]
        rows = np.arange(self.source.size)[::-1]
        field.data[...] = rows
        field.changed()
        ids = self.source.storage.identities_of(np.arange(self.source.size))
        self.model["own"][ids] = ids[rows]

    @rule()
    def swap(self) -> None:
        self.source.swap("a", "b")
        self.model["a"], self.model["b"] = self.model["b"], self.model["a"]

    @rule()
    def copy(self) -> None:
        self.source.copy("a", "b")
        self.model["b"] = self.model["a"].copy()

    @rule()
    def permute_source(self) -> None:
        self.source.permute(self.random.permutation(self.source.size))

    @rule()
    def permute_target(self) -> None:
        self.target.permute(self.random.permutation(self.target.size))

    @invariant()
    def dumps_are_those_of_the_model(self) -> None:
        for name, keys in self.model.items():
            assert np.array_equal(self.source.fields[name], keys)
        assert np.array_equal(self.source.fields["number"], np.arange(self.source.size))
        assert np.array_equal(self.target.fields["near"], self.near)
        if self.source.size:
            assert np.array_equal(self.target.fields["back"], self.back)
            assert np.array_equal(self.target.fields["up"], self.up)

    @invariant()
    def stored_keys_are_the_places_of_their_rows(self) -> None:
        number = self.source.fields["number"].data
        for name, to in (("a", self.target), ("b", self.target), ("own", self.source)):
            found = to.fields["number"].data[self.source.fields[name].data]
            assert np.array_equal(found, self.model[name][number])

    @invariant()
    def the_subset_has_its_rows(self) -> None:
        positions = self.source.attribute("some").row_positions()
        assert np.array_equal(np.sort(self.source.fields["number"].data[positions]), self.some)
        assert np.array_equal(positions, np.sort(positions))

    @invariant()
    def every_index_is_valid_once_all_are_refreshed(self) -> None:
        fields = [*self.source.fields.values(), *self.target.fields.values()]
        grouped = [field for field in fields if field.grouping is not None]
        for field in grouped:
            field.grouping.refresh()
        for field in grouped:
            index, keys = field.grouping, field.data
            assert not index.stale
            rows = np.arange(keys.size) if index.rows is None else index.rows
            assert index.rows is None or not index.orders_storage
            ids = field.relation.storage.identities_of(rows)
            for position in range(index.target.size):
                group = slice(index.offsets[position], index.offsets[position + 1])
                assert (keys[rows[group]] == position).all()
                assert (np.diff(ids[group]) > 0).all()
            assert index.offsets[-1] == keys.size


TestSequences = Sequences.TestCase
TestSequences.settings = settings(max_examples=150, stateful_step_count=25, deadline=None)
