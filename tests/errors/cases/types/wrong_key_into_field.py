from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    e.head = e  #~ E202


step(edges)
