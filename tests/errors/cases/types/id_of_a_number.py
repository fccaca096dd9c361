from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.count = ebb.int32(ebb.id(v.mass))  #~ E229


step(vertices)
