"""Short constructors of KIR for hand-built kernels in tests."""

from __future__ import annotations

from fractions import Fraction
from itertools import count

from ebb.compiler import kir
from ebb.compiler.host import HostConst, HostValue
from ebb.diagnostics.span import Source, Span
from ebb.types.rules import binary_type
from ebb.types.types import bool_, int32, int64, shaped_type, vector, with_scalar

TEXT = """\
def step(v: vertices):
    x = v.a
    breakpoint()
    v.b = x
"""
SOURCE = Source("step_kernel.py", TEXT)
HERE = Span(SOURCE, 2, 4, 2, 11)
_uids = count(1)


def local(name, type):
    return kir.Local(name, next(_uids), type)


def get(variable):
    return kir.ReadLocal(variable, variable.type, HERE)


def const(value, type):
    return kir.Const(value, type, HERE)


def i32(value):
    return const(value, int32)


def read(field, key):
    return kir.ReadField(field, key, field.type, HERE)


def binary(op, left, right):
    types = binary_type(op, left.type, right.type)
    assert types.left == left.type and types.right == right.type
    return kir.Binary(op, left, right, types.result, HERE)


def compare(op, left, right):
    return kir.Compare(op, left, right, with_scalar(left.type, bool_), HERE)


def cast(operand, type):
    return kir.Cast(operand, type, HERE)


def component(operand, *indices):
    type = shaped_type(operand.type.scalar, operand.type.shape[len(indices) :])
    return kir.Component(operand, indices, type, HERE)


def call(name, *arguments):
    from ebb.types.builtins import BUILTINS

    signature = BUILTINS[name].signature(tuple(argument.type for argument in arguments))
    return kir.Call(name, arguments, signature.result, HERE)


def affine(target, matrix, key, edge=kir.Edge.CHECK):
    rows = tuple(tuple(Fraction(entry) for entry in row) for row in matrix)
    return kir.Affine(rows, key, edge, target.key_type, HERE)


def row_id(key):
    return kir.RowId(key, int64, HERE)


def coords(key):
    return kir.Coords(key, vector(int32, key.type.target.ndim), HERE)


def assign(variable, value, *indices):
    return kir.Assign(variable, indices, value, HERE)


def write(field, key, value, *indices):
    return kir.WriteField(field, key, indices, value, HERE)


def reduce(field, key, op, value, *indices):
    return kir.ReduceField(field, key, indices, kir.ReduceOp(op), value, HERE)


def reduce_global(globl, op, value, *indices):
    return kir.ReduceGlobal(globl, indices, kir.ReduceOp(op), value, HERE)


def when(condition, *then, orelse=()):
    return kir.If(condition, then, orelse, HERE)


def for_range(variable, start, stop, step, *body):
    return kir.ForRange(variable, start, stop, step, body, HERE)


def for_query(variable, index, key, *body):
    return kir.ForQuery(variable, index, key, body, HERE)


def loop(condition, *body):
    return kir.While(condition, body, HERE)


def uniform(index, type):
    return kir.Uniform(index, type, HERE)


def random(distribution, type):
    return kir.Random(distribution, type, HERE)


BREAK, CONTINUE = kir.Break(HERE), kir.Continue(HERE)


class OnRows:
    """A relation and the constructors that need its row: ``OnRows(vertices).kernel(...)``."""

    def __init__(self, relation, name="v"):
        self.relation = relation
        self.local = local(name, relation.key_type)
        self.row = get(self.local)

    def kernel(self, *body, uniforms=()):
        values = tuple(HostValue(HostConst(value), type) for value, type in uniforms)
        return kir.Kernel("step", self.relation, self.local, values, body, HERE)
