from world import make_mesh

import ebb

vertices, edges = make_mesh()
vertices.mass.load([1.0, 0.0, 2.0, 3.0])


@ebb.func
def inverse_mass(v):
    assert v.mass > 0, "a body without mass"  #~ E401
    return 1 / v.mass


@ebb.kernel
def step(v: vertices):
    v.qd = v.force * inverse_mass(v)


step(vertices)
