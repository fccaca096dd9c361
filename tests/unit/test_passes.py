from __future__ import annotations

import numpy as np
import pytest

from ebb.backends.reference import interpreter
from ebb.compiler import kir, kir_print
from ebb.compiler.kir_verify import CompilerBug, verify_kernel
from ebb.compiler.passes.flatten_blocks import flatten_blocks
from ebb.compiler.passes.fold_constants import fold_constants
from ebb.compiler.passes.prune_branches import prune_branches
from ebb.compiler.passes.simplify_powers import simplify_powers
from ebb.compiler.pipeline import PASSES, run_passes
from ebb.diagnostics.span import Source, Span
from ebb.records import replace
from ebb.relations.relation import Relation
from ebb.types.types import bool_, float32, float64, int32, vector

HERE = Span(Source("step.py", "step"), 1, 0, 1, 4)
VEC = vector(float64, 2)


class Rows:
    """A relation with a field to read and one to write, and kernels that consist of one value or of statements."""

    def __init__(self, type_=float64, values=(1.5, -2.0, 0.0, 3.0)) -> None:
        self.relation = Relation("rows", size=len(values))
        self.a = self.relation.new_field("a", type_, init=np.array(values, dtype=type_.dtype))
        self.out = self.relation.new_field("out", type_)
        row = kir.Local("r", 0, self.relation.key_type)
        self.row = row
        self.r = kir.ReadLocal(row, row.type, HERE)
        self.read = kir.ReadField(self.a, self.r, type_, HERE)

    def kernel(self, *body: kir.Stmt) -> kir.Kernel:
        return kir.Kernel("step", self.relation, self.row, (), body, HERE)

    def write(self, value: kir.Expr) -> kir.Stmt:
        return kir.WriteField(self.out, self.r, (), value, HERE)

    def run(self, kernel: kir.Kernel):
        verify_kernel(kernel)
        self.out.fill(0)
        interpreter.run(kernel, self.relation, ())
        return self.out.to_numpy()


def const(value, type_=float64):
    return kir.Const(value, type_, HERE)


def binary(op, left, right):
    return kir.Binary(op, left, right, left.type, HERE)


def power(base, exponent):
    value = const(exponent, base.type.scalar)
    return binary("**", base, kir.Splat(value, base.type, HERE) if base.type.shape else value)


def written(kernel):
    (stmt,) = kernel.body
    return stmt.value


# fold_constants

FOLDED = [
    (binary("+", const(2**31 - 1, int32), const(1, int32)), -(2**31)),
    (binary("//", const(-7, int32), const(2, int32)), -4),
    (binary("//", const(7, int32), const(0, int32)), 0),
    (binary("*", const(0.1, float32), const(3.0, float32)), float(np.float32(0.1) * np.float32(3))),
    (kir.Unary("-", const(2.0), float64, HERE), -2.0),
    (kir.Compare("<", const(1.0), const(2.0), bool_, HERE), True),
    (kir.Cast(const(2.9), int32, HERE), 2),
    (kir.Splat(const(2.0), VEC, HERE), (2.0, 2.0)),
    (kir.Build((const(1.0), const(2.0)), VEC, HERE), (1.0, 2.0)),
    (kir.Component(const((1.0, 2.0), VEC), (const(1, int32),), float64, HERE), 2.0),
    (kir.Logic("and", const(True, bool_), const(False, bool_), bool_, HERE), False),
    (kir.Choose(const(False, bool_), const(1.0), const(2.0), float64, HERE), 2.0),
]


@pytest.mark.parametrize(("expr", "value"), FOLDED)
def test_constants_are_folded(expr, value):
    rows = Rows()
    folded = fold_constants(rows.kernel(kir.Assign(kir.Local("x", 1, expr.type), (), expr, HERE)))
    verify_kernel(folded)
    found = written(folded)
    assert isinstance(found, kir.Const)
    assert (found.value, found.type) == (value, expr.type)
    assert type(found.value) is type(value)


def test_what_may_not_run_is_dropped_and_what_must_is_kept():
    rows = Rows()
    zero = kir.Compare("==", rows.read, const(0.0), bool_, HERE)
    both = kir.Logic("or", zero, const(True, bool_), bool_, HERE)
    kept = fold_constants(rows.kernel(kir.Assign(kir.Local("x", 1, bool_), (), both, HERE)))
    assert written(kept) == both
    left = kir.Logic("or", const(True, bool_), zero, bool_, HERE)
    assert written(fold_constants(rows.kernel(kir.Assign(kir.Local("x", 1, bool_), (), left, HERE)))).value is True


def test_a_kernel_without_constants_stays_the_same_object():
    rows = Rows()
    kernel = rows.kernel(rows.write(binary("+", rows.read, rows.read)))
    for run_pass in PASSES:
        assert run_pass(kernel).body is kernel.body


# prune_branches


def test_branches_that_cannot_run_go():
    rows = Rows()
    one, two = rows.write(const(1.0)), rows.write(const(2.0))
    pruned = prune_branches(
        rows.kernel(
            kir.If(const(False, bool_), (one,), (two,), HERE),
            kir.While(const(False, bool_), (one,), HERE),
            kir.While(const(True, bool_), (one, kir.Break(HERE), two), HERE),
        )
    )
    assert pruned.body == (two, kir.While(const(True, bool_), (one, kir.Break(HERE)), HERE))


# flatten_blocks


def test_blocks_that_end_where_they_are_left_go():
    rows = Rows()
    label, other = kir.Label("f", 1), kir.Label("g", 2)
    write = rows.write(const(1.0))
    inner = kir.Block(other, (write, kir.Leave(other, HERE)), HERE)
    assert flatten_blocks(rows.kernel(kir.Block(label, (inner, kir.Leave(label, HERE)), HERE))).body == (write,)


def test_blocks_that_are_left_early_stay():
    rows = Rows()
    label = kir.Label("f", 1)
    zero = kir.Compare("==", rows.read, const(0.0), bool_, HERE)
    block = kir.Block(label, (kir.If(zero, (kir.Leave(label, HERE),), (), HERE), rows.write(const(1.0))), HERE)
    kernel = rows.kernel(block)
    assert flatten_blocks(kernel).body is kernel.body
    assert rows.run(flatten_blocks(kernel)).tolist() == [1.0, 1.0, 0.0, 1.0]


# simplify_powers


@pytest.mark.parametrize("exponent", [-1, 0.5, 1, 2, 3, 4, 5, 2.5])
def test_powers_keep_their_value(exponent):
    rows = Rows(values=(1.5, 4.0, 0.25, 3.0))
    before = rows.kernel(rows.write(power(binary("+", rows.read, rows.read), exponent)))
    after = simplify_powers(before)
    np.testing.assert_array_equal(rows.run(before), rows.run(after))
    assert ("**" in kir_print.text(after)) == (exponent in (5, 2.5))


@pytest.mark.parametrize("exponent", [0, 1, 2, 3, 4, -1])
def test_powers_of_integers_are_exact(exponent):
    rows = Rows(int32, (-3, 2, 1, 70000))
    before = rows.kernel(rows.write(power(rows.read, exponent)))
    after = simplify_powers(before)
    np.testing.assert_array_equal(rows.run(before), rows.run(after))
    assert ("**" in kir_print.text(after)) == (exponent in (0, -1))


def test_powers_of_vectors():
    rows = Rows(VEC, ((1.0, 2.0), (3.0, -4.0)))
    before = rows.kernel(rows.write(power(rows.read, 3)))
    after = fold_constants(before)
    for kernel in (simplify_powers(before), simplify_powers(after)):
        assert rows.run(kernel).tolist() == [[1.0, 8.0], [27.0, -64.0]]
        assert "**" not in kir_print.text(kernel)


def test_the_base_is_evaluated_once():
    rows = Rows()
    after = simplify_powers(rows.kernel(rows.write(power(power(rows.read, 2), 4))))
    assert kir_print.text(after).count(".a") == 1
    assert rows.run(after).tolist() == [1.5**8, 256.0, 0.0, 6561.0]


def test_what_depends_on_a_condition_is_not_evaluated_before_it():
    rows = Rows()
    zero = kir.Compare("==", rows.read, const(0.0), bool_, HERE)
    bound = kir.Local("x", 7, float64)
    name = kir.ReadLocal(bound, float64, HERE)
    chosen = kir.Choose(zero, power(rows.read, 2), power(name, 4), float64, HERE)
    kernel = rows.kernel(kir.Assign(bound, (), rows.read, HERE), rows.write(chosen))
    after = simplify_powers(kernel)
    assert kir_print.text(after).count("**") == 1  # the one whose base would have to be read first
    np.testing.assert_array_equal(rows.run(kernel), rows.run(after))


def test_the_condition_of_a_loop_stays_in_the_loop():
    rows = Rows(values=(1.0, 2.0, 3.0, 5.0))
    small = kir.Compare("<", power(kir.ReadField(rows.out, rows.r, float64, HERE), 2), const(10.0), bool_, HERE)
    loop = kir.While(small, (kir.ReduceField(rows.out, rows.r, (), kir.ReduceOp.ADD, rows.read, HERE),), HERE)
    assert rows.run(simplify_powers(rows.kernel(loop))).tolist() == [4.0, 4.0, 6.0, 5.0]


# The driver


def test_a_broken_pass_is_blamed_by_name():
    rows = Rows()

    def break_types(kernel: kir.Kernel) -> kir.Kernel:
        return replace(kernel, body=(rows.write(const(1, int32)),))

    with pytest.raises(CompilerBug, match="'step' after break_types"):
        run_passes(rows.kernel(rows.write(rows.read)), (break_types,))


def test_dumps_go_to_stderr(monkeypatch, capsys):
    rows = Rows()
    kernel = rows.kernel(rows.write(binary("+", const(1.0), const(2.0))))
    for asked, count in (("", 0), ("other", 0), ("other,step", 2), ("all", 2)):
        monkeypatch.setenv("EBB_DUMP", asked)
        run_passes(kernel)
        assert capsys.readouterr().err.count("# step after") == count
