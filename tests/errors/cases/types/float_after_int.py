from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    total = 0
    for e in v.edges:
        total += e.rest_len  #~ E203
    v.mass = total


step(vertices)
