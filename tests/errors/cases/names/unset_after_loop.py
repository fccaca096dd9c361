from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    for e in v.edges:
        last = e.rest_len
    v.mass = last  #~ E121


step(vertices)
