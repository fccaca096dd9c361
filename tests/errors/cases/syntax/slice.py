from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = ebb.length(v.q[0:2])  #~ E110


step(vertices)
