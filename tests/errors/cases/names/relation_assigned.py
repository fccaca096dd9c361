from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    edges.tail = v  #~ E124


step(vertices)
