from world import make_mesh

import ebb

vertices, edges = make_mesh()
vertices.mass.load([1.0, 2.0, -1.0, -2.0])


@ebb.kernel
def check(v: vertices):
    assert v.mass > 0  #~ E401


check(vertices)
