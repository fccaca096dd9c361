from __future__ import annotations

from typing import get_args

import pytest
from kir_forms import HERE, OnRows, assign, binary, compare, component, for_range, get, i32, local, read, when, write

from ebb.compiler import kir
from ebb.compiler.kir_walk import (
    bodies,
    children,
    expressions,
    map_bodies,
    map_children,
    map_operands,
    operands,
    statements,
)
from ebb.relations.relation import Relation
from ebb.types.types import int32, vector

FIVE, SIX = i32(5), i32(6)
PASS = kir.Break(HERE)


def filled(node, expr, body):
    """A node of that class with ``expr`` wherever an expression stands and ``body`` wherever a body does."""
    values = {
        "Expr": expr,
        "tuple[Expr, ...]": (expr, expr),
        "Body": (body,),
        "tuple[str | tuple[Expr, str], ...]": ("x", (expr, "d"), (expr, "")),
    }
    return node(**{name: values.get(type_, name) for name, type_ in node.__annotations__.items()})


def other(expr):
    return SIX if expr is FIVE else expr


@pytest.mark.parametrize("node", get_args(kir.Expr), ids=lambda node: node.__name__)
def test_expressions_are_taken_apart_and_put_together(node):
    before, after = filled(node, FIVE, PASS), filled(node, SIX, PASS)
    assert map_children(before, other) == after
    assert map_children(before, lambda expr: expr) is before
    count = sum({"Expr": 1, "tuple[Expr, ...]": 2}.get(type_, 0) for type_ in node.__annotations__.values())
    assert children(before) == (FIVE,) * count


@pytest.mark.parametrize("node", get_args(kir.Stmt), ids=lambda node: node.__name__)
def test_statements_are_taken_apart_and_put_together(node):
    before, after = filled(node, FIVE, PASS), filled(node, SIX, PASS)
    assert map_operands(before, other) == after
    assert map_operands(before, lambda expr: expr) is before
    sizes = {"Expr": 1, "tuple[Expr, ...]": 2, "tuple[str | tuple[Expr, str], ...]": 2}
    assert operands(before) == (FIVE,) * sum(sizes.get(type_, 0) for type_ in node.__annotations__.values())
    stop = kir.Continue(HERE)
    assert map_bodies(before, lambda body: (stop,)) == filled(node, FIVE, stop)
    assert bodies(before) == ((PASS,),) * sum(type_ == "Body" for type_ in node.__annotations__.values())


def test_walks_reach_every_depth():
    rows = Relation("rows", size=1)
    rows.new_field("p", vector(int32, 3))
    on = OnRows(rows)
    i = local("i", int32)
    part = component(read(rows.p, on.row), binary("%", get(i), i32(3)))
    inner = write(rows.p, on.row, part, i32(0))
    branch = when(compare("<", get(i), i32(2)), inner)
    outer = for_range(i, i32(0), i32(9), i32(1), branch, assign(i, i32(1)))
    kernel = on.kernel(outer)
    assert list(statements(kernel.body)) == [outer, branch, inner, outer.body[1]]
    found = list(expressions(kernel.body))
    assert part in found and found.index(part.operand) < found.index(part)
    assert sum(isinstance(node, kir.ReadLocal) and node.local is i for node in found) == 2
