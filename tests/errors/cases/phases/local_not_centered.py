from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    k = e.head
    k.mass = 1.0  #~ E303


step(edges)
