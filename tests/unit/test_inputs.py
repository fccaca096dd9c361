"""What a repeated launch takes of the host: as the long way says, or nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ebb
from ebb.launch import Launch

RANGE = {ebb.int32: 2**31, ebb.int64: 2**63}


@pytest.fixture
def rows():
    relation = ebb.Relation("rows", size=1)
    for name, type in {"f": ebb.float32, "d": ebb.float64, "i": ebb.int32, "l": ebb.int64, "b": ebb.bool_}.items():
        relation.new_field(name, type)
    return relation


def launch_of(kernel, rows) -> Launch:
    (launch,) = rows.storage.compiled[kernel].launches[rows]
    return launch


def taken(kernel, rows, *parameters):
    """What the short way takes, of a kernel that was launched once."""
    return launch_of(kernel, rows).take(parameters)


def test_a_captured_number_of_the_module_and_of_a_function(rows):
    outer = 0.5

    @ebb.kernel
    def scale(r: rows):
        r.f = ebb.float32(r.f * outer + PI)

    scale(rows)
    assert taken(scale, rows) == [0.5, math.pi]
    outer = 1e300
    assert taken(scale, rows) == [1e300, math.pi]
    scale(rows)
    outer = 3
    assert taken(scale, rows) is None


PI = math.pi


@pytest.mark.parametrize("value", [0.5, 3, np.float32(0.1), np.float64(0.1), 10**6, True, np.int32(3), "x", None])
def test_a_declared_float(rows, value):
    @ebb.kernel
    def give(r: rows, x: ebb.float32):
        r.f = x

    give(rows, 0.0)
    short = taken(give, rows, value)
    if isinstance(value, bool | str) or value is None:
        assert short is None
        with pytest.raises(ebb.KernelTypeError):
            give(rows, value)
    else:
        assert short is None or short == [value]
        give(rows, value)
        assert rows.f.to_numpy()[0] == np.float32(value)


@pytest.mark.parametrize("type", [ebb.int32, ebb.int64])
def test_a_declared_integer(rows, type):
    @ebb.kernel
    def give(r: rows, x: type):
        r.l = x

    give(rows, 0)
    end = RANGE[type]
    for value in (-end, 5, end - 1):
        assert taken(give, rows, value) == [value]
        give(rows, value)
        assert rows.l.to_numpy()[0] == value
    for value in (-end - 1, end, 0.5, True):
        assert taken(give, rows, value) is None
        with pytest.raises(ebb.KernelTypeError):
            give(rows, value)


def test_bare_parameters_are_typed_by_their_argument(rows):
    @ebb.kernel
    def give(r: rows, x):
        r.d = ebb.float64(x)

    for value in (0.5, 7, True):
        give(rows, value)
        launches = rows.storage.compiled[give].launches[rows]
        assert [launch.take((value,)) for launch in launches][-1] == [value]
        assert [launch.take((value,)) for launch in launches][:-1] == [None] * (len(launches) - 1)
    give(rows, 2**40)
    launches = rows.storage.compiled[give].launches[rows]
    assert [launch.take((7,)) is not None for launch in launches] == [False, True, False, False]
    give(rows, np.float32(0.25))
    assert rows.d.to_numpy()[0] == 0.25


def test_the_wrong_number_of_parameters(rows):
    @ebb.kernel
    def give(r: rows, x, y=2.0):
        r.d = ebb.float64(x + y)

    give(rows, 1.0)
    assert taken(give, rows, 1.0) is None
    assert taken(give, rows, 1.0, 3.0) == [1.0, 3.0]
    give(rows, 1.0)
    assert rows.d.to_numpy()[0] == 3.0
    with pytest.raises(ebb.KernelTypeError):
        give(rows, 1.0, 2.0, 3.0)


def test_names_of_fields(rows):
    @ebb.kernel
    def give(r: rows, name: str):
        r[name] = 1

    give(rows, "i")
    give(rows, "l")
    first, second = rows.storage.compiled[give].launches[rows]
    assert (first.take(("i",)), first.take(("l",)), second.take(("l",))) == ([], None, [])
    assert first.take((1,)) is None


def test_what_is_captured_is_replaced_or_gone(rows):
    other = ebb.Relation("other", size=1)
    other.new_field("f", ebb.float32)
    box = [0.5]

    class Settings:
        gain = 2.0

    @ebb.func
    def double(x):
        return 2 * x

    namespace = {"ebb": ebb, "double": double, "Settings": Settings, "box": box, "g": ebb.Global(ebb.float32, 1.0)}
    source = "def give(r, s):\n    r.f = double(ebb.float32(Settings.gain * box[0] + s)) + g"
    exec(source, namespace)
    give = ebb.kernel(source=source)(namespace["give"])
    give(rows, 1.0)
    assert taken(give, rows, 1.0) is not None
    Settings.gain = 3.0
    give(rows, 1.0)
    assert rows.f.to_numpy()[0] == 2 * (3.0 * 0.5 + 1.0) + 1
    box[0] = 1
    assert taken(give, rows, 1.0) is None
    box[0] = 0.5
    namespace["g"] = ebb.Global(ebb.float32, 5.0)
    assert taken(give, rows, 1.0) is None
    give(rows, 1.0)
    assert rows.f.to_numpy()[0] == 2 * (3.0 * 0.5 + 1.0) + 5
    del namespace["box"]
    assert [launch.take((1.0,)) for launch in rows.storage.compiled[give].launches[rows]] == [None, None]
    with pytest.raises(ebb.KernelTypeError):
        give(rows, 1.0)


def test_arrays_are_taken_as_they_are(rows):
    rows.new_field("v", ebb.vec3d)
    direction = np.array([1.0, 2.0, 3.0])

    @ebb.kernel
    def give(r: rows):
        r.v = direction

    give(rows)
    (value,) = taken(give, rows)
    assert value.tolist() == [1.0, 2.0, 3.0]
    direction = np.zeros(2)
    assert taken(give, rows) is None
