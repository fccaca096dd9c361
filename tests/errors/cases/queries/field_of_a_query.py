from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    v.edges.rest_len = 1.0  #~ E124


step(vertices)
