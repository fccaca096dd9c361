from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.mass = sum(e.rest_len for e in v.edges)  #~ E110


step(vertices)
