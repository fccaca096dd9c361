"""The code and the caret of what is wrong in kernels."""

from __future__ import annotations

import pytest
from elaborated import make_world

import ebb


@pytest.fixture(scope="module")
def world():
    return make_world()


@pytest.mark.parametrize(
    ("body", "code", "caret"),
    [
        ("x = lambda a: a", "E110", "lambda a: a"),
        ("x = [a for a in offsets]", "E110", "[a for a in offsets]"),
        ("x = [*offsets]", "E110", "*offsets"),
        ("x = v is v", "E110", "v is v"),
        ("x = f'{v.f}'", "E110", "f'{v.f}'"),
        ("for i in range(2): pass\nelse: pass", "E110", "pass"),
        ("v.f", "E111", "v.f"),
        ("-v.f", "E111", "-v.f"),
        ("square(v.f)", "E112", "square(v.f)"),
        ("return v.f", "E113", "return v.f"),
        ("x = 'a'", "E114", "'a'"),
        ("x = None", "E115", "None"),
        ("assert v.b, gravity", "E116", "gravity"),
        ("print(v.f, end='')", "E117", "end=''"),
    ],
)
def test_syntax(world, body, code, caret):
    assert world.errors(body) == [(code, caret)]
    assert type(world.error(body)) is ebb.KernelSyntaxError


@pytest.mark.parametrize(
    ("body", "code", "caret"),
    [
        ("v.f = gravty", "E120", "gravty"),
        ("if v.b: x = 1\nv.i = x", "E121", "x"),
        ("for e in v.edges: pass\ne.x += 1", "E121", "e"),
        ("for i in range(v.i): y = i\nv.i = y", "E121", "y"),
        ("v.i = x\nx = 1", "E122", "x"),
        ("v.d = gravity\ngravity = 1", "E122", "gravity"),
        ("gravity += 1", "E123", "gravity"),
        ("V = 3", "E123", "V"),
        ("square = 3", "E123", "square"),
        ("V.f = 5", "E124", "V.f"),
        ("v.m.T = 3", "E124", "v.m.T"),
        ("x = V.f", None, None),
        ("v.f = V.f", "E125", "V.f"),
        ("v.f = 1 / 0", "E126", "1 / 0"),
        ("v.f = v.nosuch", "E127", "nosuch"),
        ("v.f = v.p.q", "E127", "q"),
        ("v.f = ebb.sqt(v.f)", "E127", "sqt"),
        ("v.f = python_function(v.f)", "E128", "python_function"),
        ("v.f = ping(v.f)", "E129", "ping(x)"),
        ("q = v.edges\nq = v.edges", "E130", "q"),
        ("v.f = v.p + [1, 2]", "E201", "v.p + [1, 2]"),
        ("v.b = 5 < True", "E201", "5 < True"),
        ("v.i = v + 1", "E201", "v + 1"),
        ("v.b = v == v.es[0]", "E201", "v == v.es[0]"),
        ("v.f = v.d", "E202", "v.d"),
        ("v.i += 0.5", "E202", "0.5"),
        ("x = 1\nx = 2.5", "E203", "2.5"),
        ("x = 1.0\nx = True", "E203", "True"),
        ("x = [1, 2, True]", "E204", "[1, 2, True]"),
        ("x = [[1, 2], [3]]", "E204", "[[1, 2], [3]]"),
        ("x = v.p[3.5]", "E205", "3.5"),
        ("x = v.p[3]", "E206", "3"),
        ("x = v.m[0, -4]", "E206", "-4"),
        ("x = v.f[0]", "E207", "v.f[0]"),
        ("x = ebb.vec2f(v.p)", "E208", "ebb.vec2f(v.p)"),
        ("v.i = 2 ** 40", "E210", "2 ** 40"),
        ("v.u = -1", "E210", "-1"),
        ("if v.p: pass", "E211", "v.p"),
        ("v.b = v.b and v.i", "E211", "v.i"),
        ("assert v.p", "E211", "v.p"),
        ("v.f = v.f if v.b else v.p", "E212", "v.f if v.b else v.p"),
        ("v.b += 1", "E213", "v.b += 1"),
        ("x = ebb.length(v.es)", "E220", "v.es"),
        ("x = ebb.cross([1, 2], [3, 4])", "E220", "[1, 2]"),
        ("x = ebb.dot(v.p, [1, 2])", "E220", "ebb.dot(v.p, [1, 2])"),
        ("move_field(v, 'f')", "E221", "move_field(v, 'f')"),
        ("move_field(v, 3, 'f')", "E221", "3"),
        ("x = narrow(v.d)", "E202", "v.d"),
        ("x = reset(v)", "E222", "reset(v)"),
        ("for e in E: pass", "E224", "E"),
        ("a, b = v.p", "E225", None),
        ("for e in ebb.where(E.head, v): pass", "E226", "E.head"),
        ("for e in ebb.where(v.f, v): pass", "E227", "v.f"),
        ("x = ebb.affine(C, [[1, 0, 0]], v)", "E228", "v"),
        ("x = ebb.id(3)", "E229", "3"),
        ("x = ebb.coords(v)", "E229", "v"),
        ("v.edges = 3", "E230", "v.edges"),
        ("v.mate += v", "E230", "v.mate"),
        ("x = ebb.rand(3)", "E231", "ebb.rand(3)"),
        ("for i in range(0.5): pass", "E232", "0.5"),
    ],
)
def test_names_and_types(world, body, code, caret):
    if code is None:
        assert world.kir(body) == "pass"
        return
    (found,) = world.errors(body)
    assert found[0] == code
    assert caret is None or found[1] == caret
    assert type(world.error(body)) is ebb.KernelTypeError


@pytest.mark.parametrize("body", ["G.value = 1", "G = 1", "G.value /= 2", "GV.x = 1"])
def test_globals_are_never_assigned(world, body):
    error = world.error(body)
    assert type(error) is ebb.PhaseError
    assert error.codes == ("E302",)


def test_all_errors_are_reported_and_none_twice(world):
    assert world.errors("v.f = nope\nx = v.nosuch + nope\ny = x + 1\nv.d = y") == [
        ("E120", "nope"),
        ("E127", "nosuch"),
        ("E120", "nope"),
    ]
    assert world.errors("v.f = ping(v.f) + ping(v.d)") == [("E129", "ping(x)")]


def test_columns_are_characters(world):
    (error,) = world.error("é = v.f; ü = é + nope").diagnostics
    assert (error.primary.span.column, error.primary.span.text) == (21, "nope")


def test_inlined_code_says_where_it_is_called_from(world):
    (error,) = world.error("v.f = ping(v.f)").diagnostics
    callers = []
    span = error.primary.span.caller
    while span is not None:
        callers.append(span.text)
        span = span.caller
    assert callers == ["pong(x)", "ping(v.f)"]


def test_a_function_must_return_on_every_way():
    world = make_world()
    world.names["half"] = ebb.func(world.function("if x > 0:\n    return x", "x"))
    world.names["mixed"] = ebb.func(world.function("if x > 0:\n    return x\nreturn [x, x]", "x"))
    assert world.errors("v.f = half(v.f)") == [("E223", "half(v.f)")]
    assert world.errors("v.f = mixed(v.f)")[0][0] == "E212"


def test_offsets_are_known_at_compile_time(world):
    assert world.errors("c.new_t = ebb.affine(C, [[1, 0, n], [0, 1, 0]], c).t", "c, n", (ebb.int32,), "C") == [
        ("E209", "n")
    ]


def test_after_break_an_unrolled_variable_is_not_known(world):
    body = "for x in (1, 2):\n    if v.b: break\n    y = x\nv.i = y"
    assert world.errors(body) == [("E121", "y")]
    assert world.kir("y = 0\n" + body).endswith("V.i[v] = y")
