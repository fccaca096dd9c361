from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from ebb.types import builtins
from ebb.types.arithmetic import BINARY, convert, identity_of, power
from ebb.types.builtins import BUILTINS, StaticValue, from_python
from ebb.types.rules import reduce_mismatch
from ebb.types.signatures import Complaint, Signature
from ebb.types.types import (
    SCALARS,
    bool_,
    float32,
    float64,
    int32,
    int64,
    matrix,
    shaped_type,
    uint32,
    vector,
)

SHAPES = ((), (1,), (2,), (3,), (2, 2), (3, 3), (4, 4), (2, 3))
TYPES = tuple(shaped_type(scalar, shape) for scalar in SCALARS for shape in SHAPES)
CALLED = tuple(row for row in BUILTINS.values() if row.static is None)


def sample(type):
    rng = np.random.default_rng(1)
    return convert(rng.integers(0, 5, type.shape) / 2, type)


@pytest.mark.parametrize("row", CALLED, ids=lambda row: row.name)
def test_meaning_has_the_signature_s_type(row):
    """Whatever a signature accepts, the meaning gives the dtype and shape that it promises."""
    accepted = 0
    few = [t for t in TYPES if t.shape in ((), (3,), (2, 2))]
    for types in product(TYPES if row.fewest == 1 else few, repeat=row.fewest):
        signature = row.signature(types)
        if isinstance(signature, Complaint):
            assert signature.text
            continue
        accepted += 1
        assert isinstance(signature, Signature) and len(signature.arguments) == len(types)
        with np.errstate(all="ignore"):
            result = row.meaning(*(sample(argument) for argument in signature.arguments))
        assert np.shape(result) == signature.result.shape, (types, result)
        assert np.asarray(result).dtype == signature.result.dtype, (types, result)
    assert accepted


@pytest.mark.parametrize("row", CALLED, ids=lambda row: row.name)
def test_signatures_accept_their_own_arguments(row):
    """Converted arguments are of a type that needs no second conversion."""
    for types in product((int32, float32, bool_, vector(int32, 3), matrix(float32, 3, 3)), repeat=row.fewest):
        signature = row.signature(types)
        if isinstance(signature, Signature):
            assert row.signature(signature.arguments) == signature


@pytest.mark.parametrize("row", CALLED, ids=lambda row: row.name)
def test_a_wrong_number_of_arguments_is_a_complaint(row):
    assert "argument" in row.signature(()).text
    if row.most is not None:
        assert f"not {row.most + 1}" in row.signature((float32,) * (row.most + 1)).text


def test_every_row_has_a_sentence():
    assert all(row.doc.endswith(".") and len(row.doc) > 8 for row in BUILTINS.values())


def test_real_functions_keep_float32_and_widen_integers():
    for name in ("sqrt", "sin", "log", "atan2", "pow", "fmod", "floor"):
        row = BUILTINS[name]
        assert row.signature((float32,) * row.fewest).result == float32
        assert row.signature((int32,) * row.fewest).result == float64
        assert row.signature((vector(float32, 3),) * row.fewest).result == vector(float32, 3)


def test_conformance_values():
    a, b = np.array([1, 2, 3], np.int32), np.array([-3, 1, 0], np.int32)
    assert builtins.cross([3, 1, -1], [1, 0, 0]).tolist() == [0, -1, -1]
    assert builtins.cross(a, b).tolist() == [-3, -9, 7]
    assert builtins.dot(a, b) == -1 and builtins.dot(a, b).dtype == np.int32
    assert builtins.length(np.array([3, 4], np.int32)) == 5.0
    assert builtins.length(np.array([3, 4], np.int32)).dtype == np.float64
    assert builtins.outer([1, 2], [3, 4, 5]).tolist() == [[3, 4, 5], [6, 8, 10]]
    assert builtins.trace([[1, 2], [3, 4]]) == 5
    assert builtins.transpose([[1, 2, 3], [4, 5, 6]]).tolist() == [[1, 4], [2, 5], [3, 6]]
    assert builtins.sign(np.float32(-2)) == -1 and np.isnan(builtins.sign(np.nan))
    assert builtins.clamp(np.float32(7), 0, 1) == 1 and builtins.clamp(np.float32(7), 0, 1).dtype == np.float32
    assert builtins.fmod(-7, 3) == -1 and builtins.hypot(3, 4) == 5
    assert builtins.select([True, False], [1.0, 2.0], 0).tolist() == [1, 0]
    assert builtins.all_([True, False]) == False and builtins.any_([True, False]) == True  # noqa: E712
    assert builtins.min_(3, 1, 2) == 1 and np.isnan(builtins.max_(1.0, np.nan))


def test_normalize_of_zero_is_zero():
    v = np.array([3, 0, 4], np.float32)
    assert builtins.normalize(v).tolist() == pytest.approx([0.6, 0, 0.8])
    assert builtins.normalize(v).dtype == np.float32
    assert builtins.normalize(0 * v).tolist() == [0, 0, 0]


@pytest.mark.parametrize("n", [1, 2, 3, 4])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_determinant_and_inverse_against_numpy(n, dtype):
    rng = np.random.default_rng(n)
    for _ in range(20):
        m = rng.normal(size=(n, n)).astype(dtype)
        tolerance = 1e-3 if dtype == np.float32 else 1e-9
        assert builtins.det(m) == pytest.approx(np.linalg.det(m.astype(float)), rel=tolerance, abs=tolerance)
        assert builtins.inverse(m) @ m == pytest.approx(np.eye(n), abs=tolerance * float(np.linalg.cond(m)))
        assert builtins.inverse(m).dtype == builtins.det(m).dtype == dtype


def test_a_singular_inverse_is_not_finite():
    assert not np.any(np.isfinite(builtins.inverse(np.ones((2, 2)))))


def test_matmul_of_all_shapes():
    rng = np.random.default_rng(0)
    for left, right in (((3,), (3,)), ((2, 3), (3,)), ((2,), (2, 3)), ((2, 3), (3, 4))):
        a, b = rng.normal(size=left), rng.normal(size=right)
        assert builtins.matmul(a, b) == pytest.approx(a @ b)


def test_rounding_to_integers_is_python_s():
    for x in (-2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 2.7, -2.7):
        assert builtins.round_(x) == round(x) and builtins.round_(x).dtype == np.int64
        assert builtins.math_floor(x) == math.floor(x)
        assert builtins.math_ceil(x) == math.ceil(x)
        assert builtins.math_trunc(x) == math.trunc(x)
        assert builtins.floor(x) == math.floor(x) and builtins.floor(x).dtype == np.float64


@pytest.mark.parametrize(
    ("row", "types", "text"),
    [
        ("length", (vector(bool_, 3),), "bool"),
        ("dot", (vector(float32, 3), vector(float32, 2)), "one length"),
        ("dot", (vector(bool_, 2), vector(bool_, 2)), "bool"),
        ("cross", (vector(float32, 2), vector(float32, 2)), "3 components"),
        ("det", (matrix(float32, 2, 3),), "square"),
        ("inverse", (matrix(float32, 5, 5),), "4 x 4"),
        ("sqrt", (bool_,), "bool"),
        ("clamp", (int32, uint32, uint32), "signed"),
        ("pow", (vector(float32, 2), vector(float32, 3)), "one shape"),
        ("all", (vector(int32, 2),), "bools"),
        ("transpose", (vector(float32, 3),), "matrix"),
        ("select", (int32, float32, float32), "condition"),
        ("min", (float32,), "at least 2 arguments, not 1"),
    ],
)
def test_complaints(row, types, text):
    complaint = BUILTINS[row].signature(types)
    assert isinstance(complaint, Complaint) and text in complaint.text


def test_constants_of_types_and_sizes():
    mat2f = matrix(float32, 2, 2)
    assert builtins.identity.constant((mat2f,)) == StaticValue(((1.0, 0.0), (0.0, 1.0)), mat2f)
    assert builtins.identity.constant((2, float32)) == builtins.identity.constant((mat2f,))
    assert builtins.zeros.constant((vector(int32, 2),)) == StaticValue((0, 0), vector(int32, 2))
    assert builtins.zeros.constant((bool_,)) == StaticValue(False, bool_)
    assert builtins.zeros.constant(((1, 2),)) == StaticValue(((0.0, 0.0),), matrix(float64, 1, 2))
    assert builtins.identity(3).tolist() == np.eye(3).tolist()
    for wrong in ((matrix(float32, 2, 3),), (0,), (2.5,), (2, 3), (), (vector(float32, 2),)):
        assert isinstance(builtins.identity.constant(wrong), Complaint)
    for wrong in (((1, 2, 3),), ("x",), (-1,)):
        assert isinstance(builtins.zeros.constant(wrong), Complaint)


def test_python_s_functions_have_rows():
    assert from_python(math.sqrt) is builtins.sqrt and from_python(abs) is builtins.abs_
    assert from_python(math.floor) is builtins.math_floor and from_python(round) is builtins.round_
    assert from_python(print) is None and from_python([]) is None


def test_host_calls_complain_as_kernels_do():
    with pytest.raises(TypeError, match=r"length\(\) takes a vector"):
        builtins.length(2.0)
    with pytest.raises(TypeError, match="expected a number"):
        builtins.sqrt("x")
    with pytest.raises(TypeError, match="kernels only"):
        builtins.rand(float32)


@pytest.mark.parametrize("target", [int32, int64, uint32])
def test_floats_to_integers_truncate_and_saturate(target):
    info = np.iinfo(target.dtype)
    cases = {2.9: 2, np.nan: 0, np.inf: info.max, -np.inf: info.min, 1e30: info.max, -1e30: info.min, -0.5: 0}
    for source in (float32, float64):
        for value, expected in cases.items():
            converted = convert(source(value), target)
            assert converted == expected and converted.dtype == target.dtype
        everything = convert(np.array(list(cases), source.dtype), vector(target, len(cases)))
        assert everything.tolist() == list(cases.values())


def test_conversions_of_integers_and_bools():
    assert convert(np.int64(2**32 + 5), int32) == 5
    assert convert(np.int32(-1), uint32) == 2**32 - 1
    assert convert(np.float32(np.nan), bool_) == True and convert(np.int32(0), bool_) == False  # noqa: E712
    assert convert(np.bool_(True), float32).dtype == np.float32
    assert convert(np.float32(2), vector(float64, 2)).tolist() == [2, 2]


def test_integer_powers_and_shifts():
    i = np.int32
    assert [int(power(i(b), i(-1))) for b in (2, 1, -1, 0, -3)] == [0, 1, -1, 0, 0]
    assert power(i(-1), i(-2)) == 1 and power(i(3), i(4)) == 81 and power(i(3), i(4)).dtype == np.int32
    assert power(np.array([2, 1], i), np.array([-1, -1], i)).tolist() == [0, 1]
    with np.errstate(all="ignore"):
        assert [int(BINARY["<<"](i(1), i(n))) for n in (31, 32, -1)] == [-(2**31), 0, 0]
        assert [int(BINARY[">>"](i(-5), i(n))) for n in (1, 32, -1)] == [-3, -1, -1]


REDUCTIONS = tuple(
    (op, scalar)
    for op, scalar in product(("+", "*", "min", "max", "&", "|", "^"), SCALARS)
    if reduce_mismatch(op, scalar, scalar) is None
)


@pytest.mark.parametrize(("op", "scalar"), REDUCTIONS)
def test_identities_change_nothing(op, scalar):
    identity = identity_of(op, scalar.dtype)
    assert identity.dtype == scalar.dtype
    for value in (0, 1, 7):
        assert BINARY[op](identity, scalar(value)) == scalar(value)
