from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(e: edges):
    for other in ebb.where(edges.tail, e):  #~ E202
        e.rest_len += other.rest_len


step(edges)
