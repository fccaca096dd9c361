from __future__ import annotations

import io
import pdb
import sys

import numpy as np
import pytest
from kir_forms import (
    BREAK,
    CONTINUE,
    HERE,
    OnRows,
    affine,
    assign,
    binary,
    call,
    cast,
    compare,
    component,
    const,
    coords,
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

import ebb.runtime.random as philox
from ebb.backends.reference import run
from ebb.compiler import kir
from ebb.compiler.kir_verify import verify_kernel
from ebb.diagnostics.span import Span
from ebb.errors import BoundsError, KernelAssertionError, KernelTypeError, RelationError
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import bool_, float32, float64, int32, int64, key, matrix, vector

AT_BREAKPOINT = Span(HERE.source, 3, 4, 3, 16)


def launch(kernel, rows=None, uniforms=(), order=None):
    verify_kernel(kernel)
    run(kernel, rows or kernel.relation, uniforms, order)


@pytest.fixture
def vertices():
    relation = Relation("vertices", size=4)
    relation.new_field("a", float32, init=[1, 2, 3, 4])
    relation.new_field("b", float32)
    relation.new_field("n", int32)
    relation.new_field("p", vector(float32, 3))
    return relation


@pytest.fixture
def on(vertices):
    return OnRows(vertices)


def test_float32_stays_float32(vertices, on):
    vertices.a.load(np.float32(0.1) * np.arange(4, dtype=np.float32))
    product = binary("*", read(vertices.a, on.row), const(0.1, float32))
    launch(on.kernel(write(vertices.b, on.row, product)))
    assert np.array_equal(vertices.b.to_numpy(), vertices.a.to_numpy() * np.float32(0.1))


def test_integers_wrap_and_divide_like_numpy(vertices, on):
    big = i32(2**31 - 1)
    body = [
        write(vertices.n, on.row, binary("+", big, i32(1))),
        when(compare("==", row_id(on.row), const(1, int64)), write(vertices.n, on.row, binary("//", i32(-7), i32(3)))),
        when(compare("==", row_id(on.row), const(2, int64)), write(vertices.n, on.row, binary("%", i32(-7), i32(3)))),
        when(compare("==", row_id(on.row), const(3, int64)), write(vertices.n, on.row, binary("//", i32(7), i32(0)))),
    ]
    launch(on.kernel(*body))
    assert vertices.n.to_numpy().tolist() == [-(2**31), -3, 2, 0]


def test_vectors_are_never_shared(vertices, on):
    x, y = local("x", vector(float32, 3)), local("y", vector(float32, 3))
    body = [
        assign(x, read(vertices.p, on.row)),
        assign(y, get(x)),
        assign(x, const(7, float32), i32(1)),
        write(vertices.p, on.row, const(5, float32), i32(0)),
        write(
            vertices.p,
            on.row,
            get(y),
        ),
        write(vertices.b, on.row, component(get(x), i32(1))),
    ]
    launch(on.kernel(*body))
    assert np.all(vertices.p.to_numpy() == 0) and np.all(vertices.b.to_numpy() == 7)


def test_uniforms_arrive_in_their_type(vertices, on):
    kernel = on.kernel(write(vertices.b, on.row, uniform(0, float32)), uniforms=((2.5, float32),))
    launch(kernel, uniforms=(np.float32(2.5),))
    assert vertices.b.to_numpy().tolist() == [2.5] * 4


def test_matrices_by_row_and_component():
    relation = Relation("tets", size=1)
    relation.new_field("m", matrix(float64, 2, 3), init=[[[1, 2, 3], [4, 5, 6]]])
    relation.new_field("v", vector(float64, 3))
    on = OnRows(relation)
    body = [
        reduce(relation.m, on.row, "+", const(10, float64), i32(1), i32(2)),
        reduce(relation.m, on.row, "max", const((2, 2, 2), vector(float64, 3)), i32(0)),
        write(relation.v, on.row, component(read(relation.m, on.row), i32(1))),
    ]
    launch(on.kernel(*body))
    assert relation.m.to_numpy().tolist() == [[[2, 2, 3], [4, 5, 16]]]
    assert relation.v.to_numpy().tolist() == [[4, 5, 16]]


def test_matmul_and_builtins():
    relation = Relation("tets", size=1)
    relation.new_field("m", matrix(float64, 2, 2), init=[[[1, 2], [3, 4]]])
    relation.new_field("d", float64)
    relation.new_field("w", vector(float64, 2))
    on = OnRows(relation)
    m = read(relation.m, on.row)
    body = [
        write(relation.d, on.row, call("det", m)),
        write(relation.w, on.row, call("matmul", call("inverse", m), const((5, 11), vector(float64, 2)))),
    ]
    launch(on.kernel(*body))
    assert relation.d.to_numpy() == pytest.approx([-2])
    assert relation.w.to_numpy()[0] == pytest.approx([1, 2])


def test_logic_evaluates_only_what_it_needs(vertices, on):
    vertices.new_field("next", vertices)
    unset = compare("==", read(vertices.next, on.row), on.row)
    false = const(False, bool_)
    body = [
        when(kir.Logic("and", false, unset, bool_, HERE), write(vertices.n, on.row, i32(1))),
        when(kir.Logic("or", const(True, bool_), unset, bool_, HERE), write(vertices.n, on.row, i32(2))),
        write(vertices.b, on.row, kir.Choose(const(True, bool_), const(1, float32), const(2, float32), float32, HERE)),
    ]
    launch(on.kernel(*body))
    assert vertices.n.to_numpy().tolist() == [2] * 4


def test_loops_break_continue_and_leave(vertices, on):
    i, total = local("i", int32), local("total", int32)
    label = kir.Label("return", 900)
    body = [
        assign(total, i32(0)),
        for_range(
            i, i32(0), i32(10), i32(1),
            when(compare("==", binary("%", get(i), i32(2)), i32(0)), CONTINUE),
            when(compare(">", get(i), i32(7)), BREAK),
            assign(total, binary("+", get(total), get(i))),
        ),
        loop(
            const(True, bool_),
            assign(total, binary("+", get(total), i32(1))),
            when(compare(">", get(total), i32(20)), BREAK),
        ),
        kir.Block(
            label,
            (
                loop(const(True, bool_), when(compare(">", get(total), i32(0)), kir.Leave(label, HERE))),
                assign(total, i32(-1)),
            ),
            HERE,
        ),
        write(vertices.n, on.row, get(total)),
    ]  # fmt: skip
    launch(on.kernel(*body))
    assert vertices.n.to_numpy().tolist() == [21] * 4


def test_a_range_may_go_down_and_its_step_may_not_be_zero(vertices, on):
    i, total = local("i", int32), local("total", int32)
    add = assign(total, binary("+", binary("*", get(total), i32(10)), get(i)))

    def kernel(step):
        return on.kernel(
            assign(total, i32(0)), for_range(i, i32(3), i32(0), i32(step), add), write(vertices.n, on.row, get(total))
        )

    launch(kernel(-1))
    assert vertices.n.to_numpy().tolist() == [321] * 4
    with pytest.raises(KernelTypeError, match=r"E405.*step"):
        launch(kernel(0))


def mesh():
    vertices = Relation("vertices", size=4)
    edges = Relation("edges", size=6)
    edges.new_field("tail", vertices, init=[2, 0, 2, 1, 0, 2])
    edges.new_field("weight", int32, init=[1, 2, 4, 8, 16, 32])
    vertices.new_field("sum", int32)
    vertices.new_field("digits", int64)
    return vertices, edges


@pytest.mark.parametrize("second", [False, True])
def test_query_loops_and_scatters_agree(second):
    vertices, edges = mesh()
    if second:
        edges.new_field("head", vertices, init=[3, 3, 1, 1, 0, 0])
        edges.group_by("head")
    edges.group_by("tail")
    for grouped in (edges.tail, edges.head) if second else (edges.tail,):
        grouped.grouping.refresh()
    on = OnRows(vertices)
    e = local("e", edges.key_type)
    identity = binary("+", row_id(get(e)), const(1, int64))
    digits = binary("+", binary("*", read(vertices.digits, on.row), const(10, int64)), identity)
    size = kir.QuerySize(edges.tail, on.row, int32, HERE)
    body = for_query(
        e, edges.tail, on.row,
        reduce(vertices.sum, on.row, "+", read(edges.weight, get(e))),
        write(vertices.digits, on.row, digits),
    )  # fmt: skip
    launch(on.kernel(body, reduce(vertices.sum, on.row, "+", binary("*", size, i32(100)))))
    assert vertices.sum.to_numpy().tolist() == [218, 108, 337, 0]
    assert vertices.digits.to_numpy().tolist() == [25, 4, 136, 0]
    vertices.sum.fill(0)
    on = OnRows(edges, "e")
    launch(on.kernel(reduce(vertices.sum, read(edges.tail, on.row), "+", read(edges.weight, on.row))))
    assert vertices.sum.to_numpy().tolist() == [18, 8, 37, 0]


@pytest.mark.parametrize(
    ("op", "type", "values", "before", "after"),
    [
        ("+", int32, [1, 2, 3, 4], 10, 20),
        ("*", float32, [1, 2, 3, 4], 2, 48),
        ("min", float32, [-1, -2, -3, -4], 5, -4),
        ("max", int32, [-1, -2, -3, -4], -9, -1),
        ("max", float64, [-1, -2, -3, -4], -np.inf, -1),
        ("&", int32, [7, 6, 14, 6], -1, 6),
        ("|", bool_, [False, False, True, False], False, True),
        ("&", bool_, [True, True, True, True], False, False),
        ("^", int32, [1, 2, 4, 4], 8, 11),
    ],
)
def test_reductions_into_globals(op, type, values, before, after):
    relation = Relation("rows", size=4)
    relation.new_field("x", type, init=np.array(values, type.dtype))
    total = Global(type, before)
    on = OnRows(relation)
    launch(on.kernel(reduce_global(total, op, read(relation.x, on.row))))
    assert total.value == after
    launch(on.kernel(reduce_global(total, op, read(relation.x, on.row))), order=[3, 1, 0, 2])


def test_a_global_without_rows_keeps_its_value():
    relation = Relation("rows", size=0)
    total = Global(vector(float64, 2), [1, 2])
    on = OnRows(relation)
    launch(on.kernel(reduce_global(total, "+", const(1.0, float64), i32(1))))
    assert total.value.tolist() == [1, 2]


def test_globals_reduce_by_component_and_are_read():
    relation = Relation("rows", size=3)
    total, scale = Global(vector(float64, 2), [1, 2]), Global(float64, 4)
    on = OnRows(relation)
    launch(on.kernel(reduce_global(total, "+", kir.ReadGlobal(scale, float64, HERE), i32(1))))
    assert total.value.tolist() == [1, 14]


def test_casts_saturate_and_truncate(vertices, on):
    vertices.a.load(np.array([2.9, -2.9, np.nan, 1e20], np.float32))
    launch(on.kernel(write(vertices.n, on.row, cast(read(vertices.a, on.row), int32))))
    assert vertices.n.to_numpy().tolist() == [2, -2, 0, 2**31 - 1]


def test_affine_wraps_clamps_and_checks():
    cells = Relation("cells", shape=(3, 4), periodic=(True, False))
    cells.new_field("x", int32, init=np.arange(12, dtype=np.int32).reshape(3, 4))
    cells.new_field("y", int32)
    on = OnRows(cells, "c")

    def shifted(di, dj, edge=kir.Edge.CHECK):
        moved = affine(cells, [[1, 0, di], [0, 1, dj]], on.row, edge)
        return on.kernel(write(cells.y, on.row, read(cells.x, moved)))

    launch(shifted(1, 0))
    assert np.array_equal(cells.y.to_numpy(), np.roll(cells.x.to_numpy(), -1, axis=0))
    launch(shifted(-1, -2, kir.Edge.CLAMP))
    expected = np.roll(cells.x.to_numpy(), 1, axis=0)[:, [0, 0, 0, 1]]
    assert np.array_equal(cells.y.to_numpy(), expected)
    with pytest.raises(BoundsError, match="E403") as caught:
        launch(shifted(0, 1))
    text = str(caught.value)
    assert "cells[0, 4]" in text and "row cells[0, 3]" in text and "4 is not in range(4), dimension 1" in text


def test_affine_floors_fractions_between_grids():
    fine, coarse = Relation("fine", shape=(5,)), Relation("coarse", shape=(3,))
    fine.new_field("at", int32)
    fine.new_field("parent", coarse)
    on = OnRows(fine, "c")
    parent = affine(coarse, [["1/2", "1/2"]], on.row)
    launch(on.kernel(write(fine.parent, on.row, parent), write(fine.at, on.row, component(coords(parent), i32(0)))))
    assert fine.at.to_numpy().tolist() == [0, 1, 1, 2, 2]
    assert fine.parent.to_numpy().ravel().tolist() == [0, 1, 1, 2, 2]


def test_subsets_run_on_their_rows_once(vertices, on):
    vertices.new_subset("some", [2, 0, 2])
    launch(on.kernel(reduce(vertices.n, on.row, "+", i32(1))), rows=vertices.some)
    assert vertices.n.to_numpy().tolist() == [1, 0, 1, 0]


def test_order_is_the_order_of_rows(vertices, on, capsys):
    launch(on.kernel(kir.Print(((row_id(on.row), ""),), HERE)), order=[2, 0, 3, 1])
    assert capsys.readouterr().out.split() == ["2", "0", "3", "1"]


def test_print_shows_what_numpy_shows(vertices, on, capsys):
    vertices.new_subset("one", [1])
    vertices.p.load(np.arange(12).reshape(4, 3) / 4)
    tenth = const(0.1, float32)
    parts = ("x =", (tenth, ""), (tenth, ".3f"), (read(vertices.p, on.row), ""), (read(vertices.p, on.row), ".1f"))
    more = (on.row, ""), (const(True, bool_), ""), (i32(5), "03d")
    spaced = tuple(part for item in (*parts, *more) for part in (item, " "))
    launch(on.kernel(kir.Print(spaced, HERE)), rows=vertices.one)
    expected = "x = 0.1 0.100 [0.75 1.   1.25] [0.8 1.0 1.2] vertices[1] True 005 \n"
    assert capsys.readouterr().out == expected


def test_assert_names_kernel_line_row_and_text(vertices, on):
    check = kir.Assert(compare("<", read(vertices.a, on.row), const(3, float32)), "a must be small", HERE)
    with pytest.raises(KernelAssertionError) as caught:
        launch(on.kernel(check))
    text = str(caught.value)
    for fact in ("E401", "'step'", "vertices[2]", "a must be small", "line 2", "x = v.a"):
        assert fact in text


def test_dynamic_indices_are_checked(vertices, on):
    index = cast(row_id(on.row), int32)
    part = component(read(vertices.p, on.row), index)
    with pytest.raises(BoundsError, match=r"E402.*index 3 is outside"):
        launch(on.kernel(write(vertices.b, on.row, part)))
    with pytest.raises(BoundsError, match=r"(?s)index -1 .*count from the end"):
        negative = binary("-", index, i32(1))
        launch(on.kernel(write(vertices.p, on.row, const(1, float32), negative)))


def test_unset_keys_are_an_error_where_a_key_is_read():
    vertices, edges = Relation("vertices", size=3), Relation("edges", size=2)
    edges.new_field("ends", vector(key(vertices), 2))
    edges.ends.data[...] = [[0, -1], [2, 1]]
    edges.ends.changed()
    edges.new_field("n", int64)
    on = OnRows(edges, "e")
    ends = read(edges.ends, on.row)
    launch(on.kernel(write(edges.n, on.row, row_id(component(ends, i32(0))))))
    assert edges.n.to_numpy().tolist() == [0, 2]
    with pytest.raises(RelationError, match=r"E404.*'edges.ends' of edges\[0\]"):
        launch(on.kernel(write(edges.n, on.row, row_id(component(ends, i32(1))))))
    with pytest.raises(RelationError, match="E404"):
        launch(on.kernel(write(edges.ends, on.row, ends)))


def test_random_numbers_follow_the_row_and_the_launch(vertices, on):
    x, y = local("x", float64), local("y", float32)
    vertices.new_field("r", float64)
    body = on.kernel(
        assign(x, random("rand", float64)), assign(y, random("randn", float32)),
        write(vertices.r, on.row, get(x)), write(vertices.b, on.row, get(y)),
    )  # fmt: skip
    philox.seed(7)
    launch(body)
    first = vertices.r.to_numpy(), vertices.b.to_numpy()
    launch(body)
    assert not np.any(first[0] == vertices.r.to_numpy())
    philox.seed(7)
    launch(body, order=[3, 2, 1, 0])
    assert np.array_equal(first[0], vertices.r.to_numpy()) and np.array_equal(first[1], vertices.b.to_numpy())
    assert np.all((first[0] >= 0) & (first[0] < 1)) and len(set(first[0])) == 4
    assert first[0][2] == philox.draw("rand", float64, philox.LaunchKey(7, 0), 2, 0)


def test_breakpoint_shows_the_row_and_the_locals(vertices, on, monkeypatch):
    seen = {}

    def hook():
        frame = sys._getframe(1)
        seen.update(frame.f_globals, line=frame.f_lineno, file=frame.f_code.co_filename, name=frame.f_code.co_name)

    monkeypatch.setattr(sys, "breakpointhook", hook)
    vertices.new_subset("one", [2])
    x = local("x", float32)
    launch(on.kernel(assign(x, read(vertices.a, on.row)), kir.Breakpoint(AT_BREAKPOINT)), rows=vertices.one)
    assert seen["x"] == 3 and seen["line"] == 3 and seen["file"] == "step_kernel.py" and seen["name"] == "step"
    assert repr(seen["v"]) == "vertices[2]" and seen["v"].a == 3


def test_breakpoint_works_with_pdb(vertices, on, monkeypatch):
    # pytest replaces pdb.set_trace, so this debugger is made by hand, with a typed dialogue.
    dialogue, shown = io.StringIO("p x\np v.a\nl\nc\n"), io.StringIO()
    debugger = pdb.Pdb(stdin=dialogue, stdout=shown, nosigint=True, readrc=False)
    debugger.use_rawinput = False
    monkeypatch.setattr(sys, "breakpointhook", lambda: debugger.set_trace(sys._getframe(1)))
    vertices.new_subset("one", [1])
    x = local("x", float32)
    launch(on.kernel(assign(x, read(vertices.a, on.row)), kir.Breakpoint(AT_BREAKPOINT)), rows=vertices.one)
    out = shown.getvalue()
    assert "step_kernel.py(4)step()" in out and "->\t    v.b = x" in out and out.count("np.float32(2.0)") == 2


def test_ten_thousand_vector_steps():
    relation = Relation("rows", size=1000)
    relation.new_field("x", vector(float32, 3))
    on = OnRows(relation)
    i = local("i", int32)
    step = write(relation.x, on.row, binary("+", read(relation.x, on.row), const((1, 2, 3), vector(float32, 3))))
    launch(on.kernel(for_range(i, i32(0), i32(10), i32(1), step)))
    assert np.all(relation.x.to_numpy() == [10, 20, 30])
