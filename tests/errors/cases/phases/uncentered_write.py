from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    e.head.q = [0, 0, 0]  #~ E303


step(edges)
