from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from ebb.types.rules import (
    Mismatch,
    OperatorTypes,
    Reason,
    binary_type,
    castable,
    common_element,
    compare_type,
    condition_mismatch,
    fits,
    lone_type,
    reduce_mismatch,
    unary_type,
    weak_element,
    widens,
)
from ebb.types.types import (
    SCALARS,
    KeyType,
    Kind,
    bool_,
    float32,
    float64,
    int32,
    int64,
    key,
    matrix,
    uint32,
    uint64,
    vector,
)


class Rows:
    """What key types need to know of a relation."""

    key_dtype = np.dtype(np.int32)

    def __init__(self, name):
        self.name = name

    def __ebb_type__(self):
        return KeyType(self)


VERTICES, EDGES = Rows("vertices"), Rows("edges")
vec3f, vec3d, vec3i, vec2f = vector(float32, 3), vector(float64, 3), vector(int32, 3), vector(float32, 2)


def result(op, left, right):
    types = binary_type(op, left, right)
    assert isinstance(types, OperatorTypes), types
    return types.result


def reason(mismatch):
    assert isinstance(mismatch, Mismatch), mismatch
    assert mismatch.text and "None" not in mismatch.text
    return mismatch.reason


@pytest.mark.parametrize(
    ("source", "target"),
    [(int32, int64), (uint32, uint64), (int64, float32), (uint64, float64), (float32, float64), (vec3i, vec3d)],
)
def test_what_widens_goes_one_way(source, target):
    assert widens(source, target) and not widens(target, source)
    a, b = source.scalar, target.scalar
    assert common_element(a, b) == common_element(b, a) == b


@pytest.mark.parametrize(
    ("a", "b"), [(bool_, int32), (int32, uint32), (int64, uint32), (vec3f, vec2f), (float32, vec3f)]
)
def test_what_widens_neither_way(a, b):
    assert a.shape != b.shape or common_element(a.scalar, b.scalar) is None
    assert not widens(a, b) and not widens(b, a)


def test_widening_is_an_order():
    for a, b, c in product(SCALARS, repeat=3):
        assert widens(a, a)
        if widens(a, b) and widens(b, c):
            assert widens(a, c)
        if a != b:
            assert not (widens(a, b) and widens(b, a))


def test_integers_take_the_width_of_the_float():
    assert result("*", int64, float32) == float32
    assert result("+", float32, float64) == float64
    assert result("+", int32, int64) == int64


def test_true_division_gives_floats():
    assert result("/", int32, int32) == float64
    assert result("/", int32, float32) == float32
    assert result("//", int32, int32) == int32
    assert result("**", int32, int64) == int64


def test_scalars_broadcast_and_shapes_must_agree():
    types = binary_type("+", vec3i, float64)
    assert types == OperatorTypes(vec3d, vec3d, vec3d)
    assert result("*", float32, matrix(float32, 2, 3)) == matrix(float32, 2, 3)
    assert reason(binary_type("+", vec3f, vec2f)) is Reason.SHAPES
    assert reason(binary_type("+", vec3f, matrix(float32, 3, 3))) is Reason.SHAPES


def test_operators_that_do_not_take_their_operands():
    assert reason(binary_type("+", bool_, int32)) is Reason.BOOLS
    assert reason(binary_type("-", int32, uint32)) is Reason.SIGNS
    assert reason(binary_type("+", key(VERTICES), int32)) is Reason.KEYS
    assert reason(binary_type("&", float32, int32)) is Reason.BITS
    assert reason(binary_type("&", bool_, int32)) is Reason.BITS
    assert reason(binary_type("<<", float32, int32)) is Reason.INTEGERS
    assert reason(binary_type("min", bool_, bool_)) is Reason.BOOLS


def test_bits_and_shifts():
    assert result("&", bool_, bool_) == bool_
    assert result("^", vector(int32, 2), int64) == vector(int64, 2)
    assert result("<<", uint32, uint64) == uint64


def test_matrix_products():
    a, b = matrix(float32, 3, 4), matrix(float64, 4, 3)
    assert binary_type("@", a, b) == OperatorTypes(matrix(float64, 3, 4), b, matrix(float64, 3, 3))
    assert result("@", a, vector(int32, 4)) == vec3f
    assert result("@", vec3f, a) == vector(float32, 4)
    assert result("@", vec3f, vec3i) == float32
    assert reason(binary_type("@", a, vec3f)) is Reason.PRODUCT
    assert reason(binary_type("@", a, float32)) is Reason.SHAPES
    assert reason(binary_type("@", vector(bool_, 3), vec3f)) is Reason.BOOLS


def test_comparisons():
    assert compare_type("<", int32, float32) == OperatorTypes(float32, float32, bool_)
    assert compare_type("==", vec3f, float64) == OperatorTypes(vec3d, vec3d, vector(bool_, 3))
    assert compare_type("!=", bool_, bool_) == OperatorTypes(bool_, bool_, bool_)
    assert reason(compare_type("<", int32, bool_)) is Reason.BOOLS
    assert reason(compare_type("<", bool_, bool_)) is Reason.ORDER
    assert reason(compare_type("<", int32, uint32)) is Reason.SIGNS
    assert reason(compare_type("==", vec3f, vec2f)) is Reason.SHAPES


def test_keys_compare_within_one_relation():
    vertex, edge = key(VERTICES), key(EDGES)
    assert compare_type("==", vertex, vertex) == OperatorTypes(vertex, vertex, bool_)
    assert reason(compare_type("==", vertex, edge)) is Reason.RELATIONS
    assert reason(compare_type("<", vertex, vertex)) is Reason.ORDER
    assert reason(compare_type("==", vertex, int32)) is Reason.KEYS


def test_unary_operators():
    assert unary_type("-", vec3f) == vec3f and unary_type("~", uint32) == uint32 and unary_type("not", bool_) == bool_
    assert reason(unary_type("-", bool_)) is Reason.BOOLS
    assert reason(unary_type("~", float32)) is Reason.INTEGERS
    assert reason(unary_type("not", int32)) is Reason.CONDITION
    assert reason(unary_type("-", key(VERTICES))) is Reason.KEYS


def test_conditions_are_one_bool():
    assert condition_mismatch("if", bool_) is None
    assert reason(condition_mismatch("if", vector(bool_, 2))) is Reason.CONDITION
    assert reason(condition_mismatch("assert", int32)) is Reason.CONDITION


def test_reductions():
    assert reduce_mismatch("+", vec3f, vec3f) is None
    assert reduce_mismatch("|", bool_, bool_) is None
    assert reason(reduce_mismatch("+", bool_, bool_)) is Reason.BOOLS
    assert reason(reduce_mismatch("&", float32, float32)) is Reason.BITS
    assert reason(reduce_mismatch("+", key(VERTICES), int32)) is Reason.KEYS


def test_casts_keep_the_shape_or_start_from_a_scalar():
    assert castable(float64, int32) and castable(bool_, float32) and castable(vec3d, vec3f) and castable(float64, vec3f)
    assert not castable(vec3f, vec2f) and not castable(vec3f, float32) and not castable(int32, key(VERTICES))


@pytest.mark.parametrize(
    ("number", "beside", "taken"),
    [
        (2, float32, float32), (2, uint64, uint64), (0.5, float32, float32), (0.5, int32, float64),
        (True, bool_, bool_), (1, bool_, None), (True, int32, None), (1, key(VERTICES), None),
    ],
)  # fmt: skip
def test_python_numbers_are_weak(number, beside, taken):
    assert weak_element(number, beside) == taken


def test_python_numbers_alone():
    assert (
        lone_type(1) == int32 and lone_type(2**31) == int64 and lone_type(1.0) == float64 and lone_type(True) == bool_
    )


@pytest.mark.parametrize("scalar", [s for s in SCALARS if s.kind in (Kind.SIGNED, Kind.UNSIGNED)])
def test_ranges_of_integers(scalar):
    info = np.iinfo(scalar.dtype)
    assert fits(info.min, scalar) and fits(info.max, scalar)
    assert not fits(int(info.min) - 1, scalar) and not fits(int(info.max) + 1, scalar)
