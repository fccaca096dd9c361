from __future__ import annotations

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

from ebb.compiler import kir
from ebb.compiler.kir_print import text
from ebb.compiler.kir_verify import verify_kernel
from ebb.relations.globals import Global
from ebb.relations.relation import Relation
from ebb.types.types import bool_, float32, float64, int32, matrix, vector

vec3f = vector(float32, 3)


def test_spring_mass_reads_like_python():
    vertices, edges = Relation("vertices", size=2), Relation("edges", size=2)
    edges.new_field("tail", vertices, init=[0, 1])
    edges.new_field("head", vertices, init=[1, 0])
    edges.group_by("tail")
    vertices.new_field("q", vec3f)
    vertices.new_field("force", vec3f)
    on = OnRows(vertices)
    e, dq, energy = local("e", edges.key_type), local("dq", vec3f), Global(float64, 0)
    kernel = on.kernel(
        for_query(
            e, edges.tail, on.row,
            assign(dq, binary("-", read(vertices.q, read(edges.head, get(e))), read(vertices.q, on.row))),
            reduce(vertices.force, on.row, "+", binary("*", kir.Splat(uniform(0, float32), vec3f, HERE), get(dq))),
        ),
        reduce_global(energy, "+", cast(call("dot", get(dq), get(dq)), float64)),
        uniforms=((1.0, float32),),
    )  # fmt: skip
    expected = """\
kernel step(v: vertices)
  uniform $0: float32 = 1.0
  for e: edges in where(edges.tail, v):
    dq: vector(float32, 3) = vertices.q[edges.head[e]] - vertices.q[v]
    vertices.force[v] += vector(float32, 3)($0) * dq
  global0 += float64(dot(dq, dq))"""
    assert text(kernel) == expected


def test_every_form_has_a_text():
    cells = Relation("cells", shape=(3, 4))
    cells.new_field("m", matrix(float32, 2, 2))
    cells.new_field("parent", cells, init=cells_of_themselves())
    cells.group_by("parent")
    on = OnRows(cells, "c")
    i, j, other, x = local("i", int32), local("n", int32), local("n", int32), local("x", float64)
    label = kir.Label("return", 700)
    flag = const(True, bool_)
    shifted = affine(cells, [[1, 0, "1/2"], [0, 1, -1]], on.row, kir.Edge.CLAMP)
    kernel = on.kernel(
        assign(x, random("rand", float64)),
        assign(j, i32(3)),
        assign(other, kir.Choose(flag, get(j), i32(-1), int32, HERE)),
        write(cells.m, on.row, const(((1.0, 0.0), (0.0, 1.0)), matrix(float32, 2, 2))),
        write(cells.m, on.row, kir.Build((const(1, float32),) * 4, matrix(float32, 2, 2), HERE)),
        reduce(cells.m, on.row, "max", const(2.0, float32), i32(0), component(coords(on.row), i32(1))),
        for_range(
            i, i32(0), i32(5), i32(1),
            when(compare("==", get(i), i32(2)), CONTINUE, orelse=(BREAK,)),
        ),
        loop(kir.Unary("not", kir.Logic("or", flag, flag, bool_, HERE), bool_, HERE)),
        kir.Block(label, (kir.Leave(label, HERE),), HERE),
        kir.Assert(compare("!=", shifted, on.row), "moved", HERE),
        kir.Print(("id = ", (row_id(on.row), "3d"), (get(other), "")), HERE),
        assign(other, binary("min", kir.QuerySize(cells.parent, on.row, int32, HERE), get(other))),
        kir.Breakpoint(HERE),
    )  # fmt: skip
    verify_kernel(kernel)
    expected = f"""\
kernel step(c: cells)
  x: float64 = rand(float64)
  n.{j.uid}: int32 = 3
  n.{other.uid}: int32 = n.{j.uid} if True else -1
  cells.m[c] = [[1.0, 0.0], [0.0, 1.0]]f32
  cells.m[c] = [[1f32, 1f32], [1f32, 1f32]]
  cells.m[c][0, coords(c)[1]] max= 2.0f32
  for i: int32 in range(0, 5, 1):
    if i == 2:
      continue
    else:
      break
  while not (True or True):
    pass
  block return:
    leave return
  assert affine(cells, [[1, 0, 1/2], [0, 1, -1]], c, clamp) != c, 'moved'
  print('id = ', id(c):3d, n.{other.uid})
  n.{other.uid} = min(len(where(cells.parent, c)), n.{other.uid})
  breakpoint()"""
    assert text(kernel) == expected


def cells_of_themselves():
    return lambda i, j: (i, j)
