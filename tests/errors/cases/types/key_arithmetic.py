from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    e.head = e.head + 1  #~ E201


step(edges)
