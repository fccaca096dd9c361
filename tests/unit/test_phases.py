from __future__ import annotations

from fractions import Fraction

import pytest

from ebb.compiler import kir
from ebb.compiler.kir import ReduceOp
from ebb.compiler.phases.centered import find_centered
from ebb.compiler.phases.check import check_phases
from ebb.compiler.phases.table import PhaseKind
from ebb.diagnostics.span import Source, Span
from ebb.errors import PhaseError
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import bool_, float64

TEXT = """\
def step(v: vertices):
    for e in v.edges:
        dq = e.head.q - v.q
        v.force += dq
    v.q += dt * v.force
"""
SOURCE = Source("step.py", TEXT)
ADD, MULTIPLY = ReduceOp.ADD, ReduceOp.MULTIPLY


def at(text: str, source: Source = SOURCE, caller: Span | None = None) -> Span:
    for number, line in enumerate(source.text.splitlines(), 1):
        if text in line:
            column = line.index(text)
            return Span(source, number, column, number, column + len(text), caller)
    raise AssertionError(text)


HERE = at("step")


class Mesh:
    """Two relations, and constructors of KIR on them: ``v`` is the kernel's own row, ``head`` another."""

    def __init__(self) -> None:
        self.vertices = Relation("vertices", size=4)
        self.edges = Relation("edges", size=6)
        self.q = self.vertices.new_field("q", float64)
        self.force = self.vertices.new_field("force", float64)
        self.next = self.vertices.new_field("next", self.vertices)
        self.tail = self.edges.new_field("tail", self.vertices)
        self.head = self.edges.new_field("head", self.vertices)
        self.row = kir.Local("v", 0, self.vertices.key_type)
        self.v = kir.ReadLocal(self.row, self.row.type, HERE)
        self.other = kir.ReadField(self.next, self.v, self.vertices.key_type, HERE)

    def read(self, field, key, span=HERE):
        return kir.ReadField(field, key, field.type, span)

    def keep(self, value, uid=50):
        return kir.Assign(kir.Local("x", uid, value.type), (), value, HERE)

    def write(self, field, key, value=None, span=HERE):
        return kir.WriteField(field, key, (), value or one, span)

    def reduce(self, field, key, op=ADD, value=None, span=HERE):
        return kir.ReduceField(field, key, (), op, value or one, span)

    def kernel(self, *body):
        return kir.Kernel("step", self.vertices, self.row, (), body, HERE)

    def bind(self, name, uid, value):
        local = kir.Local(name, uid, value.type)
        return kir.Assign(local, (), value, HERE), kir.ReadLocal(local, local.type, HERE)


one = kir.Const(1.0, float64, HERE)


@pytest.fixture
def mesh() -> Mesh:
    return Mesh()


def phase(mesh, *body, field=None):
    return check_phases(mesh.kernel(*body)).fields[field or mesh.q]


def errors(mesh, *body):
    with pytest.raises(PhaseError) as caught:
        check_phases(mesh.kernel(*body))
    return caught.value.diagnostics


def test_centered_uses_may_be_mixed(mesh):
    found = phase(
        mesh,
        mesh.keep(mesh.read(mesh.q, mesh.v)),
        mesh.write(mesh.q, mesh.v),
        mesh.reduce(mesh.q, mesh.v),
        mesh.reduce(mesh.q, mesh.v, MULTIPLY),
    )
    assert (found.kind, found.op, found.centered_only) == (PhaseKind.EXCLUSIVE, None, True)
    assert found.read and found.written and found.reduced and found.changed


def test_reads_of_any_row_are_read(mesh):
    found = phase(mesh, mesh.keep(mesh.read(mesh.q, mesh.v)), mesh.keep(mesh.read(mesh.q, mesh.other), 51))
    assert (found.kind, found.centered_only, found.changed) == (PhaseKind.READ, False, False)


def test_reductions_of_any_row_with_one_operator_are_a_reduction(mesh):
    found = phase(mesh, mesh.reduce(mesh.q, mesh.v), mesh.reduce(mesh.q, mesh.other))
    assert (found.kind, found.op, str(found)) == (PhaseKind.REDUCE, ADD, "REDUCE(+)")


REJECTED = {
    "U write": ("E303", lambda m: [m.write(m.q, m.other)]),
    "U read + C write": ("E301", lambda m: [m.keep(m.read(m.q, m.other)), m.write(m.q, m.v)]),
    "U read + C reduce": ("E301", lambda m: [m.keep(m.read(m.q, m.other)), m.reduce(m.q, m.v)]),
    "U read + U reduce": ("E301", lambda m: [m.keep(m.read(m.q, m.other)), m.reduce(m.q, m.other)]),
    "U reduce + C read": ("E301", lambda m: [m.reduce(m.q, m.other), m.keep(m.read(m.q, m.v))]),
    "U reduce + C write": ("E301", lambda m: [m.reduce(m.q, m.other), m.write(m.q, m.v)]),
    "U reduce + U other": ("E301", lambda m: [m.reduce(m.q, m.other), m.reduce(m.q, m.other, MULTIPLY)]),
    "U reduce + C other": ("E301", lambda m: [m.reduce(m.q, m.other), m.reduce(m.q, m.v, MULTIPLY)]),
}


@pytest.mark.parametrize("case", REJECTED)
@pytest.mark.parametrize("turned", [False, True])
def test_rejected_mixtures(mesh, case, turned):
    code, build = REJECTED[case]
    body = build(mesh)
    (found,) = errors(mesh, *(reversed(body) if turned else body))
    assert found.code == code
    assert found.place == "vertices.q"


def test_branches_do_not_matter(mesh):
    condition = kir.Const(True, bool_, HERE)
    body = kir.If(condition, (mesh.keep(mesh.read(mesh.q, mesh.other)),), (mesh.write(mesh.q, mesh.v),), HERE)
    assert [error.code for error in errors(mesh, body)] == ["E301"]


def test_following_a_key_reads_it(mesh):
    read = mesh.keep(mesh.read(mesh.q, mesh.read(mesh.next, mesh.other)))
    (found,) = errors(mesh, read, mesh.write(mesh.next, mesh.v, mesh.v))
    assert found.place == "vertices.next"


def test_a_query_reads_the_grouped_field_of_all_rows(mesh):
    edge = kir.Local("e", 1, mesh.edges.key_type)
    loop = kir.ForQuery(edge, mesh.tail, mesh.v, (), HERE)
    found = phase(mesh, loop, field=mesh.tail)
    assert (found.kind, found.centered_only, found.queried) == (PhaseKind.READ, False, True)
    turn = kir.ForQuery(
        edge, mesh.tail, mesh.v, (mesh.write(mesh.tail, kir.ReadLocal(edge, edge.type, HERE), mesh.v),), HERE
    )
    (conflict,) = errors(mesh, turn)
    assert conflict.code == "E303" and "grouping" in conflict.secondary[0].text


def test_all_conflicts_are_reported(mesh):
    found = errors(
        mesh,
        mesh.write(mesh.q, mesh.other),
        mesh.reduce(mesh.force, mesh.other),
        mesh.keep(mesh.read(mesh.force, mesh.v)),
    )
    assert [error.code for error in found] == ["E303", "E301"]


# Centered keys


def test_a_local_bound_once_to_the_row_is_centered(mesh):
    bind, k = mesh.bind("k", 1, mesh.v)
    bind_again, j = mesh.bind("j", 2, k)
    assert phase(mesh, bind, bind_again, mesh.write(mesh.q, j)).centered_only


def test_a_local_bound_twice_is_not(mesh):
    bind, k = mesh.bind("k", 1, mesh.v)
    rebind, _ = mesh.bind("k", 1, mesh.v)
    assert errors(mesh, bind, rebind, mesh.write(mesh.q, k))[0].code == "E303"


def test_a_local_bound_to_another_row_is_not(mesh):
    bind, k = mesh.bind("k", 1, mesh.other)
    assert errors(mesh, bind, mesh.write(mesh.q, k))[0].code == "E303"


def test_a_rebound_parameter_is_not_centered(mesh):
    rebind = kir.Assign(mesh.row, (), mesh.other, HERE)
    assert not find_centered(mesh.kernel(rebind)).is_centered(mesh.v)


def affine(relation, key, matrix):
    entries = tuple(tuple(Fraction(entry) for entry in row) for row in matrix)
    return kir.Affine(entries, key, kir.Edge.CHECK, relation.key_type, HERE)


def test_an_identity_affine_map_is_centered():
    cells = Relation("cells", shape=(3, 4))
    corners = Relation("corners", shape=(3, 4))
    row = kir.Local("c", 0, cells.key_type)
    c = kir.ReadLocal(row, row.type, HERE)
    centered = find_centered(kir.Kernel("step", cells, row, (), (), HERE))
    identity = [[1, 0, 0], [0, 1, 0]]
    assert centered.is_centered(affine(cells, affine(cells, c, identity), identity))
    assert not centered.is_centered(affine(cells, c, [[1, 0, 1], [0, 1, 0]]))
    assert not centered.is_centered(affine(cells, c, [[0, 1, 0], [1, 0, 0]]))
    assert not centered.is_centered(affine(corners, c, identity))


# Globals


def test_two_globals_may_be_reduced(mesh):
    total, top = Global(float64, 0.0), Global(float64, 0.0)
    body = (
        kir.ReduceGlobal(total, (), ADD, one, HERE),
        kir.ReduceGlobal(total, (), ADD, one, HERE),
        kir.ReduceGlobal(top, (), ReduceOp.MAX, one, HERE),
    )
    table = check_phases(mesh.kernel(*body))
    assert [str(found) for found in table.globals.values()] == ["REDUCE(+)", "REDUCE(max)"]


@pytest.mark.parametrize("second", ["read", "other operator"])
def test_a_global_in_two_phases(mesh, second):
    total = Global(float64, 0.0)
    other = mesh.keep(kir.ReadGlobal(total, float64, HERE))
    if second == "other operator":
        other = kir.ReduceGlobal(total, (), MULTIPLY, one, HERE)
    (found,) = errors(mesh, kir.ReduceGlobal(total, (), ADD, one, HERE), other)
    assert found.code == "E304"


# What the message says


def test_the_merged_spring_mass_kernel_fails_on_q_and_not_on_force(mesh):
    edge = kir.Local("e", 1, mesh.edges.key_type)
    e = kir.ReadLocal(edge, edge.type, HERE)
    dq = kir.Local("dq", 2, float64)
    loop = kir.ForQuery(
        edge,
        mesh.tail,
        mesh.v,
        (
            kir.Assign(
                dq,
                (),
                kir.Binary(
                    "-",
                    mesh.read(mesh.q, mesh.read(mesh.head, e), at("e.head.q")),
                    mesh.read(mesh.q, mesh.v),
                    float64,
                    HERE,
                ),
                HERE,
            ),
            mesh.reduce(mesh.force, mesh.v, ADD, kir.ReadLocal(dq, float64, HERE)),
        ),
        HERE,
    )
    move = mesh.reduce(mesh.q, mesh.v, ADD, mesh.read(mesh.force, mesh.v), Span(SOURCE, 5, 4, 5, 7))
    with pytest.raises(PhaseError) as caught:
        check_phases(mesh.kernel(loop, move))
    assert str(caught.value) == (
        "error[E301]: field 'vertices.q' is in two phases in kernel 'step'\n"
        ' --> File "step.py", line 5\n'
        "  |\n"
        "3 |         dq = e.head.q - v.q\n"
        "  |              -------- READ: the 'q' of another row\n"
        "5 |     v.q += dt * v.force\n"
        "  |     ^^^ REDUCE(+): changes the 'q' of this row, which other rows read\n"
        "  |\n"
        "  = note: all rows of 'vertices' run at once, so a field is only read, or only reduced with one\n"
        "          operator, or touched only at the kernel's own row 'v'\n"
        "  = hint: write the new value to a second field and swap the two after the launch, or split the\n"
        "          kernel\n"
        "  = more: ebb explain E301"
    )
