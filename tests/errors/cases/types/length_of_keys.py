from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    e.rest_len = ebb.length([e.head, e.tail])  #~ E220


step(edges)
