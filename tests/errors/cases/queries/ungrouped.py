from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    for e in ebb.where(edges.head, v):  #~ E226
        v.mass += e.rest_len


step(vertices)
