"""Rows of a list run in strips where they follow one another: the same rows and values, whatever the list is like."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.runtime.buffer import Array

ROWS, OTHERS = 20_000, 500


def _masks() -> dict[str, Array]:
    draw = np.random.default_rng(1).random
    return {
        "runs": np.repeat(draw(ROWS // 40) < 0.4, 40),
        "short runs": draw(ROWS) < 0.5,
        "sparse": draw(ROWS) < 0.05,
        "both": np.concatenate([draw(ROWS // 2) < 0.3, np.repeat(draw(ROWS // 200) < 0.7, 100)]),
        "the last": np.arange(ROWS) > ROWS - 4,
        "all but some": np.arange(ROWS) % 100 > 3,
    }


@ebb.kernel
def _change(x):
    y = ebb.sqrt(x.a) + ebb.dot(x.key.w, x.key.w)
    if x.a > 0.5:
        x.scalar = y
    x.vector = y * x.key.w
    x.vector[1] = x.a
    x.matrix = ebb.outer(x.vector, x.key.w)
    x.whole = x.whole + 2
    total.value += y


total = ebb.Global(ebb.float64, 0.0)
CHANGED = ("scalar", "vector", "matrix", "whole")


def _rows() -> ebb.Relation:
    draw = np.random.default_rng(2)
    others, rows = ebb.Relation("others", size=OTHERS), ebb.Relation("rows", size=ROWS)
    others.new_field("w", ebb.vec3d).load(draw.random((OTHERS, 3)))
    rows.new_field("key", others).load(draw.integers(0, OTHERS, ROWS))
    rows.new_field("a", ebb.float64).load(draw.random(ROWS))
    for name, kind in zip(CHANGED, (ebb.float64, ebb.vec3d, ebb.mat3d, ebb.int32), strict=True):
        rows.new_field(name, kind).fill(0)
    return rows


def _changed(mask: Array, threads: int) -> dict[str, Array]:
    with ebb.backend("cpu", threads=threads):
        rows = _rows()
        total.value = 0.0
        _change(rows.new_subset("some", mask))
        return {name: rows.fields[name].to_numpy() for name in CHANGED} | {"total": np.array(total.value)}


@pytest.mark.parametrize("name", _masks())
def test_lists_change_their_rows_and_no_others(name: str) -> None:
    mask = _masks()[name]
    found = _changed(mask, 1)
    rows = _rows()
    a = rows.fields["a"].to_numpy()
    draw = np.random.default_rng(2)  # as in _rows
    other = draw.random((OTHERS, 3))[draw.integers(0, OTHERS, ROWS)]
    y = np.sqrt(a) + (other * other).sum(axis=1)
    vector = y[:, None] * other
    vector[:, 1] = a
    expected = {
        "scalar": np.where(a > 0.5, y, 0),
        "vector": vector,
        "matrix": vector[:, :, None] * other[:, None, :],
        "whole": np.full(ROWS, 2),
    }
    for field, values in expected.items():
        assert np.allclose(found[field][mask], values[mask], rtol=1e-14, atol=0)
        assert not found[field][~mask].any()
    assert np.isclose(found["total"], y[mask].sum(), rtol=1e-12)


@pytest.mark.parametrize("name", _masks())
def test_any_number_of_threads_gives_the_same_bits(name: str) -> None:
    mask = _masks()[name]
    alone, together = _changed(mask, 1), _changed(mask, 2)
    for field, values in alone.items():
        assert np.array_equal(values, together[field]), field


@ebb.kernel
def _checked(x):
    assert x.a >= 0, "a is negative"
    x.scalar = ebb.sqrt(x.a)


def test_rows_beside_a_run_fail_nothing() -> None:
    """Lanes behind the end of a run compute what their rows hold, but neither fail nor store."""
    rows = _rows()
    a = rows.fields["a"].to_numpy().copy()
    mask = np.repeat(np.arange(ROWS // 20) % 2 == 0, 20)
    a[~mask] = -1
    rows.fields["a"].load(a)
    _checked(rows.new_subset("some", mask))
    assert not rows.fields["scalar"].to_numpy()[~mask].any()
    a[4 * 20 + 13] = -2
    rows.fields["a"].load(a)
    with pytest.raises(ebb.KernelAssertionError, match=str(4 * 20 + 13)):
        _checked(rows.new_subset("again", mask))


@ebb.kernel
def _sided(x):
    y = 1.0
    if x.a > 0.9:
        y = ebb.sqrt(x.a)
        if x.a > 0.95:
            y = 1 / y
    if x.a < 0.1:
        y += 1 / x.key.w[0]
    x.scalar = y


@pytest.mark.parametrize("name", _masks())
def test_sides_of_conditions_may_be_taken_for_rows_beside_a_run(name: str) -> None:
    """A side that only calculates is left out where no lane takes it, also none that is not to be done."""
    mask, rows = _masks()[name], _rows()
    a, others = rows.fields["a"].to_numpy(), rows.fields["key"].target.fields["w"].to_numpy()
    _sided(rows.new_subset("some", mask))
    root = np.sqrt(a)
    expected = np.where(a > 0.9, np.where(a > 0.95, 1 / root, root), 1.0)
    expected += np.where(a < 0.1, 1 / others[rows.fields["key"].to_numpy(), 0], 0.0)
    assert np.allclose(rows.fields["scalar"].to_numpy(), np.where(mask, expected, 0.0), rtol=1e-15, atol=0)
