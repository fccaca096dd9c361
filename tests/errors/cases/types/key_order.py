from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    if e.head < e.tail:  #~ E201
        e.rest_len = 0


step(edges)
