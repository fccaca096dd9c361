from world import make_mesh

import ebb

vertices, edges = make_mesh()


@ebb.kernel
def step(v: vertices):
    for e in ebb.where(edges.rest_len, v):  #~ E227
        v.mass += 1


step(vertices)
