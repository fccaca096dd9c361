from world import make_mesh

import ebb

vertices, edges = make_mesh()
vertices.new_field("bits", ebb.uint32, init=0)


@ebb.kernel
def step(v: vertices):
    v.bits = v.bits + v.count  #~ E201


step(vertices)
