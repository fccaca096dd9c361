"""Globals and constants on the host."""

from __future__ import annotations

import numpy as np
import pytest

import ebb
from ebb.errors import RelationError
from ebb.relations.globals import Constant, Global, constant
from ebb.relations.relation import Relation
from ebb.types.aliases import mat2d, vec3d, vec3f
from ebb.types.types import SCALARS, bool_, float32, float64, int32, key, vector


@pytest.mark.parametrize("scalar", SCALARS, ids=repr)
def test_scalars_read_as_python_numbers(scalar) -> None:
    value = Global(scalar, scalar(1)).value
    assert type(value) in (bool, int, float)
    assert value == 1


def test_the_value_is_set_in_place() -> None:
    energy = Global(float64, 0.0)
    address = energy.data.ctypes.data
    energy.value = 3
    assert energy.value == 3.0
    assert isinstance(energy.value, float)
    assert energy.data.ctypes.data == address
    assert energy.data.shape == ()


def test_vectors_and_matrices() -> None:
    momentum = Global(vec3d, 0)
    assert momentum.value.tolist() == [0, 0, 0]
    momentum.value = [1, 2, 3]
    copied = momentum.value
    copied[0] = 9
    assert momentum.value.tolist() == [1, 2, 3]
    assert Global(mat2d, [[1, 2], [3, 4]]).value.shape == (2, 2)
    momentum.value = momentum
    momentum.value += 1
    assert np.asarray(momentum).tolist() == [2, 3, 4]


@pytest.mark.parametrize(
    ("type_", "value", "code"),
    [(int32, 1.5, "E507"), (int32, 2**31, "E508"), (bool_, 1, "E507"), (float64, True, "E507"), (vec3d, [1, 2], "E506"),
     (float64, [1.0], "E506"), (float64, "1", "E507"), (float32, 1e39, "E508"), (vec3d, [[1, 2, 3]], "E506")],
)  # fmt: skip
def test_what_does_not_fit_changes_nothing(type_, value: object, code: str) -> None:
    kept = Global(type_, type_.scalar(1))
    with pytest.raises(RelationError) as caught:
        kept.value = value
    assert caught.value.codes == (code,)
    assert np.all(kept.value == np.ones(type_.shape))
    with pytest.raises(RelationError):
        Global(type_, value)
    with pytest.raises(RelationError):
        constant(value, type_)


def test_globals_of_keys() -> None:
    rows = Relation("rows", size=2)
    for type_ in (rows, key(rows), vector(rows, 2)):
        for make in (lambda t: Global(t, 0), lambda t: constant(0, t)):
            with pytest.raises(RelationError) as caught:
                make(type_)
            assert caught.value.codes == ("E517",)
    with pytest.raises(TypeError):
        Global(float, 0)


def test_constants() -> None:
    assert constant(1, float64) == Constant(1.0, float64)
    assert isinstance(constant(1, float64).value, float)
    assert constant(0.1, float32).value == float(np.float32(0.1))
    assert constant(2, vec3f) == Constant((2.0, 2.0, 2.0), vec3f)
    assert constant([[1, 2], [3, 4]], mat2d).value == ((1.0, 2.0), (3.0, 4.0))
    assert hash(constant(2, vec3f)) == hash(constant([2, 2, 2], vec3f))
    assert constant(True, bool_).value is True


def test_repr() -> None:
    assert repr(Global(vec3d, 1)) == "Global(vector(float64, 3), [1.0, 1.0, 1.0])"
    assert repr(constant(1, float32)) == "constant(1.0, float32)"


def test_a_sum_of_what_a_function_computes_does_not_read_the_global():
    rows = ebb.Relation("rows", size=3)
    rows.new_field("x", float64, init=2.0)
    total = Global(float64, 1.0)

    @ebb.func
    def square(value):
        result = value * value
        return result

    @ebb.kernel
    def add(r: rows):
        if r.x > 0:
            total.value += square(r.x)
        total.value -= square(r.x)
        total.value += 1

    add(rows)
    assert total.value == 4.0
