from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    k = e.head if e.rest_len > 0 else e  #~ E212


step(edges)
