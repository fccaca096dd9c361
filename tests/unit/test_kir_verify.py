from __future__ import annotations

import pytest
from kir_forms import (
    BREAK,
    CONTINUE,
    HERE,
    OnRows,
    affine,
    assign,
    binary,
    compare,
    component,
    const,
    for_query,
    for_range,
    get,
    i32,
    local,
    loop,
    random,
    read,
    reduce,
    reduce_global,
    row_id,
    uniform,
    when,
    write,
)

from ebb.compiler import kir
from ebb.compiler.kir_verify import CompilerBug, verify_kernel
from ebb.errors import EbbError
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import bool_, float32, float64, int32, int64, vector

VERTICES, EDGES, CELLS = Relation("vertices", size=2), Relation("edges", size=2), Relation("cells", shape=(2, 2))
VERTICES.new_field("a", float32)
VERTICES.new_field("p", vector(float32, 3))
VERTICES.new_field("flag", bool_)
EDGES.new_field("tail", VERTICES)
E = Global(float64, 0)
ON = OnRows(VERTICES)
V = ON.row
A, P = read(VERTICES.a, V), read(VERTICES.p, V)
X, N = local("x", float32), local("n", int32)
YES = const(True, bool_)
LABEL = kir.Label("return", 800)
ONE = const(1.0, float32)


def binary_of(op, left, right, type):
    return kir.Binary(op, left, right, type, HERE)


WRONG = {
    "value of another type": (write(VERTICES.a, V, i32(1)), "expected a float32, found a int32"),
    "key of another relation": (write(EDGES.tail, V, V), "expected a key(edges), found a key(vertices)"),
    "field read with a wrong type": (assign(X, kir.ReadField(VERTICES.p, V, float32, HERE)), "it has the type vector"),
    "operands of two types": (assign(X, binary_of("+", ONE, i32(1), float32)), "expected a float32"),
    "division of integers": (assign(N, binary_of("/", i32(1), i32(2), int32)), "no operator /"),
    "unknown operator": (assign(N, binary_of("@", i32(1), i32(2), int32)), "no operator @"),
    "sum of bools": (when(binary_of("+", YES, YES, bool_)), "no operator +"),
    "not of a number": (assign(N, kir.Unary("not", i32(1), int32, HERE)), "no operator not"),
    "order of keys": (when(compare("<", V, V)), "no order"),
    "condition that is no bool": (when(i32(1)), "expected a bool_"),
    "and of numbers": (when(kir.Logic("and", i32(1), YES, bool_, HERE)), "expected a bool_"),
    "choice of two types": (assign(X, kir.Choose(YES, ONE, i32(1), float32, HERE)), "expected a float32"),
    "cast to another shape": (assign(X, kir.Cast(P, float32, HERE)), "a cast keeps the shape"),
    "cast of a key": (assign(N, kir.Cast(V, int32, HERE)), "keys are not cast"),
    "splat to a scalar": (assign(X, kir.Splat(ONE, float32, HERE)), "a splat is of a vector"),
    "too few elements": (write(VERTICES.p, V, kir.Build((ONE,), vector(float32, 3), HERE)), "1 elements for"),
    "constant index out of range": (assign(X, component(P, i32(3))), "is not in range(3)"),
    "negative constant index": (write(VERTICES.p, V, ONE, i32(-1)), "is not in range(3)"),
    "index that is a float": (assign(X, component(P, ONE)), "an index is a float32"),
    "too many indices": (assign(X, kir.Component(P, (i32(0), i32(0)), float32, HERE)), "2 indices into"),
    "unknown builtin": (assign(X, kir.Call("sqroot", (ONE,), float32, HERE)), "no builtin 'sqroot'"),
    "builtin of constants": (assign(X, kir.Call("zeros", (), float32, HERE)), "no builtin 'zeros'"),
    "argument not converted": (assign(X, kir.Call("sqrt", (i32(1),), float64, HERE)), "sqrt takes"),
    "argument that does not fit": (assign(X, kir.Call("sqrt", (YES,), float32, HERE)), "a bool is none"),
    "constant out of its range": (assign(N, const(2**31, int32)), "is no int32"),
    "constant of another shape": (write(VERTICES.p, V, const((1, 2), vector(float32, 3))), "is no vector"),
    "bool constant as a number": (assign(N, const(True, int32)), "is no int32"),
    "missing uniform": (assign(X, uniform(1, float32)), "no uniform 1"),
    "random inside an expression": (assign(X, binary("+", ONE, random("rand", float32))), "whole right side"),
    "random into a field": (write(VERTICES.a, V, random("rand", float32)), "whole right side"),
    "random integer": (assign(N, random("rand", int32)), "a random number is a float"),
    "unknown distribution": (assign(X, random("poisson", float32)), "no distribution"),
    "id of a number": (assign(N, kir.RowId(i32(1), int64, HERE)), "id() is of a key"),
    "affine of no grid": (assign(local("k", V.type), affine(VERTICES, [[1, 0]], V)), "a key of a grid"),
    "query of an ungrouped field": (for_query(local("e", EDGES.key_type), EDGES.tail, V), "is not grouped"),
    "range of floats": (for_range(X, ONE, ONE, ONE), "a range is of integers"),
    "break outside of a loop": (BREAK, "outside of a loop"),
    "continue outside of a loop": (CONTINUE, "outside of a loop"),
    "leave of another block": (kir.Leave(LABEL, HERE), "in which it does not stand"),
    "reduction of bools by +": (reduce(VERTICES.flag, V, "+", YES), "no reduction +"),
    "reduction of floats by &": (reduce_global(E, "&", const(1.0, float64)), "no reduction &"),
    "undeclared variable": (write(VERTICES.a, V, get(X)), "not declared before"),
    "part of an undeclared variable": (assign(local("w", vector(float32, 3)), ONE, i32(0)), "before the whole"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_is_found(wrong):
    stmt, text = WRONG[wrong]
    with pytest.raises(CompilerBug) as caught:
        verify_kernel(ON.kernel(stmt))
    assert text in str(caught.value) and "step_kernel.py:2" in str(caught.value)
    assert not isinstance(caught.value, EbbError)


READ_X = write(VERTICES.a, V, get(X))
SET_X = assign(X, ONE)
ASSIGNED = {
    "in both branches": (when(YES, SET_X, orelse=(SET_X,)), READ_X),
    "in one branch, the other leaves": (
        kir.Block(LABEL, (when(YES, SET_X, orelse=(kir.Leave(LABEL, HERE),)), READ_X), HERE),
    ),
    "before a break out of an endless loop": (loop(YES, SET_X, when(YES, BREAK)), READ_X),
    "on each way out of a block": (
        kir.Block(LABEL, (when(YES, SET_X, kir.Leave(LABEL, HERE)), SET_X), HERE),
        READ_X,
    ),
    "earlier in the turn": (loop(YES, SET_X, READ_X),),
    "in a loop that surely runs": (for_range(N, i32(0), i32(2), i32(1), SET_X), READ_X),
}
UNASSIGNED = {
    "in one branch": (when(YES, SET_X), READ_X),
    "in a loop that runs no turn": (for_range(N, i32(2), i32(2), i32(1), SET_X), READ_X),
    "in a while that may not run": (loop(A_IS_BIG := compare(">", A, ONE), SET_X), READ_X),
    "after a break": (loop(YES, when(A_IS_BIG, BREAK), SET_X), READ_X),
    "on one way out of a block": (kir.Block(LABEL, (when(YES, kir.Leave(LABEL, HERE)), SET_X), HERE), READ_X),
}


@pytest.mark.parametrize("body", ASSIGNED)
def test_assigned_for_sure(body):
    verify_kernel(ON.kernel(*ASSIGNED[body]))


@pytest.mark.parametrize("body", UNASSIGNED)
def test_maybe_unassigned(body):
    with pytest.raises(CompilerBug, match="may have no value"):
        verify_kernel(ON.kernel(*UNASSIGNED[body]))


def test_one_uid_is_one_variable():
    twin = kir.Local("y", X.uid, int32)
    with pytest.raises(CompilerBug, match="two variables have the uid"):
        verify_kernel(ON.kernel(SET_X, assign(twin, i32(1))))


def test_the_row_is_a_key_of_the_relation():
    with pytest.raises(CompilerBug, match="the row is not a key"):
        verify_kernel(kir.Kernel("step", EDGES, ON.local, (), (), HERE))


def test_a_right_kernel_passes():
    verify_kernel(
        ON.kernel(
            assign(X, random("rand", float32)),
            assign(X, binary("*", get(X), uniform(0, float32))),
            write(VERTICES.p, V, get(X), i32(2)),
            reduce(VERTICES.a, V, "+", component(P, i32(0))),
            reduce_global(E, "+", kir.Cast(row_id(V), float64, HERE)),
            uniforms=((2.0, float32),),
        )
    )
