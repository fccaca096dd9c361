from world import make_mesh

import ebb

vertices, edges = make_mesh()
vertices.new_field("exact", ebb.float64, init=0.0)


@ebb.kernel
def step(v: vertices):
    v.mass = v.exact  #~ E202


step(vertices)
